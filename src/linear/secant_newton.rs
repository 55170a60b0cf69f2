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

use nalgebra::SMatrix;

use crate::effects::Tangents;
use crate::mechanism::coordinates::THETA;
use crate::mechanism::secant::Secant;
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Mechanism, Multipliers};

const SIZE: usize = COORDINATES + 2 * MULTIPLIERS;
/// Where the rows of ΔΛ and of Δν begin.
const FIRST: usize = COORDINATES;
const SECOND: usize = COORDINATES + MULTIPLIERS;
type Square = SMatrix<f64, COORDINATES, COORDINATES>;

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
}

/// What the equations leave: f, Φ and J₁w.
pub type Residuals<'a> = (&'a Coordinates, &'a Multipliers, &'a Multipliers);

/// The matrix by rows, each with its right-hand side at the end.
type Rows = [[f64; SIZE + 1]; SIZE];

/// Δd, ΔΛ and Δν of Newton's method. Not finite where the matrix is singular all the same.
#[inline(never)]
pub fn newton(mechanism: &Mechanism, at: &StepPoint<'_>, (f, phi, rate): Residuals<'_>) -> (Coordinates, [Multipliers; 2]) {
    let mut rows = [[0.0; SIZE + 1]; SIZE];
    fill(&mut rows, mechanism, at);
    for (i, row) in rows.iter_mut().enumerate() {
        row[SIZE] = match i {
            ..FIRST => -f[i],
            FIRST..SECOND => -phi[i - FIRST],
            _ => -rate[i - SECOND],
        };
    }
    let x = eliminated(&mut rows);
    let part = |first: usize| Multipliers::from_fn(|i| x[first + i]);
    (Coordinates::from_fn(|i| x[i]), [part(FIRST), part(SECOND)])
}

/// Gauss's elimination with row exchanges. Most of the matrix is 0: rows that have nothing below the pivot are passed over.
fn eliminated(rows: &mut Rows) -> [f64; SIZE] {
    let mut order: [usize; SIZE] = std::array::from_fn(|i| i);
    for k in 0..SIZE {
        let largest =
            (k..SIZE).fold(k, |largest, i| if rows[order[i]][k].abs() > rows[order[largest]][k].abs() { i } else { largest });
        order.swap(k, largest);
        let pivot = rows[order[k]];
        let reciprocal = 1.0 / pivot[k];
        for &i in &order[k + 1..] {
            let row = &mut rows[i];
            if row[k] != 0.0 {
                let factor = row[k] * reciprocal;
                for (x, pivot) in row[k..].iter_mut().zip(&pivot[k..]) {
                    *x -= factor * pivot;
                }
            }
        }
    }
    let mut x = [0.0; SIZE];
    for k in (0..SIZE).rev() {
        let row = &rows[order[k]];
        let known: f64 = row[k + 1..SIZE].iter().zip(&x[k + 1..]).map(|(a, x)| a * x).sum();
        x[k] = (row[SIZE] - known) / row[k];
    }
    x
}

fn fill(rows: &mut Rows, mechanism: &Mechanism, at: &StepPoint<'_>) {
    let &StepPoint { secant, d, w, multipliers: [lambda, nu], forces, regularization } = at;
    let masses = mechanism.mass_times(&[1.0; COORDINATES].into());
    let all = Coordinates::from([1.0; COORDINATES]);
    let (middle_varied, end_varied) = (secant.middle.varied(&all), secant.end.varied(&all));
    let [sinc, cos] =
        [&secant.sinc, &secant.cos].map(|[p, d]| [p.to_array()[0], d.to_array()[0], d.to_array()[1], p.to_array()[1]]);
    for (i, row) in rows.iter_mut().enumerate().take(COORDINATES) {
        row[i] = masses[i];
    }
    // ∂w/∂d in halves, and M⁻¹J_cᵀ by rows.
    let (mut shift, mut mobile) = ([1.0; COORDINATES], [Multipliers::ZERO; COORDINATES]);
    for i in 0..COORDINATES {
        // Columns of Φ_q in the middle and at the end, and their derivatives with respect to their angles.
        let unit = Coordinates::unit(i);
        let (middle, end) = (secant.middle.phi_q_times(&unit), secant.end.phi_q_times(&unit));
        let (mut discrete, mut by_nu, mut mean, mut rate_by_d) = (middle, -middle, middle, 2.0 * end);
        if let Some(link) = THETA.iter().position(|&theta| theta == i) {
            let (middle_turned, end_turned) = (middle_varied.phi_q_times(&unit), end_varied.phi_q_times(&unit));
            let (s, c) = (sinc[link], cos[link]);
            let [slope_s, slope_c] = slopes(d[i], s, c);
            let [pull, pull_nu] = [middle.dot(lambda), middle.dot(nu)];
            let [turn, turn_nu] = [middle_turned.dot(lambda), middle_turned.dot(nu)];
            let z = d[i] - c * pull_nu / masses[i];
            shift[i] = 1.0 - (slope_c * pull_nu + 0.5 * c * turn_nu) / masses[i];
            rows[i][i] += slope_s * pull + 0.5 * s * turn - slope_c * pull_nu - 0.5 * c * turn_nu
                + 0.5 * (shift[i] * s * turn_nu + z * (slope_s * turn_nu - 0.5 * s * pull_nu));
            (discrete, mean) = (s * middle, c * middle);
            by_nu = -c * (1.0 + 0.5 * s * turn_nu / masses[i]) * middle + 0.5 * z * s * middle_turned;
            rate_by_d = 2.0 * shift[i] * end + w[i] * end_turned;
        }
        mobile[i] = mean / masses[i];
        rows[i][FIRST..SECOND].copy_from_slice(&discrete[..]);
        for m in 0..MULTIPLIERS {
            rows[FIRST + m][i] = end[m];
        }
        rows[i][SECOND..SIZE].copy_from_slice(&by_nu[..]);
        for m in (0..MULTIPLIERS).filter(|&m| end[m] != 0.0) {
            add(&mut rows[SECOND + m][SECOND..SIZE], -2.0 * end[m], &mobile[i]);
        }
        for m in 0..MULTIPLIERS {
            rows[SECOND + m][i] = rate_by_d[m];
        }
    }
    // Forces at the rates of the end, w/h.
    for (i, row) in rows.iter_mut().enumerate().take(COORDINATES) {
        for (j, mobile) in mobile.iter().enumerate() {
            let damping = forces.damping[(i, j)];
            row[j] += forces.stiffness[(i, j)] + damping * shift[j];
            if damping != 0.0 {
                add(&mut row[SECOND..SIZE], -damping, mobile);
            }
        }
    }
    for m in 0..MULTIPLIERS {
        rows[FIRST + m][FIRST + m] = -regularization;
        rows[SECOND + m][SECOND + m] -= 2.0 * regularization;
    }
}

/// y += factor·x.
fn add(y: &mut [f64], factor: f64, x: &Multipliers) {
    for (y, x) in y.iter_mut().zip(&x[..]) {
        *y += factor * x;
    }
}

/// Derivatives of s = sin(d/2)/(d/2) and of c = cos(d/2) with respect to d.
fn slopes(d: f64, s: f64, c: f64) -> [f64; 2] {
    // The series of the first where the difference would be round-off.
    let of_s = if d.abs() < 1e-2 { d * (d * d / 480.0 - 1.0 / 12.0) } else { (c - s) / d };
    [of_s, -0.25 * d * s]
}
