//! The whole tangent of the conserving step, for loads that depend on the rates and for the ladder of rescues.
//!
//! ```text
//! [ A    J_bᵀ          −N         ] [ Δd ]     [ f   ]
//! [ J₁   −e             0         ] [ ΔΛ ] = − [ Φ   ]
//! [ W     0   −2 J₁M⁻¹J_cᵀ − 2e   ] [ Δν ]     [ J₁w ]
//! ```
//!
//! with A = ∂f/∂d, N = −∂f/∂ν, W = ∂(J₁w)/∂d of the equations of `docs/conserving.md`. e weighs increments only, so that it moves no
//! root; with it the matrix is regular also where the constraints lose rank.

use nalgebra::{Const, LU, SMatrix, SVector};

use crate::effects::Tangents;
use crate::mechanism::coordinates::THETA;
use crate::mechanism::secant::Secant;
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Mechanism, Multipliers, Pose};

const SIZE: usize = COORDINATES + 2 * MULTIPLIERS;
/// Where the rows of ΔΛ and of Δν begin.
const FIRST: usize = COORDINATES;
const SECOND: usize = COORDINATES + MULTIPLIERS;
type Square = SMatrix<f64, COORDINATES, COORDINATES>;
type Jacobian = SMatrix<f64, MULTIPLIERS, COORDINATES>;

/// Tangents of the mean forces over a step of h, K = −∂Q̄/∂d and C = −∂Q̄/∂q̇₁, weighted as the step's equations need them.
#[derive(Clone, Copy, Debug)]
pub struct StepTangents {
    h: f64,
    /// ½h² K.
    stiffness: Square,
    /// h C.
    damping: Square,
}

impl StepTangents {
    /// None yet, for a step of h seconds.
    pub fn new(h: f64) -> Self {
        Self { h, stiffness: Square::zeros(), damping: Square::zeros() }
    }
}

impl Tangents for StepTangents {
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        self.stiffness[(row, column)] += 0.5 * self.h * self.h * value;
    }

    fn damping(&mut self, row: usize, column: usize, value: f64) {
        self.damping[(row, column)] += self.h * value;
    }
}

/// Where the tangent is asked for.
pub struct StepPoint<'a> {
    /// The step.
    pub secant: &'a Secant,
    /// Its increments d.
    pub d: &'a Coordinates,
    /// h q̇₁.
    pub w: &'a Coordinates,
    /// Λ and ν.
    pub multipliers: [&'a Multipliers; 2],
    /// Of the mean forces.
    pub forces: &'a StepTangents,
    /// e, 1/kg.
    pub regularization: f64,
    /// Whether velocities are held to the constraints; otherwise ν stays.
    pub both_levels: bool,
}

/// What the equations leave: f, Φ and J₁w.
pub type Residuals<'a> = (&'a Coordinates, &'a Multipliers, &'a Multipliers);

/// Δd, ΔΛ and Δν of Newton's method. Not finite where the matrix is singular all the same.
#[inline(never)]
pub fn newton(mechanism: &Mechanism, at: &StepPoint<'_>, (f, phi, rate): Residuals<'_>) -> (Coordinates, [Multipliers; 2]) {
    let mut right = SVector::<f64, SIZE>::zeros();
    right.fixed_rows_mut::<COORDINATES>(0).copy_from_slice(&f[..]);
    right.fixed_rows_mut::<MULTIPLIERS>(FIRST).copy_from_slice(&phi[..]);
    if at.both_levels {
        right.fixed_rows_mut::<MULTIPLIERS>(SECOND).copy_from_slice(&rate[..]);
    }
    if !LU::<f64, Const<SIZE>, Const<SIZE>>::new(matrix(mechanism, at)).solve_mut(&mut right) {
        right.fill(f64::NAN);
    }
    let part = |first: usize| Multipliers::from_fn(|i| -right[first + i]);
    (Coordinates::from_fn(|i| -right[i]), [part(FIRST), part(SECOND)])
}

fn matrix(mechanism: &Mechanism, at: &StepPoint<'_>) -> SMatrix<f64, SIZE, SIZE> {
    let &StepPoint { secant, d, w, multipliers: [lambda, nu], forces, regularization, both_levels } = at;
    let masses = SVector::from(*mechanism.mass_times(&[1.0; COORDINATES].into()));
    let (middle, end) = (secant.middle.phi_q(), secant.end.phi_q());
    let (middle_turned, end_turned) = (turned(&secant.middle), turned(&secant.end));
    let [sinc, cos] =
        [&secant.sinc, &secant.cos].map(|[p, d]| [p.to_array()[0], d.to_array()[0], d.to_array()[1], p.to_array()[1]]);

    let (mut discrete, mut mean) = (middle, middle);
    let mut a = Square::from_diagonal(&masses) + forces.stiffness;
    // d of the angles' middle rates against d and ν, in parts of those against z.
    let mut shift = [1.0; COORDINATES];
    let mut by_nu = Jacobian::zeros();
    for (link, i) in THETA.into_iter().enumerate() {
        let (s, c) = (sinc[link], cos[link]);
        let [slope_s, slope_c] = slopes(d[i], s, c);
        discrete.column_mut(i).scale_mut(s);
        mean.column_mut(i).scale_mut(c);
        // Rows of J_mᵀ and of its derivative, times Λ and ν.
        let row = |jacobian: &Jacobian, y: &Multipliers| jacobian.column(i).iter().zip(y.iter()).map(|(x, y)| x * y).sum::<f64>();
        let [pull, pull_nu] = [row(&middle, lambda), row(&middle, nu)];
        let [turn, turn_nu] = [row(&middle_turned, lambda), row(&middle_turned, nu)];
        let z = d[i] - c * pull_nu / masses[i];
        let z_slope = 1.0 - (slope_c * pull_nu + 0.5 * c * turn_nu) / masses[i];
        shift[i] = z_slope;
        a[(i, i)] += slope_s * pull + 0.5 * s * turn - slope_c * pull_nu - 0.5 * c * turn_nu
            + 0.5 * (z_slope * s * turn_nu + z * (slope_s * turn_nu - 0.5 * s * pull_nu));
        // −N in the angles' rows, by columns of its transpose.
        let along = middle.column(i) * (-c * (1.0 + 0.5 * s * turn_nu / masses[i]));
        by_nu.set_column(i, &(along + middle_turned.column(i) * (0.5 * z * s)));
    }
    for i in (0..COORDINATES).filter(|i| !THETA.contains(i)) {
        by_nu.set_column(i, &(-middle.column(i)));
    }

    // Forces at the rates of the end: w/h = (2z − h q̇₀)/h.
    let mobility = Square::from_diagonal(&masses.map(|m| 1.0 / m));
    let rates_by_nu = mobility * mean.transpose();
    a += forces.damping * Square::from_diagonal(&SVector::from(shift));
    let by_nu = by_nu.transpose() - forces.damping * rates_by_nu;

    let mut matrix = SMatrix::<f64, SIZE, SIZE>::zeros();
    matrix.fixed_view_mut::<COORDINATES, COORDINATES>(0, 0).copy_from(&a);
    matrix.fixed_view_mut::<COORDINATES, MULTIPLIERS>(0, FIRST).copy_from(&discrete.transpose());
    matrix.fixed_view_mut::<MULTIPLIERS, COORDINATES>(FIRST, 0).copy_from(&end);
    for i in FIRST..SECOND {
        matrix[(i, i)] = -regularization;
    }
    if both_levels {
        let mut rate_by_d = end * Square::from_diagonal(&(2.0 * SVector::from(shift)));
        for i in THETA {
            let turning = end_turned.column(i) * w[i];
            let mut column = rate_by_d.column_mut(i);
            column += turning;
        }
        matrix.fixed_view_mut::<COORDINATES, MULTIPLIERS>(0, SECOND).copy_from(&by_nu);
        matrix.fixed_view_mut::<MULTIPLIERS, COORDINATES>(SECOND, 0).copy_from(&rate_by_d);
        matrix.fixed_view_mut::<MULTIPLIERS, MULTIPLIERS>(SECOND, SECOND).copy_from(&(end * rates_by_nu * -2.0));
    }
    for i in SECOND..SIZE {
        matrix[(i, i)] -= if both_levels { 2.0 * regularization } else { 1.0 };
    }
    matrix
}

/// The derivatives of the angles' columns of Φ_q, each with respect to its own angle: 0 elsewhere.
fn turned(pose: &Pose) -> Jacobian {
    let all = Coordinates::from([1.0; COORDINATES]);
    let mut turned = pose.varied(&all).phi_q();
    for i in (0..COORDINATES).filter(|i| !THETA.contains(i)) {
        turned.column_mut(i).fill(0.0);
    }
    turned
}

/// Derivatives of s = sin(d/2)/(d/2) and of c = cos(d/2) with respect to d.
fn slopes(d: f64, s: f64, c: f64) -> [f64; 2] {
    // The series of the first where the difference would be round-off.
    let of_s = if d.abs() < 1e-2 { d * (d * d / 480.0 - 1.0 / 12.0) } else { (c - s) / d };
    [of_s, -0.25 * d * s]
}
