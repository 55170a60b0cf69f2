//! Orders and reference values: fall-90-120 and the torque test in quadruple precision, from other programs.

use fivebar::integrator::{self, Posed, System, rk4};
use fivebar::mechanism::Coordinates;
use fivebar::observers;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::five_bar::FiveBar;
use fivebar::simulation::{Inputs, Method, Simulation};

use crate::support::{Reference, angle_error, fall_90_120, run, slope, tip_error, torque};

/// The reference at t = 1 s, with accelerations.
fn fall_at_1s() -> (Reference, [Coordinates; 3]) {
    let reference = Reference::read("fall-90-120").pop().expect("rows");
    assert_eq!(reference.t, 1.0);
    let parameters = fall_90_120(Method::I3alp);
    let (q, v) = reference.coordinates(&parameters.geometry);
    let simulation = Simulation::new(&parameters, &Inputs::default()).expect("scene");
    let inputs = Inputs::default();
    let system = FiveBar::new(simulation.model(), &inputs, &[0; 4]);
    let (a, ..) =
        integrator::equilibrium(&system, Posed { q: &q, pose: &system.pose(&q), v: &v }, simulation.model().regularization);
    (reference, [q, v, a])
}

#[test]
fn i3alp_is_of_second_order_in_positions_velocities_and_accelerations() {
    let (_, [q, v, a]) = fall_at_1s();
    let mut points = [vec![], vec![], vec![]];
    for h in [2.5e-4, 1e-4, 5e-5, 2.5e-5, 1e-5] {
        let mut simulation = Simulation::new(&fall_90_120(Method::I3alp), &Inputs::default()).expect("scene");
        run(&mut simulation, &Inputs::default(), h, 1.0);
        let core = &simulation.state().core;
        for (points, (got, want)) in points.iter_mut().zip([(&core.q, &q), (&core.v, &v), (&core.a, &a)]) {
            points.push((h, angle_error(got, want)));
        }
    }
    for (what, points) in ["q", "q̇", "q̈"].into_iter().zip(points) {
        let order = slope(&points);
        assert!((order - 2.0).abs() < 0.1, "order in {what}: {order:.3}, {points:?}");
    }
}

/// At 2 µs the second-order error alone is 2.0e-8 m; round-off must be negligible in comparison.
#[test]
fn i3alp_has_no_round_off_floor() {
    let (reference, _) = fall_at_1s();
    let mut simulation = Simulation::new(&fall_90_120(Method::I3alp), &Inputs::default()).expect("scene");
    run(&mut simulation, &Inputs::default(), 2e-6, 1.0);
    let error = tip_error(&simulation, reference.tip);
    assert!(error < 3e-8, "tip error {error:e} m");
}

#[test]
fn rk4_is_of_fourth_order() {
    let (reference, _) = fall_at_1s();
    let scene = Simulation::new(&fall_90_120(Method::Rk4), &Inputs::default()).expect("scene");
    let model = scene.model();
    let inputs = Inputs::default();
    let system = FiveBar::new(model, &inputs, &[0; 4]);
    let settings = rk4::Settings { regularization: model.regularization, tolerance: 5e-13, max_iterations: 10 };
    let mut points = vec![];
    for h in [1e-3, 5e-4, 2.5e-4, 1e-4] {
        let mut state = scene.state().core;
        for _ in 0..(1.0_f64 / h).round() as u64 {
            rk4::advance(&system, &settings, &mut state, h).expect("step");
        }
        points.push((h, angle_error(&state.q, &reference.coordinates(&model.mechanism.geometry).0)));
    }
    let order = slope(&points);
    // At 1 ms the error is smaller than its order predicts.
    assert!(order > 3.7 && order < 5.0, "order {order:.3}, {points:?}");
}

/// A sinusoidal motor torque, constant over each communication step at its mid-step value, still gives second order in q and q̇, because q̈
/// and λ are recomputed when the input changes. (q̈ at a point uses the input of its step, half a step away.) Reference: the same with
/// h = 5 µs, whose own error is 1/400 of the finest.
#[test]
fn i3alp_is_of_second_order_under_inputs_that_change() {
    let mut parameters = default_parameters();
    parameters.effects.gravity.enabled = false;
    parameters.settings.adaptive = false;
    parameters.start.theta[1] = 120f64.to_radians();
    let end = |h: f64| {
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        for i in 0..(0.5 / h).round() as u64 {
            let middle = (i as f64 + 0.5) * h;
            let inputs = Inputs {
                tau: [0.02 * (20.0 * middle).sin(), -0.01 * (13.0 * middle).sin()],
                tip_force: [0.05 * (9.0 * middle).sin(), 0.1 * (17.0 * middle).sin()],
                ..default_inputs()
            };
            simulation.advance(&inputs, h, 1).expect("step");
        }
        let core = &simulation.state().core;
        (core.q, core.v, observers::energies(simulation.model(), &simulation.state()).error)
    };
    let (q_reference, v_reference, _) = end(5e-6);
    let (mut positions, mut velocities, mut energies) = (vec![], vec![], vec![]);
    for h in [1e-3, 5e-4, 2.5e-4, 1e-4] {
        let (q, v, energy) = end(h);
        positions.push((h, angle_error(&q, &q_reference)));
        velocities.push((h, angle_error(&v, &v_reference)));
        energies.push((h, energy.abs()));
    }
    for (what, points) in [("position", positions), ("velocity", velocities), ("energy balance", energies)] {
        let order = slope(&points);
        assert!((order - 2.0).abs() < 0.1, "{what}: order {order:.3}, {points:?}");
    }
}

/// Φ ≤ 1e-12 m, Φ̇ ≤ 1e-9 m/s, Φ̈ ≤ 1e-8 m/s² at every step, for every h.
#[test]
fn constraints_hold_at_every_step() {
    for (h, adaptive) in [(1e-3, false), (1e-4, false), (1e-5, false), (1e-3, true)] {
        let mut parameters = fall_90_120(Method::I3alp);
        parameters.settings.adaptive = adaptive;
        let mut simulation = Simulation::new(&parameters, &Inputs::default()).expect("scene");
        for _ in 0..(1.0_f64 / h).round() as u64 {
            simulation.advance(&Inputs::default(), h, 1).expect("step");
            let norms = observers::constraint_norms(simulation.model(), &simulation.state());
            assert!(norms.position <= 1e-12 && norms.velocity <= 1e-9 && norms.acceleration <= 1e-8, "h = {h}: {norms:?}");
        }
    }
}

/// Every row of the quadruple-precision files, by the default method with a small local error.
#[test]
fn reference_solutions_are_met() {
    let mut fall = fall_90_120(Method::I3alp);
    fall.settings.adaptive = true;
    let (torque, pull) = torque();
    // Local errors of 1e-13 rad add up to 1e-6 (fall) and, amplified by the fast passages of the torque test, 1e-5.
    for (name, mut parameters, inputs, bound) in [("fall-90-120", fall, Inputs::default(), 1e-6), ("torque", torque, pull, 1e-5)] {
        parameters.settings.error_tolerance = 1e-13;
        let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
        let mut steps = 0;
        for row in Reference::read(name) {
            let target = (row.t / 1e-3).round() as u64;
            simulation.advance(&inputs, 1e-3, target - steps).expect("step");
            steps = target;
            let (q, v) = row.coordinates(&parameters.geometry);
            let core = &simulation.state().core;
            let (error, rate_error) = (angle_error(&core.q, &q), angle_error(&core.v, &v));
            assert!(tip_error(&simulation, row.tip) < bound, "{name}, t = {}: tip", row.t);
            assert!(error < 10.0 * bound && rate_error < 1e3 * bound, "{name}, t = {}: {error:e} rad, {rate_error:e} rad/s", row.t);
        }
    }
}

/// The symmetric free fall comes to rest at 0.73296 and 1.46591 s (two independent prototypes, five digits).
#[test]
fn the_free_fall_turns_when_it_should() {
    let mut simulation = Simulation::new(&default_parameters(), &default_inputs()).expect("scene");
    let mut steps = 0;
    for t in [0.73296, 1.46591] {
        let target = (t / 1e-5_f64).round() as u64;
        simulation.advance(&default_inputs(), 1e-5, target - steps).expect("steps");
        steps = target;
        let velocity = observers::motion(simulation.model(), &simulation.state()).tip_velocity;
        // Tolerance: half a unit of the last digit of t, times an acceleration of some 10 m/s².
        assert!(velocity.norm() < 1e-4, "t = {t}: {velocity}");
    }
}
