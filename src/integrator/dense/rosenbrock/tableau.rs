//! Coefficients of the Rosenbrock methods Rodas4 and Rodas5P, in the transformed form with u instead of k, which needs no product with the
//! Jacobian.
//!
//! E. Hairer, G. Wanner, *Solving Ordinary Differential Equations II*, 2nd ed., sections IV.7 and VI.4, with the digits of their code
//! `rodas.f`; G. Steinebach, *Construction of Rosenbrock–Wanner method Rodas5P*, BIT 63 (2023). Both are stiffly accurate: the last stages
//! are at the end of the step, and the last u is the difference from the embedded solution.

use crate::integrator::dense::Scheme;

/// Largest number of stages.
pub(super) const MAX_STAGES: usize = 8;

/// Coefficients of a Rosenbrock method.
pub(in super::super) trait Tableau: Sized {
    /// Scheme of the method.
    const SCHEME: Scheme;
    /// Number of stages.
    const STAGES: usize;
    /// Coefficient γ of the matrix 1/(hγ) − J.
    const GAMMA: f64;
    /// Coefficients aᵢⱼ of the stages; the last row is the end of the step.
    const A: [[f64; MAX_STAGES]; MAX_STAGES + 1];
    /// Coefficients cᵢⱼ of earlier u in the right-hand side of each stage, times the step.
    const C: [[f64; MAX_STAGES]; MAX_STAGES];
    /// Coefficients of the authors' dense output y₀ (1−θ) + θ (y₁ + (1−θ) (k₁ + θ (k₂ + θ k₃))); each k is a sum of u.
    const DENSE: [[f64; MAX_STAGES]; 3];
    /// Coefficients of u in the middle of the step, which are added to the mean of both ends.
    const MIDDLE: [f64; MAX_STAGES] = {
        let mut middle = [0.0; MAX_STAGES];
        let mut i = 0;
        while i < MAX_STAGES {
            middle[i] = 0.25 * (Self::DENSE[0][i] + 0.5 * Self::DENSE[1][i] + 0.25 * Self::DENSE[2][i]);
            i += 1;
        }
        middle
    };
    /// Quadrature weights of the stages, with the order of the method.
    const QUADRATURE: [f64; MAX_STAGES] = weights::<Self>(&Self::A[MAX_STAGES]);
    /// Quadrature weights of the error estimate.
    const QUADRATURE_ERROR: [f64; MAX_STAGES] = {
        let mut last = [0.0; MAX_STAGES];
        last[Self::STAGES - 1] = 1.0;
        weights::<Self>(&last)
    };
}

/// Quadrature weights b = γ (1 − γ Cᵀ)⁻¹ m for a sum of u with coefficients m, computed backward from the last stage. For a component that
/// depends only on the others, the sum is h Σ bᵢ (derivative at stage i + its change along uᵢ).
const fn weights<T: Tableau>(coefficients: &[f64; MAX_STAGES]) -> [f64; MAX_STAGES] {
    let mut weights = *coefficients;
    let mut i = MAX_STAGES;
    while i > 0 {
        i -= 1;
        let mut j = i + 1;
        while j < MAX_STAGES {
            weights[i] += T::C[j][i] * weights[j];
            j += 1;
        }
        weights[i] *= T::GAMMA;
    }
    weights
}

/// Rodas4 (Hairer and Wanner): order 4, error estimate of order 3.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Rodas4;

impl Tableau for Rodas4 {
    const SCHEME: Scheme = Scheme::Rodas4;
    const STAGES: usize = 6;
    const GAMMA: f64 = 0.25;
    const A: [[f64; MAX_STAGES]; MAX_STAGES + 1] = [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1.544, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.9466785280815826, 0.2557011698983284, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3.314825187068521, 2.896124015972201, 0.9986419139977817, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895, 0.0, 0.0, 0.0, 0.0],
        [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895, 1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1.221224509226641, 6.019134481288629, 12.53708332932087, -0.687886036105895, 1.0, 1.0, 0.0, 0.0],
    ];
    const C: [[f64; MAX_STAGES]; MAX_STAGES] = [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [-5.6688, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [-2.430093356833875, -0.2063599157091915, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [-0.1073529058151375, -9.594562251023355, -20.47028614809616, 0.0, 0.0, 0.0, 0.0, 0.0],
        [7.496443313967647, -10.24680431464352, -33.99990352819905, 11.7089089320616, 0.0, 0.0, 0.0, 0.0],
        [8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ];
    const DENSE: [[f64; MAX_STAGES]; 3] = [
        [10.12623508344586, -7.487995877610167, -34.80091861555747, -7.992771707568823, 1.025137723295662, 0.0, 0.0, 0.0],
        [-0.6762803392801253, 6.087714651680015, 16.43084320892478, 24.76722511418386, -6.594389125716872, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    ];
}

/// Rodas5P (Steinebach): order 5, error estimate of order 4.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Rodas5p;

impl Tableau for Rodas5p {
    const SCHEME: Scheme = Scheme::Rodas5p;
    const STAGES: usize = 8;
    const GAMMA: f64 = 0.21193756319429014;
    const A: [[f64; MAX_STAGES]; MAX_STAGES + 1] = [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [2.849394379747939, 0.45842242204463923, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [-6.954028509809101, 2.489845061869568, -10.358996098473584, 0.0, 0.0, 0.0, 0.0, 0.0],
        [2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641, 0.0, 0.0, 0.0, 0.0],
        [-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946, 0.0, 0.0, 0.0],
        [-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946, 1.0, 0.0, 0.0],
        [-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946, 1.0, 1.0, 0.0],
        [-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946, 1.0, 1.0, 1.0],
    ];
    const C: [[f64; MAX_STAGES]; MAX_STAGES] = [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [-14.155112264123755, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [-17.97296035885952, -2.859693295451294, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [147.12150275711716, -1.41221402718213, 71.68940251302358, 0.0, 0.0, 0.0, 0.0, 0.0],
        [165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306, 0.0, 0.0, 0.0, 0.0],
        [24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471, 0.0, 0.0, 0.0],
        [
            30.91273214028599,
            -3.1208243349937974,
            77.79954646070892,
            34.28646028294783,
            -19.097331116725623,
            -28.087943162872662,
            0.0,
            0.0,
        ],
        [
            37.80277123390563,
            -3.2571969029072276,
            112.26918849496327,
            66.9347231244047,
            -40.06618937091002,
            -54.66780262877968,
            -9.48861652309627,
            0.0,
        ],
    ];
    const DENSE: [[f64; MAX_STAGES]; 3] = [
        [
            25.948786856663858,
            -2.5579724845846235,
            10.433815404888879,
            -2.3679251022685204,
            0.524948541321073,
            1.1241088310450404,
            0.4272876194431874,
            -0.17202221070155493,
        ],
        [
            -9.91568850695171,
            -0.9689944594115154,
            3.0438037242978453,
            -24.495224566215796,
            20.176138334709044,
            15.98066361424651,
            -6.789040303419874,
            -6.710236069923372,
        ],
        [
            11.419903575922262,
            2.8879645146136994,
            72.92137995996029,
            80.12511834622643,
            -52.072871366152654,
            -59.78993625266729,
            -0.15582684282751913,
            4.883087185713722,
        ],
    ];
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks order conditions of the quadratures, which a wrong digit would violate.
    fn check<T: Tableau>() {
        let sum = |row: &[f64; MAX_STAGES]| row.iter().sum::<f64>();
        // Coefficients of up to 112 cancel.
        assert!((sum(&T::QUADRATURE) - 1.0).abs() < 1e-12, "weights of the step: {}", sum(&T::QUADRATURE));
        assert!(sum(&T::QUADRATURE_ERROR).abs() < 1e-12, "weights of the error: {}", sum(&T::QUADRATURE_ERROR));
        // For a constant derivative each stage is at its time, and the end of the step at 1.
        let mut u = [0.0; MAX_STAGES];
        let combine = |u: &[f64; MAX_STAGES], row: &[f64; MAX_STAGES]| row.iter().zip(u).map(|(a, u)| a * u).sum::<f64>();
        for stage in 0..T::STAGES {
            u[stage] = T::GAMMA * (1.0 + combine(&u, &T::C[stage]));
        }
        assert!((combine(&u, &T::A[MAX_STAGES]) - 1.0).abs() < 1e-12, "the end of the step: {}", combine(&u, &T::A[MAX_STAGES]));
        // For a motion at constant rate, the middle is the mean of both ends.
        assert!(combine(&u, &T::MIDDLE).abs() < 1e-12, "the middle: {}", combine(&u, &T::MIDDLE));
    }

    #[test]
    fn weights_satisfy_quadrature_conditions() {
        check::<Rodas4>();
        check::<Rodas5p>();
    }
}
