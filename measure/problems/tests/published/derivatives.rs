//! Derivatives that a problem provides to the integrator, against finite differences along its own motion.
//!
//! Results may not reveal errors: a wrong tangent still converges, only slower, and a wrong velocity term looks like an error of the
//! method's order.

use fivebar::integrator::{Events, Implicit, Kkt, Passage, TangentPoint};
use fivebar::vector::Vector;
use problems::{Problem, four_bars, pendulum, squeezer};

/// Step of central differences: truncation 1e-12, round-off 1e-10, relative to the differentiated function.
const STEP: f64 = 1e-6;

/// Derivative of f at x along a direction of any length.
fn along<const N: usize, const K: usize>(x: &Vector<N>, direction: &Vector<N>, f: impl Fn(&Vector<N>) -> Vector<K>) -> Vector<K> {
    let scale = direction.max_norm().max(f64::MIN_POSITIVE);
    let moved = |step: f64| f(&(*x + step / scale * *direction));
    scale * ((moved(STEP) - moved(-STEP)) / (2.0 * STEP))
}

/// An arbitrary vector without symmetry, the same in every run.
fn any<const K: usize>(seed: f64) -> Vector<K> {
    Vector::from_fn(|i| (seed + 1.7 * i as f64).sin())
}

/// Checks everything at 20 points of the motion. `h` is a step for the tangent: as long as possible, so that stiffnesses have weight.
fn check<S: Implicit<N, M> + Passage<N> + Events<N>, const N: usize, const M: usize>(
    mut problem: Problem<S, N, M>,
    duration: f64,
    h: f64,
) {
    problem.duration = duration;
    let method = problem.adaptive(1e-6);
    let mut points = Vec::new();
    problem.watch(method, duration / 20.0, |_, state| points.push((state.q, state.v, state.lambda))).expect("steps");
    let (system, regularization) = (&problem.system, problem.regularization);
    let beta = h * h / 4.0;

    for (q, v, lambda) in points {
        let pose = system.pose(&q);

        // Φ_q is the derivative of Φ; the transposed product uses the same matrix.
        let some = any::<N>(0.3);
        let product = system.phi_q_times(&pose, &some);
        assert!((product - along(&q, &some, |q| system.phi(q, &system.pose(q)))).max_norm() < 1e-8);
        let (left, right) = (product.dot(&lambda), system.phi_q_transposed_times(&pose, &lambda).dot(&some));
        assert!((left - right).abs() < 1e-12 * (1.0 + lambda.max_norm()) * N as f64, "{left} {right}");

        // Φ̇_q q̇ is the change of Φ_q q̇.
        let change = along(&q, &v, |q| system.phi_q_times(&system.pose(q), &v));
        let speed = v.max_norm();
        assert!((system.phi_q_dot_times(&pose, &v) - change).max_norm() < 1e-8 * (1.0 + speed * speed));

        // M + h/2 C + β K, and with ∂(Φ_qᵀλ)/∂q the tangent.
        let weighed = |x: &Vector<N>| {
            let damping = along(&v, x, |v| system.forces(&q, &pose, v).0);
            let stiffness = along(&q, x, |q| system.forces(q, &system.pose(q), &v).0);
            system.mass_times(&pose, x) - h / 2.0 * damping - beta * stiffness
        };
        let at = TangentPoint { q: &q, pose: &pose, v: &v, lambda: &lambda, h };

        // Solutions of both linear systems satisfy their equations.
        let (b, c) = (any::<N>(0.9), any::<M>(1.4));
        let residual = |(x, y): (Vector<N>, Vector<M>), geometric: f64, weight: &dyn Fn(&Vector<N>) -> Vector<N>| {
            let transposed = system.phi_q_transposed_times(&pose, &y);
            let change = along(&q, &x, |q| system.phi_q_transposed_times(&system.pose(q), &lambda));
            let first = weight(&x) + geometric * change + transposed - b;
            let second = system.phi_q_times(&pose, &x) - regularization * y - c;
            (first.max_norm() / transposed.max_norm(), second.max_norm() / (1.0 + x.max_norm()))
        };
        let (first, second) =
            residual(system.factor_mass(&pose, regularization).solve(&b, &c), 0.0, &|x| system.mass_times(&pose, x));
        assert!(first < 1e-9 && second < 1e-9, "mass: {first:e} {second:e}");
        let solution = system.solve_tangent(&at, regularization, &b, &c).expect("a step short enough");
        let (first, second) = residual(solution, beta, &weighed);
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
