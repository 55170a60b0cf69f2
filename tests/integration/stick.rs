//! Dry friction that sticks: what is held stays, lets go at breakaway, and slips as its closed form says. Against solutions in quadruple
//! precision: `effects_reference.rs`.

use std::f64::consts::PI;

use fivebar::effects::Law;
use fivebar::effects::stick_slip::{FrictionProblem, SlipDirection, StickSlip, StickSlips};
use fivebar::fmi::bindings::{default_inputs, default_parameters};
use fivebar::mechanism::coordinates::THETA;
use fivebar::simulation::{Direction, Inputs, Method, Parameters, Simulation};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::{enable, tip};

/// The methods that can end a step where something stops or lets go.
const METHODS: [Method; 3] = [Method::I3alp, Method::Dop853, Method::Automatic];

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

/// Friction in the motor joints alone.
const COULOMB: [f64; 5] = [0.01, 0.0, 0.0, 0.0, 0.01];
const BREAKAWAY: [f64; 5] = [0.012, 0.0, 0.0, 0.0, 0.012];

/// Motor torques that hold the machine against gravity, N·m, where friction does nothing: the accelerations are affine in them.
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

/// For 60 s under gravity and half the breakaway torque at each motor: it does not move at all, and a minute of it costs less than a
/// tenth of a second of motion.
#[test]
fn below_breakaway_it_stays() {
    for method in METHODS {
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
        // By i3-ALP no step has anything to iterate; by the explicit method there are steps of 10 s.
        assert!(counters.iterations == 0 && counters.rejected == 0, "{method:?}: {counters:?}");
        assert!(counters.substeps <= if method != Method::I3alp { 20 } else { 60_000 }, "{method:?}: {counters:?}");

        // Torques that friction holds at the motors are those that were put on top.
        let holding = held.state().holding(held.model());
        assert!((holding[0] + 0.006).abs() < 1e-9 && (holding[4] - 0.006).abs() < 1e-9, "{method:?}: {holding:?}");
    }
}

/// The tip for 60 s under half of what the plane can hold: along the plane it stays. What the plane's spring does across it fades, though
/// explicit steps could be as long as the border of stability allows.
#[test]
fn below_its_bound_the_tip_stays_on_the_plane() {
    for method in METHODS {
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
        // The free arm takes some 7,600 explicit steps for a minute.
        let counters = held.counters();
        assert!(
            counters.substeps + counters.rejected <= if method == Method::I3alp { 60_000 } else { 7_600 },
            "{method:?}: {counters:?}"
        );
    }
}

/// Just below breakaway it holds, just above it goes, and at once with what is left of the torque above Coulomb's.
#[test]
fn it_lets_go_at_breakaway() {
    for method in METHODS {
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

        // A torque that grows by the millisecond, by a part of 1e-3 of the bound: it lets go in the millisecond in which it passes it.
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

/// Gain of the servo that pulls, N·m/rad, its speed, rad/s, and by how much friction falls when it lets go, N·m.
const KP: f64 = 5.0;
const PULL: f64 = 1e-3;
const DROP: f64 = 0.0025;

/// The left motor joint pulled by a soft servo while friction holds the right one: on its way of 1 mrad the machine is a mass on a spring.
fn pulled(method: Method) -> Parameters {
    let mut parameters = sticking(method, [0.01, 0.0, 0.0, 0.0, 1.0], [0.01 + DROP, 0.0, 0.0, 0.0, 1.0]);
    // So low that friction falls at once.
    parameters.effects.friction.breakaway_velocity = 1e-6;
    parameters.effects.gravity.enabled = false;
    enable(&mut parameters, "servo");
    let servo = &mut parameters.effects.servo;
    (servo.kp, servo.kd, servo.limit) = ([KP; 2], [0.0; 2], [1e3; 2]);
    parameters
}

/// The references at a time.
fn pulling(parameters: &Parameters, time: f64) -> Inputs {
    Inputs { servo_theta: [parameters.start.theta[0] + PULL * time, parameters.start.theta[1]], ..default_inputs() }
}

/// Inertia that the left motor feels while friction holds the right one, kg·m²: from what a torque does.
fn inertia(parameters: &Parameters) -> f64 {
    let accelerated = |torque: f64| {
        let inputs = Inputs { tau: [torque, 0.0], ..pulling(parameters, 0.0) };
        Simulation::new(parameters, &inputs).expect("a scene").state().core.a[THETA[0]]
    };
    1.0 / (accelerated(2.0) - accelerated(1.0))
}

/// A mass I on a spring k drawn at the speed v, with friction that falls from T_s to T_c: it lets go with the spring at T_s, swings about
/// T_c, and rests again after (2π − 2 atan(ΔT ω/(k v)))/ω, having gone 2ΔT/k + v times that. Its inertia changes by 1e-3 on its way, and
/// references are held for 1 ms, which is 1e-3 of a jump: within 1 %.
#[test]
fn it_sticks_and_slips_as_the_closed_form_says() {
    for method in METHODS {
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
        // The spring is loose at first.
        assert!((starts[0] - 0.0125 / KP / PULL).abs() <= 2e-3, "{method:?}: {starts:?}");
        for pair in rests.windows(2) {
            assert!((pair[1] - pair[0] - jump).abs() < 0.01 * jump, "{method:?}: {rests:?}, {jump}");
        }
        for pair in starts.windows(2) {
            assert!((pair[1] - pair[0] - period).abs() < 0.01 * period, "{method:?}: {starts:?}, {period}");
        }
    }
}

/// Grips that hold one motion between them, and a third that is too weak for the other: nothing rests, however strong they are; and they hold
/// it the same way, whichever of them could by itself.
#[test]
fn grips_of_one_motion_hold_one_motion() {
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

/// With coaxial motors the inner joints turn by the same angle: they stop together and hold together, whichever of them is strong, and the
/// arm then turns about its motors as one piece.
#[test]
fn coaxial_links_stop_and_go_on_together() {
    for method in METHODS {
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
                // By dop853 what is held drifts with the error of its steps.
                assert!((left - right).abs() < 1e-10 && left > 0.5, "{method:?}, {strong}: {left} {right}");
                assert!((apart(&simulation) - stopped).abs() < 1e-10, "{method:?}, {strong}");
                // Each uses the same part of what it can: a third of 2 mN·m goes to the other leg, of those 5.25 to 5.35.
                let holding = state.holding(simulation.model());
                let parts = [1, 2, 3].map(|joint| (holding[joint] / friction[joint]).abs());
                assert!(parts.iter().all(|part| (part - parts[0]).abs() < 1e-6 && *part > 0.05 && *part < 0.5), "{parts:?}");
            }
            let counters = simulation.counters();
            assert!(counters.rejected < 100 && counters.substeps < 3000, "{method:?}, {strong}: {counters:?}");
        }
    }
}

/// A scene, and its inputs at a time.
type Motion = (Parameters, fn(f64) -> Inputs);

/// Motions with all kinds of grips: the fall in whose joints friction sticks and lets go; a handle drawn onto a wall to which it sticks.
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
    // It presses, rests, is pushed along, rests again, and lifts off.
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

/// Work is what it is, and never given back.
#[test]
fn what_is_dissipated_never_falls() {
    for method in METHODS {
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

/// However many macro steps a call has, and where one is stored and gone on from: the same bits.
#[test]
fn calls_and_copies_change_nothing() {
    for method in METHODS {
        for (parameters, inputs) in motions(method) {
            let run = |size: u64| {
                let mut simulation = Simulation::new(&parameters, &inputs(0.0)).expect("a scene");
                for call in 0..1200 / size {
                    // Where the inputs change both have a communication point.
                    simulation.advance(&inputs(1e-3 * (call * size) as f64), 1e-3, size).expect("steps");
                    if size == 1 {
                        // What is stored can be read back, after many steps too.
                        let (run, residuals) = (simulation.run().clone(), simulation.residuals());
                        simulation = Simulation::restored(simulation.parameters(), run, &residuals).expect("a stored state");
                    }
                }
                (simulation.state().core.q, simulation.state().core.v, simulation.state().stick_slip)
            };
            let [one, many] = [1, 50].map(run);
            assert!(one == many, "{method:?}: {one:?} {many:?}");
        }
    }
}

/// Derivatives keep what is held where it is; where friction holds everything, they are refused.
#[test]
fn derivatives_keep_what_is_held() {
    let parameters = pulled(Method::I3alp);
    let start = |torque: f64| {
        let inputs = Inputs { tau: [torque, 0.0], ..pulling(&parameters, 0.0) };
        Simulation::new(&parameters, &inputs).expect("a scene")
    };
    let by_torque = Direction { inputs: Inputs { tau: [1.0, 0.0], ..Inputs::default() }, ..Direction::default() };
    let (resolve_motion, more) = (start(0.5), start(0.75));
    let varied = resolve_motion.state().varied(resolve_motion.model(), &by_torque).expect("one joint is held");
    // The accelerations are affine in the torque: nothing but round-off.
    for link in [0, 3] {
        let difference = (more.state().core.a[THETA[link]] - resolve_motion.state().core.a[THETA[link]]) / 0.25;
        assert!((varied.a[THETA[link]] - difference).abs() < 1e-9 * (1.0 + difference.abs()), "{link}: {difference}");
    }
    assert!(varied.a[THETA[3]].abs() < 1e-9 && varied.a[THETA[0]] > 100.0, "{:?}", varied.a);
    let resting = start(0.0);
    let refused = resting.state().varied(resting.model(), &by_torque).expect_err("all is held").to_string();
    assert!(refused.contains("friction holds") && refused.ends_with('.'), "{refused}");
}

/// Only methods whose steps can end where something stops take it: the others refuse with one sentence.
#[test]
fn other_methods_refuse() {
    let fixed = Parameters {
        settings: fivebar::simulation::Settings { adaptive: false, ..default_parameters().settings },
        ..sticking(Method::I3alp, COULOMB, BREAKAWAY)
    };
    let others = [Method::Rk4, Method::I3alpPrinted, Method::I3alpConserving].map(|method| sticking(method, COULOMB, BREAKAWAY));
    for (parameters, name) in
        others.iter().chain([&fixed]).zip(["rk4", "i3alpPrinted", "i3alpConserving", "solver.adaptive = false"])
    {
        let refused = Simulation::new(parameters, &default_inputs()).expect_err("no steps that can end").to_string();
        assert!(refused.contains("friction.law = stick") && refused.contains(name) && refused.ends_with('.'), "{refused}");
        let mut without = parameters.clone();
        without.effects.friction.law = Law::Smooth;
        Simulation::new(&without, &default_inputs()).expect("a scene");
        without.effects.contact.enabled = true;
        without.effects.contact.law = Law::Stick;
        let refused = Simulation::new(&without, &default_inputs()).expect_err("no steps that can end").to_string();
        assert!(refused.contains("contact.law = stick") && refused.contains(name), "{refused}");
    }
}

/// A motor joint that holds while the other one moves, with a breakaway just below the most that it once has to hold, for no longer than a
/// hundredth of a step: it lets go there. By places an eighth of a step apart one of four such moments was missed.
#[test]
fn a_load_that_passes_the_bound_for_a_moment_lets_go() {
    const STEP: f64 = 5e-5;
    const CALLS: usize = 600;
    let mut random = ChaCha8Rng::seed_from_u64(14);
    let mut uniform = |low: f64, high: f64| low + (high - low) * ((random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64);
    let mut moments = 0;
    for scene in 0..160 {
        let held = scene % 2;
        // The motors' joints are the first and the last.
        let joint = 4 * held;
        let only = |torque: f64| std::array::from_fn(|i| if i == joint { torque } else { 0.0 });
        let mut parameters = sticking([Method::Dop853, Method::Automatic][scene / 2 % 2], only(1e6), only(1e6));
        parameters.settings.error_tolerance = 1e-8;
        parameters.effects.gravity.enabled = scene % 3 > 0;
        parameters.start.theta = [uniform(1.6, 2.6), uniform(0.3, 1.3)];
        parameters.start.omega[1 - held] = uniform(-20.0, 20.0);
        enable(&mut parameters, "servo");
        parameters.effects.servo.kp = [uniform(0.1, 20.0); 2];
        let inputs = Inputs { servo_theta: parameters.start.theta.map(|angle| angle + uniform(-0.5, 0.5)), ..default_inputs() };
        // What the joint would have to hold.
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
            // What it holds is known to some tolerances, of some 1e2 rad/s² on 1e-3 kg·m².
            assert!(load <= bound * (1.0 + 1e-6) + 1e-7, "scene {scene} holds {load} N·m of {bound}");
        }
    }
    assert!(moments > 20, "{moments} moments");
}
