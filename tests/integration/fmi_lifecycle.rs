//! Instantiation, order of calls, reset, independence (rules 25, 27, 28, 36, 45, 46 of this project).

use fivebar::ffi::*;
use fivebar::variables::{GUID, VARIABLES};

use super::fmi_host::{Host, Instantiation, instantiate_without_callbacks, reference, version_and_platform};

#[test]
fn version_and_platform_need_no_instance() {
    assert_eq!(version_and_platform(), ("2.0".to_owned(), "default".to_owned()));
}

#[test]
fn instantiation_checks_its_arguments() {
    let wrong = "{00000000-0000-0000-0000-000000000000}";
    for (with, expected) in [
        (Instantiation { kind: 2, ..Default::default() }, "fmuType is 2, must be fmi2ModelExchange (0) or fmi2CoSimulation (1)."),
        (Instantiation { name: Some(""), ..Default::default() }, "instanceName is null or empty."),
        (Instantiation { name: None, ..Default::default() }, "instanceName is null or empty."),
    ] {
        let lines = Host::instantiate(with).err().expect("a refusal");
        assert_eq!(lines.len(), 1);
        assert_eq!(lines[0].text, format!("fmi2Instantiate: {expected}"));
        assert_eq!((lines[0].status, lines[0].category.as_str()), (fmi2Error, "logStatusError"));
    }
    let lines = Host::instantiate(Instantiation { guid: wrong, ..Default::default() }).err().expect("a refusal");
    let expected = format!("fmi2Instantiate: fmuGUID is {wrong}, this library belongs to {GUID}; start values of another unit");
    assert!(lines.len() == 1 && lines[0].text.starts_with(&expected), "{lines:?}");
}

#[test]
fn null_callbacks_are_refused_and_a_null_logger_is_not() {
    assert_eq!(instantiate_without_callbacks(), (false, true));
}

#[test]
fn a_run_from_beginning_to_end() {
    let host = Host::new();
    assert_eq!(host.set_real(&[reference("tau[1]")], &[0.1]), fmi2OK);
    assert_eq!(host.setup(None, 0.0, Some(0.1)), fmi2OK);
    assert_eq!(host.call(fmi2EnterInitializationMode), fmi2OK);
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    host.run(0.01, 10);
    assert_eq!(host.call(fmi2Terminate), fmi2OK);
    let mut steps = [0];
    assert_eq!(host.get_integer(&[reference("solver.steps")], &mut steps), fmi2OK);
    assert_eq!(steps, [100]);
    assert_eq!(host.take(), []);
}

#[test]
fn calls_out_of_order_are_refused_and_change_nothing() {
    let host = Host::new();
    let refuse = |status: fmi2Status, expected: &str| {
        assert_eq!(status, fmi2Error, "{expected}");
        assert_eq!(host.line(), expected);
    };
    let tau = [reference("tau[1]")];

    let instantiated = "the state is \"instantiated\", allowed is";
    refuse(
        host.get_real(&tau, &mut [0.0]),
        &format!("fmi2GetReal: {instantiated}: initialization mode, step complete, step failed, terminated."),
    );
    refuse(host.do_step(0.0, 1e-3), &format!("fmi2DoStep: {instantiated}: step complete, step failed."));
    refuse(host.call(fmi2Terminate), &format!("fmi2Terminate: {instantiated}: step complete, step failed."));
    refuse(host.call(fmi2ExitInitializationMode), &format!("fmi2ExitInitializationMode: {instantiated}: initialization mode."));
    refuse(host.call(fmi2EnterInitializationMode), "fmi2EnterInitializationMode: fmi2SetupExperiment must be called before.");
    assert_eq!(host.other_statuses(0), [fmi2Error; 3]);
    host.take();

    assert_eq!(host.setup(None, 0.0, None), fmi2OK);
    assert_eq!(host.call(fmi2EnterInitializationMode), fmi2OK);
    let initialization = "the state is \"initialization mode\", allowed is";
    refuse(host.setup(None, 0.0, None), &format!("fmi2SetupExperiment: {initialization}: instantiated."));
    refuse(host.do_step(0.0, 1e-3), &format!("fmi2DoStep: {initialization}: step complete, step failed."));

    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    refuse(
        host.call(fmi2EnterInitializationMode),
        "fmi2EnterInitializationMode: the state is \"step complete\", allowed is: instantiated.",
    );
    refuse(host.call(fmi2CancelStep), "fmi2CancelStep: no step is pending: fmi2DoStep never returns fmi2Pending.");
    host.run(1e-3, 1);

    assert_eq!(host.call(fmi2Terminate), fmi2OK);
    let terminated = "the state is \"terminated\", allowed is";
    refuse(host.do_step(1e-3, 1e-3), &format!("fmi2DoStep: {terminated}: step complete, step failed."));
    refuse(
        host.set_real(&tau, &[1.0]),
        &format!("fmi2SetReal: {terminated}: instantiated, initialization mode, step complete, step failed."),
    );
    assert_eq!(host.get_real(&tau, &mut [0.0]), fmi2OK);
}

#[test]
fn impossible_experiments_are_refused() {
    let host = Host::new();
    assert_eq!(host.setup(None, 1.0, Some(0.5)), fmi2Error);
    assert_eq!(host.line(), "fmi2SetupExperiment: stopTime is 0.5 s, must not be before startTime, which is 1.0 s.");
    assert_eq!(host.setup(None, f64::NAN, None), fmi2Error);
    assert_eq!(host.line(), "fmi2SetupExperiment: startTime is NaN s, must be finite.");
    assert_eq!(host.setup(Some(-1.0), 0.0, None), fmi2Error);
    assert_eq!(host.line(), "fmi2SetupExperiment: tolerance is -1, must not be negative.");
    assert_eq!(host.setup(Some(1e-4), 0.0, None), fmi2OK);
    assert_eq!(host.take(), [], "an event, and the log does not want events");
}

#[test]
fn a_scene_that_cannot_be_initialised_is_refused_and_can_be_corrected() {
    let host = Host::initializing(0.0, None);
    let base = [reference("base.distance")];
    assert_eq!(host.set_real(&base, &[5.0]), fmi2OK);
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2Error);
    assert!(host.line().starts_with("fmi2ExitInitializationMode: "));
    // Reading an output there is refused for the same reason; a parameter is allowed.
    assert_eq!(host.get_real(&[reference("tip.x")], &mut [0.0]), fmi2Error);
    assert!(host.line().starts_with("fmi2GetReal: "));
    let mut value = [0.0];
    assert_eq!(host.get_real(&base, &mut value), fmi2OK);
    assert_eq!(value, [5.0]);
    assert_eq!(host.set_real(&base, &[0.42]), fmi2OK);
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    host.run(1e-3, 1);
}

/// The bits of every variable.
fn everything(host: &Host) -> Vec<u64> {
    use fivebar::variables::FmiType;
    let read = |variable: &fivebar::variables::Variable| {
        let (reference, mut real, mut integer) = ([variable.reference], [0.0], [0]);
        let status = match variable.fmi_type() {
            FmiType::Real => host.get_real(&reference, &mut real),
            FmiType::Integer => host.get_integer(&reference, &mut integer),
            FmiType::Boolean => host.get_boolean(&reference, &mut integer),
        };
        assert_eq!(status, fmi2OK, "{}: {:?}", variable.name, host.take());
        f64::to_bits(real[0]) ^ u64::from(integer[0].cast_unsigned())
    };
    VARIABLES.iter().map(read).collect()
}

#[test]
fn reset_is_as_good_as_new() {
    let start = |host: &Host| {
        assert_eq!(host.setup(None, 0.0, None), fmi2OK);
        assert_eq!(host.call(fmi2EnterInitializationMode), fmi2OK);
        let fresh = everything(host);
        assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
        host.run(0.01, 20);
        (fresh, everything(host))
    };
    let used = Host::ready(&[("tau[1]", 0.3), ("init.theta[2]", 2.0), ("solver.stepSize", 5e-4)]);
    used.run(0.01, 30);
    assert_eq!(used.call(fmi2Reset), fmi2OK);
    assert_eq!(start(&used), start(&Host::new()));
}

#[test]
fn reset_is_allowed_everywhere() {
    for host in [Host::new(), Host::initializing(0.0, None), Host::ready(&[])] {
        assert_eq!(host.call(fmi2Reset), fmi2OK);
        assert_eq!(host.setup(None, 0.0, None), fmi2OK);
    }
    let host = Host::ready(&[]);
    assert_eq!(host.call(fmi2Terminate), fmi2OK);
    assert_eq!(host.call(fmi2Reset), fmi2OK);
}

#[test]
fn instances_do_not_influence_each_other_even_in_threads() {
    let scene = |tau: f64| {
        let host = Host::ready(&[("tau[1]", tau)]);
        host.run(1e-3, 300);
        everything(&host)
    };
    let (one, two) = (scene(0.1), scene(-0.2));
    assert_ne!(one, two);
    std::thread::scope(|threads| {
        let (first, second) = (threads.spawn(|| scene(0.1)), threads.spawn(|| scene(-0.2)));
        assert_eq!((first.join().expect("one"), second.join().expect("two")), (one, two));
    });
}
