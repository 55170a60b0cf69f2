//! The measurements measure what they say.

use std::collections::HashMap;
use std::fs;

use accuracy::{Choice, Extent, Folder, Scene, precision};
use hard_cases::Setting;

fn fall() -> Scene {
    let scenes = Scene::judged(Extent::Quick).expect("scenes with references");
    scenes.into_iter().find(|scene| scene.title() == "fall_90_120, 1 s").expect("the fall")
}

#[test]
fn every_value_of_a_line_is_another_run() {
    let choices = Choice::all(Extent::Full);
    for (i, choice) in choices.iter().enumerate() {
        assert!(choices[..i].iter().all(|other| other.setting != choice.setting), "{choice:?} twice");
    }
    assert!(choices.iter().any(|choice| choice.setting == Setting::Tolerance(3e-9)), "the default tolerance is on its line");
}

/// The tables of a small sample: one row per scene and choice, with the origin on top; i3alp at fixed step is of second order.
#[test]
fn tables_are_complete() {
    let (folder, scenes) = (tempfile::tempdir().expect("a folder"), [fall()]);
    let tables = Folder::new(folder.path().into(), "a\ntest".into()).expect("the folder");
    precision::write(&tables, &scenes, Extent::Quick).expect("measured");
    let text = fs::read_to_string(folder.path().join("precision.csv")).expect("the table");
    assert!(text.starts_with("# a test\n"), "{}", &text[..40]);
    let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_reader(text.as_bytes());
    let rows: Vec<HashMap<String, String>> = reader.deserialize().collect::<Result<_, _>>().expect("rows");
    assert_eq!(rows.len(), Choice::all(Extent::Quick).len());
    let number = |row: &HashMap<String, String>, name: &str| row[name].parse::<f64>().expect("a number");
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
