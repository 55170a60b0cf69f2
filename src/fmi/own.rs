//! A unit of one's own: this library under another name and GUID, with start values that it reads when it is instantiated.
//!
//! The values are in `resources/unit.txt` of the unpacked .fmu, which `python/src/fivebar/own_unit.py` writes:
//!
//! ```text
//! unit MyMachine {GUID in the model description of the .fmu} {GUID of the plain unit}
//! base.distance 0.1
//! end
//! ```
//!
//! Each value must pass the checks of values set by a master. The plain unit, with the GUID [`GUID`], has no such file and does not look
//! for one.

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};

use super::location::folders;
use super::values::{check_settable, check_value};
use super::{CallError, Stage};
use crate::variables::{FmiType, GUID, Value, Variable};

/// Name of the file in the resources folder.
const FILE: &str = "unit.txt";

/// Form of the file.
const FORM: &str = "there must be a line \"unit NAME GUID LIBRARY\", lines \"VARIABLE VALUE\", and a line \"end\"";

/// Largest file that is read, bytes: three times as large as a file that sets every variable.
const LARGEST: u64 = 64 * 1024;

/// GUID of a unit, as text in braces.
pub type Guid = [u8; GUID.len()];

/// GUID and start values of the instances of a unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    pub(super) guid: Guid,
    /// Start values that replace the values in the XML.
    pub(super) starts: Vec<(&'static Variable, Value)>,
}

impl Unit {
    /// The plain unit, with the start values of the XML.
    pub fn plain() -> Self {
        let Ok(guid) = GUID.as_bytes().try_into() else { unreachable!("the length is that of GUID") };
        Self { guid, starts: Vec::new() }
    }

    /// Finds the unit with this GUID: the plain one, or a unit with a file of start values. The file is looked for in the `resources` that
    /// the master names, then in the archive that contains the `library`.
    ///
    /// # Errors
    /// Refused if no file is found, or if the file found cannot be read, belongs to another unit or library, or has a value that is not
    /// allowed.
    pub fn find(guid: &str, resources: Option<&[u8]>, library: impl FnOnce() -> Option<PathBuf>) -> Result<Self, CallError> {
        if guid == GUID {
            return Ok(Self::plain());
        }
        let mut places = resources.map(|location| folders(location, cfg!(windows))).unwrap_or_default();
        places.extend(library().as_deref().and_then(resources_of));
        let mut files: Vec<PathBuf> = places.iter().map(|folder| folder.join(FILE)).collect();
        files.dedup();
        for file in &files {
            let refused = |why: String| CallError::error(format!("{}: {why}.", file.display()));
            match read(file) {
                Ok(text) => return Self::parse(&text, guid).map_err(refused),
                Err(error) if leads_nowhere(&error) => {}
                Err(error) => return Err(refused(format!("start values cannot be read: {error}"))),
            }
        }
        let files: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
        let places =
            if files.is_empty() { "and no folder of resources is known".to_owned() } else { format!("at {}", files.join(", ")) };
        Err(CallError::error(format!(
            "fmuGUID is {guid}, this library belongs to {GUID}; start values of another unit were looked for, {places}."
        )))
    }

    /// Parses the file of the unit with the GUID `wanted`. Refuses text of another form, of another unit or library, or with a value that
    /// is not allowed.
    fn parse(text: &str, wanted: &str) -> Result<Self, String> {
        let mut lines = text.lines().map(|line| line.split(' ').collect::<Vec<_>>());
        let head = lines.next();
        let Some(["unit", name, guid, library]) = head.as_deref() else { return Err(FORM.to_owned()) };
        if *guid != wanted {
            return Err(format!("fmuGUID is {wanted}, these start values belong to the unit {name} with {guid}"));
        }
        if *library != GUID {
            return Err(format!("the unit {name} was made for the library {library}, this library is {GUID}: make the unit again"));
        }
        let guid = guid.as_bytes().try_into().map_err(|_| format!("guid = \"{guid}\" must be a UUID in braces"))?;
        let mut unit = Self { guid, starts: Vec::new() };
        loop {
            match lines.next().as_deref() {
                Some([name, value]) => unit.add(name, value)?,
                Some(["end"]) if lines.next().is_none() => return Ok(unit),
                _ => return Err(FORM.to_owned()),
            }
        }
    }

    /// Adds the start value of one line. Refuses unknown variables, values that the variable does not allow, and a second value.
    fn add(&mut self, name: &str, text: &str) -> Result<(), String> {
        let variable = Variable::named(name).ok_or_else(|| format!("there is no variable {name}"))?;
        let value = match variable.fmi_type() {
            FmiType::Real => text.parse().ok().map(Value::Real),
            FmiType::Integer => text.parse().ok().map(Value::Integer),
            FmiType::Boolean => text.parse().ok().map(Value::Boolean),
        };
        let value =
            value.ok_or_else(|| format!("{name} = \"{text}\" is not allowed: it must be of type {}", variable.type_name()))?;
        let checked = check_settable(variable, Stage::Instantiated).and_then(|()| check_value(variable, value));
        checked.map_err(|refusal| refusal.message.trim_end_matches('.').to_owned())?;
        if self.starts.iter().any(|(other, _)| *other == variable) {
            return Err(format!("{name} has two start values, it must have one"));
        }
        self.starts.push((variable, value));
        Ok(())
    }
}

/// Resources folder of the archive that contains a library: `binaries/PLATFORM/NAME.so` → `resources`.
fn resources_of(library: &Path) -> Option<PathBuf> {
    library.ancestors().nth(3).map(|root| root.join("resources"))
}

/// Text of a file of bounded size. Refuses devices and folders: opening or reading them may block or never end.
fn read(file: &Path) -> io::Result<String> {
    if !file.metadata()?.is_file() {
        return Err(io::Error::other("it is no file"));
    }
    let mut text = String::new();
    let size = File::open(file)?.take(LARGEST + 1).read_to_string(&mut text)?;
    if size as u64 > LARGEST {
        return Err(io::Error::other(format!("it must have at most {LARGEST} bytes")));
    }
    Ok(text)
}

/// Whether the file does not exist, so that the next place is tried.
fn leads_nowhere(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::InvalidFilename | ErrorKind::InvalidInput)
}

#[cfg(test)]
mod tests {
    use super::*;

    const OTHER: &str = "{00000000-0000-5000-8000-000000000000}";

    fn head() -> String {
        format!("unit My {OTHER} {GUID}\n")
    }

    /// A file with these start values.
    fn with(starts: &str) -> Result<Unit, String> {
        Unit::parse(&format!("{}{starts}end\n", head()), OTHER)
    }

    #[test]
    fn values_of_every_type_are_read() {
        let unit = with(
            "base.distance 1e-1\nsolver.maxIterations 20\nsolver.method 4\ngravity.enabled false\npayload.enabled true\r\ntau[1] -0.25\n",
        );
        let starts: Vec<(&str, Value)> =
            unit.expect("a unit").starts.into_iter().map(|(variable, value)| (variable.name, value)).collect();
        let expected = [
            ("base.distance", Value::Real(0.1)),
            ("solver.maxIterations", Value::Integer(20)),
            ("solver.method", Value::Integer(4)),
            ("gravity.enabled", Value::Boolean(false)),
            ("payload.enabled", Value::Boolean(true)),
            ("tau[1]", Value::Real(-0.25)),
        ];
        assert_eq!(starts, expected);
        assert_eq!(with("").expect("a unit with the start values of the XML").starts, []);
    }

    #[test]
    fn a_value_is_checked_as_one_that_is_set() {
        for (line, why) in [
            ("base.distance -1", "base.distance = -1.0 m is not allowed: it must be at least 0 m"),
            ("base.distance inf", "base.distance = inf m is not allowed: it must be finite"),
            ("base.distance wide", "base.distance = \"wide\" is not allowed: it must be of type Real"),
            ("solver.method 99", "solver.method = 99 is not allowed: it must be one of 1 (i3alp)"),
            ("solver.method dop853", "solver.method = \"dop853\" is not allowed: it must be of type Enumeration"),
            ("gravity.enabled 1", "gravity.enabled = \"1\" is not allowed: it must be of type Boolean"),
            ("solver.maxIterations 2.5", "solver.maxIterations = \"2.5\" is not allowed: it must be of type Integer"),
            ("tip.x 0", "tip.x is computed and cannot be set"),
            ("der(theta[1]) 0", "there is no variable der(theta[1])"),
            ("tau[3] 0", "there is no variable tau[3]"),
        ] {
            let refusal = with(&format!("{line}\n")).expect_err(why);
            assert!(refusal.starts_with(why), "{refusal}");
        }
    }

    #[test]
    fn other_files_are_refused() {
        let head = head();
        for (text, why) in [
            ("".to_owned(), FORM),
            ("unit".to_owned(), FORM),
            (head.clone(), FORM),
            (format!("{head}tau[1] 1\n"), FORM),
            (format!("{head}tau[1] 1\nend\nend\n"), FORM),
            (format!("{head}{head}end\n"), FORM),
            (format!("{head}\nend\n"), FORM),
            (format!("{head}end\ntau[1] 1\n"), FORM),
            (format!("{head}tau[1] 1 N\nend\n"), FORM),
            (format!("{head}tau[1]  1\nend\n"), FORM),
            (format!("{head}tau[1]\nend\n"), FORM),
            (format!("{head}tau[1] 1\ntau[1] 1\nend\n"), "tau[1] has two start values, it must have one"),
            (format!("unit {OTHER} {GUID}\nend\n"), FORM),
            (head.replace(OTHER, GUID) + "end\n", "fmuGUID is {00000000-"),
            (head.replace(GUID, OTHER) + "end\n", "the unit My was made for the library {00000000-"),
        ] {
            let refusal = Unit::parse(&text, OTHER).expect_err(why);
            assert!(refusal.contains(why), "{text}: {refusal}");
        }
        let short = format!("unit My {{1}} {GUID}\nend\n");
        assert_eq!(Unit::parse(&short, "{1}"), Err("guid = \"{1}\" must be a UUID in braces".to_owned()));
    }
}
