//! The method that chooses the scheme of its steps, on the five-bar: derivatives for implicit steps, chosen schemes and their cost,
//! communication points, stored states.

use std::f64::consts::FRAC_PI_2;

use fivebar::effects::NAMES;
use fivebar::integrator::{Posed, State, System, equilibrium};
use fivebar::observers;
use fivebar::simulation::angles::{AngleSystem, Angles, angles_of};
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::five_bar::FiveBar;
use fivebar::simulation::{Counters, Inputs, Method, Parameters, Simulation};
use fivebar::vector::Vector;

use crate::support::{MGL, Reference, angle_error, enable, fall_90_120, run, tip_error, unequal};

/// e of the explicit method in the link angles, below the round-off of a regular matrix.
const REGULARIZATION: f64 = 1e-18;

fn automatic(mut parameters: Parameters, tolerance: f64) -> Parameters {
    (parameters.settings.method, parameters.settings.error_tolerance) = (Method::Automatic, tolerance);
    parameters
}

/// Servos on both motors, so stiff that stability limits explicit steps to 0.1 ms.
fn clamped() -> (Parameters, Inputs) {
    let mut parameters = fall_90_120(Method::Automatic);
    enable(&mut parameters, "servo");
    let servo = &mut parameters.effects.servo;
    (servo.kp, servo.kd, servo.limit) = ([200.0; 2], [2.0; 2], [50.0; 2]);
    let inputs = Inputs { servo_theta: [1.6, 2.0], ..default_inputs() };
    (parameters, inputs)
}

fn counters(simulation: &Simulation) -> Counters {
    simulation.state().core.counters
}

/// ∂q̈/∂q and ∂q̈/∂q̇ against central differences, with each effect alone and with all of them.
#[test]
fn tangents_of_accelerations_are_derivatives() {
    let loads = Inputs { tau: [0.02, -0.01], tip_force: [0.1, 0.05], servo_theta: [1.4, 1.9], ..default_inputs() };
    let alone = NAMES.iter().map(|name| vec![*name]);
    for effects in alone.chain([vec![], NAMES.to_vec()]) {
        let mut parameters = unequal();
        parameters.effects.gravity.enabled = false;
        for name in &effects {
            enable(&mut parameters, name);
        }
        // Stop and plane at the current posture, the plane on the tip's side; smooth friction.
        parameters.effects.stop.upper = [1.5, 1.5];
        parameters.effects.contact.offset = 0.4;
        parameters.effects.friction.breakaway_velocity = 1.0;
        let simulation = Simulation::new(&parameters, &loads).expect("scene");
        let mut moving = simulation.clone();
        run(&mut moving, &loads, 1e-3, 0.05);
        for simulation in [simulation, moving] {
            let state = simulation.state();
            let (q, v) = (angles_of(&state.core.q), angles_of(&state.core.v) + Vector::from([0.3, -0.2, 0.5, 0.1]));
            let system = AngleSystem::new(FiveBar::new(simulation.model(), &loads, &state.turns));
            let at = State::start(&system, q, v, REGULARIZATION);
            let tangents = system.acceleration_tangents(&at, &system.pose(&at.q), REGULARIZATION).expect("tangents");
            let step = 1e-6;
            let acceleration =
                |q: Angles, v: Angles| equilibrium(&system, Posed { q: &q, pose: &system.pose(&q), v: &v }, REGULARIZATION).0;
            for i in 0..4 {
                let shift = step * Vector::unit(i);
                let by_q = (0.5 / step) * (acceleration(q + shift, v) - acceleration(q - shift, v));
                let by_v = (0.5 / step) * (acceleration(q, v + shift) - acceleration(q, v - shift));
                for (what, exact, difference) in [("angle", tangents.by_q[i], by_q), ("rate", tangents.by_v[i], by_v)] {
                    // Errors of differences: 1e-12 times the third derivative, and round-off of some 1e3/s² over 1e-6.
                    let error = (exact - difference).max_norm();
                    assert!(
                        error < 2e-6 * (1.0 + exact.max_norm() + at.a.max_norm()),
                        "{effects:?}, {what} {i}: {error:e} of {exact:?}"
                    );
                }
            }
        }
    }
}

/// Without stiff loads and changing inputs the method equals dop853 to the bit.
#[test]
fn on_a_free_road_it_is_dop853() {
    let end = |method: Method| {
        let mut parameters = automatic(fall_90_120(method), 1e-9);
        parameters.settings.method = method;
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        run(&mut simulation, &default_inputs(), 1e-3, 2.0);
        simulation.state()
    };
    assert_eq!(end(Method::Automatic), end(Method::Dop853));
}

/// A stiff servo: a hundredth of dop853's steps, within the tolerance at the end; the energy is also accurate.
#[test]
fn stiff_loads_take_implicit_steps() {
    let end = |method: Method, tolerance: f64| {
        let (parameters, inputs) = clamped();
        let mut parameters = automatic(parameters, tolerance);
        parameters.settings.method = method;
        let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
        run(&mut simulation, &inputs, 1e-3, 1.0);
        simulation
    };
    let exact = end(Method::Dop853, 1e-12).state().core.q;
    for tolerance in [1e-5, 1e-7, 1e-9] {
        let (own, explicit) = (end(Method::Automatic, tolerance), end(Method::Dop853, tolerance));
        let error = angle_error(&own.state().core.q, &exact);
        assert!(error < 10.0 * tolerance, "{tolerance:e}: {error:e} rad");
        let (few, many) = (counters(&own), counters(&explicit));
        assert!(5 * few.substeps < many.substeps, "{tolerance:e}: {few:?}, by dop853 {many:?}");
        let energies = observers::energies(own.model(), &own.state());
        assert!(energies.error.abs() < 1e3 * tolerance * MGL, "{tolerance:e}: {energies:?}");
        assert!(!own.is_stiff(), "nothing to warn of");
    }
}

/// After projection onto the constraints a machine under stiff servos stays in equilibrium: on `stiff_servo` loose tolerances give five
/// digits in few steps. Projection along the shortest way gives errors a hundred times as large and twice as many steps.
#[test]
fn implicit_steps_end_in_balance() {
    let mut parameters = fall_90_120(Method::Automatic);
    enable(&mut parameters, "servo");
    let servo = &mut parameters.effects.servo;
    (servo.kp, servo.kd, servo.limit) = ([1e6, 0.0], [30.0, 0.0], [1e6, 1.0]);
    let inputs = Inputs { servo_theta: [FRAC_PI_2, 0.0], ..default_inputs() };
    let reference = Reference::read("stiff_servo").pop().expect("rows");
    for (tolerance, most_off, most_tries) in [(1e-3, 1e-4, 45), (1e-4, 1e-5, 65), (1e-6, 1e-6, 100)] {
        let mut simulation = Simulation::new(&automatic(parameters.clone(), tolerance), &inputs).expect("scene");
        run(&mut simulation, &inputs, 1e-3, reference.t);
        let error = tip_error(&simulation, reference.tip);
        let Counters { substeps, rejected, .. } = counters(&simulation);
        assert!(error < most_off, "{tolerance:e}: {error:e} m");
        assert!(substeps + rejected < most_tries, "{tolerance:e}: {substeps} steps and {rejected} refused tries");
    }
}

/// If inputs change every macro step, the method takes as many steps as order 8 with half the evaluations; its error is far below the
/// tolerance.
#[test]
fn short_holds_take_steps_of_order_5() {
    let end = |method: Method, tolerance: f64| {
        let mut parameters = automatic(fall_90_120(method), tolerance);
        parameters.settings.method = method;
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        for i in 0..300 {
            let inputs = Inputs { tau: [1e-4 * f64::from(i % 7), 0.0], ..default_inputs() };
            simulation.advance(&inputs, 1e-3, 1).expect("step");
        }
        simulation
    };
    let exact = end(Method::Dop853, 1e-13).state().core.q;
    for tolerance in [1e-5, 1e-7, 1e-9] {
        let own = end(Method::Automatic, tolerance);
        let error = angle_error(&own.state().core.q, &exact);
        // 300 steps, amplified by the motion.
        assert!(error < 1e2 * tolerance, "{tolerance:e}: {error:e} rad");
        let counters = counters(&own);
        assert!(counters.substeps < 310 && counters.rejected < 15, "{tolerance:e}: {counters:?}");
        assert_ne!(own.state().core.q, end(Method::Dop853, tolerance).state().core.q, "other steps");
    }
}

/// Communication points do not change the result, with steps of any kind.
#[test]
fn communication_points_leave_no_trace() {
    let (parameters, inputs) = clamped();
    let start = Simulation::new(&automatic(parameters, 1e-7), &inputs).expect("scene");
    let ends = [1_u64, 5, 50, 500].map(|steps| {
        let mut simulation = start.clone();
        for (half, tau) in [(0, 0.0), (1, 0.1)] {
            let inputs = Inputs { tau: [tau, 0.0], servo_theta: [1.6 + f64::from(half) * 0.1, 2.0], ..inputs };
            for _ in 0..500 / steps {
                simulation.advance(&inputs, 1e-3, steps).expect("steps");
            }
        }
        simulation.state()
    });
    assert!(ends.iter().all(|end| *end == ends[0]));
    assert!(ends[0].core.counters.substeps < 500, "{:?}", ends[0].core.counters);
}

/// Interpolated states of implicit steps meet the constraints and are as accurate as the step ends.
#[test]
fn interpolated_outputs_are_as_good_as_steps() {
    let (parameters, inputs) = clamped();
    for tolerance in [1e-6, 1e-9] {
        let [mut own, mut exact] = [(Method::Automatic, tolerance), (Method::Dop853, 1e-12)].map(|(method, tolerance)| {
            let mut parameters = automatic(parameters.clone(), tolerance);
            parameters.settings.method = method;
            Simulation::new(&parameters, &inputs).expect("scene")
        });
        for i in 0..300 {
            own.advance(&inputs, 1e-3, 1).expect("a step");
            exact.advance(&inputs, 1e-3, 1).expect("a step");
            let norms = observers::constraint_norms(own.model(), &own.state());
            assert!(norms.position < 1e-14 && norms.velocity < 1e-12, "{norms:?}");
            let error = angle_error(&own.state().core.q, &exact.state().core.q);
            assert!(error < 20.0 * tolerance, "{tolerance:e}, {i} ms: {error:e} rad");
        }
    }
}

/// A copy continues with the same bits, also between steps of different kinds.
#[test]
fn a_copy_continues_with_the_same_bits() {
    let (parameters, inputs) = clamped();
    let mut simulation = Simulation::new(&automatic(parameters, 1e-6), &default_inputs()).expect("scene");
    for i in 0..40 {
        let mut copy = simulation.clone();
        let inputs = Inputs { tau: [0.01 * f64::from(i % 3), 0.0], ..inputs };
        for simulation in [&mut simulation, &mut copy] {
            simulation.advance(&inputs, 1e-3, 1 + i as u64 % 5).expect("steps");
        }
        assert_eq!(simulation.state(), copy.state());
    }
    assert_eq!(default_parameters().settings.method, Method::I3alp, "what the unit starts with");
}

/// A machine goes from stiff servos to a free fall and back, three times. Under servos steps are implicit, in falls explicit, and the error
/// is as small as with the purely explicit method.
#[test]
fn switching_loses_no_digit() {
    let end = |method: Method, tolerance: f64| {
        let (parameters, inputs) = clamped();
        let mut parameters = automatic(parameters, tolerance);
        parameters.settings.method = method;
        let held = parameters.effects.clone();
        let mut free = held.clone();
        (free.servo.kp, free.servo.kd) = ([0.0; 2], [0.0; 2]);
        let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
        let mut substeps = [0; 2];
        for phase in 0..6 {
            simulation.tune(if phase % 2 == 0 { &held } else { &free }).expect("what may be tuned");
            let before = counters(&simulation).substeps;
            run(&mut simulation, &inputs, 1e-3, [0.2, 0.05][phase % 2]);
            substeps[phase % 2] += counters(&simulation).substeps - before;
        }
        (simulation.state().core.q, substeps)
    };
    let exact = end(Method::Dop853, 1e-13).0;
    for tolerance in [1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10] {
        let [(own, [few, free]), (explicit, [many, as_many])] =
            [Method::Automatic, Method::Dop853].map(|method| end(method, tolerance));
        let errors = [own, explicit].map(|q| angle_error(&q, &exact));
        // Both errors are below 0.2 tolerances, because the stiff servos damp earlier errors.
        assert!(errors[0] < tolerance, "{tolerance:e}: {errors:?} rad");
        assert!(few < many, "{tolerance:e}: {few} steps in the clamp, {many} by dop853");
        assert!(free < 3 * as_many, "{tolerance:e}: {free} free steps, {as_many} by dop853");
    }
}

/// A machine that friction stops comes to rest in some ten steps and then costs nothing, even if the law is ten thousand times as steep as
/// the tolerance on rates resolves; dop853 takes 40,000 steps and more per second.
#[test]
fn rest_under_steep_friction_takes_no_steps() {
    for (breakaway_velocity, tolerance) in [(1e-2, 1e-4), (1e-4, 1e-4), (1e-5, 1e-4), (1e-5, 1e-6), (1e-5, 3e-9), (1e-6, 1e-3)] {
        let mut parameters = automatic(fall_90_120(Method::Automatic), tolerance);
        enable(&mut parameters, "friction");
        let friction = &mut parameters.effects.friction;
        friction.breakaway_velocity = breakaway_velocity;
        let torque = [0.06, 0.06, 2e-3, 2e-3, 0.06];
        (friction.coulomb, friction.breakaway) = (torque, torque);
        parameters.start.omega = [3.0, 0.0];
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        run(&mut simulation, &default_inputs(), 1e-3, 1.0);
        let come = counters(&simulation);
        run(&mut simulation, &default_inputs(), 1e-3, 2.0);
        let rest = counters(&simulation);
        // The joint creeps at a fraction of the breakaway velocity.
        assert!(simulation.state().core.v.max_norm() < breakaway_velocity, "{breakaway_velocity:e}, {tolerance:e}");
        assert!(come.substeps < 150, "{breakaway_velocity:e}, {tolerance:e}: {come:?}");
        assert!(rest.substeps - come.substeps < 5, "{breakaway_velocity:e}, {tolerance:e}: {come:?}, {rest:?}");
    }
}
