//! The description of a unit with a name, experiment and start values of its own; everything else stays.

use std::collections::BTreeMap;

use quick_xml::escape::escape;
use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, Writer};

use crate::Error;
use crate::data::{Experiment, ModelDescription};
use crate::edit::{replace, value, write};

/// Name, experiment and start values of a unit made from a scene.
#[derive(Clone, Debug)]
pub struct Own {
    /// Name of the model, the library and the .fmu: an identifier of C.
    pub name: String,
    /// Description of the model, one sentence.
    pub description: String,
    /// Default experiment.
    pub experiment: Experiment,
    /// Start values as the XML writes them, by the names of variables.
    pub starts: BTreeMap<String, String>,
}

impl ModelDescription {
    /// The model with another name, experiment and start values, checked again.
    pub fn own(&self, own: &Own) -> Result<Self, Error> {
        check_name(&own.name)?;
        for name in own.starts.keys() {
            if !self.variables.iter().any(|variable| variable.name.full == *name && variable.kind.has_start()) {
                return Err(Error(format!("variable {name} is none that has a start value")));
            }
        }
        Self::parse(&self.rewritten(own))
    }

    fn rewritten(&self, own: &Own) -> String {
        const CHECKED: &str = "parse() has read the same text before";
        let mut reader = Reader::from_str(&self.xml);
        let mut writer = Writer::new(Vec::new());
        let mut start = None;
        loop {
            let event = match reader.read_event().expect(CHECKED) {
                Event::Eof => break,
                Event::Start(element) => Event::Start(match element.name().0 {
                    "fmiModelDescription" => with(&with(&element, "modelName", &own.name), "description", &own.description),
                    "ScalarVariable" => {
                        start = value(&element, "name").and_then(|name| own.starts.get(&name));
                        element
                    }
                    _ => element,
                }),
                Event::Empty(element) => Event::Empty(match (element.name().0, start.take()) {
                    ("CoSimulation" | "ModelExchange", _) => with(&element, "modelIdentifier", &own.name),
                    ("DefaultExperiment", _) => {
                        let stop = with(&element, "stopTime", &format!("{:?}", own.experiment.stop_time));
                        with(&stop, "stepSize", &format!("{:?}", own.experiment.step_size))
                    }
                    (_, Some(start)) => with(&element, "start", start),
                    (_, None) => element,
                }),
                other => other,
            };
            write(&mut writer, event);
        }
        String::from_utf8(writer.into_inner()).expect("the source is UTF-8")
    }
}

/// The element with another value of one attribute.
fn with(element: &BytesStart<'_>, name: &str, new: &str) -> BytesStart<'static> {
    replace(element, name, &escape(new))
}

/// FMI 2.0.4, section 2.2.1: modelIdentifier is an identifier of C, because it is the name of files and the beginning of functions.
fn check_name(name: &str) -> Result<(), Error> {
    let mut letters = name.chars();
    let starts_well = letters.next().is_some_and(|c| c.is_ascii_alphabetic() || c == '_');
    if starts_well && letters.all(|c| c.is_ascii_alphanumeric() || c == '_') {
        if is_device(name) {
            return Err(Error(format!("the name \"{name}\" is not allowed: Windows has a device of that name and no files")));
        }
        return Ok(());
    }
    Err(Error(format!("the name \"{name}\" is not allowed: it must be a letter or _ followed by letters, digits or _")))
}

/// Names that no file of Windows can have, with any ending (Microsoft, *Naming Files, Paths, and Namespaces*).
fn is_device(name: &str) -> bool {
    let name = name.to_ascii_uppercase();
    let numbered = |device: &str| matches!(name.strip_prefix(device).map(str::as_bytes), Some([b'0'..=b'9']));
    matches!(name.as_str(), "CON" | "PRN" | "AUX" | "NUL") || numbered("COM") || numbered("LPT")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Kind;

    fn own(starts: &[(&str, &str)]) -> Own {
        Own {
            name: "MyMachine".into(),
            description: "Links of \"10 & 12 cm\" < 1 m".into(),
            experiment: Experiment { stop_time: 2.0, step_size: 1e-4 },
            starts: starts.iter().map(|(name, start)| (name.to_string(), start.to_string())).collect(),
        }
    }

    fn plain() -> ModelDescription {
        ModelDescription::read().expect("the shipped description")
    }

    #[test]
    fn what_is_one_s_own_differs_and_nothing_else() {
        let plain = plain();
        let starts = [("init.theta[2]", "-2.5e-3"), ("solver.method", "4"), ("gravity.enabled", "false"), ("tau[1]", "0.25")];
        let mine = plain.own(&own(&starts)).expect("a description");
        assert_eq!((mine.model_name.as_str(), mine.model_identifier.as_str()), ("MyMachine", "MyMachine"));
        assert_eq!(mine.description, own(&[]).description);
        assert_eq!(mine.experiment, Experiment { stop_time: 2.0, step_size: 1e-4 });
        assert_ne!(mine.guid(), plain.guid());
        for (mine, plain) in mine.variables.iter().zip(&plain.variables) {
            let expected = match plain.name.full.as_str() {
                "init.theta[2]" => Kind::Real { start: Some(-2.5e-3), bounds: crate::Bounds { min: Some(-1e5), max: Some(1e5) } },
                "solver.method" => Kind::Enumeration { start: Some(4) },
                "gravity.enabled" => Kind::Boolean { start: Some(false) },
                "tau[1]" => Kind::Real { start: Some(0.25), bounds: crate::Bounds { min: None, max: None } },
                _ => plain.kind.clone(),
            };
            assert_eq!(mine.kind, expected, "{}", plain.name.full);
            assert_eq!((&mine.name, mine.reference, mine.causality), (&plain.name, plain.reference, plain.causality));
        }
        // Lines without name, experiment or start values are unchanged.
        let same = mine.xml.lines().zip(plain.xml.lines()).filter(|(mine, plain)| mine == plain).count();
        assert_eq!(plain.xml.lines().count() - same, 9);
    }

    #[test]
    fn what_cannot_be_is_refused() {
        for (starts, expected) in [
            (("tau[3]", "1"), "variable tau[3] is none that has a start value"),
            (("tip.x", "1"), "variable tip.x is none that has a start value"),
            (("link[1].mass", "-1"), "variable link[1].mass: start -1 is below its min"),
            (("solver.method", "9"), "variable solver.method: start 9 is not an item"),
        ] {
            let error = plain().own(&own(&[starts])).expect_err(expected).0;
            assert!(error.contains(expected), "{error}");
        }
        for name in ["", "2bars", "my machine", "führung", "a-b", "a/b", "CON", "Aux", "com1", "LPT9"] {
            let error = plain().own(&Own { name: name.into(), ..own(&[]) }).expect_err(name).0;
            assert!(error.contains(&format!("\"{name}\"")), "{error}");
        }
        for name in ["Console", "COM", "com10", "NULL"] {
            assert!(plain().own(&Own { name: name.into(), ..own(&[]) }).is_ok(), "{name}");
        }
    }
}
