//! Tsit5, an explicit Runge–Kutta method of order 5 with six stages, for inputs that change so often that no higher order pays.
//!
//! Ch. Tsitouras, *Runge–Kutta pairs of order 5(4) satisfying only the first column simplifying assumption*, Computers and Mathematics with
//! Applications 62 (2011). The author's error estimate needs the derivative at the end of the step as a seventh stage, which would be
//! discarded when inputs change. The estimate here uses the six stages.

use super::{MAX_STAGES, Scheme, Stages, Tableau, Weights};
use crate::integrator::dense::trial::StageDerivative;
use crate::integrator::dense_output::Interpolant;
use crate::integrator::{State, System};

/// Number of stages.
const STAGES: usize = 6;
/// Row of the end of the step.
const END: usize = STAGES;
/// Row of the error estimate of order 3: embedded solution minus solution. Only the solution itself satisfies the eight conditions of
/// order 4. Among directions that satisfy the four conditions of order 3, this one violates the other four least, by 0.0006 (root of the
/// sum of squares, weighted as in the expansion of the error). Its length makes its terms of order 5 as large as in the author's estimate,
/// 0.001.
const ERROR: usize = END + 1;
/// Row of the error estimate of order 2: the direction that violates the two conditions of order 3 most. With its length the estimate is as
/// large as the author's for short steps.
const COARSE: usize = END + 2;

/// Coefficients of the stages, then rows [`END`], [`ERROR`] and [`COARSE`].
const WEIGHTS: [[f64; STAGES]; STAGES + 3] = [
    [0.0; STAGES],
    [0.161, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-0.008480655492356989, 0.335480655492357, 0.0, 0.0, 0.0, 0.0],
    [2.8971530571054935, -6.359448489975075, 4.3622954328695815, 0.0, 0.0, 0.0],
    [5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525, 0.0, 0.0],
    [5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383, 0.0],
    [0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774],
    [
        0.003014534158676784,
        -0.0015531644641268323,
        -0.0034780779268492137,
        -0.04479532242331361,
        0.2557691044049442,
        -0.20895707374933137,
    ],
    [
        -0.0015344258113236782,
        0.0005169932978093094,
        0.0015821823673065846,
        0.00043533664844560833,
        -0.0003841888054910146,
        -0.0006158976967468101,
    ],
];

/// Fills a row with zeros for stages that the method does not have.
const fn full(row: usize) -> Weights {
    let mut weights = [0.0; MAX_STAGES];
    let mut stage = 0;
    while stage < STAGES {
        weights[stage] = WEIGHTS[row][stage];
        stage += 1;
    }
    weights
}

/// The method of order 5, with six stages.
pub(in super::super) struct Tsit5;

impl Tableau for Tsit5 {
    const SCHEME: Scheme = Scheme::Tsit5;
    const STAGES: usize = STAGES;
    const A: [Weights; MAX_STAGES] = {
        let mut stages = [[0.0; MAX_STAGES]; MAX_STAGES];
        let mut stage = 0;
        while stage < STAGES {
            stages[stage] = full(stage);
            stage += 1;
        }
        stages
    };
    const END: Weights = full(END);
    const FINE: Weights = full(ERROR);
    const COARSE: Weights = full(COARSE);
    const DAMPING: f64 = 1.0;
    const SECOND: Option<Weights> = None;

    fn dense<const N: usize, const M: usize, S: System<N, M>>(
        stages: &Stages<N>,
        _: &S,
        _: f64,
        [from, to]: [&State<N, M>; 2],
    ) -> [StageDerivative<N>; 4] {
        StageDerivative::of_positions(Interpolant::between([[from.q, from.v, from.a], [to.q, to.v, to.a]], stages.h))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dot(x: &[f64; STAGES], y: &[f64; STAGES]) -> f64 {
        x.iter().zip(y).map(|(x, y)| x * y).sum()
    }

    /// Order conditions of trees with up to three vertices: sums that are 0 for estimates, and 1, 1/2, 1/3, 1/6 for the solution.
    fn conditions(weights: &[f64; STAGES]) -> [f64; 4] {
        let times: [f64; STAGES] = std::array::from_fn(|i| dot(&WEIGHTS[i], &[1.0; STAGES]));
        let squares = times.map(|time| time * time);
        let sums = std::array::from_fn(|i| dot(&WEIGHTS[i], &times));
        [&[1.0; STAGES], &times, &squares, &sums].map(|sums| dot(weights, sums))
    }

    #[test]
    fn estimates_are_of_orders_3_and_2() {
        // Round-off of sums of numbers up to 13, and of numbers below 1.
        let round_off = [2e-14, 1e-16];
        for (sum, exact) in conditions(&WEIGHTS[END]).into_iter().zip([1.0, 1.0 / 2.0, 1.0 / 3.0, 1.0 / 6.0]) {
            assert!((sum - exact).abs() < round_off[0], "{sum} instead of {exact}");
        }
        assert!(conditions(&WEIGHTS[ERROR]).iter().all(|sum| sum.abs() < 10.0 * round_off[1]), "{:?}", conditions(&WEIGHTS[ERROR]));
        let coarse = conditions(&WEIGHTS[COARSE]);
        assert!(coarse[..2].iter().all(|sum| sum.abs() < round_off[1]), "{coarse:?}");
        assert!(coarse[2..].iter().all(|sum| sum.abs() > 1e-4), "{coarse:?}");
    }
}
