//! The unit to be packed: the plain one, or one of one's own, whose start values, experiment and description come from a scene
//! file.

use crate::paths;
use anyhow::{Context, Result, bail, ensure};
use model_description::{Experiment, Kind, ModelDescription, Own, Variable};
use scenes::{Scene, Value};
use std::fs;
use std::path::{Path, PathBuf};

/// Folder of the descriptions of units of one's own while their libraries are built.
const FOLDER: &str = "target/own";

/// A unit, before it is built.
pub(super) struct Unit {
    /// Its model description.
    pub(super) description: ModelDescription,
    /// Scene of a unit of one's own; `None` for the plain unit.
    pub(super) own: Option<OwnScene>,
}

/// The scene of a unit of one's own.
pub(super) struct OwnScene(Scene);

/// A start value of one's own: the variable, as the plain unit has it, and the value.
pub(super) type Start = (&'static Variable, Value);

impl Unit {
    /// The plain one, `FiveBar`.
    pub(super) fn plain() -> Result<Self> {
        Ok(Self { description: plain_description()?, own: None })
    }

    /// Unit of the scene in `file`; called `name`, or after the file.
    pub(super) fn own(file: &Path, name: Option<&str>) -> Result<Self> {
        let scene = read(file)?;
        let plain = plain_description()?;
        let name = name.map_or_else(|| camel(&scene.name), str::to_owned);
        // Names of files differ by more than capitals, or some machines take them for the same.
        ensure!(
            !name.eq_ignore_ascii_case(&plain.model_identifier),
            "the name {name} is that of the plain unit: --name gives this one another"
        );
        let own = Own {
            description: description(&scene),
            experiment: Experiment { stop_time: scene.stop_time, step_size: scene.step_size },
            starts: starts(&scene).map(|(variable, value)| (variable.name.full.clone(), text(value))).collect(),
            name,
        };
        // Values have been checked with the scene: only the name may still be refused.
        let description = plain.own(&own).context("--name gives the unit a name")?;
        Ok(Self { description, own: Some(OwnScene(scene)) })
    }

    /// Name of the library and of the .fmu.
    pub(super) fn name(&self) -> &str {
        &self.description.model_identifier
    }

    /// The file with the text of the description that the library is built with, where that is not the XML itself.
    pub(super) fn own_text(&self) -> Result<Option<PathBuf>> {
        if self.own.is_none() {
            return Ok(None);
        }
        let file = paths::in_root(FOLDER).join(self.name()).with_extension("xml");
        write(&file, &self.description.xml).with_context(|| format!("{} cannot be written", paths::short(&file)))?;
        Ok(Some(file))
    }
}

impl OwnScene {
    /// Every start value that the scene gives, signals with theirs at 0 s.
    pub(super) fn starts(&self) -> impl Iterator<Item = Start> {
        starts(&self.0)
    }

    /// Names and start values as a JSON object: all that `fivebar.start` has to set.
    pub(super) fn start_values(&self) -> String {
        let values: Vec<String> =
            self.starts().map(|(variable, value)| format!("\"{}\": {}", variable.name.full, text(value))).collect();
        format!("{{{}}}", values.join(", "))
    }

    /// Parts of the scene that a unit cannot have, in sentences.
    pub(super) fn left_out(&self) -> Vec<String> {
        let mut sentences = Vec::new();
        if !self.0.signals.is_empty() {
            sentences.push(left_to_the_master(&self.0));
        }
        if !self.0.overlays.is_empty() {
            let labels: Vec<&str> = self.0.overlays.iter().map(|overlay| overlay.label.as_str()).collect();
            sentences.push(format!("The scene's further runs are left out: {}.", labels.join("; ")));
        }
        sentences
    }
}

fn plain_description() -> Result<ModelDescription> {
    ModelDescription::read().context("modelDescription/modelDescription.xml")
}

fn read(file: &Path) -> Result<Scene> {
    let shipped = paths::in_root("scenes").join(file).with_extension("json");
    if !file.exists() && shipped.is_file() {
        bail!("there is no file {}; did you mean {}?", file.display(), paths::short(&shipped));
    }
    Scene::read_file(file)
}

fn starts(scene: &Scene) -> impl Iterator<Item = Start> {
    scene.values.iter().copied().chain(scene.signals_at(0.0))
}

/// As XML writes it.
fn text(value: Value) -> String {
    value.fold(|real| format!("{real:?}"), |integer| integer.to_string(), |boolean| boolean.to_string())
}

/// Whether the plain unit has this start value as well.
pub(super) fn is_plain((variable, value): &Start) -> bool {
    match (&variable.kind, value) {
        (Kind::Real { start, .. }, Value::Real(value)) => *start == Some(*value),
        (Kind::Integer { start, .. } | Kind::Enumeration { start }, Value::Integer(value)) => *start == Some(*value),
        (Kind::Boolean { start }, Value::Boolean(value)) => *start == Some(*value),
        _ => false,
    }
}

fn description(scene: &Scene) -> String {
    if scene.signals.is_empty() {
        return scene.description.clone();
    }
    let end = if scene.description.ends_with(|c: char| c.is_ascii_punctuation()) { "" } else { "." };
    format!("{}{end} {}", scene.description, left_to_the_master(scene))
}

fn left_to_the_master(scene: &Scene) -> String {
    let names: Vec<&str> = scene.signals.iter().map(|signal| signal.variable.name.full.as_str()).collect();
    format!(
        "Inputs that the scene changes with time begin at its values at 0 s and are for the master to change: {}.",
        names.join(", ")
    )
}

/// `pick_and_place` → `PickAndPlace`.
fn camel(stem: &str) -> String {
    let capital = |part: &str| {
        let mut letters = part.chars();
        letters.next().map(|first| first.to_uppercase().chain(letters).collect::<String>()).unwrap_or_default()
    };
    stem.split(|c: char| !c.is_alphanumeric()).map(capital).collect()
}

/// Leaves a file alone that has the text: cargo would build its library anew.
fn write(file: &Path, text: &str) -> Result<()> {
    if fs::read_to_string(file).is_ok_and(|present| present == text) {
        return Ok(());
    }
    fs::create_dir_all(file.parent().context("the text lies in a folder")?)?;
    Ok(fs::write(file, text)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit of the scene with this text in the file `my_machine.json`.
    fn unit(text: &str, name: Option<&str>) -> Result<Unit> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("my_machine.json");
        fs::write(&file, text)?;
        Unit::own(&file, name)
    }

    fn refusal(text: &str, name: Option<&str>) -> String {
        format!("{:#}", unit(text, name).err().expect("a refusal"))
    }

    #[test]
    fn names_are_in_camel_case() {
        for (stem, name) in
            [("pick_and_place", "PickAndPlace"), ("fall_90_120", "Fall90120"), ("my-robot 2", "MyRobot2"), ("myRobot", "MyRobot")]
        {
            assert_eq!(camel(stem), name);
        }
    }

    #[test]
    fn a_scene_becomes_start_values_experiment_and_description() {
        let text = r#"{
            "description": "Turns & falls", "experiment": { "stopTime": 2.5, "stepSize": 0.002 },
            "solver.method": "dop853", "init.assembly": "minus", "servo.enabled": true, "servo.kp[1]": 2,
            "signals": { "servo.theta[1]": { "linear": [[0, 1.25], [1, 2]] } },
            "overlay": [{ "label": "fine", "solver.stepSize": 1e-5 }]
        }"#;
        let unit = unit(text, None).unwrap();
        assert_eq!(unit.name(), "MyMachine");
        let description = &unit.description;
        assert_eq!(description.experiment, Experiment { stop_time: 2.5, step_size: 0.002 });
        assert!(description.description.starts_with("Turns & falls. Inputs that the scene changes with time begin at"));
        for (name, start) in [("solver.method", "4"), ("init.assembly", "2"), ("servo.enabled", "true"), ("servo.theta[1]", "1.25")]
        {
            let line = description.xml.split(&format!("name=\"{name}\"")).nth(1).unwrap();
            assert!(line.split("</ScalarVariable>").next().unwrap().contains(&format!("start=\"{start}\"")), "{name}");
        }
        let own = unit.own.as_ref().unwrap();
        let values = own.start_values();
        assert!(values.starts_with(r#"{"solver.method": 4, "#) && values.ends_with(r#", "servo.theta[1]": 1.25}"#), "{values}");
        assert_eq!(own.starts().filter(|start| !is_plain(start)).count(), 4, "servo.kp[1] is what it is anyway");
        assert!(own.left_out()[0].ends_with("for the master to change: servo.theta[1]."));
        assert_eq!(own.left_out()[1], "The scene's further runs are left out: fine.");
    }

    #[test]
    fn what_is_wrong_is_one_sentence() {
        let scene = r#"{ "description": "x" }"#;
        assert_eq!(refusal(scene, Some("fivebar")), "the name fivebar is that of the plain unit: --name gives this one another");
        assert!(refusal(scene, Some("my machine")).contains("the name \"my machine\" is not allowed"));
        assert!(refusal(scene, Some("aux")).contains("the name \"aux\" is not allowed: Windows has a device of that name"));
        assert!(refusal(r#"{ "description": "x", "tau[3]": 1 }"#, None).contains("there is no variable 'tau[3]'"));
        assert!(refusal(r#"{ "description": "x", "link[1].mass": 0 }"#, None).contains("'link[1].mass' must be a number in kg"));
        let missing = format!("{:#}", Unit::own(Path::new("pick_and_place"), None).err().unwrap());
        assert_eq!(missing, "there is no file pick_and_place; did you mean scenes/pick_and_place.json?");
    }
}
