//! IFToMM benchmark A01: simple pendulum.
//!
//! A point of 1 kg, 1 m from a fixed axis, starts from the horizontal (x = +1) at rest, g = 9.81 m/s². Coordinates x, y; a single
//! constraint Φ = (x² + y² − 1)/2.
//!
//! Source: Library of Computational Benchmark Problems, IFToMM Technical Committee for Multibody Dynamics, problem A01. The position
//! at 10 s follows from Jacobi's elliptic functions.

use fivebar::integrator::{Events, Implicit, Kkt, Passage, Path, StepError, System, TangentPoint, Work};

use crate::Problem;
use fivebar::vector::Vector;

/// Gravity, m/s².
const G: f64 = 9.81;
/// Period, s: 4 K(1/√2)/√g.
pub const PERIOD: f64 = 2.367_841_947_576_237;
/// Position at 10 s, m.
pub const AT_10_S: [f64; 2] = [0.275_087_462_576_116_9, -0.961_419_205_099_125_1];

/// M = 1 kg · identity, Φ_q = (x, y), Φ̇_q q̇ = |q̇|², ∂(Φ_qᵀλ)/∂q = λ · identity.
#[derive(Clone, Debug)]
pub struct Pendulum;

/// The benchmark. Error: distance from the position at 10 s, m.
pub fn problem() -> Problem<Pendulum, 2, 1> {
    Problem {
        system: Pendulum,
        q: [1.0, 0.0].into(),
        v: Vector::ZERO,
        duration: 10.0,
        regularization: 1e-12,
        error: |q| (q[0] - AT_10_S[0]).hypot(q[1] - AT_10_S[1]),
        energy: |_, q, v| v.dot(v) / 2.0 + G * q[1],
    }
}

/// [a · identity, (x, y)ᵀ; (x, y), −e].
pub struct Factor {
    a: f64,
    q: Vector<2>,
    regularization: f64,
}

impl Kkt<2, 1> for Factor {
    fn solve(&self, b: &Vector<2>, c: &Vector<1>) -> (Vector<2>, Vector<1>) {
        let y = (self.q.dot(b) / self.a - c[0]) / (self.q.dot(&self.q) / self.a + self.regularization);
        ((*b - y * self.q) / self.a, [y].into())
    }
}

impl System<2, 1> for Pendulum {
    type Pose = Vector<2>;
    type Mass = Factor;

    fn pose(&self, q: &Vector<2>) -> Vector<2> {
        *q
    }
    fn phi(&self, q: &Vector<2>, _: &Vector<2>) -> Vector<1> {
        [(q.dot(q) - 1.0) / 2.0].into()
    }
    fn phi_q_times(&self, q: &Vector<2>, v: &Vector<2>) -> Vector<1> {
        [q.dot(v)].into()
    }
    fn phi_q_dot_times(&self, _: &Vector<2>, v: &Vector<2>) -> Vector<1> {
        [v.dot(v)].into()
    }
    fn mass_times(&self, _: &Vector<2>, x: &Vector<2>) -> Vector<2> {
        *x
    }
    fn forces(&self, _: &Vector<2>, _: &Vector<2>, _: &Vector<2>) -> (Vector<2>, Work) {
        ([0.0, -G].into(), Work::default())
    }
    fn factor_mass(&self, q: &Vector<2>, regularization: f64) -> Factor {
        Factor { a: 1.0, q: *q, regularization }
    }
    fn error_norm(&self, x: &Vector<2>) -> f64 {
        x[0].abs().max(x[1].abs())
    }
    fn length_scale(&self) -> f64 {
        1.0
    }
}

impl Implicit<2, 1> for Pendulum {
    type General = Self;

    fn general(&self) -> Self {
        self.clone()
    }

    fn phi_q_transposed_times(&self, q: &Vector<2>, lambda: &Vector<1>) -> Vector<2> {
        lambda[0] * *q
    }
    fn solve_tangent(
        &self,
        at: &TangentPoint<'_, Vector<2>, 2, 1>,
        regularization: f64,
        b: &Vector<2>,
        c: &Vector<1>,
    ) -> Result<(Vector<2>, Vector<1>), StepError> {
        Ok(Factor { a: 1.0 + at.h * at.h / 4.0 * at.lambda[0], q: *at.q, regularization }.solve(b, c))
    }
}

impl Passage<2> for Pendulum {}

impl Events<2> for Pendulum {
    type Mode = ();
    type GuardValues = ();

    fn guard_values(&self, _: &Vector<2>, _: &Vector<2>) {}

    fn path_bounds(&self, _: &Path<2>) {}

    fn mode_of(&self, _: &Vector<2>, _: &Vector<2>) {}
}
