//! IFToMM benchmark A01: simple pendulum.
//!
//! A point of 1 kg, 1 m from a fixed axis, starts from the horizontal (x = +1) at rest, g = 9.81 m/s². Coordinates x, y; the one
//! constraint is Φ = (x² + y² − 1)/2.
//!
//! Source: Library of Computational Benchmark Problems, IFToMM Technical Committee for Multibody Dynamics, problem A01. The position
//! at 10 s follows from Jacobi's elliptic functions.

use fivebar::integrator::{Failure, Implicit, Kkt, Power, System};

use crate::Problem;

/// Gravity, m/s².
const G: f64 = 9.81;
/// Period, s: 4 K(1/√2)/√g.
pub const PERIOD: f64 = 2.367_841_947_576_237;
/// Position at 10 s, m.
pub const AT_10_S: [f64; 2] = [0.275_087_462_576_116_9, -0.961_419_205_099_125_1];

/// M = 1 kg · identity, Φ_q = (x, y), Φ̇_q q̇ = |q̇|², ∂(Φ_qᵀλ)/∂q = λ · identity.
#[derive(Clone, Debug)]
pub struct Pendulum;

/// The benchmark: the error is the distance from the position at 10 s, m.
pub fn problem() -> Problem<Pendulum, 2, 1> {
    Problem {
        system: Pendulum,
        q: [1.0, 0.0],
        v: [0.0; 2],
        duration: 10.0,
        softness: 1e-12,
        error: |q| (q[0] - AT_10_S[0]).hypot(q[1] - AT_10_S[1]),
        energy: |_, q, v| dot(v, v) / 2.0 + G * q[1],
    }
}

fn dot([a, b]: &[f64; 2], [c, d]: &[f64; 2]) -> f64 {
    a * c + b * d
}

/// [a · identity, (x, y)ᵀ; (x, y), −e].
pub struct Factor {
    a: f64,
    q: [f64; 2],
    softness: f64,
}

impl Kkt<2, 1> for Factor {
    fn solve(&self, b: &[f64; 2], [c]: &[f64; 1]) -> ([f64; 2], [f64; 1]) {
        let y = (dot(&self.q, b) / self.a - c) / (dot(&self.q, &self.q) / self.a + self.softness);
        ([(b[0] - self.q[0] * y) / self.a, (b[1] - self.q[1] * y) / self.a], [y])
    }
}

impl System<2, 1> for Pendulum {
    type Pose = [f64; 2];
    type Mass = Factor;

    fn pose(&self, q: &[f64; 2]) -> [f64; 2] {
        *q
    }
    fn phi(&self, q: &[f64; 2], _: &[f64; 2]) -> [f64; 1] {
        [(dot(q, q) - 1.0) / 2.0]
    }
    fn phi_q_times(&self, q: &[f64; 2], v: &[f64; 2]) -> [f64; 1] {
        [dot(q, v)]
    }
    fn phi_q_dot_times(&self, _: &[f64; 2], v: &[f64; 2]) -> [f64; 1] {
        [dot(v, v)]
    }
    fn mass_times(&self, _: &[f64; 2], x: &[f64; 2]) -> [f64; 2] {
        *x
    }
    fn forces(&self, _: &[f64; 2], _: &[f64; 2], _: &[f64; 2]) -> [f64; 2] {
        [0.0, -G]
    }
    fn factor_mass(&self, q: &[f64; 2], softness: f64) -> Factor {
        Factor { a: 1.0, q: *q, softness }
    }
    fn follows_work(&self) -> bool {
        false
    }
    fn power(&self, _: &[f64; 2], _: &[f64; 2], _: &[f64; 2]) -> Power {
        Power::default()
    }
    fn angle_norm(&self, x: &[f64; 2]) -> f64 {
        x[0].abs().max(x[1].abs())
    }
    fn size(&self) -> f64 {
        1.0
    }
}

impl Implicit<2, 1> for Pendulum {
    type Tangent = Factor;
    type Rare = Self;

    fn rare(&self) -> Self {
        self.clone()
    }

    fn phi_q_transposed_times(&self, q: &[f64; 2], [lambda]: &[f64; 1]) -> [f64; 2] {
        q.map(|q| q * lambda)
    }
    fn weight_times(&self, _: &[f64; 2], _: &[f64; 2], _: &[f64; 2], _: f64, x: &[f64; 2]) -> [f64; 2] {
        *x
    }
    fn factor_tangent(
        &self,
        q: &[f64; 2],
        _: &[f64; 2],
        _: &[f64; 2],
        [lambda]: &[f64; 1],
        h: f64,
        softness: f64,
    ) -> Result<Factor, Failure> {
        Ok(Factor { a: 1.0 + h * h / 4.0 * lambda, q: *q, softness })
    }
}
