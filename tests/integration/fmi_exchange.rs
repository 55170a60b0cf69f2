//! Model exchange through the C functions: states, derivatives, indicators, events, and postures at which the states are no coordinates.

use fivebar::ffi::*;
use fivebar::variables::EVENT_INDICATORS;

use super::fmi_host::{Host, Instantiation, reference};

/// An instance in continuous-time mode, with values set by name.
fn integrated(values: &[(&str, f64)]) -> Host {
    let host = Host::instantiate(Instantiation { kind: fmi2ModelExchange, ..Default::default() }).expect("an instance");
    assert_eq!(host.setup(None, 0.0, Some(1.0)), fmi2OK);
    for (name, value) in values {
        assert_eq!(host.set_real(&[reference(name)], &[*value]), fmi2OK, "{name}: {:?}", host.take());
    }
    for function in [fmi2EnterInitializationMode, fmi2ExitInitializationMode] {
        assert_eq!(host.call(function), fmi2OK, "{:?}", host.take());
    }
    assert_eq!(host.new_discrete_states(), (fmi2OK, false));
    assert_eq!(host.call(fmi2EnterContinuousTimeMode), fmi2OK);
    host
}

const BENT: (&str, f64) = ("init.theta[2]", 2.0);

/// der(x) are the rates and accelerations that co-simulation reports for the same motion.
#[test]
fn derivatives_equal_co_simulation() {
    let values = [BENT, ("init.omega[1]", 1.0), ("init.omega[2]", -2.0), ("tau[1]", 0.05), ("tip.fy", 0.3)];
    let (host, stepped) = (integrated(&values), Host::ready(&values));
    let names = ["theta[1]", "theta[2]", "omega[1]", "omega[2]", "alpha[1]", "alpha[2]"].map(reference);
    let mut expected = [0.0; 6];
    assert_eq!(stepped.get_real(&names, &mut expected), fmi2OK);
    assert_eq!(host.array::<4>(fmi2GetContinuousStates), Ok(expected[..4].try_into().expect("four")));
    let derivatives = host.array::<4>(fmi2GetDerivatives).expect("derivatives");
    assert_eq!(derivatives[..2], expected[2..4]);
    for (got, expected) in derivatives[2..].iter().zip(&expected[4..]) {
        assert!((got - expected).abs() < 1e-9 * expected.abs(), "{derivatives:?} {expected:?}");
    }
    // Inputs act at once, and only on the accelerations.
    assert_eq!(host.set_real(&[reference("tau[1]")], &[0.06]), fmi2OK);
    let pushed = host.array::<4>(fmi2GetDerivatives).expect("derivatives");
    assert!(pushed[2] != derivatives[2] && pushed[..2] == derivatives[..2]);
    assert_eq!(host.array::<4>(fmi2GetNominalsOfContinuousStates), Ok([1.0; 4]));
}

/// The master sets the states; outputs follow, also over whole turns and back.
#[test]
fn states_are_set_by_the_master() {
    let host = integrated(&[("base.distance", 0.0), BENT]);
    let start = host.array::<4>(fmi2GetContinuousStates).expect("states");
    let read = |name| {
        let mut value = [0.0];
        assert_eq!(host.get_real(&[reference(name)], &mut value), fmi2OK);
        value[0]
    };
    let (tip, passive) = ([read("tip.x"), read("tip.y")], read("passive.theta[1]"));
    // With coaxial motors the machine turns as a whole, twice, in steps.
    for step in 1..=40 {
        let turned = std::f64::consts::TAU * f64::from(step) / 20.0;
        let states = [start[0] + turned, start[1] + turned, 0.5, 0.5];
        assert_eq!(host.set_states(&states), fmi2OK);
        assert_eq!(host.array::<4>(fmi2GetContinuousStates), Ok(states));
        assert_eq!(host.completed_step(), fmi2OK);
    }
    assert!((read("tip.x") - tip[0]).abs() + (read("tip.y") - tip[1]).abs() < 1e-14);
    assert!((read("passive.theta[1]") - passive - 2.0 * std::f64::consts::TAU).abs() < 1e-13);
    // Also by fmi2SetReal, beyond the standard, because some masters know no other way.
    assert_eq!(host.set_real(&[reference("theta[2]"), reference("omega[1]")], &[start[1] + 12.0, 3.0]), fmi2OK);
    let states = host.array::<4>(fmi2GetContinuousStates).expect("states");
    assert_eq!((states[1], states[2]), (start[1] + 12.0, 3.0));
}

/// States are no coordinates if the distal links are in line or cannot meet: fmi2Discard, one message, and no change.
#[test]
fn in_a_direct_singularity_derivatives_are_discarded() {
    let host = integrated(&[]);
    assert_eq!(host.array::<4>(fmi2GetDerivatives), Err(fmi2Discard));
    let line = host.line();
    assert!(line.starts_with("fmi2GetDerivatives: |singular.detJx|/(link[2].length link[3].length) = "), "{line}");
    assert!(line.ends_with("theta, omega are no coordinates; use co-simulation, which passes direct singularities."), "{line}");
    let (x, inside) = (host.array::<4>(fmi2GetContinuousStates), [1.6, 2.0, 0.0, 0.0]);
    let stretched = std::f64::consts::FRAC_PI_2;
    for (states, expected) in [
        ([stretched, stretched, 1.0, 1.0], "fmi2SetContinuousStates: |singular.detJx|/"),
        ([1.6, 1.2, 0.0, 0.0], "fmi2SetContinuousStates: theta = (1.6, 1.2) rad cannot be closed: the elbows are "),
    ] {
        assert_eq!(host.set_states(&states), fmi2Discard);
        let line = host.line();
        assert!(line.starts_with(expected) && line.ends_with("; use co-simulation, which passes direct singularities."), "{line}");
        assert_eq!(host.array::<4>(fmi2GetContinuousStates), x);
    }
    assert_eq!(host.set_states(&inside), fmi2OK);
    assert!(host.array::<4>(fmi2GetDerivatives).is_ok());
}

/// Indicators change sign exactly at changes of mode and at the borders of stops and plane.
#[test]
fn indicators_change_sign_at_modes_and_kinks() {
    let host = Host::instantiate(Instantiation { kind: fmi2ModelExchange, ..Default::default() }).expect("an instance");
    assert_eq!(host.set_boolean(&[reference("stop.enabled"), reference("contact.enabled")], &[1, 1]), fmi2OK);
    for (name, value) in [BENT, ("contact.offset", 0.2), ("stop.upper[2]", 2.2)] {
        assert_eq!(host.set_real(&[reference(name)], &[value]), fmi2OK);
    }
    assert_eq!(host.setup(None, 0.0, None), fmi2OK);
    for function in [fmi2EnterInitializationMode, fmi2ExitInitializationMode, fmi2EnterContinuousTimeMode] {
        assert_eq!(host.call(function), fmi2OK, "{:?}", host.take());
    }
    let modes = ["mode.assembly", "mode.working", "singular.type"].map(reference);
    let observe = || {
        let mut numbers = [0; 3];
        assert_eq!(host.get_integer(&modes, &mut numbers), fmi2OK);
        let mut force = [0.0];
        assert_eq!(host.get_real(&[reference("contact.fy")], &mut force), fmi2OK);
        (numbers, force[0] > 0.0)
    };
    let mut changes = 0;
    let mut before = None;
    for step in 0..4000 {
        // Both legs swing; the elbows stay within reach of each other.
        let (a, b) = (0.0071 * f64::from(step), 0.0043 * f64::from(step));
        let states = [1.6 + 0.9 * libm::sin(a), 1.9 + 0.9 * libm::sin(b), 0.9 * libm::cos(a), 0.9 * libm::cos(b)];
        if host.set_states(&states) != fmi2OK {
            host.take();
            before = None;
            continue;
        }
        let signs = host.array::<EVENT_INDICATORS>(fmi2GetEventIndicators).expect("indicators").map(|z| z > 0.0);
        let now = (signs, observe());
        if let Some((old_signs, old)) = before
            && old != now.1
        {
            changes += 1;
            assert_ne!(old_signs, signs, "step {step}: {old:?} -> {:?}", now.1);
        }
        before = Some(now);
    }
    assert!(changes > 10, "{changes} changes");
}

/// A tuned parameter acts from fmi2NewDiscreteStates on; a payload picked up there changes the rates, which is reported.
#[test]
fn tuned_values_act_from_an_event_on() {
    let host = Host::instantiate(Instantiation { kind: fmi2ModelExchange, ..Default::default() }).expect("an instance");
    let mass = reference("payload.mass");
    assert_eq!(host.set_boolean(&[reference("payload.enabled")], &[1]), fmi2OK);
    for (name, value) in [BENT, ("payload.mass", 0.01), ("init.omega[1]", 2.0)] {
        assert_eq!(host.set_real(&[reference(name)], &[value]), fmi2OK);
    }
    assert_eq!(host.setup(None, 0.0, None), fmi2OK);
    for function in [fmi2EnterInitializationMode, fmi2ExitInitializationMode, fmi2EnterContinuousTimeMode] {
        assert_eq!(host.call(function), fmi2OK, "{:?}", host.take());
    }
    assert_eq!(host.set_real(&[mass], &[0.1]), fmi2Error);
    assert_eq!(
        host.line(),
        "fmi2SetReal: payload.mass is a tunable parameter and can only be set in event mode, not in continuous-time mode."
    );
    assert_eq!(host.call(fmi2EnterEventMode), fmi2OK);
    let before = host.array::<4>(fmi2GetContinuousStates).expect("states");
    assert_eq!(host.set_real(&[mass], &[0.1]), fmi2OK);
    assert_eq!(host.call(fmi2EnterContinuousTimeMode), fmi2Error);
    assert_eq!(host.line(), "fmi2EnterContinuousTimeMode: parameters have been set: fmi2NewDiscreteStates must be called before.");
    assert_eq!(host.new_discrete_states(), (fmi2OK, true));
    let after = host.array::<4>(fmi2GetContinuousStates).expect("states");
    assert!(after[..2] == before[..2] && after[2] < before[2], "{before:?} {after:?}");
    assert_eq!(host.new_discrete_states(), (fmi2OK, false));
    // Without a change of mass the states stay.
    assert_eq!(host.set_real(&[reference("gravity.g")], &[1.6]), fmi2OK);
    assert_eq!(host.new_discrete_states(), (fmi2OK, false));
    // A refused value stays set, so that the master can correct it.
    assert_eq!(host.set_real(&[mass], &[1e4]), fmi2OK);
    assert_eq!(host.new_discrete_states().0, fmi2Error);
    assert!(host.line().starts_with("fmi2NewDiscreteStates: payload.mass = 10000.0 kg is not allowed during this run"));
    assert_eq!(host.set_real(&[mass], &[0.0]), fmi2OK);
    assert_eq!(host.new_discrete_states(), (fmi2OK, false));
    assert_eq!(host.call(fmi2EnterContinuousTimeMode), fmi2OK);
}

/// An accepted step must not pass the end; a trial time may.
#[test]
fn a_step_past_the_end_is_refused() {
    let host = integrated(&[BENT]);
    for (time, status) in [(0.5, fmi2OK), (1.0 + 1e-12, fmi2OK), (1.01, fmi2Error), (0.2, fmi2OK)] {
        assert_eq!(host.set_time(time), fmi2OK);
        assert_eq!(host.completed_step(), status, "{time}");
    }
    assert_eq!(host.line(), "fmi2CompletedIntegratorStep: the time is 1.01 s, which is past stopTime 1.0 s.");
    assert_eq!(host.set_time(f64::NAN), fmi2Error);
    assert_eq!(host.line(), "fmi2SetTime: time is NaN s, must be finite.");
}

/// The warning comes once, as in co-simulation.
#[test]
fn unused_references_give_a_warning() {
    let host = integrated(&[BENT]);
    assert_eq!(host.set_real(&[reference("servo.theta[1]")], &[1.0]), fmi2OK);
    assert_eq!((host.completed_step(), host.completed_step()), (fmi2OK, fmi2OK));
    assert!(host.line().contains("no active effect reads them: servo.enabled is false."));
}

/// A stored state can be restored only into an instance of the same kind, and each kind has its own functions.
#[test]
fn kinds_do_not_mix() {
    let (host, stepped) = (integrated(&[BENT]), Host::ready(&[BENT]));
    let mut stored = stepped.state();
    assert_eq!(host.set_state(stored), fmi2Error);
    assert_eq!(host.line(), "fmi2SetFMUstate: FMUstate belongs to an instance for co-simulation, this one is for model exchange.");
    assert_eq!(host.free_state(&mut stored), fmi2OK);
    assert_eq!(host.do_step(0.0, 1e-3), fmi2Error);
    assert_eq!(host.line(), "fmi2DoStep: the instance is for model exchange, which does not have this function.");
    assert_eq!(stepped.set_time(0.0), fmi2Error);
    assert_eq!(stepped.line(), "fmi2SetTime: the instance is for co-simulation, which does not have this function.");
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2Error);
    assert_eq!(host.line(), "fmi2ExitInitializationMode: the state is \"continuous-time mode\", allowed is: initialization mode.");
}
