//! Stack requirements of the C functions: each runs in threads with a small stack.

use std::thread::Builder;

use fivebar::ffi::*;
use fivebar::variables::VARIABLES;

use crate::fmi_host::{Host, methods, reference};
use crate::support::methods_with_events;

/// Stack of a thread that suffices for a plain machine, bytes: within the value in `docs/fmi.md`, including the thread's own use.
const PLAIN: usize = 48 * 1024;
/// Stack of a thread that suffices for following, bytes: the value in `docs/fmi.md`.
const FOLLOWED: usize = 128 * 1024;

/// A start of a machine without coaxial motors.
const START: [(&str, f64); 3] = [("base.distance", 0.1), ("init.theta[1]", 2.2), ("init.theta[2]", 0.9)];

/// Runs `work` in a thread with a stack of `bytes`. If it overflows, the process ends with a message that names the thread.
fn with_stack(bytes: usize, name: String, work: impl FnOnce() + Send + 'static) {
    let thread = Builder::new().name(name).stack_size(bytes).spawn(work).expect("a thread");
    thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
}

/// An instance with choices and values set by name, ready to step.
fn ready(choices: &[(&str, i32)], on: &[&str], values: &[(&str, f64)]) -> Host {
    let host = Host::initializing(0.0, None);
    for (name, choice) in choices {
        assert_eq!(host.set_integer(&[reference(name)], &[*choice]), fmi2OK, "{name}");
    }
    for name in on {
        assert_eq!(host.set_boolean(&[reference(name)], &[1]), fmi2OK, "{name}");
    }
    for (name, value) in values {
        assert_eq!(host.set_real(&[reference(name)], &[*value]), fmi2OK, "{name}: {:?}", host.take());
    }
    read(&host);
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK, "{:?}", host.take());
    host
}

/// Reads every Real.
fn read(host: &Host) {
    let references: Vec<u32> =
        VARIABLES.iter().filter(|v| v.fmi_type() == fivebar::variables::FmiType::Real).map(|v| v.reference).collect();
    let mut values = vec![0.0; references.len()];
    assert_eq!(host.get_real(&references, &mut values), fmi2OK, "{:?}", host.take());
}

/// Makes steps, each with another torque, and tunes one parameter; then uses states and derivatives.
fn go(host: &Host, samples: bool) {
    for step in 0..100 {
        let time = f64::from(step) * 1e-3;
        assert_eq!(host.set_real(&[reference("tau[1]")], &[1e-3 * f64::from(step % 3)]), fmi2OK);
        if samples {
            let mut theta = [0.0; 2];
            assert_eq!(host.get_real(&["theta[1]", "theta[2]"].map(reference), &mut theta), fmi2OK);
            let names = ["measured.theta[1]", "measured.theta[2]", "measured.time[1]", "measured.time[2]"].map(reference);
            assert_eq!(host.set_real(&names, &[theta[0], theta[1], time, time]), fmi2OK);
        }
        if step == 50 {
            assert_eq!(host.set_real(&[reference("gravity.g")], &[9.0]), fmi2OK);
        }
        assert_eq!(host.do_step(time, 1e-3), fmi2OK, "{:?}", host.take());
    }
    read(host);
    let unknowns = ["tip.x", "tip.y"].map(reference);
    assert_eq!(host.directional_derivative(&unknowns, &[(reference("tau[1]"), 1.0)], &mut [0.0; 2]), fmi2OK);
    let mut state = host.state();
    let (_, size) = host.serialized_size(state);
    let (written, bytes) = host.serialize(state, size);
    assert_eq!((written, host.get_state(&mut state), host.deserialize(&bytes, &mut state)), (fmi2OK, fmi2OK, fmi2OK));
    assert_eq!((host.set_state(state), host.free_state(&mut state)), (fmi2OK, fmi2OK));
    assert_eq!((host.call(fmi2Terminate), host.call(fmi2Reset)), (fmi2OK, fmi2OK));
}

const LOADS: [&str; 4] = ["gravity.enabled", "viscous.enabled", "friction.enabled", "stop.enabled"];

#[test]
fn a_plain_machine_needs_little() {
    for method in methods() {
        // Links next to without inertia take the general solve.
        for (on, inertia) in [(&LOADS[..0], 6.23e-5), (&LOADS[..], 6.23e-5), (&LOADS[..0], 1e-9)] {
            let values = [("link[2].inertia", inertia)];
            let choices = [("solver.method", method)];
            with_stack(PLAIN, format!("method {method}, {on:?}, {inertia}"), move || go(&ready(&choices, on, &values), false));
        }
    }
}

#[test]
fn a_machine_that_sticks_needs_little() {
    for method in methods_with_events() {
        for inertia in [6.23e-5, 1e-9] {
            let (choices, values) = ([("solver.method", method as i32), ("friction.law", 2)], [("link[2].inertia", inertia)]);
            with_stack(PLAIN, format!("{method:?}, {inertia}"), move || go(&ready(&choices, &LOADS, &values), false));
        }
    }
}

#[test]
fn a_machine_that_is_followed_needs_more() {
    for method in methods() {
        for learn in [&["estimator.enabled"][..], &["estimator.enabled", "estimator.learn.enabled"]] {
            let choices = [("solver.method", method)];
            with_stack(FOLLOWED, format!("method {method}, {learn:?}"), move || go(&ready(&choices, learn, &START), true));
        }
    }
}

#[test]
fn model_exchange_needs_little() {
    with_stack(PLAIN, "model exchange".to_owned(), || {
        let host = Host::instantiate(crate::fmi_host::Instantiation { kind: fmi2ModelExchange, ..Default::default() });
        let host = host.unwrap_or_else(|lines| panic!("{lines:?}"));
        assert_eq!(host.setup(None, 0.0, None), fmi2OK);
        for (name, value) in START {
            assert_eq!(host.set_real(&[reference(name)], &[value]), fmi2OK, "{name}");
        }
        for function in [fmi2EnterInitializationMode, fmi2ExitInitializationMode] {
            assert_eq!(host.call(function), fmi2OK, "{:?}", host.take());
        }
        assert_eq!((host.new_discrete_states().0, host.call(fmi2EnterContinuousTimeMode)), (fmi2OK, fmi2OK));
        let states: [f64; 4] = host.array(fmi2GetContinuousStates).expect("states");
        assert_eq!((host.set_states(&states), host.completed_step()), (fmi2OK, fmi2OK));
        let _: [f64; 4] = host.array(fmi2GetDerivatives).expect("derivatives");
        read(&host);
        let state = host.state();
        let (_, size) = host.serialized_size(state);
        let mut other = std::ptr::null_mut();
        assert_eq!(host.deserialize(&host.serialize(state, size).1, &mut other), fmi2OK);
        for mut state in [state, other] {
            assert_eq!((host.set_state(state), host.free_state(&mut state)), (fmi2OK, fmi2OK));
        }
    });
}
