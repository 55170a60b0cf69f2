//! Steps of each kind alone, on unconstrained systems with known solutions: orders of step and interpolant, stiffness.

use fivebar::integrator::dense::{DenseStep, Horizon, Scheme, Schemes, Settings};
use fivebar::integrator::{AccelerationTangents, Events, Features, Kkt, Passage, Path, State, System, Work};
use fivebar::vector::Vector;

use crate::support::slope;

/// A point of unit mass in the plane: q̈ = f(q, q̇), with its derivatives and the rate of its kinetic energy.
#[derive(Clone)]
struct Point {
    acceleration: fn(&Vector<2>, &Vector<2>) -> Vector<2>,
    tangents: Option<fn(&Vector<2>, &Vector<2>) -> AccelerationTangents<2>>,
    power: fn(&Vector<2>, &Vector<2>, &Vector<2>) -> f64,
}

impl Point {
    /// A problem in Cartesian coordinates.
    const fn cartesian(acceleration: fn(&Vector<2>, &Vector<2>) -> Vector<2>) -> Self {
        Self { acceleration, tangents: None, power: |_, v, a| a.dot(v) }
    }
}

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
    /// The power of all accelerating forces is the rate of the kinetic energy.
    fn forces(&self, q: &Vector<2>, (): &(), v: &Vector<2>) -> (Vector<2>, Work) {
        let acceleration = (self.acceleration)(q, v);
        (acceleration, Work { input: (self.power)(q, v, &acceleration), dissipated: 0.0 })
    }
    fn factor_mass(&self, (): &(), _: f64) -> Free {
        Free
    }
    fn features(&self) -> Features {
        Features { work: true, ..Features::SMOOTH }
    }
    fn acceleration_tangents(&self, at: &State<2, 0>, (): &(), _: f64) -> Option<AccelerationTangents<2>> {
        self.tangents.map(|tangents| tangents(&at.q, &at.v))
    }
    fn error_norm(&self, x: &Vector<2>) -> f64 {
        x.max_norm()
    }
    fn length_scale(&self) -> f64 {
        1.0
    }
}

impl Passage<2> for Point {}

impl Events<2> for Point {
    type Mode = ();
    type GuardValues = ();

    fn guard_values(&self, _: &Vector<2>, _: &Vector<2>) {}

    fn path_bounds(&self, _: &Path<2>) {}

    fn mode_of(&self, _: &Vector<2>, _: &Vector<2>) {}
}

/// Kepler's problem with unit constants: q̈ = −q/|q|³.
const KEPLER: Point = Point::cartesian(|q, _| -1.0 / q.dot(q).powf(1.5) * *q);

/// Kepler's problem in polar coordinates, distance and angle: accelerations depend nonlinearly on the rates.
const POLAR: Point = Point {
    acceleration: |q, v| [q[0] * v[1] * v[1] - 1.0 / (q[0] * q[0]), -2.0 * v[0] * v[1] / q[0]].into(),
    tangents: Some(|q, v| AccelerationTangents {
        by_q: [[v[1] * v[1] + 2.0 / q[0].powi(3), 2.0 * v[0] * v[1] / (q[0] * q[0])].into(), Vector::ZERO],
        by_v: [[0.0, -2.0 * v[1] / q[0]].into(), [2.0 * q[0] * v[1], -2.0 * v[0] / q[0]].into()],
    }),
    power: |q, v, a| v[0] * (a[0] + q[0] * v[1] * v[1]) + q[0] * q[0] * v[1] * a[1],
};

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

/// Position and velocity in polar coordinates.
fn polar([[x, y], [u, v]]: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
    let r = x.hypot(y);
    [[r, y.atan2(x)], [(x * u + y * v) / r, (x * v - y * u) / (r * r)]]
}

fn settings(error_tolerance: f64, first_step: f64) -> Settings {
    Settings {
        schemes: Schemes::Only(Scheme::Dop853),
        error_tolerance,
        energy_scale: 1.0,
        first_step,
        max_iterations: 10,
        max_work: 400_000,
        regularization: 0.0,
    }
}

/// A tolerance below round-off cannot be met and soon gives an error.
#[test]
fn an_impossible_tolerance_is_an_error() {
    let ([q, v], settings) = (ellipse(0.7), settings(1e-40, 0.1));
    let mut running = DenseStep::start(&KEPLER, q.into(), v.into(), &settings);
    let to_the_end = Horizon { output: 1.0, limit: f64::INFINITY };
    let failure = running.advance(&KEPLER, &settings, 1.0, to_the_end, None).expect_err("no step is that exact");
    assert!(failure.to_string().contains("sub-step"), "{failure}");
}

/// One step of h has an error of h⁹, its interpolant h⁸; the work along it has the same orders. A wrong coefficient would be visible.
#[test]
fn the_step_is_of_order_8_and_its_interpolant_of_order_7() {
    const START: f64 = 0.7;
    for (part, order) in [(1.0, 9.0), (0.3, 8.0), (0.5, 8.0), (0.8, 8.0)] {
        let (mut positions, mut works) = (vec![], vec![]);
        for h in [0.3, 0.2, 0.15, 0.1] {
            let [q, v] = ellipse(START);
            // Every step is accepted, so the first has this length.
            let settings = settings(1e6, h);
            let mut running = DenseStep::start(&KEPLER, q.into(), v.into(), &settings);
            running
                .advance(&KEPLER, &settings, part * h, Horizon { output: part * h, limit: f64::INFINITY }, None)
                .expect("a step");
            let sample = running.sample(&KEPLER, &settings);
            let [position, velocity] = ellipse(START + part * h);
            let energy = |[x, y]: [f64; 2]| (x * x + y * y) / 2.0;
            positions.push((h, (sample.q[0] - position[0]).hypot(sample.q[1] - position[1])));
            works.push((h, (sample.work.input - energy(velocity) + energy(v)).abs()));
        }
        for (what, points) in [("position", positions), ("work", works)] {
            let slope = slope(&points);
            // At these steps the next term of the error reduces the slope by up to 0.65 for the position and 0.93 for the work. A wrong
            // coefficient costs several orders.
            assert!((slope - order).abs() < 1.0, "{what} at {part}: slope {slope:.2}, {points:?}");
        }
    }
}

/// The other kinds, in polar coordinates. The error of one step is one order higher than the method. Between its ends an implicit step has
/// the order of its published dense output, lower by one; the step of order 5 has the order of a quintic. Derivatives and work have one order less.
#[test]
fn every_kind_is_of_its_order() {
    const START: f64 = 0.7;
    for &scheme in Scheme::LIST {
        for part in [1.0, 0.3, 0.5, 0.8] {
            let (mut positions, mut rates, mut works) = (vec![], vec![], vec![]);
            for h in [0.1, 0.07, 0.05, 0.035] {
                // A longer step for the higher order, to stay above round-off.
                let h = if scheme == Scheme::Dop853 { 3.0 * h } else { h };
                let [q, v] = polar(ellipse(START));
                let settings = Settings { schemes: Schemes::Only(scheme), ..settings(1e6, h) };
                let mut running = DenseStep::start(&POLAR, q.into(), v.into(), &settings);
                running
                    .advance(&POLAR, &settings, part * h, Horizon { output: part * h, limit: f64::INFINITY }, None)
                    .expect("a step");
                let sample = running.sample(&POLAR, &settings);
                let [to, rate] = polar(ellipse(START + part * h));
                let energy = |q: [f64; 2], v: [f64; 2]| (v[0] * v[0] + (q[0] * v[1]).powi(2)) / 2.0;
                positions.push((h, (sample.q[0] - to[0]).hypot(sample.q[1] - to[1])));
                rates.push((h, (sample.v[0] - rate[0]).hypot(sample.v[1] - rate[1])));
                works.push((h, (sample.work.input - energy(to, rate) + energy(q, v)).abs()));
            }
            let inside = part < 1.0;
            let step = f64::from(scheme.order()) + 1.0;
            let hermite = scheme != Scheme::Dop853;
            let expected = match (inside, hermite) {
                (false, _) => [step; 3],
                (true, false) => [step - 1.0; 3],
                (true, true) if scheme == Scheme::Tsit5 => [6.0, 5.0, 5.0],
                (true, true) => [step - 1.0, step - 2.0, step - 1.0],
            };
            for ((what, points), order) in [("angle", positions), ("rate", rates), ("work", works)].into_iter().zip(expected) {
                let slope = slope(&points);
                // The next term of the error bends the lines; a wrong coefficient or derivative costs at least one order. The slope may be
                // larger if the leading term happens to be small.
                assert!(slope > order - 0.6, "{scheme:?}, {what} at {part}: slope {slope:.2} of {order}, {points:?}");
            }
        }
    }
}

/// The error estimate of a step of order 5, from its stages alone, exceeds the true error and decreases with the fifth power of the step.
#[test]
fn the_estimate_of_order_5_is_on_the_safe_side() {
    let mut estimates = vec![];
    for h in [0.1, 0.07, 0.05, 0.035, 0.02, 0.01] {
        let [q, v] = polar(ellipse(0.7));
        // In units of a tolerance that accepts every step.
        let settings = Settings { schemes: Schemes::Only(Scheme::Tsit5), ..settings(1e6, h) };
        let mut running = DenseStep::start(&POLAR, q.into(), v.into(), &settings);
        running.advance(&POLAR, &settings, h, Horizon { output: f64::INFINITY, limit: f64::INFINITY }, None).expect("a step");
        let sample = running.sample(&POLAR, &settings);
        let mut state = State::start(&POLAR, sample.q, sample.v, 0.0);
        running.record(&sample, &mut state);
        let (to, rate) = (polar(ellipse(0.7 + h))[0], polar(ellipse(0.7 + h))[1]);
        // Weighted as in the step: tolerances of rates are (10/s + their magnitude) times tolerances of coordinates.
        let off = |i: usize| (sample.q[i] - to[i]).powi(2) + ((sample.v[i] - rate[i]) / (10.0 + rate[i].abs())).powi(2);
        let error = ((off(0) + off(1)) / 4.0).sqrt();
        assert!(state.error_estimate > 3.0 * error, "{h} s: estimated {:e}, {error:e}", state.error_estimate);
        estimates.push((h, state.error_estimate));
    }
    // Damping of the estimate begins within these steps, and the next term of both estimates bends the line.
    let slope = slope(&estimates);
    assert!((slope - 5.0).abs() < 0.5, "slope {slope:.2}, {estimates:?}");
}

/// A stiff spring pulls a point onto a curve, q₀ = sin(q₁)/4, along which it swings like a pendulum. The run automatically takes steps of
/// the motion's length, loses no digit at changes of kind, and returns to explicit steps when nothing is stiff.
#[test]
fn kinds_change_and_no_digit_is_lost() {
    // q̈₁ = −sin q₁; the error of q₀ is a damped spring with a rate of 10,000/s while cos(q₁/2)⁸ is not small.
    const PULLED: Point = Point {
        acceleration: |q, v| {
            let ([s, c], swing) = ([q[1].sin(), q[1].cos()], -q[1].sin());
            let k = 1e8 * (0.5 * q[1]).cos().powi(8);
            let (off, rate) = (q[0] - 0.25 * s, v[0] - 0.25 * c * v[1]);
            [-k * off - 2e-4 * k * rate + 0.25 * (c * swing - s * v[1] * v[1]), swing].into()
        },
        tangents: Some(|q, v| {
            let [s, c] = [q[1].sin(), q[1].cos()];
            let k = 1e8 * (0.5 * q[1]).cos().powi(8);
            let k_slope = -4e8 * (0.5 * q[1]).cos().powi(7) * (0.5 * q[1]).sin();
            let (off, rate) = (q[0] - 0.25 * s, v[0] - 0.25 * c * v[1]);
            let by_angle =
                -k_slope * (off + 2e-4 * rate) + 0.25 * k * (c - 2e-4 * s * v[1]) + 0.25 * (s * s - c * c - c * v[1] * v[1]);
            AccelerationTangents {
                by_q: [[-k, 0.0].into(), [by_angle, -c].into()],
                by_v: [[-2e-4 * k, 0.0].into(), [2e-4 * k * 0.25 * c - 0.5 * s * v[1], 0.0].into()],
            }
        }),
        power: |_, v, a| a.dot(v),
    };
    let run = |schemes: Schemes, tolerance: f64| {
        let settings = Settings { schemes, ..settings(tolerance, 1e-3) };
        let angle: f64 = 3.0;
        let start: [f64; 2] = [0.25 * angle.sin(), angle];
        let mut running = DenseStep::start(&PULLED, start.into(), Vector::ZERO, &settings);
        let mut worst: f64 = 0.0;
        for _ in 0..2000 {
            running.advance(&PULLED, &settings, 1e-2, Horizon { output: 1e-2, limit: f64::INFINITY }, None).expect("steps");
            let sample = running.sample(&PULLED, &settings);
            worst = worst.max((sample.q[0] - 0.25 * sample.q[1].sin()).abs());
        }
        let sample = running.sample(&PULLED, &settings);
        let mut state = State::start(&PULLED, sample.q, sample.v, 0.0);
        running.record(&sample, &mut state);
        (sample.q, worst, state.counters.substeps)
    };
    let (exact, ..) = run(Schemes::Only(Scheme::Dop853), 1e-13);
    for tolerance in [1e-4, 1e-6] {
        let (q, worst, steps) = run(Schemes::Automatic, tolerance);
        let (explicit, explicit_worst, explicit_steps) = run(Schemes::Only(Scheme::Dop853), tolerance);
        let (error, explicit_error) = ((q - exact).max_norm(), (explicit - exact).max_norm());
        assert!(worst < 100.0 * tolerance, "{tolerance:e}: {worst:e} off the curve, by dop853 alone {explicit_worst:e}");
        // Near the upright position the pendulum amplifies errors some 1e3 times.
        assert!(error < 1e4 * tolerance, "{tolerance:e}: {error:e}, by dop853 alone {explicit_error:e}");
        assert!(3 * steps < explicit_steps, "{tolerance:e}: {steps} steps, by dop853 alone {explicit_steps}");
    }
}

/// The error control keeps the error of an orbit within some multiples of the tolerance, and loose steps are not classified as stiff.
#[test]
fn the_error_follows_the_tolerance() {
    for tolerance in [1e-4, 1e-6, 1e-8, 1e-10, 1e-12] {
        let settings = settings(tolerance, 1e-3);
        let [q, v] = ellipse(0.0);
        let mut running = DenseStep::start(&KEPLER, q.into(), v.into(), &settings);
        let orbits = 10.0 * std::f64::consts::TAU;
        running.advance(&KEPLER, &settings, orbits, Horizon { output: orbits, limit: f64::INFINITY }, None).expect("steps");
        let sample = running.sample(&KEPLER, &settings);
        // Local errors add up to an error of the period, and that to an error of position: with the square of the number of steps, some
        // 1e2.
        let error = (sample.q[0] - q[0]).hypot(sample.q[1] - q[1]);
        assert!(error < 1e4 * tolerance && !running.is_stiff(), "tolerance {tolerance:e}: {error:e}");
    }
}

/// Under a damper and a damped spring that are much stiffer than the motion, steps are a few times the inverse rate and classified as
/// stiff.
#[test]
fn stiffness_is_noticed() {
    for stiff in [Point::cartesian(|_, v| -1e4 * *v), Point::cartesian(|q, v| -1e8 * *q - 1e3 * *v)] {
        let settings = settings(1e-6, 1e-3);
        let mut running = DenseStep::start(&stiff, [1e-3, 2e-4].into(), [1.0, -1.0].into(), &settings);
        let mut steps = 0;
        while !running.is_stiff() {
            steps += 1;
            assert!(steps < 5000, "5 s without a verdict");
            running.advance(&stiff, &settings, 1e-3, Horizon { output: 1e-3, limit: f64::INFINITY }, None).expect("steps");
        }
    }
}
