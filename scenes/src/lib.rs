//! The scenes, read for programs that link the library: values by the names of variables, and inputs that change with time.
//!
//! What a file may hold is said, and checked with a user's eyes, in `xtask/python/scene.py` and `signals.py`.

mod signal;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use fivebar::fmi::bindings::{self, default_inputs, default_parameters};
use fivebar::simulation::{Inputs, Parameters};
use fivebar::variables::{FmiType, Value, Variable};
use serde_json::{Map, Value as Json};

pub use signal::Signal;

/// A file of `scenes/`.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Its name without the ending.
    pub name: String,
    /// How long it is to be followed, s.
    pub stop_time: f64,
    /// The communication step, s.
    pub step_size: f64,
    /// What it sets.
    pub values: Vec<(&'static Variable, Value)>,
    /// Its inputs that change with time.
    pub signals: Vec<Signal>,
}

/// Keys that are no variables.
const RESERVED: [&str; 4] = ["description", "experiment", "signals", "overlay"];

impl Scene {
    /// The scene of this name.
    pub fn read(name: &str) -> Result<Self> {
        let text = fs::read_to_string(folder().join(name).with_extension("json")).context("it cannot be read");
        text.and_then(|text| Self::parse(name, &text)).with_context(|| format!("scenes/{name}.json"))
    }

    /// All of them, by name.
    pub fn all() -> Result<Vec<Self>> {
        let entries = fs::read_dir(folder()).context("scenes/")?;
        let mut files: Vec<PathBuf> = entries.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
        files.retain(|file| file.extension().is_some_and(|extension| extension == "json"));
        files.sort();
        files.iter().filter_map(|file| file.file_stem()).map(|name| Self::read(&name.to_string_lossy())).collect()
    }

    fn parse(name: &str, text: &str) -> Result<Self> {
        let content: Map<String, Json> = serde_json::from_str(text).context("it is no JSON object")?;
        let experiment = |key: &str| content["experiment"][key].as_f64().with_context(|| format!("experiment.{key} is no number"));
        let own = content.iter().filter(|(key, _)| !RESERVED.contains(&key.as_str()));
        Ok(Self {
            name: name.to_owned(),
            stop_time: experiment("stopTime")?,
            step_size: experiment("stepSize")?,
            values: own.map(|(key, value)| typed(key, value)).collect::<Result<_>>()?,
            signals: content.get("signals").map_or(Ok(Vec::new()), signal::read)?,
        })
    }

    /// Parameters and inputs at the start.
    pub fn start(&self) -> Result<(Parameters, Inputs)> {
        self.with(self.signals_at(0.0))
    }

    /// Parameters, and the inputs of each millisecond up to `end` s as the reference trajectories hold them: signals are the doubles
    /// nearest to what they are where it begins. Without signals there is one entry, for all.
    pub fn held(&self, end: f64) -> Result<(Parameters, Vec<Inputs>)> {
        let last = if self.signals.is_empty() { 1 } else { (1e3 * end).round() as u32 };
        let nearest = |i| self.signals.iter().map(move |signal| (signal.variable, Value::Real(signal.nearest(i))));
        let each = (0..last).map(|i| Ok(self.with(nearest(i))?.1)).collect::<Result<_>>()?;
        Ok((self.with(nearest(0))?.0, each))
    }

    /// What the scene sets, and then `signals`.
    fn with(&self, signals: impl Iterator<Item = (&'static Variable, Value)>) -> Result<(Parameters, Inputs)> {
        let (mut parameters, mut inputs) = (default_parameters(), default_inputs());
        for (variable, value) in self.values.iter().copied().chain(signals) {
            let written = bindings::write(&mut parameters, &mut inputs, variable, value);
            ensure!(written, "scenes/{}.json: {} cannot be set to {value}", self.name, variable.name);
        }
        Ok((parameters, inputs))
    }

    /// The inputs that change, at a time, s.
    pub fn signals_at(&self, time: f64) -> impl Iterator<Item = (&'static Variable, Value)> {
        self.signals.iter().map(move |signal| (signal.variable, Value::Real(signal.at(time))))
    }
}

fn folder() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn named(name: &str) -> Result<&'static Variable> {
    Variable::named(name).with_context(|| format!("there is no variable {name}"))
}

/// A variable with its value; those of enumerations are given by the names of their items.
fn typed(name: &str, value: &Json) -> Result<(&'static Variable, Value)> {
    let variable = named(name)?;
    let typed = match variable.fmi_type() {
        FmiType::Real => value.as_f64().map(Value::Real),
        FmiType::Boolean => value.as_bool().map(Value::Boolean),
        FmiType::Integer if variable.items.is_empty() => value.as_i64().and_then(|n| i32::try_from(n).ok()).map(Value::Integer),
        FmiType::Integer => {
            variable.items.iter().find(|item| value.as_str() == Some(item.name)).map(|item| Value::Integer(item.value))
        }
    };
    Ok((variable, typed.with_context(|| format!("{name} cannot be {value}"))?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_is_what_its_file_says() {
        let scene = Scene::read("stiff_servo").expect("a shipped scene");
        let (parameters, inputs) = scene.start().expect("values");
        assert_eq!((scene.stop_time, scene.step_size), (0.5, 1e-3));
        assert!(parameters.effects.servo.enabled && scene.signals.is_empty());
        assert_eq!((parameters.effects.servo.kp, inputs.servo_theta[0]), ([1e6, 0.0], std::f64::consts::FRAC_PI_2));
        assert_eq!(parameters.geometry, default_parameters().geometry);
    }

    /// All that are shipped can be read, and one with signals starts with their values.
    #[test]
    fn shipped_scenes_are_read() {
        let scenes = Scene::all().expect("shipped scenes");
        assert!(scenes.len() > 10 && scenes.iter().all(|scene| scene.start().is_ok()));
        let moved = scenes.iter().find(|scene| scene.name == "pick_and_place").expect("it has signals");
        assert_eq!((moved.signals.len(), moved.start().expect("values").1.servo_theta), (4, [2.7567, 1.345]));
        let (_, each) = moved.held(0.5).expect("values");
        // The middle of the first way; 0.2 and 0.7 as doubles are round-off away from what is written.
        assert!(each.len() == 500 && (each[450].servo_theta[0] - (2.7567 + 1.7966) / 2.0).abs() < 1e-15);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let refusal = |values: &str| {
            let text = format!(r#"{{"experiment": {{"stopTime": 1, "stepSize": 0.001}}, {values}}}"#);
            format!("{:#}", Scene::parse("odd", &text).expect_err("it is wrong"))
        };
        assert_eq!(refusal(r#""init.assembly": 1"#), "init.assembly cannot be 1");
        assert_eq!(refusal(r#""tau[3]": 0.1"#), "there is no variable tau[3]");
        assert_eq!(refusal(r#""signals": {"tau[1]": {"steps": []}}"#), "signal tau[1]: there is no kind steps");
        let missing = Scene::read("no_such_scene").expect_err("there is none").to_string();
        assert_eq!(missing, "scenes/no_such_scene.json");
    }
}
