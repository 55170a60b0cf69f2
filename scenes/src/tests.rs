//! Values as they are read, and sentences of refusals.

use std::collections::BTreeSet;
use std::fs;

use model_description::Kind;
use serde_json::{Value as Json, json};

use crate::{Scene, Value, Values, names};

/// Parses a scene with this content, a JSON object, and a description.
fn parse(content: Json) -> anyhow::Result<Scene> {
    let mut content = content;
    content.as_object_mut().expect("an object").entry("description").or_insert_with(|| "trial".into());
    Scene::parse("trial", &content.to_string())
}

fn named(values: &Values) -> Vec<(&str, Value)> {
    values.iter().map(|(variable, value)| (variable.name.full.as_str(), *value)).collect()
}

#[test]
fn shipped_scenes_say_only_what_differs() {
    let scenes = Scene::all().expect("shipped scenes");
    assert!(scenes.len() > 10);
    for scene in scenes {
        for (variable, value) in &scene.values {
            let start = match variable.kind {
                Kind::Real { start, .. } => start.map(Value::Real),
                Kind::Integer { start, .. } | Kind::Enumeration { start } => start.map(Value::Integer),
                Kind::Boolean { start } => start.map(Value::Boolean),
            };
            // A scene without a method runs by `automatic`, not by the default of the unit.
            let decides = variable.name.full == "solver.method";
            assert!(decides || start != Some(*value), "{}: {} has this value anyway", scene.name, variable.name.full);
        }
    }
}

/// The double nearest to the decimal number, as any other reader finds it; without `float_roundtrip` it would be a neighbour.
#[test]
fn numbers_are_read_to_the_last_bit() {
    let scene = Scene::read("singular_crossing").expect("a shipped scene");
    assert!(named(&scene.values).contains(&("init.theta[1]", Value::Real("-1.7844905137348799".parse().expect("a number")))));
    assert!(scene.resolved().expect("a file").to_string().contains(":-1.7844905137348799,"));
}

#[test]
fn the_paper_s_scenes_are_there() {
    for name in ["paper_free_fall", "paper_torque", "paper_torque_gravity"] {
        assert!(Scene::read(name).is_ok_and(|scene| scene.stop_time > 2.0 && scene.step_size == 1e-3), "{name}");
    }
}

/// docs/scenes.md lists every scene with its effects, and its example is a valid scene.
#[test]
fn docs_list_every_scene_with_its_effects() {
    let docs = fs::read_to_string(crate::folder().join("../docs/scenes.md")).expect("docs/scenes.md");
    let variables = &names::model().expect("the model description").variables;
    let active = |scene: &Scene| -> Vec<&str> {
        let switches = variables.iter().filter_map(|variable| {
            let effect = variable.name.full.strip_suffix(".enabled")?;
            let set = scene.values.iter().find(|(set, _)| set.reference == variable.reference).map(|(_, value)| *value);
            (set.unwrap_or(Value::Boolean(variable.kind == Kind::Boolean { start: Some(true) })) == Value::Boolean(true))
                .then_some(effect)
        });
        switches.collect()
    };
    let mut rows: BTreeSet<(String, String)> = docs.lines().filter_map(row).collect();
    for scene in Scene::all().expect("shipped scenes") {
        let active = active(&scene);
        let effects = if active.is_empty() { "none".into() } else { active.join(", ") };
        assert!(rows.remove(&(scene.name.clone(), effects.clone())), "docs/scenes.md has no row for {} with {effects}", scene.name);
    }
    assert!(rows.is_empty(), "no scenes: {rows:?}");
    let (_, example) = docs.split_once("```json\n").expect("an example");
    let scene = Scene::parse("example", example.split("```").next().expect("its end")).expect("a scene");
    assert_eq!(scene.signals.len(), 2);
}

/// Name and effects of a row such as "| [`swing`](../scenes/swing.json) | a swing | gravity |".
fn row(line: &str) -> Option<(String, String)> {
    let cells: Vec<&str> = line.strip_prefix("| [`")?.strip_suffix(" |")?.split(" | ").collect();
    Some((cells[0].split('`').next()?.to_owned(), (*cells.get(2)?).to_owned()))
}

/// Tip coordinates need inverse kinematics, and encoder offsets need a source of samples: only the Python package has them.
#[test]
fn scenes_in_the_tip_s_coordinates_or_with_mounting_angles_are_the_package_s() {
    let knots = json!({ "linear": [[0, 0], [1, 1]] });
    for (content, what) in [
        (json!({ "tip.x": 0.1, "tip.y": 0.2 }), "'tip.x' is in the tip's coordinates"),
        (json!({ "signals": { "tip.x": knots, "tip.y": knots } }), "'tip.x' is in the tip's coordinates"),
        (json!({ "encoder.offset[2]": 1e-3 }), "'encoder.offset[2]' is of an encoder"),
    ] {
        let error = format!("{:#}", parse(content).expect_err("not read"));
        assert!(error.ends_with(&format!("{what}, which the Python package fivebar reads and this reader does not")), "{error}");
    }
}

#[test]
fn values_and_overlays_are_typed() {
    let scene = parse(json!({
        "$schema": "fivebar.schema.json",
        "experiment": { "stopTime": 2 },
        "tau[1]": 1,
        "gravity.enabled": false,
        "solver.maxIterations": 20,
        "overlay": [{ "label": "fine", "solver.method": "rk4", "tau[1]": 0.5 }],
    }))
    .expect("a scene");
    assert_eq!((scene.name.as_str(), scene.stop_time, scene.step_size), ("trial", 2.0, 1e-3));
    let own =
        [("tau[1]", Value::Real(1.0)), ("gravity.enabled", Value::Boolean(false)), ("solver.maxIterations", Value::Integer(20))];
    assert_eq!(named(&scene.values), own);
    assert_eq!(scene.overlays[0].label, "fine");
    let changed = [("solver.method", Value::Integer(3)), ("tau[1]", Value::Real(0.5))];
    assert_eq!(named(&scene.overlays[0].values), [&own[1..], &changed].concat());
}

#[test]
fn a_scene_without_a_stop_time_ends_with_its_signals() {
    let stop = |signals| parse(json!({ "signals": signals })).expect("a scene").stop_time;
    let unit = stop(json!({}));
    assert_eq!(stop(json!({ "tau[1]": { "linear": [[0, 0], [0.7, 1]] }, "tau[2]": { "steps": [[0, 0], [1.3, 1]] } })), 1.3);
    assert_eq!(stop(json!({ "tau[1]": { "linear": [[-2, 0], [-1, 1]] } })), unit);
    assert_eq!(unit, 50.0);
}

#[test]
fn a_resolved_scene_has_nothing_left_to_look_up() {
    let scene = parse(json!({
        "experiment": { "stopTime": 0.25, "stepSize": 0.1 },
        "init.assembly": "minus",
        "overlay": [{ "label": "fine", "solver.method": "rk4" }],
        "signals": { "tau[1]": { "linear": [[0, 0], [1, 2]] } },
    }));
    let expected = json!({
        "name": "trial",
        "description": "trial",
        "stopTime": 0.25,
        "stepSize": 0.1,
        "variants": [
            { "label": "i3alp", "values": { "init.assembly": 2 } },
            { "label": "fine", "values": { "init.assembly": 2, "solver.method": 3 } },
        ],
        "signals": { "tau[1]": [0.0, 0.2, 0.4, 0.5] },
    });
    assert_eq!(scene.expect("a scene").resolved().expect("a file"), expected);
}

/// Content, and words of the sentence that refuses it.
#[test]
fn errors_are_named() {
    let knots = json!([[0, 0], [1, 1]]);
    let signals = |signals: Json| json!({ "signals": signals });
    for (content, words) in [
        (json!({ "gravity.enable": false }), ["gravity.enable", "did you mean 'gravity.enabled'"].as_slice()),
        (json!({ "descripton": "x" }), &["descripton", "'description'"]),
        (json!({ "zzz": 1 }), &["'zzz'", "known are tau[1]"]),
        (json!({ "tau[3]": 0.1 }), &["there is no variable 'tau[3]'", "'tau[1]'"]),
        (json!({ "tip.vx": 0.1 }), &["'tip.vx' is computed by the FMU and cannot be set"]),
        (json!({ "solver.method": "euler" }), &["solver.method", "one of i3alp, i3alpPrinted, rk4, dop853", "not \"euler\""]),
        (json!({ "solver.method": 3 }), &["solver.method", "one of i3alp", "not 3"]),
        (json!({ "tau[1]": "much" }), &["'tau[1]' must be a number in N.m, not \"much\""]),
        (json!({ "tau[1]": true }), &["tau[1]", "not true"]),
        (json!({ "base.distance": -1 }), &["'base.distance' must be a number in m from 0 to", "not -1"]),
        (json!({ "gravity.enabled": 1 }), &["'gravity.enabled' must be true or false, not 1"]),
        (json!({ "solver.maxIterations": 1.5 }), &["'solver.maxIterations' must be a whole number from 1 to 100, not 1.5"]),
        (json!({ "solver.maxIterations": 101 }), &["from 1 to 100, not 101"]),
        (json!({ "experiment": { "stoptime": 1 } }), &["stoptime", "did you mean 'stopTime'"]),
        (json!({ "experiment": { "stopTime": -1 } }), &["experiment.stopTime", "positive number of seconds, not -1"]),
        (json!({ "experiment": { "stepSize": "1 ms" } }), &["experiment.stepSize", "1 ms"]),
        (json!({ "experiment": 5 }), &["'experiment' must be an object", "not 5"]),
        (json!({ "overlay": {} }), &["'overlay' must be a list", "not {}"]),
        (json!({ "overlay": [{ "tau[1]": 1 }] }), &["overlay 1: it has no text 'label'"]),
        (json!({ "overlay": [{ "label": " " }] }), &["overlay 1: 'label' must be a text"]),
        (json!({ "overlay": [3] }), &["overlay 1: it must be an object", "not 3"]),
        (json!({ "overlay": [{ "label": "a", "tau[3]": 1 }] }), &["overlay 1: ", "'tau[3]'", "'tau[1]'"]),
        (json!({ "overlay": [{ "label": "a" }, { "label": "a" }] }), &["two runs have the label 'a'"]),
        (json!({ "overlay": [{ "label": "i3alp" }] }), &["two runs have the label 'i3alp'"]),
        (json!({ "$schema": 5 }), &["'$schema' must be a text, not 5"]),
        (json!({ "description": 5 }), &["'description' must be a text, not 5"]),
        (signals(json!([])), &["'signals' must be an object", "not []"]),
        (
            signals(json!({ "servo.thta[1]": { "linear": knots } })),
            &["servo.thta[1]", "not an input", "did you mean 'servo.theta[1]'"],
        ),
        (
            signals(json!({ "gravity.g": { "linear": knots } })),
            &["'gravity.g' is a tunable parameter: if it is Real, it takes 'steps'"],
        ),
        (
            signals(json!({ "gravity.enabled": { "steps": knots } })),
            &["'gravity.enabled' is a fixed parameter: it keeps its start value"],
        ),
        (signals(json!({ "tau[1]": 5 })), &["signal 'tau[1]'", "one of linear, minimumJerk, rateOf, steps, not 5"]),
        (signals(json!({ "tau[1]": { "cubic": knots } })), &["one of linear, minimumJerk, rateOf, steps", "cubic"]),
        (signals(json!({ "tau[1]": { "linear": [[0, 0]] } })), &["signal 'tau[1]'", "two or more knots [time in s, value]"]),
        (signals(json!({ "tau[1]": { "linear": [[0, 0], [1, "a"]] } })), &["knots", "\"a\""]),
        (signals(json!({ "tau[1]": { "linear": [[0, 0], [1, 2, 3]] } })), &["knots", "[1,2,3]"]),
        (signals(json!({ "tau[1]": { "linear": [[0, 0], [1, 1], [1, 2]] } })), &["times must increase, but 1 s follows 1 s"]),
        (signals(json!({ "servo.omega[1]": { "rateOf": "servo.theta[1]" } })), &["'rateOf' must name", "rad/s", "servo.theta[1]"]),
        (
            signals(json!({ "tau[1]": { "rateOf": "servo.theta[1]" }, "servo.theta[1]": { "linear": knots } })),
            &["signal 'tau[1]'", "whose rate has the unit N.m, not \"servo.theta[1]\""],
        ),
        (
            signals(json!({ "servo.theta[1]": { "rateOf": "servo.theta[1]" } })),
            &["signal 'servo.theta[1]': 'rateOf' must name a signal with knots", "not \"servo.theta[1]\""],
        ),
        (
            signals(json!({ "servo.theta[1]": { "rateOf": "servo.omega[1]" }, "servo.omega[1]": { "rateOf": "servo.theta[1]" } })),
            &["'rateOf' must name a signal with knots", "not \"servo."],
        ),
        (json!({ "description": "two\nlines" }), &["'description' must be a text without control characters, not \"two\\nlines\""]),
        (json!({ "description": "a\u{1}b" }), &["'description' must be a text without control characters", "\\u0001"]),
        (json!({ "description": "a\u{ffff}b" }), &["'description' must be a text without control characters"]),
        (json!({ "overlay": [{ "label": "a\u{7f}" }] }), &["overlay 1: 'label' must be a text without control characters"]),
        (
            json!({ "solver.maxWork": 99_999_999_999_999_u64 }),
            &["'solver.maxWork' must be a whole number from 0 to 2147483647, not 99999"],
        ),
        (json!({ "tau[1]": [[[[[[[[1]]]]]]]] }), &["it is not valid JSON: more than 8 brackets are nested at line 1 column"]),
        (signals(json!({ "servo.omega[1]": { "rateOf": 3 } })), &["'rateOf' must name", "not 3"]),
        (json!({ "tau[2]": 1, "signals": { "tau[2]": { "linear": knots } } }), &["'tau[2]' has a signal and a value"]),
        (
            json!({ "overlay": [{ "label": "a", "tau[2]": 1 }], "signals": { "tau[2]": { "linear": knots } } }),
            &["'tau[2]' has a signal and a value"],
        ),
    ] {
        let sentence = format!("{:#}", parse(content.clone()).expect_err(&content.to_string()));
        assert!(words.iter().all(|word| sentence.contains(word)) && !sentence.contains('\n'), "{content}: {sentence}");
    }
}

#[test]
fn other_content_than_scenes_is_named() {
    let refusal = |text: &str| format!("{:#}", Scene::parse("odd", text).expect_err(text));
    assert_eq!(refusal("[]"), "a scene must be an object of variable names and values");
    assert_eq!(refusal("{}"), "it has no text 'description'");
    assert_eq!(refusal(r#"{"tau[1]": }"#), "it is not valid JSON: expected value at line 1 column 12");
    let deep = format!(r#"{{"signals": {}}}"#, "[".repeat(200_000));
    assert_eq!(refusal(&deep), "it is not valid JSON: more than 8 brackets are nested at line 1 column 20");
    assert_eq!(refusal(r#"{"tau[1]": NaN}"#), "it is not valid JSON: expected value at line 1 column 12");
    assert_eq!(refusal(r#"{"tau[1]": 1, "tau[1]": 2}"#), "it is not valid JSON: 'tau[1]' is given twice at line 1 column 26");
    let missing = format!("{:#}", Scene::read("no_such_scene").expect_err("there is none"));
    assert!(missing.starts_with("scenes/no_such_scene.json: it cannot be read: "), "{missing}");
}
