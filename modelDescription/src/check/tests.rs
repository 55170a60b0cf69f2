//! A test for every check, with a broken copy of the shipped description.

use crate::{ModelDescription, XML};

/// The shipped description with one text replaced; the text must occur.
fn broken(old: &str, new: &str) -> String {
    assert!(XML.contains(old), "the XML no longer contains {old}");
    let xml = XML.replacen(old, new, 1);
    ModelDescription::parse(&xml).map(|_| ()).expect_err(&format!("{old} -> {new}")).0
}

#[test]
fn the_shipped_description_passes() {
    let description = ModelDescription::read().expect("the shipped description");
    assert_eq!(description.model_identifier, "FiveBar");
    assert_eq!(description.variables[0].name.full, "tau[1]");
    assert_eq!(description.variables[0].unit.as_deref(), Some("N.m"));
}

#[test]
fn broken_copies_are_refused_by_name() {
    for (old, new, expected) in [
        (r#"name="tau[2]""#, r#"name="tau[1]""#, "variable tau[1] is defined twice"),
        (r#"name="tau[2]""#, r#"name="tau[3]""#, "tau must count from 1"),
        (r#"name="tau[2]""#, r#"name="tau[2""#, "[ is not closed"),
        (r#"name="Torque""#, r#"name="tip.fx""#, "type tip.fx has the name of a variable"),
        (r#"valueReference="101""#, r#"valueReference="100""#, "variable tau[1]: reference 100 is also that of tau[2]"),
        (r#"valueReference="101""#, r#"valueReference="-1""#, r#"valueReference="-1""#),
        (r#"causality="input""#, r#"causality="inptu""#, r#"causality="inptu" is not one of parameter, input"#),
        (r#"causality="input""#, r#"causality="input" initial="exact""#, "variable tau[1]: causality Input"),
        (r#"variability="continuous""#, r#"variability="fixed""#, "variable tau[1]: causality Input, variability Fixed"),
        (r#"causality="input""#, r#"cuasality="input""#, "attribute cuasality is not one of"),
        (
            r#"<Real declaredType="Torque" start="0"/>"#,
            r#"<Real declaredType="Torque"/>"#,
            "variable tau[1]: a start value is required",
        ),
        (
            r#"<Real declaredType="Angle"/>"#,
            r#"<Real declaredType="Angle" start="0"/>"#,
            "variable theta[1]: a calculated variable",
        ),
        (r#"start="0.42" min="0" max="1e6""#, r#"start="-0.42" min="0""#, "variable base.distance: start -0.42 is below its min"),
        (r#"start="0.42" min="0" max="1e6""#, r#"start="0.42" max="0.4""#, "variable base.distance: start 0.42 is above its max"),
        (
            r#"start="0.42" min="0" max="1e6""#,
            r#"start="NaN" min="0""#,
            "variable base.distance: start, min and max must be finite",
        ),
        (r#"start="0.42" min="0" max="1e6""#, r#"start="0,42" min="0""#, r#"start="0,42" is not a value of its type"#),
        (r#"start="10" min="1" max="100""#, r#"start="10" min="11" max="9""#, "min 11 is larger than max 9"),
        (
            r#"declaredType="Method" start="1""#,
            r#"declaredType="Method" start="9""#,
            "variable solver.method: start 9 is not an item",
        ),
        (
            r#"declaredType="Method" start="1""#,
            r#"declaredType="Torque" start="1""#,
            "variable solver.method: its declaredType is not",
        ),
        (r#"declaredType="Torque""#, r#"declaredType="Toqrue""#, "variable tau[1]: declaredType Toqrue is not defined"),
        (r#"unit="N.m""#, r#"unit="Nm""#, "type Torque: unit Nm is not defined"),
        (r#"unit="rad" displayUnit="deg""#, r#"unit="rad" displayUnit="grad""#, "type Angle: grad is not a display unit of rad"),
        (r#"name="minus" value="2""#, r#"name="minus" value="1""#, "type Assembly must have items, each with its own value"),
        (r#"name="minus" value="2""#, r#"name="plus" value="2""#, "type Assembly: item plus is defined twice"),
        (r#"<Unknown name="theta[2]""#, r#"<Unknown name="thtea[2]""#, "Outputs, entry 6: variable thtea[2], expected theta[2]"),
        (r#"<Unknown name="theta[1]" dependencies="theta[1]"/>"#, "", "Outputs, entry 5: variable theta[2], expected theta[1]"),
        (
            r#"<Unknown name="theta[1]" dependencies="init.theta[1]"/>"#,
            "",
            "InitialUnknowns, entry 5: variable theta[2], expected theta[1]",
        ),
        (
            r#"dependencies="theta[1]""#,
            r#"dependencies="alpha[1]""#,
            "variable theta[1]: dependency alpha[1] is neither an input nor a continuous state",
        ),
        (
            r#"dependencies="init.theta[1]""#,
            r#"dependencies="theta[1]""#,
            "variable theta[1]: dependency theta[1] is neither a parameter nor an input",
        ),
        (r#"dependencies="tau tip.*"#, r#"dependencies="tua tip.*"#, "variable der(omega[1]): dependency tua is neither"),
        (r#"dependencies="tau tip.*"#, r#"dependencies="tau tau[1]"#, "variable der(omega[1]): dependency tau[1] is defined twice"),
        (
            r#"description="Macro steps since the start" causality="local""#,
            r#"description="Macro steps since the start" causality="output""#,
            "variable solver.steps: an output must be a Real",
        ),
        (
            r#"description="Derivative of theta[1]" causality="local""#,
            r#"description="Derivative of theta[1]" causality="output""#,
            "variable der(theta[1]): a derivative must be local",
        ),
        (
            r#"name="der(theta[1])" valueReference="602""#,
            r#"name="der(theta[1])" valueReference="100""#,
            "variable der(theta[1]): reference 100 belongs to tau[1], which is not computed",
        ),
        (
            r#"name="der(theta[1])" v"#,
            r#"name="der(theta[3])" v"#,
            "variable der(theta[3]): the derivative of theta[1] must be named",
        ),
        (
            r#"name="der(theta[1])" valueReference="602""#,
            r#"name="der(theta[1])" valueReference="604""#,
            "variable der(theta[1]): alpha[1] has the same reference and another",
        ),
        (r#"stepSize="0.001""#, "", "<DefaultExperiment> has no attribute stepSize"),
        ("</ModelVariables>", "", "byte"),
    ] {
        let error = broken(old, new);
        assert!(error.contains(expected), "{old} -> {new} gives \"{error}\", expected \"{expected}\"");
    }
}
