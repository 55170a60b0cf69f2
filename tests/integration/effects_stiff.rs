//! Stiff effects at h = 1 ms: stable, without chatter, and the counters show the sub-steps.

use fivebar::observers;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Inputs, Method, Parameters, Simulation};

use crate::support::{MGL, enable, run};

/// The paper's mechanism with right proximal link at 120°, without gravity.
fn table() -> Parameters {
    let mut parameters = default_parameters();
    parameters.effects.gravity.enabled = false;
    parameters.start.theta[1] = 120f64.to_radians();
    parameters
}

/// A load below breakaway makes the joints creep smoothly, no faster than the friction law allows, with one sub-step per step.
#[test]
fn a_load_below_breakaway_only_creeps() {
    for adaptive in [true, false] {
        let mut parameters = table();
        enable(&mut parameters, "friction");
        parameters.settings.adaptive = adaptive;
        let inputs = Inputs { tau: [8e-4, 0.0], ..default_inputs() };
        let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
        run(&mut simulation, &inputs, 1e-3, 0.2);
        let before = simulation.state().core.counters.substeps;
        let mut last = f64::INFINITY;
        for _ in 0..1000 {
            run(&mut simulation, &inputs, 1e-3, 1e-3);
            let rate = observers::motion(simulation.model(), &simulation.state()).omega[0];
            // T_c tanh(w/w_c) at joint 1 alone would allow this creep rate; every other joint slows it down.
            let fastest = 0.01 * (8e-4_f64 / 1e-3).atanh();
            assert!(rate > 0.0 && rate < fastest, "{rate} rad/s, at most {fastest}");
            // No chatter: the creep changes as slowly as the posture.
            assert!((rate - last).abs() < 1e-4 * rate || last.is_infinite(), "{last} {rate}");
            last = rate;
        }
        assert_eq!(simulation.state().core.counters.substeps - before, 1000, "adaptive {adaptive}");
    }
}

/// A swing damped by friction passes zero speed without chatter: the rate changes sign once per half swing, then rests.
#[test]
fn friction_through_zero_speed_does_not_chatter() {
    for adaptive in [true, false] {
        let mut parameters = table();
        enable(&mut parameters, "friction");
        enable(&mut parameters, "spring");
        parameters.settings.adaptive = adaptive;
        parameters.effects.spring.theta0 = [1.2, 2.2];
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        let (mut changes, mut last) = (0, 0.0);
        for _ in 0..4000 {
            run(&mut simulation, &default_inputs(), 1e-3, 1e-3);
            let rate = observers::motion(simulation.model(), &simulation.state()).omega[0];
            changes += u32::from(rate * last < 0.0);
            last = rate;
        }
        let energies = observers::energies(simulation.model(), &simulation.state());
        // 0.05 N·m/rad against a total friction of 5 mN·m: a few swings of 0.1 s.
        assert!((1..=40).contains(&changes), "adaptive {adaptive}: {changes} changes of sign");
        assert!(energies.kinetic < 1e-6 * MGL && last.abs() < 0.01, "adaptive {adaptive}: {last} rad/s, {energies:?}");
    }
}

/// A stop and a plane hit at 20 rad/s: no energy gain, a closed balance, and counted sub-steps.
#[test]
fn stops_and_contact_are_hit_at_20_rad_per_s() {
    for effect in ["stop", "contact"] {
        let mut parameters = table();
        enable(&mut parameters, effect);
        parameters.start.omega = [20.0, 20.0];
        parameters.effects.stop.lower = [0.5, 0.5];
        parameters.effects.stop.upper = [2.6, 2.6];
        parameters.effects.contact.offset = 0.15;
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        let before = observers::energies(simulation.model(), &simulation.state()).kinetic;
        let mut hit = false;
        for _ in 0..2000 {
            run(&mut simulation, &default_inputs(), 1e-3, 1e-3);
            let energies = observers::energies(simulation.model(), &simulation.state());
            hit |= energies.potential > 1e-3 * before;
            assert!(energies.kinetic + energies.potential <= before * (1.0 + 1e-3), "{effect}: {energies:?}");
            // The bound allows for the error of some ten hits at the default tolerance.
            assert!(energies.error.abs() < 1e-3 * before, "{effect}: {energies:?}");
        }
        let counters = simulation.state().core.counters;
        assert!(hit && counters.substeps > counters.steps, "{effect}: {counters:?}");
    }
}

/// A servo of 1e3 N·m/rad on the paper's links, 1.4 kHz, reaches its reference and stays there.
#[test]
fn a_servo_with_a_high_gain_is_stable() {
    for gravity in [false, true] {
        let mut parameters = table();
        enable(&mut parameters, "servo");
        parameters.effects.gravity.enabled = gravity;
        parameters.effects.servo.kp = [1e3; 2];
        parameters.effects.servo.kd = [1.0; 2];
        let inputs = Inputs { servo_theta: [1.8, 1.9], ..default_inputs() };
        let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
        run(&mut simulation, &inputs, 1e-3, 1.0);
        let motion = observers::motion(simulation.model(), &simulation.state());
        for (motor, reference) in [(0, 1.8), (3, 1.9)] {
            // Gravity pulls with at most some 0.1 N·m.
            assert!((motion.theta[motor] - reference).abs() < 2e-4, "{motion:?}");
            assert!(motion.omega[motor].abs() < 1e-3, "{motion:?}");
        }
        let counters = simulation.state().core.counters;
        assert!(counters.substeps > counters.steps, "{counters:?}");
        let energies = observers::energies(simulation.model(), &simulation.state());
        // The servo moves and brakes the links with up to 1 N·m over 0.2 rad.
        assert!(energies.error.abs() < 1e-3 * 0.2, "{energies:?}");
    }
}

/// A parameter tuned between steps acts from the next one; the added energy counts as input.
#[test]
fn a_tuned_parameter_acts_and_its_energy_is_counted() {
    let mut parameters = table();
    enable(&mut parameters, "gravity");
    enable(&mut parameters, "spring");
    enable(&mut parameters, "viscous");
    parameters.effects.viscous.b = [1e-4, 0.0, 0.0, 0.0, 1e-4];
    let inputs = default_inputs();
    let mut simulation = Simulation::new(&parameters, &inputs).expect("scene");
    let mut untouched = simulation.clone();
    run(&mut simulation, &inputs, 1e-3, 0.1);
    run(&mut untouched, &inputs, 1e-3, 0.1);
    simulation.tune(&parameters.effects).expect("the same values");
    assert_eq!(simulation.state(), untouched.state(), "its own values change nothing");

    let mut tuned = parameters.effects.clone();
    (tuned.gravity.g, tuned.spring.k) = (1.62, [0.2; 2]);
    let before = observers::energies(simulation.model(), &simulation.state());
    simulation.tune(&tuned).expect("allowed");
    let after = observers::energies(simulation.model(), &simulation.state());
    assert!((after.input - before.input - (after.potential - before.potential)).abs() < 1e-15, "{before:?} {after:?}");
    assert!((after.potential - before.potential).abs() > 1e-3, "{before:?} {after:?}");
    run(&mut simulation, &inputs, 1e-3, 0.3);
    run(&mut untouched, &inputs, 1e-3, 0.3);
    assert_ne!(simulation.state().core.q, untouched.state().core.q);
    let energies = observers::energies(simulation.model(), &simulation.state());
    assert!(energies.error.abs() < 1e-4 * MGL, "{energies:?}");

    // Values out of bounds are refused and change nothing.
    let state = simulation.state();
    tuned.viscous.b = [-1.0, 0.0, 0.0, 0.0, 0.0];
    let refusal = simulation.tune(&tuned).expect_err("negative").to_string();
    assert_eq!(refusal, "viscous.b[1] = -1.0 N.m.s/rad is not allowed: it must be at least 0 N.m.s/rad.");
    assert_eq!(simulation.state(), state);
}

/// A run tuned at the very end of a step, with its dense output in memory, can be stored and restored.
#[test]
fn a_run_tuned_at_the_end_of_a_step_is_restored() {
    let mut parameters = table();
    enable(&mut parameters, "gravity");
    enable(&mut parameters, "contact");
    parameters.settings.method = Method::Dop853;
    let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
    // Inputs that change with every macro step end the steps there.
    for step in 0..20 {
        let inputs = Inputs { tau: [1e-3 * f64::from(step), 0.0], ..default_inputs() };
        run(&mut simulation, &inputs, 1e-3, 1e-3);
    }
    parameters.effects.gravity.g = 1.62;
    simulation.tune(&parameters.effects).expect("allowed");
    let restored = Simulation::restored(&parameters, simulation.run().clone()).expect("a legal run");
    assert_eq!(restored.state(), simulation.state());
}

/// A tuned value that couples links selects another linear solve, and a value that uncouples them the fast one again: the motion equals a
/// scene with this value from the start.
#[test]
fn a_tuned_value_may_couple_links() {
    let inputs = Inputs { tau: [0.02, -0.01], ..default_inputs() };
    let with = |b: [f64; 5]| {
        let mut parameters = table();
        enable(&mut parameters, "viscous");
        parameters.effects.viscous.b = b;
        parameters
    };
    let (uncoupled, coupled) = ([1e-4, 0.0, 0.0, 0.0, 1e-4], [1e-4, 2e-4, 1e-4, 2e-4, 1e-4]);
    for (from, to) in [(uncoupled, coupled), (coupled, uncoupled)] {
        for method in [Method::I3alp, Method::Rk4, Method::Dop853] {
            let [from, to] = [from, to].map(|b| {
                let mut parameters = with(b);
                parameters.settings.method = method;
                parameters
            });
            let mut tuned = Simulation::new(&from, &inputs).expect("scene");
            let mut same = Simulation::new(&to, &inputs).expect("scene");
            tuned.tune(&to.effects).expect("allowed");
            for simulation in [&mut tuned, &mut same] {
                run(simulation, &inputs, 1e-3, 0.3);
            }
            // Apart from the counter, a restart leaves no trace.
            let (mut after, expected) = (tuned.state(), same.state());
            assert_eq!(after.core.counters.restarts, 1);
            after.core.counters.restarts = 0;
            assert_eq!(after, expected, "{method:?}");
        }
    }
}

/// A machine at rest exactly in a vertex under a load below breakaway creeps on the branch of least constraint and is not thrown out of the
/// vertex as without friction; above breakaway it moves.
#[test]
fn friction_holds_a_load_in_a_vertex() {
    use std::f64::consts::PI;
    for (friction, goes) in [(2.0, false), (1e-3, true)] {
        let mut parameters = default_parameters();
        enable(&mut parameters, "friction");
        parameters.effects.friction.coulomb = [friction; 5];
        parameters.effects.friction.breakaway = [friction; 5];
        let inputs = default_inputs();
        let mut simulation = Simulation::at(&parameters, &inputs, [PI, 0.0, PI, PI], [0.0; 4]).expect("a vertex");
        let mut fastest: f64 = 0.0;
        for _ in 0..200 {
            run(&mut simulation, &inputs, 1e-3, 1e-3);
            let motion = observers::motion(simulation.model(), &simulation.state());
            fastest = motion.omega.iter().fold(fastest, |fastest, rate| fastest.max(rate.abs()));
        }
        let energies = observers::energies(simulation.model(), &simulation.state());
        // The weights pull with some 0.1 N·m: against 2 N·m the machine creeps at about 0.01 rad/s · 0.1/2.
        assert!(if goes { fastest > 1.0 } else { fastest < 2e-3 }, "{friction} N.m: {fastest} rad/s");
        assert!(energies.error.abs() < 1e-2 * MGL, "{friction} N.m: {energies:?}");
        assert!(simulation.state().core.counters.substeps < 20_000, "{friction} N.m: {:?}", simulation.state().core.counters);
    }
}
