//! Dry friction that sticks: joints rest, slip at breakaway, and slide according to the closed form. `effects_reference.rs` has solutions
//! in quadruple precision.

use std::f64::consts::PI;

use fivebar::effects::Law;
use fivebar::hybrid::friction::FrictionProblem;
use fivebar::hybrid::{SlipDirection, StickSlip, StickSlips};
use fivebar::mechanism::Assembly;
use fivebar::mechanism::coordinates::THETA;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Direction, Inputs, Method, Parameters, Simulation};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::{dense_methods, enable, methods_of_fixed_steps, methods_with_events, tip};

/// A machine with motors 10 cm apart, and friction that sticks.
fn sticking(method: Method, coulomb: [f64; 5], breakaway: [f64; 5]) -> Parameters {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.1;
    parameters.start.theta = [2.2, 0.9];
    enable(&mut parameters, "friction");
    let friction = &mut parameters.effects.friction;
    (friction.law, friction.coulomb, friction.breakaway) = (Law::Stick, coulomb, breakaway);
    parameters.settings.method = method;
    parameters
}

/// Friction only in the motor joints.
const COULOMB: [f64; 5] = [0.01, 0.0, 0.0, 0.0, 0.01];
const BREAKAWAY: [f64; 5] = [0.012, 0.0, 0.0, 0.0, 0.012];

/// Motor torques that balance gravity without friction, N·m; the accelerations are affine in them.
fn balancing(parameters: &Parameters) -> [f64; 2] {
    let mut free = parameters.clone();
    free.effects.friction.enabled = false;
    let accelerated = |tau: [f64; 2]| {
        let inputs = Inputs { tau, ..default_inputs() };
        let a = Simulation::new(&free, &inputs).expect("a scene").state().core.a;
        [a[THETA[0]], a[THETA[3]]]
    };
    let [none, left, right] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]].map(accelerated);
    let [a, b] = [0, 1].map(|i| left[i] - none[i]);
    let [c, d] = [0, 1].map(|i| right[i] - none[i]);
    let determinant = a * d - b * c;
    [(c * none[1] - d * none[0]) / determinant, (b * none[0] - a * none[1]) / determinant]
}

fn angles(simulation: &Simulation) -> [f64; 4] {
    simulation.state().angles()
}

/// Under gravity and half the breakaway torque at each motor nothing moves for 60 s, and this minute costs less than a tenth of a second of
/// motion.
#[test]
fn below_breakaway_it_stays() {
    for method in methods_with_events() {
        let parameters = sticking(method, COULOMB, BREAKAWAY);
        let [left, right] = balancing(&parameters);
        let inputs = Inputs { tau: [left + 0.006, right - 0.006], ..default_inputs() };
        let mut held = Simulation::new(&parameters, &inputs).expect("a scene");
        let start = angles(&held);
        for call in 0..600 {
            held.advance(&inputs, 1e-3, 100).expect("steps");
            let state = held.state();
            assert!(state.core.a.max_norm() <= 1e-6, "{method:?}, call {call}: {:e} rad/s²", state.core.a.max_norm());
        }
        assert_eq!(angles(&held), start, "{method:?}");
        assert_eq!(held.state().core.work.dissipated, 0.0, "{method:?}");
        let counters = held.counters();
        // i3-ALP has nothing to iterate; the explicit method takes steps of 10 s.
        assert!(counters.iterations == 0 && counters.rejected == 0, "{method:?}: {counters:?}");
        assert!(counters.substeps <= if method != Method::I3alp { 20 } else { 60_000 }, "{method:?}: {counters:?}");

        // The torques of friction at the motors equal the added torques.
        let holding = held.state().holding(held.model());
        assert!((holding[0] + 0.006).abs() < 1e-9 && (holding[4] - 0.006).abs() < 1e-9, "{method:?}: {holding:?}");
    }
}

/// Under half of the plane's breakaway force the tip rests along the plane for 60 s. Across the plane its vibration decays, although
/// explicit steps could be as long as stability allows.
#[test]
fn below_its_bound_the_tip_stays_on_the_plane() {
    for method in methods_with_events() {
        let mut parameters = default_parameters();
        parameters.geometry.base_distance = 0.1;
        parameters.start.theta = [2.2, 0.9];
        (parameters.settings.method, parameters.effects.gravity.enabled) = (method, false);
        let [x, y] = tip(&Simulation::new(&parameters, &default_inputs()).expect("a scene"));
        enable(&mut parameters, "contact");
        let contact = &mut parameters.effects.contact;
        (contact.law, contact.mu, contact.offset) = (Law::Stick, 0.5, y + 1.0 / contact.k);
        let inputs = Inputs { tip_force: [0.25, -1.0], ..default_inputs() };
        let mut held = Simulation::new(&parameters, &inputs).expect("a scene");
        for call in 0..600 {
            held.advance(&inputs, 1e-3, 100).expect("steps");
            assert!((tip(&held)[0] - x).abs() < 1e-12, "{method:?}, call {call}");
            let fastest = held.state().core.a.max_norm();
            assert!(fastest <= 1e-6, "{method:?}, call {call}: {fastest:e} rad/s² or m/s²");
        }
        // The free arm takes some 7,600 explicit steps per minute.
        let counters = held.counters();
        assert!(
            counters.substeps + counters.rejected <= if method == Method::I3alp { 60_000 } else { 7_600 },
            "{method:?}: {counters:?}"
        );
    }
}

/// Just below breakaway the joint sticks, just above it slips, immediately with the excess of the torque over Coulomb's.
#[test]
fn it_lets_go_at_breakaway() {
    for method in methods_with_events() {
        let mut parameters = sticking(method, COULOMB, BREAKAWAY);
        parameters.effects.friction.breakaway_velocity = 1e-6;
        let [left, right] = balancing(&parameters);
        let mut moved = [0.999_999, 1.000_001].map(|part| {
            let inputs = Inputs { tau: [left + part * 0.012, right], ..default_inputs() };
            let mut simulation = Simulation::new(&parameters, &inputs).expect("a scene");
            let start = angles(&simulation)[0];
            simulation.advance(&inputs, 1e-3, 100).expect("steps");
            angles(&simulation)[0] - start
        });
        assert_eq!(moved[0], 0.0, "{method:?}");
        // 2 mN·m on some g·m² turn it by some mrad in 0.1 s.
        assert!((1e-3..2e-2).contains(&moved[1]), "{method:?}: {moved:?}");
        moved[1] = 0.0;

        // The torque grows every millisecond by 1e-3 of the bound; the joint slips in the millisecond in which the torque passes it.
        let mut simulation = Simulation::new(&parameters, &Inputs { tau: [left, right], ..default_inputs() }).expect("a scene");
        let start = angles(&simulation)[0];
        let went = (1..2000).find(|step| {
            let inputs = Inputs { tau: [left + 0.012e-3 * f64::from(*step) - 1e-9, right], ..default_inputs() };
            simulation.advance(&inputs, 1e-3, 1).expect("a step");
            angles(&simulation)[0] != start
        });
        assert_eq!(went, Some(1001), "{method:?}");
    }
}

/// Gain of the pulling servo, N·m/rad, its speed, rad/s, and the drop of friction at breakaway, N·m.
const KP: f64 = 5.0;
const PULL: f64 = 1e-3;
const DROP: f64 = 0.0025;

/// A soft servo pulls the left motor joint while friction holds the right one: on its way of 1 mrad the machine is a mass on a spring.
fn pulled(method: Method) -> Parameters {
    let mut parameters = sticking(method, [0.01, 0.0, 0.0, 0.0, 1.0], [0.01 + DROP, 0.0, 0.0, 0.0, 1.0]);
    // Small enough for friction to drop at once.
    parameters.effects.friction.breakaway_velocity = 1e-6;
    parameters.effects.gravity.enabled = false;
    enable(&mut parameters, "servo");
    let servo = &mut parameters.effects.servo;
    (servo.kp, servo.kd, servo.limit) = ([KP; 2], [0.0; 2], [1e3; 2]);
    parameters
}

/// The setpoints at a time.
fn pulling(parameters: &Parameters, time: f64) -> Inputs {
    Inputs { servo_theta: [parameters.start.theta[0] + PULL * time, parameters.start.theta[1]], ..default_inputs() }
}

/// Inertia at the left motor while friction holds the right one, kg·m²: from the acceleration by a torque.
fn inertia(parameters: &Parameters) -> f64 {
    let accelerated = |torque: f64| {
        let inputs = Inputs { tau: [torque, 0.0], ..pulling(parameters, 0.0) };
        Simulation::new(parameters, &inputs).expect("a scene").state().core.a[THETA[0]]
    };
    1.0 / (accelerated(2.0) - accelerated(1.0))
}

/// A mass I on a spring k pulled at the speed v, with friction that drops from T_s to T_c: it slips when the spring reaches T_s, swings
/// about T_c, and rests again after (2π − 2 atan(ΔT ω/(k v)))/ω, after a distance of 2ΔT/k plus v times this duration. On its way the
/// inertia changes by 1e-3, and setpoints are constant for 1 ms, which is 1e-3 of a jump: agreement within 1 %.
#[test]
fn it_sticks_and_slips_as_the_closed_form_says() {
    for method in methods_with_events() {
        let parameters = pulled(method);
        let omega = (KP / inertia(&parameters)).sqrt();
        let slip = (2.0 * PI - 2.0 * (DROP * omega / (KP * PULL)).atan()) / omega;
        let jump = 2.0 * DROP / KP + PULL * slip;
        let period = jump / PULL;

        let mut simulation = Simulation::new(&parameters, &pulling(&parameters, 0.0)).expect("a scene");
        let (mut rests, mut starts) = (vec![angles(&simulation)[0]], Vec::new());
        let mut dissipated = 0.0;
        for step in 0..8000 {
            let time = 1e-3 * f64::from(step);
            let rested = simulation.state().stick_slip.at_rest();
            simulation.advance(&pulling(&parameters, time), 1e-3, 1).expect("a step");
            let state = simulation.state();
            match (rested, state.stick_slip.at_rest()) {
                (true, false) => starts.push(time),
                (false, true) => rests.push(angles(&simulation)[0]),
                _ => {}
            }
            assert!(state.core.work.dissipated >= dissipated, "{method:?}, {time} s");
            dissipated = state.core.work.dissipated;
            let error = state.energy_error(simulation.model()).abs();
            assert!(error < 1e-9, "{method:?}, {time} s: {error:e} J");
        }
        assert!(rests.len() == 7 && starts.len() == 6, "{method:?}: {rests:?} {starts:?}");
        // The spring is slack at first.
        assert!((starts[0] - 0.0125 / KP / PULL).abs() <= 2e-3, "{method:?}: {starts:?}");
        for pair in rests.windows(2) {
            assert!((pair[1] - pair[0] - jump).abs() < 0.01 * jump, "{method:?}: {rests:?}, {jump}");
        }
        for pair in starts.windows(2) {
            assert!((pair[1] - pair[0] - period).abs() < 0.01 * period, "{method:?}: {starts:?}, {period}");
        }
    }
}

/// Two friction places together hold one motion, a third is too weak for the other: nothing rests, however strong they are. They hold the
/// motion in the same way, whichever of them could alone.
#[test]
fn places_of_one_motion_hold_one_motion() {
    let mut balance = FrictionProblem::default();
    balance.places.extend([0, 1, 2]);
    for (i, j, mobility) in [(0, 0, 1.0), (1, 1, 1.0), (2, 2, 1.0), (1, 2, -1.0), (2, 1, -1.0)] {
        balance.mobility[i][j] = mobility;
    }
    balance.change[..3].copy_from_slice(&[2.0, -0.5, 0.5]);
    balance.bounds[..3].copy_from_slice(&[1.0, 0.1, 1.0]);
    assert!(!balance.can_rest());
    let mut stick_slip = StickSlips::OPEN;
    balance.resolve_motion(&mut stick_slip);
    let expected = [
        StickSlip::Slips(SlipDirection::Forward),
        StickSlip::Sticks(SlipDirection::Forward),
        StickSlip::Sticks(SlipDirection::Backward),
    ];
    assert_eq!([0, 1, 2].map(|place| stick_slip.at(place)), expected);
    balance.change[0] = 0.5;
    assert!(balance.can_rest());
}

/// Past a turning point a joint slips as the links drive it, although friction there moves nothing: its mobility is round-off, which must
/// not decide. The numbers are for the left elbow of coaxial motors as the right arm stretches.
#[test]
fn a_place_that_friction_cannot_move_slips_as_it_is_driven() {
    for (change, direction) in [(668.0, SlipDirection::Forward), (-668.0, SlipDirection::Backward)] {
        for mobility in [0.0, 4.5e-13] {
            let mut balance = FrictionProblem::default();
            balance.places.push(1);
            (balance.mobility[0][0], balance.change[0], balance.bounds[0]) = (mobility, change, 1.2e-3);
            let mut stick_slip = StickSlips::OPEN;
            balance.resolve_motion(&mut stick_slip);
            assert_eq!(stick_slip.at(1), StickSlip::Slips(direction), "{change} rad/s², {mobility:e}");
        }
    }
}

/// With coaxial motors the inner joints turn by the same angle. They stop and stick together, whichever of them is strong, and the arm then
/// turns about its motors as one piece.
#[test]
fn coaxial_links_stop_and_go_on_together() {
    for method in methods_with_events() {
        for strong in 1..4 {
            let mut friction = [0.0, 1e-4, 1.5e-4, 2e-4, 0.0];
            friction[strong] = 5e-3;
            let mut parameters = sticking(method, friction, friction);
            parameters.geometry.base_distance = 0.0;
            parameters.effects.gravity.enabled = false;
            parameters.start.theta = [2.2, 1.2];
            parameters.start.omega = [1.0, 0.5];
            let inputs = Inputs { tau: [2e-3, 0.0], ..default_inputs() };
            let mut simulation = Simulation::new(&parameters, &inputs).expect("a scene");
            simulation.advance(&inputs, 1e-3, 100).expect("steps");
            let apart = |simulation: &Simulation| angles(simulation)[0] - angles(simulation)[3];
            let stopped = apart(&simulation);
            for _ in 0..10 {
                simulation.advance(&inputs, 1e-3, 10).expect("steps");
                let state = simulation.state();
                let [left, right] = [0, 3].map(|link| state.core.v[THETA[link]]);
                // By dop853 sticking joints drift with the error of its steps.
                assert!((left - right).abs() < 1e-10 && left > 0.5, "{method:?}, {strong}: {left} {right}");
                assert!((apart(&simulation) - stopped).abs() < 1e-10, "{method:?}, {strong}");
                // Each joint uses an equal fraction of its breakaway torque; a third of 2 mN·m acts on the other leg, relative to 5.25 to
                // 5.35.
                let holding = state.holding(simulation.model());
                let parts = [1, 2, 3].map(|joint| (holding[joint] / friction[joint]).abs());
                assert!(parts.iter().all(|part| (part - parts[0]).abs() < 1e-6 && *part > 0.05 && *part < 0.5), "{parts:?}");
            }
            let counters = simulation.counters();
            assert!(counters.rejected < 100 && counters.substeps < 3000, "{method:?}, {strong}: {counters:?}");
        }
    }
}

/// A scene, and its inputs over time.
type Motion = (Parameters, fn(f64) -> Inputs);

/// Motions with all kinds of friction places: a fall in which joints stick and slip; a handle pulled onto a wall, on which it sticks.
fn motions(method: Method) -> [Motion; 2] {
    let mut fall = default_parameters();
    fall.start.theta[1] = 2.0 * PI / 3.0;
    enable(&mut fall, "viscous");
    enable(&mut fall, "friction");
    fall.effects.friction.law = Law::Stick;
    fall.settings.method = method;
    let mut wall = sticking(method, [1e-3; 5], [1.2e-3; 5]);
    wall.effects.gravity.enabled = false;
    enable(&mut wall, "payload");
    enable(&mut wall, "contact");
    wall.effects.contact.offset = 0.2;
    wall.effects.contact.law = Law::Stick;
    // The hand presses, rests, pushes along, rests again, and lifts off.
    let hand = |time: f64| Inputs {
        tip_force: match time {
            t if t < 0.6 => [0.0, -3.0],
            t if t < 0.65 => [1.2, -3.0],
            t if t < 0.9 => [0.3, -3.0],
            _ => [0.0, 0.2],
        },
        ..default_inputs()
    };
    [(fall, |_| default_inputs()), (wall, hand)]
}

/// Dissipated energy never decreases.
#[test]
fn dissipated_energy_never_decreases() {
    for method in methods_with_events() {
        for (parameters, inputs) in motions(method) {
            let mut simulation = Simulation::new(&parameters, &inputs(0.0)).expect("a scene");
            let (mut dissipated, mut rested) = (0.0, 0);
            for step in 0..1200 {
                let time = 1e-3 * f64::from(step);
                simulation.advance(&inputs(time), 1e-3, 1).expect("a step");
                let state = simulation.state();
                assert!(state.core.work.dissipated >= dissipated - 1e-15, "{method:?}, {time} s");
                dissipated = state.core.work.dissipated;
                let error = state.energy_error(simulation.model()).abs();
                assert!(error < 1e-6, "{method:?}, {time} s: {error:e} J");
                rested += u32::from(state.stick_slip.at_rest());
                let holding = state.holding(simulation.model());
                assert!(holding.iter().all(|torque| torque.is_finite()), "{method:?}, {time} s: {holding:?}");
            }
            assert!(inputs(0.0) == default_inputs() || rested > 200, "{method:?}: {rested} ms at rest");
        }
    }
}

/// Any number of macro steps per call, and continuing from a stored state, gives the same bits.
#[test]
fn calls_and_copies_change_nothing() {
    for method in methods_with_events() {
        for (parameters, inputs) in motions(method) {
            let run = |size: u64| {
                let mut simulation = Simulation::new(&parameters, &inputs(0.0)).expect("a scene");
                for call in 0..1200 / size {
                    // Both runs have a communication point at each change of the inputs.
                    simulation.advance(&inputs(1e-3 * (call * size) as f64), 1e-3, size).expect("steps");
                    if size == 1 {
                        // Stored states can be read back, also after many steps.
                        let run = simulation.run().clone();
                        simulation = Simulation::restored(simulation.parameters(), run).expect("a stored state");
                    }
                }
                (simulation.state().core.q, simulation.state().core.v, simulation.state().stick_slip)
            };
            let [one, many] = [1, 50].map(run);
            assert!(one == many, "{method:?}: {one:?} {many:?}");
        }
    }
}

/// Derivatives keep sticking joints at rest; if friction locks everything, they are refused.
#[test]
fn derivatives_keep_sticking_joints_at_rest() {
    let parameters = pulled(Method::I3alp);
    let start = |torque: f64| {
        let inputs = Inputs { tau: [torque, 0.0], ..pulling(&parameters, 0.0) };
        Simulation::new(&parameters, &inputs).expect("a scene")
    };
    let by_torque = Direction { inputs: Inputs { tau: [1.0, 0.0], ..Inputs::default() }, ..Direction::default() };
    let (resolve_motion, more) = (start(0.5), start(0.75));
    let varied = resolve_motion.state().varied(resolve_motion.model(), &by_torque).expect("one joint is held");
    // The accelerations are affine in the torque, so differences have only round-off.
    for link in [0, 3] {
        let difference = (more.state().core.a[THETA[link]] - resolve_motion.state().core.a[THETA[link]]) / 0.25;
        assert!((varied.a[THETA[link]] - difference).abs() < 1e-9 * (1.0 + difference.abs()), "{link}: {difference}");
    }
    assert!(varied.a[THETA[3]].abs() < 1e-9 && varied.a[THETA[0]] > 100.0, "{:?}", varied.a);
    let resting = start(0.0);
    let refused = resting.state().varied(resting.model(), &by_torque).expect_err("all is held").to_string();
    assert!(refused.contains("the tip sticks or friction locks") && refused.ends_with('.'), "{refused}");
}

/// Only methods with steps that can end at a stop accept it; the others refuse with one message.
#[test]
fn other_methods_refuse() {
    for method in methods_of_fixed_steps() {
        let mut parameters = sticking(method, COULOMB, BREAKAWAY);
        parameters.settings.adaptive = false;
        let refused = Simulation::new(&parameters, &default_inputs()).expect_err("no steps that can end").to_string();
        let fixed = if method == Method::I3alp { " and solver.adaptive = false" } else { "" };
        let expected = format!("friction.law = stick is not allowed with solver.method = {}{fixed}, whose steps", method.name());
        let takes_it = |other: &Method| refused.contains(&format!(" {}", other.name()));
        assert!(
            refused.starts_with(&expected) && methods_with_events().iter().all(takes_it) && refused.ends_with('.'),
            "{refused}"
        );
        let mut without = parameters.clone();
        without.effects.friction.law = Law::Smooth;
        Simulation::new(&without, &default_inputs()).expect("a scene");
        without.effects.contact.enabled = true;
        without.effects.contact.law = Law::Stick;
        let refused = Simulation::new(&without, &default_inputs()).expect_err("no steps that can end").to_string();
        assert!(refused.contains("contact.law = stick") && refused.contains(method.name()), "{refused}");
    }
}

/// A motor joint sticks while the other moves; its breakaway torque is just below the largest torque that it must hold, which lasts at
/// most a hundredth of a step: it slips there. Checking only places an eighth of a step apart would miss one in four such instants.
#[test]
fn a_load_that_passes_the_bound_for_a_moment_lets_go() {
    const STEP: f64 = 5e-5;
    const CALLS: usize = 600;
    let mut random = ChaCha8Rng::seed_from_u64(14);
    let mut uniform = |low: f64, high: f64| low + (high - low) * ((random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64);
    let (methods, mut moments) = (dense_methods(), 0);
    for scene in 0..160 {
        let held = scene % 2;
        // The motors' joints are the first and the last.
        let joint = 4 * held;
        let only = |torque: f64| std::array::from_fn(|i| if i == joint { torque } else { 0.0 });
        let mut parameters = sticking(methods[scene / 2 % methods.len()], only(1e6), only(1e6));
        parameters.settings.error_tolerance = 1e-8;
        parameters.effects.gravity.enabled = scene % 3 > 0;
        parameters.start.theta = [uniform(1.6, 2.6), uniform(0.3, 1.3)];
        parameters.start.omega[1 - held] = uniform(-20.0, 20.0);
        enable(&mut parameters, "servo");
        parameters.effects.servo.kp = [uniform(0.1, 20.0); 2];
        let inputs = Inputs { servo_theta: parameters.start.theta.map(|angle| angle + uniform(-0.5, 0.5)), ..default_inputs() };
        // Torque needed to hold the joint.
        let Ok(mut simulation) = Simulation::new(&parameters, &inputs) else { continue };
        let load = |simulation: &Simulation| simulation.state().holding(simulation.model())[joint].abs();
        let mut loads = vec![load(&simulation)];
        for _ in 0..CALLS {
            simulation.advance(&inputs, STEP, 1).expect("a step");
            loads.push(load(&simulation));
        }
        let top = (0..loads.len()).max_by(|i, j| loads[*i].total_cmp(&loads[*j])).expect("a load");
        let bound = loads[top] * (1.0 - 10_f64.powf(uniform(-5.0, -2.0)));
        if top == 0 || top == CALLS || loads[0] > 0.99 * bound {
            continue;
        }
        moments += 1;
        let friction = &mut parameters.effects.friction;
        (friction.coulomb, friction.breakaway) = (only(0.9 * bound), only(bound));
        let mut simulation = Simulation::new(&parameters, &inputs).expect("a scene");
        for _ in 0..CALLS {
            simulation.advance(&inputs, STEP, 1).expect("a step");
            let load = load(&simulation);
            // The holding torque is accurate to some tolerances, of some 1e2 rad/s² on 1e-3 kg·m².
            assert!(load <= bound * (1.0 + 1e-6) + 1e-7, "scene {scene} holds {load} N·m of {bound}");
        }
    }
    assert!(moments > 20, "{moments} moments");
}

/// A coaxial machine with its tip 40 µm to 400 µm deep in a hard plane, to which it sticks while the parallelogram of its legs passes the
/// stretched arm at some hundreds of rad/s. Joint forces grow without bound there, and the sticking constraint turns their round-off into
/// rates. As it is, and with plane, weight and friction tuned.
fn stretched(method: Method, tolerance: f64) -> [Parameters; 2] {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.0;
    parameters.start.theta = [2.338665394833697, 2.0386653948336972];
    parameters.start.omega = [-2.305151876677578, 1.350627632379787];
    (parameters.settings.method, parameters.settings.error_tolerance) = (method, tolerance);
    enable(&mut parameters, "friction");
    enable(&mut parameters, "contact");
    let effects = &mut parameters.effects;
    effects.gravity.tilt = 0.7446753806531686;
    let friction = &mut effects.friction;
    (friction.law, friction.breakaway_velocity) = (Law::Stick, 0.00994729365140451);
    friction.coulomb = [0.0003973574236690279, 0.0006592618041607885, 0.006133952469057851, 0.0, 0.0];
    friction.breakaway = [0.0020817151715406094, 0.0018071261764696777, 0.010622773557628754, 0.0, 0.0];
    let contact = &mut effects.contact;
    (contact.law, contact.mu) = (Law::Stick, 10.0);
    (contact.k, contact.d, contact.width) = (130880.39653304724, 6.6413753298844, 0.00029645219206492234);
    (contact.nx, contact.ny, contact.offset) = (0.2075219331886862, 0.9782303651214423, 0.2818399332333961);
    let mut tuned = parameters.clone();
    let effects = &mut tuned.effects;
    effects.gravity.g = 18.58078903476394;
    (effects.friction.coulomb[0], effects.friction.breakaway[0]) = (0.0011920722710070837, 0.006245145514621828);
    let contact = &mut effects.contact;
    (contact.nx, contact.ny, contact.offset) = (0.24275571825888692, 0.9700874503118839, 0.28175129633999296);
    [parameters, tuned]
}

/// The link angles after some calls, rad.
fn after_calls([parameters, tuned]: &[Parameters; 2], size: f64, calls: u64) -> [f64; 4] {
    let inputs = Inputs { tip_force: [0.0, -0.024408629776949232], ..default_inputs() };
    let mut simulation = Simulation::new(parameters, &default_inputs()).expect("a scene");
    simulation.tune(&tuned.effects).expect("parameters");
    for call in 0..calls {
        let taken = simulation.advance(&inputs, size, 1);
        assert!(taken.is_ok(), "{:e} rad, call {call} of {size} s: {}", parameters.settings.error_tolerance, taken.unwrap_err());
    }
    angles(&simulation)
}

fn farthest(one: [f64; 4], other: [f64; 4]) -> f64 {
    one.into_iter().zip(other).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
}

/// For any tolerance and length of calls no call fails, and the motion equals the explicit method's in the angles.
#[test]
fn a_tip_that_sticks_goes_through_the_stretched_arm() {
    const CALL: f64 = 0.000980392156862745;
    for (size, calls) in [(CALL, 17), (0.5e-3, 34), (1e-3, 17), (2e-3, 8)] {
        let reference = after_calls(&stretched(Method::Dop853, 1e-12), size, calls);
        let tolerances = if size == CALL { [1e-8, 5e-9, 3e-9, 2e-9, 1e-9].as_slice() } else { &[3e-9] };
        for tolerance in tolerances {
            let off = farthest(after_calls(&stretched(Method::I3alp, *tolerance), size, calls), reference);
            // In a bounce of 10 ms some hundred local errors add up.
            assert!(off < 100.0 * tolerance, "{tolerance:e} rad, calls of {size} s: {off:e} rad");
        }
    }
}

/// Scenes around this one; all must complete.
#[test]
fn tips_that_stick_go_through_the_stretched_arm() {
    let mut random = ChaCha8Rng::seed_from_u64(31);
    let mut uniform = |low: f64, high: f64| low + (high - low) * ((random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64);
    for scene in 0..12 {
        let (mu, stiffer) = (3.0 * 10_f64.powf(uniform(0.0, 1.0)), 10_f64.powf(uniform(-1.0, 3_f64.log10())));
        let faster = [uniform(0.8, 1.2), uniform(0.8, 1.2)];
        let [reference, found] = [(Method::Dop853, 1e-11), (Method::I3alp, 3e-9)].map(|(method, tolerance)| {
            let mut scenes = stretched(method, tolerance);
            for parameters in &mut scenes {
                let contact = &mut parameters.effects.contact;
                (contact.mu, contact.k) = (mu, stiffer * contact.k);
                (0..2).for_each(|motor| parameters.start.omega[motor] *= faster[motor]);
            }
            after_calls(&scenes, 0.000980392156862745, 17)
        });
        let off = farthest(found, reference);
        assert!(off < 1e-6, "scene {scene}, mu {mu}, {stiffer} times the stiffness: {off:e} rad");
    }
}

/// Folded legs on coaxial motors: the elbows do not turn there, so their friction neither slips nor sticks, and no event is located. At
/// every tolerance cost equals the cost of other postures, and the motion equals the motion without friction in the elbows.
#[test]
fn elbows_of_folded_legs_cost_nothing() {
    let folded = |method, tolerance, elbows: f64| {
        let mut parameters = default_parameters();
        parameters.geometry.base_distance = 0.0;
        parameters.start.theta = [PI / 2.0, 1.0663508792717247];
        parameters.start.assembly = Assembly::Minus;
        parameters.start.omega[1] = 7.6;
        enable(&mut parameters, "friction");
        let friction = &mut parameters.effects.friction;
        friction.law = Law::Stick;
        for elbow in [1, 3] {
            friction.coulomb[elbow] *= elbows;
            friction.breakaway[elbow] *= elbows;
        }
        (parameters.settings.method, parameters.settings.error_tolerance) = (method, tolerance);
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("a scene");
        simulation.advance(&default_inputs(), 2e-3, 200).expect("steps");
        simulation
    };
    for method in [Method::Dop853, Method::Automatic] {
        for tolerance in [1e-7, 3e-9, 1e-11] {
            let [with, without] = [1.0, 0.0].map(|elbows| folded(method, tolerance, elbows));
            let off = farthest(angles(&with), angles(&without));
            assert!(off < 1e-12, "{method:?}, {tolerance:e} rad: {off:e} rad");
            let [cost, least] = [&with, &without].map(|run| run.counters().substeps + run.counters().rejected);
            assert!(cost <= 2 * least && cost < 200, "{method:?}, {tolerance:e} rad: {cost} steps, without friction there {least}");
            let state = with.state();
            assert_eq!([1, 3].map(|elbow| state.holding(with.model())[elbow]), [0.0; 2]);
            // The stored state can be read back.
            let run = with.run().clone();
            Simulation::restored(with.parameters(), run).expect("a stored state");
        }
    }
    // By steps of third order.
    let [explicit, implicit] = [Method::Dop853, Method::I3alp].map(|method| angles(&folded(method, 1e-11, 1.0)));
    assert!(farthest(explicit, implicit) < 1e-8, "{explicit:?} {implicit:?}");
}
