//! DOP853 alone, on systems without constraints whose solutions are known: orders of the step and of the interpolant, stiffness.

use fivebar::integrator::dense::{DenseStep, Horizon, Kind, Kinds, Settings};
use fivebar::integrator::{Kinked, Kkt, Passage, System, Work};
use fivebar::vector::Vector;

use crate::support::slope;

/// A point of unit mass in the plane: q̈ = f(q, q̇).
struct Point(fn(&Vector<2>, &Vector<2>) -> Vector<2>);

/// The identity: unit mass, no constraints.
struct Free;

impl Kkt<2, 0> for Free {
    fn solve(&self, b: &Vector<2>, _: &Vector<0>) -> (Vector<2>, Vector<0>) {
        (*b, Vector::ZERO)
    }
}

impl System<2, 0> for Point {
    type Pose = ();
    type Mass = Free;

    fn pose(&self, _: &Vector<2>) {}
    fn phi(&self, _: &Vector<2>, (): &()) -> Vector<0> {
        Vector::ZERO
    }
    fn phi_q_times(&self, (): &(), _: &Vector<2>) -> Vector<0> {
        Vector::ZERO
    }
    fn phi_q_dot_times(&self, (): &(), _: &Vector<2>) -> Vector<0> {
        Vector::ZERO
    }
    fn mass_times(&self, (): &(), x: &Vector<2>) -> Vector<2> {
        *x
    }
    fn forces(&self, q: &Vector<2>, (): &(), v: &Vector<2>) -> Vector<2> {
        (self.0)(q, v)
    }
    fn factor_mass(&self, (): &(), _: f64) -> Free {
        Free
    }
    fn follows_work(&self) -> bool {
        true
    }
    /// The work of everything that accelerates: what the kinetic energy gains.
    fn power(&self, q: &Vector<2>, (): &(), v: &Vector<2>) -> Work {
        Work { input: (self.0)(q, v).dot(v), dissipated: 0.0 }
    }
    fn angle_norm(&self, x: &Vector<2>) -> f64 {
        x.max_norm()
    }
    fn length_scale(&self) -> f64 {
        1.0
    }
}

impl Passage<2> for Point {}

impl Kinked<2> for Point {
    type Sides = ();
    type Touches = ();

    fn touches(&self, _: &Vector<2>, _: &Vector<2>) {}

    fn sides_of(&self, _: &Vector<2>, _: &Vector<2>) {}
}

/// Kepler's problem with unit constants: q̈ = −q/|q|³.
const KEPLER: Point = Point(|q, _| -1.0 / q.dot(q).powf(1.5) * *q);

/// Position and velocity on an ellipse of eccentricity 0.3 and unit axis, at a mean anomaly: Kepler's equation by iteration.
fn ellipse(mean: f64) -> [[f64; 2]; 2] {
    let eccentricity = 0.3;
    let mut anomaly: f64 = mean;
    for _ in 0..50 {
        anomaly -= (anomaly - eccentricity * anomaly.sin() - mean) / (1.0 - eccentricity * anomaly.cos());
    }
    let (minor, rate) = ((1.0 - eccentricity * eccentricity).sqrt(), 1.0 / (1.0 - eccentricity * anomaly.cos()));
    let (sin, cos) = anomaly.sin_cos();
    [[cos - eccentricity, minor * sin], [-sin * rate, minor * cos * rate]]
}

fn settings(error_tolerance: f64, first_step: f64) -> Settings {
    Settings { kinds: Kinds::Only(Kind::Eighth), error_tolerance, energy_scale: 1.0, first_step, max_iterations: 10, max_work: 400_000, regularization: 0.0 }
}

/// One step of h leaves an error of h⁹, its interpolant h⁸; the work along it has the same orders. A wrong coefficient would
/// show.
#[test]
fn the_step_is_of_order_8_and_its_interpolant_of_order_7() {
    const START: f64 = 0.7;
    for (part, order) in [(1.0, 9.0), (0.3, 8.0), (0.5, 8.0), (0.8, 8.0)] {
        let (mut positions, mut works) = (vec![], vec![]);
        for h in [0.3, 0.2, 0.15, 0.1] {
            let [q, v] = ellipse(START);
            // Every step is accepted, so that the first has this length.
            let settings = settings(1e6, h);
            let mut running = DenseStep::start(&KEPLER, q.into(), v.into(), &settings);
            running.advance(&KEPLER, &settings, part * h, Horizon { output: part * h, limit: f64::INFINITY }).expect("a step");
            let sample = running.sample(&KEPLER, &settings);
            let [position, velocity] = ellipse(START + part * h);
            let energy = |[x, y]: [f64; 2]| (x * x + y * y) / 2.0;
            positions.push((h, (sample.q[0] - position[0]).hypot(sample.q[1] - position[1])));
            works.push((h, (sample.work.input - energy(velocity) + energy(v)).abs()));
        }
        for (what, points) in [("position", positions), ("work", works)] {
            let slope = slope(&points);
            // At these steps the next term of the error takes up to 0.65 off for the position and 0.93 for the work. A wrong coefficient
            // costs several orders.
            assert!((slope - order).abs() < 1.0, "{what} at {part}: slope {slope:.2}, {points:?}");
        }
    }
}

/// The error control holds the error of an orbit to some times the tolerance, and loose steps are not taken for stiff.
#[test]
fn the_error_follows_the_tolerance() {
    for tolerance in [1e-4, 1e-6, 1e-8, 1e-10, 1e-12] {
        let settings = settings(tolerance, 1e-3);
        let [q, v] = ellipse(0.0);
        let mut running = DenseStep::start(&KEPLER, q.into(), v.into(), &settings);
        let orbits = 10.0 * std::f64::consts::TAU;
        running.advance(&KEPLER, &settings, orbits, Horizon { output: orbits, limit: f64::INFINITY }).expect("steps");
        let sample = running.sample(&KEPLER, &settings);
        // Local errors add up to one of the period, and that to one of the place: with the square of the number of steps, some 1e2.
        let error = (sample.q[0] - q[0]).hypot(sample.q[1] - q[1]);
        assert!(error < 1e4 * tolerance && !running.is_stiff(), "tolerance {tolerance:e}: {error:e}");
    }
}

/// A damper, and a damped spring, far stiffer than their motion: steps of a few times the inverse rate, and the verdict.
#[test]
fn stiffness_is_noticed() {
    for stiff in [Point(|_, v| -1e4 * *v), Point(|q, v| -1e8 * *q - 1e3 * *v)] {
        let settings = settings(1e-6, 1e-3);
        let mut running = DenseStep::start(&stiff, [1e-3, 2e-3].into(), [1.0, -1.0].into(), &settings);
        let mut steps = 0;
        while !running.is_stiff() {
            steps += 1;
            assert!(steps < 5000, "5 s without a verdict");
            running.advance(&stiff, &settings, 1e-3, Horizon { output: 1e-3, limit: f64::INFINITY }).expect("steps");
        }
    }
}
