//! The measurements write complete tables with plausible errors.

use std::collections::HashMap;
use std::fs;

use accuracy::{COMMUNICATION, Choice, Extent, Folder, Run, Scene, precision};
use hard_cases::Setting;
use scenes::{Causality, Scene as File};

fn judged(title: &str) -> Scene {
    let scenes = Scene::judged(Extent::Quick).expect("scenes with references");
    scenes.into_iter().find(|scene| scene.title() == title).expect(title)
}

/// A row, by column names.
type Row = HashMap<String, String>;

/// The head and the rows of precision.csv for a small sample.
fn measured(scene: Scene) -> (String, Vec<Row>) {
    let folder = tempfile::tempdir().expect("a folder");
    let tables = Folder::new(folder.path().into(), "a\ntest".into()).expect("the folder");
    precision::write(&tables, &[scene], Extent::Quick).expect("measured");
    let text = fs::read_to_string(folder.path().join("precision.csv")).expect("the table");
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_reader(text.as_bytes());
    let rows: Vec<Row> = reader.deserialize().collect::<Result<_, _>>().expect("rows");
    assert_eq!(rows.len(), Choice::all(Extent::Quick).len());
    (text.lines().next().expect("a line").into(), rows)
}

fn number(row: &Row, name: &str) -> f64 {
    row[name].parse().expect("a number")
}

#[test]
fn every_scene_is_judged() {
    let judged = Scene::judged(Extent::Full).expect("scenes with references");
    // References of scenes with tuned parameters are for tests; the report is about steps.
    let is_tuned = |scene: &File| scene.signals.iter().any(|signal| signal.variable.causality != Causality::Input);
    for scene in File::all().expect("shipped scenes").into_iter().filter(|scene| !is_tuned(scene)) {
        assert!(judged.iter().any(|judged| judged.name == scene.name), "{} is not in the table", scene.name);
    }
}

#[test]
fn every_value_of_a_line_is_another_run() {
    let choices = Choice::all(Extent::Full);
    for (i, choice) in choices.iter().enumerate() {
        assert!(choices[..i].iter().all(|other| other.setting != choice.setting), "{choice:?} twice");
    }
    assert!(choices.iter().any(|choice| choice.setting == Setting::Tolerance(3e-9)), "the default tolerance is on its line");
}

/// One row per choice, with the origin at the top; fixed steps of i3alp are of second order.
#[test]
fn tables_are_complete() {
    let (about, rows) = measured(judged("fall_90_120, 1 s"));
    assert_eq!(about, "# a test");
    for row in rows.iter().filter(|row| row["ending"] == "complete") {
        let [best, median, worst] =
            ["best us per simulated ms", "us per simulated ms", "worst us per simulated ms"].map(|n| number(row, n));
        assert!(0.0 < best && best <= median && best <= worst, "{row:?}");
        assert!(number(row, "error [m]") < 1.0 && number(row, "sub-steps") > 0.0, "{row:?}");
    }
    let fixed: Vec<_> = rows.iter().filter(|row| row["method"] == "i3alp, fixed step").collect();
    let [.., coarse, fine] = fixed.as_slice() else { panic!("two steps") };
    let order =
        (number(coarse, "error [m]") / number(fine, "error [m]")).ln() / (number(coarse, "value") / number(fine, "value")).ln();
    assert!((order - 2.0).abs() < 0.1, "order {order}");
}

/// Varying inputs equal the reference's; otherwise no tolerance would help. Steps longer than an input's duration are reported.
#[test]
fn a_driven_scene_follows_its_reference() {
    let scene = judged("pick_and_place, 1.6 s");
    assert_eq!(scene.inputs.len(), 1600);
    assert!(Run::new(&scene.parameters, &scene.inputs, Setting::Rk4(2e-3)).is_err());
    let (_, rows) = measured(scene);
    let (longer, others): (Vec<_>, Vec<_>) =
        rows.iter().partition(|row| row["knob"] == "step" && number(row, "value") > COMMUNICATION);
    for row in &longer {
        assert_eq!(row["ending"], "left out: inputs are held for 1 ms, a longer step would be another motion");
        assert_eq!((&*row["error [m]"], &*row["us per simulated ms"]), ("inf", "NaN"));
    }
    assert_eq!(longer.len(), 4, "4 ms by four methods");
    let [.., finest] = *others.iter().filter(|row| row["method"] == "dop853").collect::<Vec<_>>() else { panic!("dop853") };
    // Three times the observed error at 1e-12 rad.
    assert!(number(finest, "error [m]") < 2e-13, "{finest:?}");
}
