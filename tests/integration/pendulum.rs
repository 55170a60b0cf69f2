//! The integrator knows only its `System`: a pendulum in x, y runs through the very same code.
//!
//! IFToMM benchmark A01: 1 kg point mass, 1 m, from the horizontal at rest, g = 9.81 m/s²; values from `numerics.md` §4.

use fivebar::integrator::{Failure, Kkt, Power, State, System, i3alp, rk4};

use crate::support::slope;

const SOFTNESS: f64 = 1e-12;

/// M = 1 kg · identity, Φ = (x² + y² − 1)/2, Φ_q = (x, y), Φ̇_q q̇ = |q̇|², ∂(Φ_qᵀλ)/∂q = λ · identity.
struct Pendulum;

/// [A · identity, (x, y)ᵀ; (x, y), −e].
struct Scalar {
    a: f64,
    q: [f64; 2],
    softness: f64,
}

fn dot([a, b]: &[f64; 2], [c, d]: &[f64; 2]) -> f64 {
    a * c + b * d
}

impl Kkt<2, 1> for Scalar {
    fn solve(&self, b: &[f64; 2], [c]: &[f64; 1]) -> ([f64; 2], [f64; 1]) {
        let y = (dot(&self.q, b) / self.a - c) / (dot(&self.q, &self.q) / self.a + self.softness);
        ([(b[0] - self.q[0] * y) / self.a, (b[1] - self.q[1] * y) / self.a], [y])
    }
}

impl System<2, 1> for Pendulum {
    type Pose = [f64; 2];
    type Mass = Scalar;
    type Tangent = Scalar;

    fn pose(&self, q: &[f64; 2]) -> [f64; 2] {
        *q
    }
    fn phi(&self, q: &[f64; 2], _: &[f64; 2]) -> [f64; 1] {
        [(dot(q, q) - 1.0) / 2.0]
    }
    fn phi_q_times(&self, q: &[f64; 2], v: &[f64; 2]) -> [f64; 1] {
        [dot(q, v)]
    }
    fn phi_q_transposed_times(&self, q: &[f64; 2], [lambda]: &[f64; 1]) -> [f64; 2] {
        q.map(|q| q * lambda)
    }
    fn phi_q_dot_times(&self, _: &[f64; 2], v: &[f64; 2]) -> [f64; 1] {
        [dot(v, v)]
    }
    fn mass_times(&self, _: &[f64; 2], x: &[f64; 2]) -> [f64; 2] {
        *x
    }
    fn forces(&self, _: &[f64; 2], _: &[f64; 2], _: &[f64; 2]) -> [f64; 2] {
        [0.0, -9.81]
    }
    fn weight_times(&self, _: &[f64; 2], _: &[f64; 2], _: &[f64; 2], _: f64, x: &[f64; 2]) -> [f64; 2] {
        *x
    }
    fn factor_mass(&self, q: &[f64; 2], softness: f64) -> Scalar {
        Scalar { a: 1.0, q: *q, softness }
    }
    fn factor_tangent(
        &self,
        q: &[f64; 2],
        _: &[f64; 2],
        _: &[f64; 2],
        [lambda]: &[f64; 1],
        h: f64,
        softness: f64,
    ) -> Result<Scalar, Failure> {
        Ok(Scalar { a: 1.0 + h * h / 4.0 * lambda, q: *q, softness })
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

/// Distance from the benchmark's position after 10 s (4.2 periods).
fn error(step: impl Fn(&mut State<2, 1>, f64), h: f64) -> f64 {
    let mut state = State::start(&Pendulum, [1.0, 0.0], [0.0; 2], SOFTNESS);
    for _ in 0..(10.0 / h).round() as u64 {
        step(&mut state, h);
    }
    (state.q[0] - 0.275_087_462_576_116_9).hypot(state.q[1] + 0.961_419_205_099_125_1)
}

#[test]
fn the_pendulum_benchmark_is_met_by_every_method() {
    let i3alp = |adaptive: bool, error_tolerance: f64| {
        let settings = i3alp::Settings { adaptive, error_tolerance, tolerance: 5e-13, max_iterations: 10, softness: SOFTNESS };
        move |state: &mut State<2, 1>, h: f64| {
            i3alp::advance(&Pendulum, &settings, state, h, &mut Power::default()).expect("step");
        }
    };
    let settings = rk4::Settings { projection: true, softness: SOFTNESS, tolerance: 5e-13, max_iterations: 10 };
    let rk4 = |state: &mut State<2, 1>, h: f64| rk4::advance(&Pendulum, &settings, state, h, &mut Power::default()).expect("step");

    let points: Vec<(f64, f64)> = [4e-3, 2e-3, 1e-3, 5e-4].map(|h| (h, error(i3alp(false, 1.0), h))).to_vec();
    assert!((slope(&points) - 2.0).abs() < 0.05, "{points:?}");
    let points: Vec<(f64, f64)> = [4e-3, 2e-3, 1e-3].map(|h| (h, error(rk4, h))).to_vec();
    assert!((slope(&points) - 4.0).abs() < 0.3, "{points:?}");
    // A local error of 1e-13 m in each of some 2e5 sub-steps.
    let adaptive = error(i3alp(true, 1e-13), 1e-2);
    assert!(adaptive < 1e-7, "{adaptive:e}");
}
