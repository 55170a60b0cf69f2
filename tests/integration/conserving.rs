//! The conserving step: energy and both levels of the constraints at fixed steps, for any motion and load.

use fivebar::effects::JOINTS;
use fivebar::observers::{self, Energies};
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Inputs, Method, Parameters, Signal, Simulation};

use crate::support::{MGL, Reference, enable, fall_90_120, slope, tip_error, unequal};

/// A scene with this method, its own posture and effects, and steps of h.
fn conserving(mut parameters: Parameters, h: f64) -> Parameters {
    parameters.settings.method = Method::I3alpConserving;
    parameters.settings.step_size = h;
    parameters
}

/// Largest balance residual, relative to the largest energy but at least to mgL (`balance`), and relative to mgL (`in_mgl`); largest
/// constraint violations (m, m/s, and m/s² relative to the largest acceleration); most iterations of a step.
struct Worst {
    balance: f64,
    in_mgl: f64,
    position: f64,
    velocity: f64,
    acceleration: f64,
    iterations: u64,
}

/// The largest term of a balance, J.
fn largest_of(energies: &Energies) -> f64 {
    let parts = [energies.kinetic, energies.potential, energies.input, energies.dissipated];
    parts.into_iter().fold(0.0, |largest: f64, part| largest.max(part.abs()))
}

/// Runs a motion step by step; each macro step is one step.
fn followed(simulation: &mut Simulation, inputs: &Inputs, h: f64, duration: f64) -> Worst {
    let steps = (duration / h).round() as u64;
    let (mut error, mut largest) = (0.0f64, MGL);
    let mut worst = Worst { balance: 0.0, in_mgl: 0.0, position: 0.0, velocity: 0.0, acceleration: 0.0, iterations: 0 };
    for step in 0..steps {
        let spent = simulation.counters().iterations;
        simulation.advance(inputs, h, 1).unwrap_or_else(|failure| panic!("step {step}: {failure}"));
        let state = simulation.state();
        let energies = observers::energies(simulation.model(), &state);
        let norms = observers::constraint_norms(simulation.model(), &state);
        error = error.max(energies.error.abs());
        largest = largest.max(largest_of(&energies));
        worst.position = worst.position.max(norms.position);
        worst.velocity = worst.velocity.max(norms.velocity);
        worst.acceleration = worst.acceleration.max(norms.acceleration / state.core.a.max_norm().max(1.0));
        worst.iterations = worst.iterations.max(simulation.counters().iterations - spent);
    }
    let counters = simulation.counters();
    assert_eq!((counters.steps, counters.substeps, counters.rejected), (steps, steps, 0));
    Worst { balance: error / largest, in_mgl: error / MGL, ..worst }
}

/// Compared with the solution to 15 digits one second into the fall, the method is of second order, and at 1 ms its error is at most the
/// prototype's.
#[test]
fn it_is_of_second_order() {
    let reference = Reference::read("fall_90_120");
    let end = reference.iter().find(|row| row.t == 1.0).expect("a row at 1 s");
    let errors = [2e-3, 1e-3, 5e-4, 2.5e-4].map(|h| {
        let parameters = conserving(fall_90_120(Method::I3alpConserving), h);
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        simulation.advance(&default_inputs(), h, (1.0 / h).round() as u64).expect("a fall");
        (h, tip_error(&simulation, end.tip))
    });
    assert!(errors[1].1 <= 3.8e-3, "{errors:?}");
    assert!((slope(&errors) - 2.0).abs() <= 0.1, "{errors:?}");
}

/// Falls with fast passages of singularities: 5 s each.
#[test]
fn falls_keep_energy_and_constraints() {
    for (theta, h) in [([1.4973, 1.55439], 1e-3), ([1.3698, 1.6889], 4e-3), ([1.5425, 1.5784], 2.5e-4), ([1.2, 1.9], 1e-3)] {
        let mut parameters = conserving(default_parameters(), h);
        parameters.start.theta = theta;
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        let worst = followed(&mut simulation, &default_inputs(), h, 5.0);
        assert!(worst.in_mgl <= 1e-8 && worst.position <= 1e-14 && worst.velocity <= 1e-11, "{theta:?} at {h} s: {}", worst.in_mgl);
        // Equilibrium near vertices: measured 1.4e-11.
        assert!(worst.acceleration <= 1e-10, "{theta:?} at {h} s: {:e}", worst.acceleration);
    }
}

/// The method works for any machine: with all links different, centres of mass outside the links, payload and rotors; with nearly massless
/// links; with coaxial motors.
#[test]
fn any_machine_keeps_its_energy() {
    let mut loaded = unequal();
    for effect in ["payload", "rotor"] {
        enable(&mut loaded, effect);
    }
    let mut light = unequal();
    light.geometry.links[1].inertia = 1e-9;
    let mut coaxial = default_parameters();
    coaxial.geometry.base_distance = 0.0;
    coaxial.start.theta = [2.0, 1.0];
    for (name, parameters) in [("unequal", unequal()), ("loaded", loaded), ("light", light), ("coaxial", coaxial)] {
        let mut simulation = Simulation::new(&conserving(parameters, 1e-3), &default_inputs()).expect("scene");
        let worst = followed(&mut simulation, &default_inputs(), 1e-3, 2.0);
        // The battery's bound for any machine, 1e-9 m/s; energy error after 2 s with nearly massless links.
        assert!(worst.balance <= 1e-9 && worst.velocity <= 1e-9, "{name}: {:e} {:e}", worst.balance, worst.velocity);
    }
}

/// Constant loads do exactly the work of force times displacement.
#[test]
fn constant_loads_balance() {
    let inputs = Inputs { tau: [0.05, -0.02], tip_force: [0.1, 0.3], ..default_inputs() };
    let mut simulation = Simulation::new(&conserving(unequal(), 1e-3), &inputs).expect("scene");
    let worst = followed(&mut simulation, &inputs, 1e-3, 2.0);
    assert!(worst.balance <= 1e-12, "{:e}", worst.balance);
}

/// Every effect, from soft to far stiffer than the step: the energy balance.
#[test]
fn every_effect_balances() {
    type Change = Box<dyn Fn(&mut Parameters)>;
    let mut cases: Vec<(String, f64, Change)> = Vec::new();
    for k in [0.05, 5.0, 500.0, 1e5] {
        cases.push((
            format!("spring {k}"),
            1e-12,
            Box::new(move |p| {
                enable(p, "spring");
                (p.effects.spring.k, p.effects.spring.theta0) = ([k; 2], [1.8; 2]);
            }),
        ));
    }
    for (k, d) in [(50.0, 0.0), (50.0, 0.02), (5e3, 0.0), (5e3, 0.02)] {
        cases.push((
            format!("stop {k} {d}"),
            1e-12,
            Box::new(move |p| {
                enable(p, "stop");
                let stop = &mut p.effects.stop;
                (stop.lower, stop.upper, stop.k, stop.d) = ([0.9; 2], [2.3; 2], k, d);
            }),
        ));
    }
    for (d, mu) in [(0.0, 0.0), (5.0, 0.0), (5.0, 0.3)] {
        cases.push((
            format!("contact {d} {mu}"),
            1e-12,
            Box::new(move |p| {
                enable(p, "contact");
                let contact = &mut p.effects.contact;
                (contact.offset, contact.d, contact.mu) = (0.1, d, mu);
            }),
        ));
    }
    for b in [1e-4, 1e-2, 1.0, 100.0] {
        cases.push((
            format!("viscous {b}"),
            1e-10,
            Box::new(move |p| {
                enable(p, "viscous");
                p.effects.viscous.b = [b; JOINTS];
            }),
        ));
    }
    for rate in [1e-2, 1e-3, 1e-5] {
        cases.push((format!("friction at {rate}"), 1e-12, Box::new(move |p| dry(p, 1e-3, rate))));
    }
    for (kp, kd) in [(2.0, 0.02), (100.0, 0.5), (1e4, 1.0), (1e6, 10.0), (1e6, 0.0)] {
        cases.push((
            format!("servo {kp} {kd}"),
            1e-11,
            Box::new(move |p| {
                enable(p, "servo");
                (p.effects.servo.kp, p.effects.servo.kd) = ([kp; 2], [kd; 2]);
            }),
        ));
    }
    cases.push((
        "all".into(),
        1e-11,
        Box::new(|p| {
            for effect in fivebar::effects::NAMES {
                enable(p, effect);
            }
            p.effects.contact.offset = 0.1;
        }),
    ));
    let mut wrong = Vec::new();
    for (name, allowed, change) in &cases {
        let mut parameters = conserving(default_parameters(), 1e-3);
        parameters.start.theta[1] = 120f64.to_radians();
        change(&mut parameters);
        let inputs = Inputs { servo_theta: [std::f64::consts::FRAC_PI_2 + 0.2, 2.0], ..default_inputs() };
        let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
        let worst = followed(&mut simulation, &inputs, 1e-3, 2.0);
        let counters = simulation.counters();
        // A fall against the stiffest friction reaches a posture without a root.
        if worst.balance > *allowed || worst.velocity > 1e-9 || counters.fallbacks > 1 {
            wrong.push((name, worst.balance, worst.velocity, counters));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Dry friction without a Stribeck peak in all joints; `turn` is w_c, the rate at which the law turns.
fn dry(parameters: &mut Parameters, torque: f64, turn: f64) {
    enable(parameters, "friction");
    let friction = &mut parameters.effects.friction;
    (friction.coulomb, friction.breakaway) = ([torque; JOINTS], [torque; JOINTS]);
    friction.breakaway_velocity = 10.0 * turn;
}

/// Friction that supports the mechanism lets it creep at a small fraction of the law's turning rate. Friction that brakes a motion stops
/// it.
#[test]
fn friction_holds_and_brakes() {
    for turn in [1e-2, 1e-3, 1e-5] {
        for (omega, allowed) in [([0.0; 2], 1e-12), ([5.0, -3.0], 1e-7)] {
            let mut parameters = conserving(default_parameters(), 1e-3);
            parameters.start.theta[1] = 120f64.to_radians();
            parameters.start.omega = omega;
            dry(&mut parameters, 0.2, turn);
            let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
            let worst = followed(&mut simulation, &default_inputs(), 1e-3, 2.0);
            let rates = observers::motion(simulation.model(), &simulation.state()).omega;
            let creep = rates.iter().fold(0.0f64, |largest, rate| largest.max(rate.abs()));
            assert!(worst.balance <= allowed && creep <= 0.05 * turn, "{turn} {omega:?}: {:e} {creep:e}", worst.balance);
        }
    }
}

/// Each step uses the mid-step values of changing torques; the motion is of second order, and so is the work.
#[test]
fn inputs_that_change_are_of_second_order() {
    let run = |h: f64| {
        let parameters = conserving(unequal(), h);
        let start = Inputs { tau: [0.02, 0.0], ..default_inputs() };
        let mut simulation = Simulation::new(&parameters, &start).expect("scene");
        let ramp = Inputs { tau: [-0.1, 0.05], ..default_inputs() };
        let signal = Signal::new(start, [ramp, default_inputs()]);
        simulation.advance_along(&signal, h, (0.3 / h).round() as u64).expect("a motion");
        let energies = observers::energies(simulation.model(), &simulation.state());
        let largest = largest_of(&energies);
        assert!(energies.error.abs() <= 1e-12 * largest, "{:e} of {largest:e} J", energies.error);
        observers::motion(simulation.model(), &simulation.state()).tip
    };
    let exact = run(1.25e-5);
    let errors = [2e-3, 1e-3, 5e-4].map(|h| {
        let tip = run(h);
        (h, (tip.x - exact.x).hypot(tip.y - exact.y))
    });
    assert!((slope(&errors) - 2.0).abs() <= 0.15, "{errors:?}");
}

/// The work of a step can be bounded: it ends with a status and everything unchanged, or by the fallback, which is counted.
#[test]
fn the_work_of_a_step_is_bounded() {
    let mut parameters = conserving(default_parameters(), 4e-3);
    // Falls that come arbitrarily close to vertices; round-off decides which of them meet a step without a root.
    let starts = (0..20).map(|i| 1.36 + 1e-3 * f64::from(i));
    let mut outcomes = Vec::new();
    // Iterations beyond the bound: two attempts of ten and, without the fallback, a better first guess; the projection of the last
    // stage.
    for (most, iterations) in [(0, 30), (25, 55), (1000, 1030)] {
        parameters.settings.max_work = most;
        let (mut failures, mut fallbacks) = (Vec::new(), 0);
        for start in starts.clone() {
            parameters.start.theta = [start, 1.6889];
            let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
            for _ in 0..5000 {
                let before = simulation.clone();
                let spent = before.counters().iterations;
                if let Err(cause) = simulation.advance(&default_inputs(), 4e-3, 1) {
                    assert_eq!(simulation.run(), before.run());
                    failures.push(cause.to_string());
                    break;
                }
                let taken = simulation.counters().iterations - spent;
                assert!(taken <= iterations, "{most}: {taken}");
            }
            let error = observers::energies(simulation.model(), &simulation.state()).error.abs();
            assert!(error <= 1e-8 * MGL, "{most}: {error:e}");
            fallbacks += simulation.counters().fallbacks;
        }
        outcomes.push((failures, fallbacks));
    }
    let [without_rescue, bounded, free] = &outcomes[..] else { unreachable!("three bounds") };
    assert!(!without_rescue.0.is_empty(), "without a rescue some falls end");
    assert!(without_rescue.0.iter().all(|status| status.contains("solver.maxWork = 0")), "{without_rescue:?}");
    assert!(bounded.0.is_empty() && bounded.1 > 0, "the fallback is taken");
    assert!(free.0.is_empty(), "{free:?}");
}

/// Loads cannot end a run or violate the balance with however small a bound on work: friction that sticks from rest, and servos much
/// stiffer than the step. With these most steps use the last fallback stage. A step may exceed its bound and the first two attempts by the
/// iterations of this stage's projection.
#[test]
fn bounded_steps_go_on_under_stiff_loads() {
    let inputs = Inputs { servo_theta: [std::f64::consts::FRAC_PI_2 + 0.2, 2.0], ..default_inputs() };
    for most in [1, 5, 25, 40] {
        for (name, kd) in [("friction", 0.0), ("servo", 0.0), ("servo", 10.0)] {
            let mut parameters = conserving(default_parameters(), 1e-3);
            parameters.settings.max_work = most;
            parameters.start.theta[1] = 120f64.to_radians();
            if name == "friction" {
                dry(&mut parameters, 0.2, 1e-5);
            } else {
                enable(&mut parameters, "servo");
                (parameters.effects.servo.kp, parameters.effects.servo.kd) = ([1e6; 2], [kd; 2]);
            }
            let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
            let worst = followed(&mut simulation, &inputs, 1e-3, 1.0);
            // As in `every_effect_balances`, for servos.
            assert!(worst.balance <= 1e-11 && worst.position <= 1e-14, "{name} {kd}, {most}: {:e}", worst.balance);
            assert!(worst.iterations <= u64::from(most.max(20)) + 30, "{name} {kd}, {most}: {} iterations", worst.iterations);
        }
    }
}

/// All effects at once, compared with steps of order 8 with an error of 1e-11 rad: second order, also for the work of each kind.
///
/// The order is visible because no load has a kink: tip and axes stay pressed into plane and stops, the drives do not saturate, and
/// friction changes over 1 rad/s or 1 m/s. The error of a quantity is the largest of ten instants, so that none is small by chance.
#[test]
fn effects_are_of_second_order() {
    let course = |method: Method, h: f64| {
        let mut parameters = conserving(unequal(), h);
        (parameters.settings.method, parameters.settings.error_tolerance) = (method, 1e-11);
        for effect in fivebar::effects::NAMES {
            enable(&mut parameters, effect);
        }
        let effects = &mut parameters.effects;
        (effects.contact.offset, effects.contact.k, effects.contact.d, effects.contact.width) = (0.5, 2.0, 0.05, 0.01);
        (effects.contact.slip_velocity, effects.friction.breakaway_velocity) = (1.0, 1.0);
        (effects.stop.lower, effects.stop.upper) = ([-2.0; 2], [1.0, -0.1]);
        (effects.stop.k, effects.stop.d, effects.stop.width) = (0.05, 1e-3, 0.1);
        effects.servo.limit = [10.0; 2];
        let inputs = Inputs { servo_theta: [1.8, 1.2], ..default_inputs() };
        let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
        [(); 10].map(|()| {
            simulation.advance(&inputs, h, (0.02 / h).round() as u64).expect("a motion");
            let energies = observers::energies(simulation.model(), &simulation.state());
            let tip = observers::motion(simulation.model(), &simulation.state()).tip;
            [tip.x, tip.y, energies.input, energies.dissipated]
        })
    };
    let exact = course(Method::Dop853, 1e-3);
    let runs = [5e-4, 2.5e-4, 1.25e-4].map(|h| (h, course(Method::I3alpConserving, h)));
    for i in 0..4 {
        let largest = |deviation: &dyn Fn(usize) -> f64| (0..10).map(|k| deviation(k).abs()).fold(0.0, f64::max);
        let errors = runs.map(|(h, run)| (h, largest(&|k| run[k][i] - exact[k][i])));
        let size = largest(&|k| exact[k][i]);
        // With three halvings the order of a second-order error scatters by less than a tenth around 2.
        assert!((slope(&errors) - 2.0).abs() < 0.1 && errors[0].1 < 1e-2 * size, "{i}: {errors:?} of {size}");
    }
}
