//! What a problem tells the integrator, against finite differences along its own motion.
//!
//! A wrong tangent converges all the same, only slower, and a wrong velocity term is an error of the method's order: neither would
//! be seen in the results for sure.

use fivebar::integrator::{Implicit, Kkt};
use problems::{Problem, four_bars, pendulum, squeezer};

/// Step of central differences: truncation 1e-12, round-off 1e-10, relative to what is differentiated.
const STEP: f64 = 1e-6;

/// Derivative of f at x along a direction of any length.
fn along<const N: usize, const K: usize>(x: &[f64; N], direction: &[f64; N], f: impl Fn(&[f64; N]) -> [f64; K]) -> [f64; K] {
    let scale = largest(direction).max(f64::MIN_POSITIVE);
    let moved = |step: f64| f(&std::array::from_fn(|i| x[i] + step / scale * direction[i]));
    let (ahead, behind) = (moved(STEP), moved(-STEP));
    std::array::from_fn(|i| (ahead[i] - behind[i]) / (2.0 * STEP) * scale)
}

fn largest<const K: usize>(x: &[f64; K]) -> f64 {
    x.iter().fold(0.0, |largest, x| largest.max(x.abs()))
}

fn difference<const K: usize>(x: &[f64; K], y: &[f64; K]) -> f64 {
    largest(&std::array::from_fn::<f64, K, _>(|i| x[i] - y[i]))
}

/// Some vector without symmetry, the same in every run.
fn any<const K: usize>(seed: f64) -> [f64; K] {
    std::array::from_fn(|i| (seed + 1.7 * i as f64).sin())
}

/// Checks everything at 20 points of the motion. `h` is a step for the tangent: as long as it may be, so that stiffnesses weigh.
fn check<S: Implicit<N, M>, const N: usize, const M: usize>(mut problem: Problem<S, N, M>, duration: f64, h: f64) {
    problem.duration = duration;
    let method = problem.adaptive(1e-6);
    let mut points = Vec::new();
    problem.watch(method, duration / 20.0, |_, state| points.push((state.q, state.v, state.lambda))).expect("steps");
    let system = &problem.system;
    let beta = h * h / 4.0;

    for (q, v, lambda) in points {
        let pose = system.pose(&q);

        // Φ_q is the derivative of Φ, and its transpose the same matrix.
        let some = any::<N>(0.3);
        let product = system.phi_q_times(&pose, &some);
        assert!(difference(&product, &along(&q, &some, |q| system.phi(q, &system.pose(q)))) < 1e-8);
        let transposed = system.phi_q_transposed_times(&pose, &lambda);
        let left: f64 = product.iter().zip(&lambda).map(|(x, y)| x * y).sum();
        let right: f64 = transposed.iter().zip(&some).map(|(x, y)| x * y).sum();
        assert!((left - right).abs() < 1e-12 * (1.0 + largest(&lambda)) * N as f64, "{left} {right}");

        // Φ̇_q q̇ is the change of Φ_q q̇.
        let change = along(&q, &v, |q| system.phi_q_times(&system.pose(q), &v));
        let speed = largest(&v);
        assert!(difference(&system.phi_q_dot_times(&pose, &v), &change) < 1e-8 * (1.0 + speed * speed));

        // M + h/2 C + β K, and with ∂(Φ_qᵀλ)/∂q the tangent.
        let weighed = |x: &[f64; N]| -> [f64; N] {
            let inertia = system.mass_times(&pose, x);
            let damping = along(&v, x, |v| system.forces(&q, &pose, v));
            let stiffness = along(&q, x, |q| system.forces(q, &system.pose(q), &v));
            std::array::from_fn(|i| inertia[i] - h / 2.0 * damping[i] - beta * stiffness[i])
        };
        let weight = system.weight_times(&q, &pose, &v, h, &some);
        assert!(difference(&weight, &weighed(&some)) < 1e-8 * largest(&weight));

        // Both linear solves, put into their own equations.
        let (b, c) = (any::<N>(0.9), any::<M>(1.4));
        let residual = |(x, y): ([f64; N], [f64; M]), geometric: f64, weight: &dyn Fn(&[f64; N]) -> [f64; N]| {
            let transposed = system.phi_q_transposed_times(&pose, &y);
            let change = along(&q, &x, |q| system.phi_q_transposed_times(&system.pose(q), &lambda));
            let weight = weight(&x);
            let first: [f64; N] = std::array::from_fn(|i| weight[i] + geometric * change[i] + transposed[i] - b[i]);
            let product = system.phi_q_times(&pose, &x);
            let second: [f64; M] = std::array::from_fn(|i| product[i] - problem.regularization * y[i] - c[i]);
            (largest(&first) / largest(&transposed), largest(&second) / (1.0 + largest(&x)))
        };
        let (first, second) =
            residual(system.factor_mass(&pose, problem.regularization).solve(&b, &c), 0.0, &|x| system.mass_times(&pose, x));
        assert!(first < 1e-9 && second < 1e-9, "mass: {first:e} {second:e}");
        let tangent = system.factor_tangent(&q, &pose, &v, &lambda, h, problem.regularization).expect("a step short enough");
        let (first, second) = residual(tangent.solve(&b, &c), beta, &weighed);
        assert!(first < 1e-8 && second < 1e-9, "tangent: {first:e} {second:e}");
    }
}

#[test]
fn of_the_pendulum() {
    check(pendulum::problem(), 2.0, 0.1);
}

#[test]
fn of_two_loops() {
    check(four_bars::two(), 2.0, 0.02);
}

#[test]
fn of_forty_loops() {
    check(four_bars::forty(), 2.0, 0.01);
}

#[test]
fn of_the_squeezer() {
    check(squeezer::problem(), 0.03, 2e-4);
}
