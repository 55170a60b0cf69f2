//! Keys, runs and experiment of a file.

use anyhow::{Context, Result, bail, ensure};
use model_description::Kind;
use serde_json::{Map, Value as Json};

use crate::names::{items, model, settable, similar};
use crate::{Overlay, Scene, Signal, Value, Values, json, signal};

/// Keys of a scene that are not variables.
const RESERVED: [&str; 5] = [SCHEMA, DESCRIPTION, EXPERIMENT, SIGNALS, OVERLAY];

/// The key by which editors find the schema of scenes.
const SCHEMA: &str = "$schema";
const DESCRIPTION: &str = "description";
const EXPERIMENT: &str = "experiment";
const SIGNALS: &str = "signals";
const OVERLAY: &str = "overlay";

/// Key of an overlay that is not a variable.
const LABEL: &str = "label";

impl Scene {
    /// Parses a scene from the text of its file; refuses text that is not a scene.
    pub fn parse(name: &str, text: &str) -> Result<Self> {
        let content = json::read(text).context("it is not valid JSON")?;
        let content = content.as_object().context("a scene must be an object of variable names and values")?;
        let own = content.iter().filter(|(key, _)| !RESERVED.contains(&key.as_str()));
        let values = values(own, &RESERVED)?;
        if content.contains_key(SCHEMA) {
            text_of(SCHEMA, content.get(SCHEMA))?;
        }
        let (stop_time, step_size) = experiment(content.get(EXPERIMENT))?;
        let description = text_of(DESCRIPTION, content.get(DESCRIPTION))?;
        let overlays = overlays(content.get(OVERLAY), &values)?;
        let signals = signal::read(content.get(SIGNALS))?;
        let stop_time = match stop_time {
            Some(given) => given,
            None => end(&signals)?,
        };
        let scene = Self { name: name.to_owned(), description, stop_time, step_size, values, overlays, signals };
        scene.check_labels()?;
        scene.check_signals()?;
        Ok(scene)
    }

    /// Labels of the runs: the method for the scene's own run, then the labels of the overlays.
    pub(crate) fn labels(&self) -> Result<Vec<&str>> {
        let own = method(&self.values)?;
        Ok([own].into_iter().chain(self.overlays.iter().map(|overlay| overlay.label.as_str())).collect())
    }

    fn check_labels(&self) -> Result<()> {
        let labels = self.labels()?;
        for (i, label) in labels.iter().enumerate() {
            ensure!(!labels[..i].contains(label), "two runs have the label '{label}', but labels must differ");
        }
        Ok(())
    }

    fn check_signals(&self) -> Result<()> {
        let mut set = self.overlays.iter().map(|overlay| &overlay.values).chain([&self.values]).flatten();
        match set.find(|(variable, _)| self.signals.iter().any(|signal| signal.variable.reference == variable.reference)) {
            Some((variable, _)) => bail!("'{}' has a signal and a value, but only one of them is allowed", variable.name.full),
            None => Ok(()),
        }
    }
}

fn values<'a>(given: impl Iterator<Item = (&'a String, &'a Json)>, reserved: &[&str]) -> Result<Values> {
    given
        .map(|(name, value)| {
            let variable = settable(name, reserved)?;
            Ok((variable, Value::read(variable, value)?))
        })
        .collect()
}

fn text_of(key: &str, given: Option<&Json>) -> Result<String> {
    let text = given.with_context(|| format!("it has no text '{key}'"))?;
    match text.as_str() {
        Some(words) if words.contains(is_no_text) => bail!("'{key}' must be a text without control characters, not {text}"),
        Some(words) if !words.trim().is_empty() => Ok(words.to_owned()),
        _ => bail!("'{key}' must be a text, not {text}"),
    }
}

/// Whether a line of XML, a table or a page cannot contain the character (XML 1.0, section 2.2).
fn is_no_text(c: char) -> bool {
    c.is_control() || matches!(c, '\u{2028}' | '\u{2029}' | '\u{fffe}' | '\u{ffff}')
}

/// Stop time, s, if it is given, and communication step, s; the default is the step of the model description.
fn experiment(given: Option<&Json>) -> Result<(Option<f64>, f64)> {
    const KEYS: [&str; 2] = ["stopTime", "stepSize"];
    let none = Map::new();
    let given = match given {
        None => &none,
        Some(Json::Object(given)) => given,
        Some(other) => bail!(r#"'{EXPERIMENT}' must be an object such as {{"stopTime": 2, "stepSize": 0.001}}, not {other}"#),
    };
    if let Some(unknown) = given.keys().find(|key| !KEYS.contains(&key.as_str())) {
        bail!("'{EXPERIMENT}' has no key '{unknown}'{}", similar(unknown, KEYS.into_iter()));
    }
    let seconds = |key| match given.get(key) {
        None => Ok(None),
        Some(value) => match value.as_f64().filter(|&seconds| seconds > 0.0) {
            Some(seconds) => Ok(Some(seconds)),
            None => bail!("'{EXPERIMENT}.{key}' must be a positive number of seconds, not {value}"),
        },
    };
    Ok((seconds(KEYS[0])?, seconds(KEYS[1])?.unwrap_or(model()?.experiment.step_size)))
}

/// Stop time, s, of a scene without one: the end of its signals, or else the stop time of the model description.
fn end(signals: &[Signal]) -> Result<f64> {
    let last = signals.iter().map(|signal| signal.end).fold(0.0, f64::max);
    Ok(if last > 0.0 { last } else { model()?.experiment.stop_time })
}

fn overlays(given: Option<&Json>, own: &Values) -> Result<Vec<Overlay>> {
    let given = match given {
        None => return Ok(Vec::new()),
        Some(Json::Array(given)) => given,
        Some(other) => bail!("'{OVERLAY}' must be a list of runs, not {other}"),
    };
    let numbered = given.iter().zip(1..);
    numbered.map(|(item, number)| overlay(item, own).with_context(|| format!("overlay {number}"))).collect()
}

fn overlay(given: &Json, own: &Values) -> Result<Overlay> {
    let Some(given) = given.as_object() else {
        bail!("it must be an object with a '{LABEL}' and the values that replace the scene's, not {given}");
    };
    let label = text_of(LABEL, given.get(LABEL))?;
    let changes = values(given.iter().filter(|(key, _)| *key != LABEL), &[LABEL])?;
    let kept = own.iter().filter(|(variable, _)| changes.iter().all(|(changed, _)| changed.reference != variable.reference));
    let values = kept.chain(&changes).copied().collect();
    Ok(Overlay { label, values })
}

/// Name of the method of a run.
fn method(values: &Values) -> Result<&'static str> {
    let variable = settable("solver.method", &[])?;
    let given = values.iter().find(|(set, _)| set.reference == variable.reference).map(|(_, value)| *value);
    let number = match (given, &variable.kind) {
        (Some(Value::Integer(number)), _) => Some(number),
        (_, Kind::Enumeration { start }) => *start,
        _ => None,
    };
    let item = items(variable)?.iter().find(|item| Some(item.value) == number);
    item.map(|item| item.name.as_str()).context("solver.method has no start value among its items")
}
