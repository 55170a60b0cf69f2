//! Reading and writing variables (rules 29, 30, 31, 35, 48 of this project).

use fivebar::ffi::*;
use fivebar::variables::{FmiType, VARIABLES, Value, VariableId};

use super::fmi_host::{Host, reference};

#[test]
fn a_fresh_instance_has_the_start_values_of_the_xml() {
    let description = model_description::ModelDescription::read().expect("the shipped description");
    let host = Host::initializing(0.0, None);
    for variable in &description.variables {
        let (reference, name) = ([variable.reference], variable.name.full.as_str());
        match variable.kind {
            model_description::Kind::Real { start, .. } => {
                let mut value = [f64::NAN];
                assert_eq!(host.get_real(&reference, &mut value), fmi2OK, "{name}");
                assert!(value[0].is_finite(), "{name}");
                assert!(start.is_none_or(|start| start.to_bits() == value[0].to_bits()), "{name}: {value:?}");
            }
            model_description::Kind::Integer { start, .. } | model_description::Kind::Enumeration { start } => {
                let mut value = [-1];
                assert_eq!(host.get_integer(&reference, &mut value), fmi2OK, "{name}");
                assert!(start.is_none_or(|start| start == value[0]), "{name}: {value:?}");
            }
            model_description::Kind::Boolean { start } => {
                let mut value = [-1];
                assert_eq!(host.get_boolean(&reference, &mut value), fmi2OK, "{name}");
                assert!(start.is_none_or(|start| i32::from(start) == value[0]), "{name}: {value:?}");
            }
        }
    }
    assert_eq!(host.take(), []);
}

#[test]
fn outputs_at_the_start_match_the_scene() {
    let host = Host::initializing(0.0, None);
    let names = ["theta[1]", "theta[2]", "omega[1]", "tip.x", "tip.y", "elbow[2].x", "energy.error", "solver.positionError"];
    let mut values = [f64::NAN; 8];
    assert_eq!(host.get_real(&names.map(reference), &mut values), fmi2OK);
    let right_angle = std::f64::consts::FRAC_PI_2;
    let expected = [right_angle, right_angle, 0.0, 0.21, 0.21, 0.42, 0.0, 0.0];
    for ((name, value), expected) in names.iter().zip(values).zip(expected) {
        assert!((value - expected).abs() < 1e-15, "{name} = {value}, expected {expected}");
    }
    // The stretched distal links of the paper's start are a direct singularity.
    let mut kind = [0];
    assert_eq!(host.get_integer(&[reference("singular.type")], &mut kind), fmi2OK);
    assert_eq!(kind, [fivebar::variables::SingularityKind::Direct as i32]);
}

#[test]
fn values_out_of_bounds_are_refused_by_name_and_nothing_is_written() {
    let host = Host::initializing(0.0, None);
    let tau = reference("tau[1]");
    for (name, value, expected) in [
        ("tau[2]", f64::NAN, "tau[2] = NaN N.m is not allowed: it must be finite."),
        ("tip.fx", f64::NEG_INFINITY, "tip.fx = -inf N is not allowed: it must be finite."),
        ("link[3].mass", -0.5, "link[3].mass = -0.5 kg is not allowed: it must be at least 1e-9 kg."),
        ("solver.tolerance", -1e-3, "solver.tolerance = -0.001 is not allowed: it must be at least 1e-16."),
        ("theta[1]", 0.0, "theta[1] is computed and cannot be set."),
    ] {
        assert_eq!(host.set_real(&[tau, reference(name)], &[0.5, value]), fmi2Error);
        assert_eq!(host.line(), format!("fmi2SetReal: {expected}"));
    }
    for (name, value, expected) in [
        ("solver.maxIterations", 0, "solver.maxIterations = 0 is not allowed: it must be at least 1."),
        ("solver.maxIterations", 101, "solver.maxIterations = 101 is not allowed: it must be at most 100."),
        ("init.assembly", 3, "init.assembly = 3 is not allowed: it must be one of 1 (plus), 2 (minus)."),
        ("solver.steps", 3, "solver.steps is computed and cannot be set."),
        ("mode.assembly", 1, "mode.assembly is computed and cannot be set."),
    ] {
        assert_eq!(host.set_integer(&[reference("solver.method"), reference(name)], &[3, value]), fmi2Error);
        assert_eq!(host.line(), format!("fmi2SetInteger: {expected}"));
    }
    let (mut torque, mut method) = ([f64::NAN], [0]);
    assert_eq!(host.get_real(&[tau], &mut torque), fmi2OK);
    assert_eq!(host.get_integer(&[reference("solver.method")], &mut method), fmi2OK);
    assert_eq!((torque, method), ([0.0], [1]));
}

#[test]
fn unknown_references_and_wrong_types_are_refused_and_nothing_is_handed_over() {
    let host = Host::initializing(0.0, None);
    let mut values = [7.0; 2];
    assert_eq!(host.get_real(&[reference("tau[1]"), 99_999], &mut values), fmi2Error);
    assert_eq!(host.line(), "fmi2GetReal: value reference 99999 belongs to no variable.");
    assert_eq!(host.get_real(&[reference("tau[1]"), reference("solver.method")], &mut values), fmi2Error);
    assert_eq!(host.line(), "fmi2GetReal: solver.method (value reference 400) is of type Enumeration, not Real.");
    assert_eq!(values, [7.0; 2]);
    assert_eq!(host.get_integer(&[reference("tau[1]")], &mut [0]), fmi2Error);
    assert_eq!(host.get_boolean(&[reference("solver.maxIterations")], &mut [0]), fmi2Error);
    assert_eq!(host.set_boolean(&[reference("tau[1]")], &[1]), fmi2Error);
    host.take();
    assert_eq!(host.strings(reference("tau[1]")), [fmi2Error; 2]);
    assert_eq!(host.take()[0].text, "fmi2GetString: tau[1] is of type Real, not String.");
    assert_eq!(host.strings(reference("singular.type")), [fmi2Error; 2]);
    assert_eq!(host.take()[0].text, "fmi2GetString: singular.type is of type Enumeration, not String.");
    assert_eq!(host.strings(99_999), [fmi2Error; 2]);
}

#[test]
fn null_arrays_are_as_good_as_empty_ones_and_refused_otherwise() {
    let host = Host::initializing(0.0, None);
    assert_eq!(host.null_arrays(0), [fmi2OK; 8]);
    assert_eq!(host.take(), []);
    assert_eq!(host.null_arrays(1), [fmi2Error; 8]);
    assert!(host.take().iter().all(|line| line.text.ends_with(": vr is null.")));
    assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK);
    assert_eq!(host.null_values(), [fmi2Error; 5]);
    let texts: Vec<String> = host.take().into_iter().map(|line| line.text).collect();
    assert_eq!(texts[0], "fmi2GetReal: value is null.");
    assert_eq!(texts[4], "fmi2SetDebugLogging: categories is null.");
}

#[test]
fn what_may_be_set_depends_on_role_and_state() {
    // Every input and tunable parameter in every state that allows setting; every other parameter only before the run.
    let parameters = |host: &Host, expected: fmi2Status| {
        for variable in VARIABLES.iter().filter(|variable| variable.start.is_some()) {
            let always = variable.tunable || matches!(variable.id, VariableId::Input(_) | VariableId::Sample(_));
            let reference = [variable.reference];
            let status = match variable.start {
                Some(Value::Real(start)) => host.set_real(&reference, &[start]),
                Some(Value::Integer(start)) => host.set_integer(&reference, &[start]),
                Some(Value::Boolean(start)) => host.set_boolean(&reference, &[start.into()]),
                None => unreachable!("filtered"),
            };
            assert_eq!(status, if always { fmi2OK } else { expected }, "{}", variable.name);
        }
    };
    parameters(&Host::new(), fmi2OK);
    parameters(&Host::initializing(0.0, None), fmi2OK);
    let host = Host::ready(&[]);
    assert_eq!(host.set_real(&[reference("link[1].mass")], &[0.02]), fmi2Error);
    let expected = "fmi2SetReal: link[1].mass is a fixed parameter and can only be set before fmi2ExitInitializationMode.";
    assert_eq!(host.line(), expected);
    parameters(&host, fmi2Error);
}

#[test]
fn values_set_are_read_back() {
    let host = Host::initializing(0.0, None);
    assert_eq!(host.set_boolean(&[reference("gravity.enabled")], &[0]), fmi2OK);
    assert_eq!(host.set_integer(&[reference("solver.method")], &[3]), fmi2OK);
    let (mut enabled, mut method) = ([1], [0]);
    assert_eq!(host.get_boolean(&[reference("gravity.enabled")], &mut enabled), fmi2OK);
    assert_eq!(host.get_integer(&[reference("solver.method")], &mut method), fmi2OK);
    assert_eq!((enabled, method), ([0], [3]));
}

#[test]
fn initialization_outputs_follow_the_values_set() {
    let host = Host::initializing(0.0, None);
    let elbow = [reference("elbow[1].x")];
    let (mut before, mut after) = ([f64::NAN], [f64::NAN]);
    assert_eq!(host.get_real(&elbow, &mut before), fmi2OK);
    assert_eq!(host.set_real(&[reference("init.theta[1]")], &[1.3]), fmi2OK);
    assert_eq!(host.get_real(&elbow, &mut after), fmi2OK);
    assert!((before[0] - 0.0).abs() < 1e-15 && (after[0] - 0.21 * 1.3f64.cos()).abs() < 1e-15, "{before:?} {after:?}");
}

#[test]
fn outputs_answer_for_the_present_inputs() {
    let host = Host::ready(&[("init.theta[2]", 2.0)]);
    host.run(1e-3, 10);
    let alpha = [reference("alpha[1]")];
    let (mut before, mut after, mut again) = ([0.0], [0.0], [0.0]);
    assert_eq!(host.get_real(&alpha, &mut before), fmi2OK);
    assert_eq!(host.set_real(&[reference("tau[1]")], &[0.5]), fmi2OK);
    assert_eq!(host.get_real(&alpha, &mut after), fmi2OK);
    assert!(after[0] > before[0] + 100.0, "{before:?} {after:?}");
    assert_eq!(host.set_real(&[reference("tau[1]")], &[0.0]), fmi2OK);
    assert_eq!(host.get_real(&alpha, &mut again), fmi2OK);
    // Only up to rounding: the step's acceleration and the recomputed one may have different bits.
    assert!((again[0] - before[0]).abs() <= 1e-9 * before[0].abs(), "{before:?} {again:?}");
}

#[test]
fn reading_changes_nothing_and_gives_the_same_bits_in_any_order() {
    let real = || VARIABLES.iter().filter(|variable| variable.fmi_type() == FmiType::Real);
    let forwards: Vec<u32> = real().map(|variable| variable.reference).collect();
    let backwards: Vec<u32> = forwards.iter().rev().copied().collect();
    let (read, unread) = (Host::ready(&[("tau[1]", 0.1)]), Host::ready(&[("tau[1]", 0.1)]));
    let mut values = vec![0.0; forwards.len()];
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<u64>>();
    for step in 0..100 {
        let point = f64::from(step) * 1e-3;
        assert_eq!((read.do_step(point, 1e-3), unread.do_step(point, 1e-3)), (fmi2OK, fmi2OK));
        assert_eq!(read.get_real(&forwards, &mut values), fmi2OK);
        let first = bits(&values);
        assert_eq!(read.get_real(&backwards, &mut values), fmi2OK);
        values.reverse();
        assert_eq!(bits(&values), first);
    }
    let first = bits(&values);
    assert_eq!(unread.get_real(&forwards, &mut values), fmi2OK);
    assert_eq!(bits(&values), first);
}

/// Inputs that are finite but too large: a value that is not finite is discarded by name and not returned; the others can be read.
#[test]
fn values_that_are_not_finite_are_never_returned() {
    let host = Host::ready(&[("init.theta[2]", 2.0)]);
    assert_eq!(host.set_real(&[reference("tau[1]")], &[1e308]), fmi2OK);
    let mut values = [7.0; 2];
    assert_eq!(host.get_real(&["tip.x", "alpha[1]"].map(reference), &mut values), fmi2Discard);
    let text = host.line();
    assert!(text.starts_with("fmi2GetReal: alpha[1] = ") && text.contains("it must be finite"), "{text}");
    assert_eq!(values, [7.0; 2]);
    assert_eq!(host.get_real(&["tip.x", "tau[1]"].map(reference), &mut values), fmi2OK);
    assert_eq!(values[1], 1e308);
    assert_eq!(host.output_derivative(reference("tip.x"), 2).0, fmi2Discard);
    assert!(host.line().contains("derivative 2 of tip.x = "));
    assert_eq!(host.set_real(&[reference("tau[1]")], &[0.0]), fmi2OK);
    let knowns = ["tau[1]", "tau[2]"].map(|name| (reference(name), 1e308));
    values = [7.0; 2];
    assert_eq!(host.directional_derivative(&["tip.x", "alpha[1]"].map(reference), &knowns, &mut values), fmi2Discard);
    assert!(host.line().contains("change of alpha[1] = "));
    assert_eq!(values, [7.0; 2]);
    assert_eq!(host.get_real(&[reference("alpha[1]")], &mut values[..1]), fmi2OK);
}
