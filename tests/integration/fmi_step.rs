//! Communication points, the step grid, discard, status functions (rules 32, 33, 34, 43, 44 of this project).

use fivebar::ffi::*;

use super::fmi_host::{Host, methods, reference};

const DO_STEP_STATUS: fmi2StatusKind = 0;
const PENDING_STATUS: fmi2StatusKind = 1;
const LAST_SUCCESSFUL_TIME: fmi2StatusKind = 2;
const TERMINATED: fmi2StatusKind = 3;

/// Tip, rates and last error estimate, as bits.
fn motion(host: &Host) -> [u64; 8] {
    let names = ["tip.x", "tip.y", "theta[1]", "theta[2]", "omega[1]", "omega[2]", "alpha[1]", "solver.errorEstimate"];
    let mut values = [f64::NAN; 8];
    assert_eq!(host.get_real(&names.map(reference), &mut values), fmi2OK);
    values.map(f64::to_bits)
}

fn steps(host: &Host) -> i32 {
    let mut steps = [-1];
    assert_eq!(host.get_integer(&[reference("solver.steps")], &mut steps), fmi2OK);
    steps[0]
}

#[test]
fn one_long_step_is_many_short_ones_bit_for_bit() {
    for method in methods() {
        let run = |size: f64, count: u32| {
            let host = Host::initializing(0.0, None);
            assert_eq!(host.set_integer(&[reference("solver.method")], &[method]), fmi2OK);
            assert_eq!(host.set_real(&[reference("tau[1]"), reference("init.theta[2]")], &[0.05, 2.1]), fmi2OK);
            assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
            host.run(size, count);
            (motion(&host), steps(&host))
        };
        let together = run(0.12, 1);
        assert_eq!(together.1, 120);
        for (size, count) in [(0.06, 2), (0.01, 12), (1e-3, 120)] {
            assert_eq!(run(size, count), together, "method {method}: {count} steps of {size} s");
        }
    }
}

#[test]
fn steps_that_are_no_multiple_are_divided_equally() {
    for (size, expected) in [(1.0 / 60.0, 17), (4e-4, 1), (2.5e-3, 3)] {
        let host = Host::ready(&[]);
        host.run(size, 3);
        assert_eq!(steps(&host), 3 * expected, "{size} s");
    }
}

#[test]
fn points_and_steps_that_cannot_be_meant_are_refused() {
    let host = Host::initializing(2.0, Some(3.0));
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    for (point, size, expected) in [
        (0.0, 1e-3, "currentCommunicationPoint is 0.0 s, expected 2.0 s."),
        (2.0, 0.0, "communicationStepSize is 0.0 s, must be positive and finite."),
        (2.0, -1.0, "communicationStepSize is -1.0 s, must be positive and finite."),
        (2.0, f64::NAN, "communicationStepSize is NaN s, must be positive and finite."),
        (
            2.0,
            1.5,
            "currentCommunicationPoint + communicationStepSize is 3.5 s, which is past stopTime 3.0 s; the step starts 1.0 s before stopTime.",
        ),
    ] {
        assert_eq!(host.do_step(point, size), fmi2Error);
        assert_eq!(host.line(), format!("fmi2DoStep: {expected}"));
    }
    assert_eq!(steps(&host), 0);
    assert_eq!(host.do_step(2.0000000000000004, 0.5), fmi2OK);
    assert_eq!(host.do_step(2.5, 0.5000000000000002), fmi2OK);
    // At the end every further step is refused in the same way.
    for _ in 0..2 {
        assert_eq!(host.do_step(3.0, 1e-3), fmi2Error);
        assert!(host.line().contains("past stopTime 3.0 s"));
    }
}

#[test]
fn status_functions_when_there_is_nothing_to_tell() {
    let host = Host::ready(&[]);
    host.run(1e-3, 2);
    assert_eq!(host.real_status(LAST_SUCCESSFUL_TIME), (fmi2OK, 2e-3));
    assert_eq!(host.boolean_status(TERMINATED), (fmi2OK, fmi2False));
    assert_eq!(host.take(), []);
    for kind in [DO_STEP_STATUS, PENDING_STATUS, LAST_SUCCESSFUL_TIME, TERMINATED] {
        assert_eq!(host.other_statuses(kind), [fmi2Discard; 3]);
    }
    assert_eq!(host.take()[0].text, "fmi2GetStatus: there is no fmi2DoStepStatus: a step is never pending.");
    assert_eq!(host.real_status(TERMINATED).0, fmi2Discard);
    assert_eq!(host.boolean_status(LAST_SUCCESSFUL_TIME).0, fmi2Discard);
    host.take();
    assert_eq!(host.real_status(4).0, fmi2Error);
    assert_eq!(host.line(), "fmi2GetRealStatus: status kind is 4, must be 0 to 3.");
}

/// A scene with a failing first step: one iteration of the printed method is not enough for 0.1 s.
fn hopeless() -> Host {
    let host = Host::initializing(0.0, None);
    let printed = 2;
    assert_eq!(host.set_integer(&["solver.method", "solver.maxIterations"].map(reference), &[printed, 1]), fmi2OK);
    let (names, values) = (["solver.stepSize", "init.theta[2]", "init.omega[1]"], [0.1, 2.0, 5.0]);
    assert_eq!(host.set_real(&names.map(reference), &values), fmi2OK);
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    host
}

#[test]
fn a_step_that_cannot_be_done_is_discarded_and_leaves_everything_as_it_was() {
    let host = hopeless();
    let before = (motion(&host), steps(&host));
    assert_eq!(host.do_step(0.0, 0.2), fmi2Discard);
    let lines = host.take();
    assert_eq!(lines.len(), 1, "{lines:?}");
    assert_eq!((lines[0].status, lines[0].category.as_str()), (fmi2Discard, "logStatusDiscard"));
    let text = &lines[0].text;
    assert!(text.starts_with("fmi2DoStep: the step from 0.0 s by 0.2 s failed at 0.0 s: "), "{text}");
    assert!(text.ends_with("; the state at 0.0 s is unchanged."), "{text}");

    assert_eq!(host.real_status(LAST_SUCCESSFUL_TIME), (fmi2OK, 0.0));
    assert_eq!(host.boolean_status(TERMINATED), (fmi2OK, fmi2False));
    assert_eq!((motion(&host), steps(&host)), before);

    // The step fails again; another input may be set, fixed parameters may not; a shorter step succeeds.
    assert_eq!(host.set_real(&[reference("tau[1]")], &[0.0]), fmi2OK);
    assert_eq!(host.set_real(&[reference("link[1].mass")], &[1.0]), fmi2Error);
    host.take();
    assert_eq!(host.do_step(0.0, 0.2), fmi2Discard);
    assert_eq!(host.take()[0].text, *text);
    assert_eq!(host.do_step(0.0, 1e-9), fmi2OK, "{:?}", host.take());
    assert_eq!(host.real_status(LAST_SUCCESSFUL_TIME), (fmi2OK, 1e-9));
    assert_eq!(host.set_real(&[reference("tau[1]")], &[0.1]), fmi2OK);

    assert_eq!(host.do_step(1e-9, 0.2), fmi2Discard);
    assert_eq!(host.call(fmi2Terminate), fmi2OK);
}

/// A discarded step leaves no trace, not even in a counter, with any method and solve, with old or new inputs.
#[test]
fn a_discarded_step_leaves_no_trace() {
    for (method, adaptive, payload, friction) in
        [(1, 0, 0, 0), (1, 0, 1, 0), (1, 0, 0, 1), (1, 1, 0, 0), (2, 1, 0, 0), (2, 1, 0, 1), (3, 1, 0, 0), (4, 1, 0, 0)]
    {
        let host = Host::initializing(0.0, None);
        assert_eq!(host.set_integer(&["solver.method", "solver.maxIterations"].map(reference), &[method, 1]), fmi2OK);
        let switches = ["solver.adaptive", "payload.enabled", "friction.enabled"].map(reference);
        assert_eq!(host.set_boolean(&switches, &[adaptive, payload, friction]), fmi2OK);
        // This step is too long for all methods; the huge gravity defeats methods that divide a step.
        let (names, values) = (["solver.stepSize", "init.theta[2]", "init.omega[1]", "gravity.g"], [0.1, 2.0, 5.0, 1e12]);
        assert_eq!(host.set_real(&names.map(reference), &values), fmi2OK);
        assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK, "{:?}", host.take());
        let bytes = |host: &Host| {
            let mut state = host.state();
            let (_, size) = host.serialized_size(state);
            let bytes = host.serialize(state, size).1;
            assert_eq!(host.free_state(&mut state), fmi2OK);
            bytes
        };
        for torque in [0.0, 0.0, 1.0, 1.0] {
            assert_eq!(host.set_real(&[reference("tau[1]")], &[torque]), fmi2OK);
            let before = bytes(&host);
            assert_eq!(host.do_step(0.0, 0.1), fmi2Discard, "method {method}, adaptive {adaptive}");
            // Except the stage of the life cycle, which comes first, and the checksum at the end.
            let (inside, after) = (59..before.len() - 4, bytes(&host));
            assert!(before[inside.clone()] == after[inside], "method {method}, adaptive {adaptive}, {payload}, {friction}");
        }
        host.take();
    }
}

/// Tuned values act from the next completed step; a discarded one has not begun. The same holds for the warning about references.
#[test]
fn a_discarded_step_leaves_tuned_parameters_pending() {
    let host = hopeless();
    let energies = || {
        let mut values = [f64::NAN; 3];
        let names = ["energy.potential", "energy.input", "energy.error"];
        assert_eq!(host.get_real(&names.map(reference), &mut values), fmi2OK);
        values.map(f64::to_bits)
    };
    let before = energies();
    assert_eq!(host.set_real(&["gravity.g", "servo.theta[1]"].map(reference), &[5.0, 1.0]), fmi2OK);
    assert_eq!(host.do_step(0.0, 0.2), fmi2Discard);
    assert_eq!(energies(), before);
    assert_eq!(host.take().len(), 1, "the sentence of the discarded step, and no warning yet");
    assert_eq!(host.do_step(0.0, 1e-9), fmi2OK);
    assert_ne!(energies(), before);
    assert!(host.line().contains("no active effect reads them"));
}

#[test]
fn inputs_act_from_the_point_at_which_they_are_set() {
    let host = Host::ready(&[("init.theta[2]", 2.0)]);
    host.run(0.01, 5);
    let driven = Host::ready(&[("init.theta[2]", 2.0)]);
    driven.run(0.01, 5);
    assert_eq!(motion(&host), motion(&driven));
    assert_eq!(driven.set_real(&[reference("tau[2]")], &[0.2]), fmi2OK);
    assert_eq!((host.do_step(0.05, 0.01), driven.do_step(0.05, 0.01)), (fmi2OK, fmi2OK));
    assert_ne!(motion(&host), motion(&driven));
    let mut input = [0.0];
    assert_eq!(driven.get_real(&[reference("energy.input")], &mut input), fmi2OK);
    assert!(input[0] != 0.0);
}
