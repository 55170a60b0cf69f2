//! A unit of one's own: this library under another name, with start values that it reads when it is instantiated.
//!
//! The values lie in `resources/unit.xml` of the unpacked .fmu, which `python/src/fivebar/own_unit.py` writes:
//!
//! ```xml
//! <unit name="MyMachine" guid="{…}" library="{…}">
//!   <start name="base.distance" value="0.1"/>
//! </unit>
//! ```
//!
//! `guid` is the GUID in the model description of the .fmu, `library` that of the plain unit ([`GUID`]). Each value passes the checks of
//! one that a master sets. The plain unit has no such file, and nothing looks for one.

use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::{Path, PathBuf};

use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};

use super::location::folders;
use super::values::{check_settable, check_value};
use super::{CallError, Stage};
use crate::variables::{FmiType, GUID, Value, Variable};

/// Name of the file in the folder of resources.
const FILE: &str = "unit.xml";

/// Largest file that is read, bytes: every variable that can be set takes a third of it.
const LARGEST: u64 = 64 * 1024;

/// GUID of a unit, as text in braces.
pub type Guid = [u8; GUID.len()];

/// GUID and start values that an instance is made with.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    pub(super) guid: Guid,
    /// Start values in the place of those of the XML.
    pub(super) starts: Vec<(&'static Variable, Value)>,
}

impl Unit {
    /// The plain unit: every start value is that of the XML.
    pub fn plain() -> Self {
        let Ok(guid) = GUID.as_bytes().try_into() else { unreachable!("the length is that of GUID") };
        Self { guid, starts: Vec::new() }
    }

    /// The unit of a GUID: the plain one, or the one whose file lies in the resources that the master names or, if there is none, in
    /// those of the archive that the library was unpacked from.
    ///
    /// # Errors
    /// Refused if no file is found, or the one found cannot be read, belongs to another unit or library, or has a value that is refused.
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

    /// Parses the file of the unit with this GUID.
    fn parse(text: &str, guid: &str) -> Result<Self, String> {
        let mut reader = Reader::from_str(text);
        let mut unit: Option<Self> = None;
        let mut is_closed = false;
        loop {
            match (reader.read_event().map_err(|error| format!("byte {}: {error}", reader.error_position()))?, &mut unit) {
                (Event::Start(element), None) if element.name().0 == "unit" => unit = Some(Self::head(&element, guid)?),
                (Event::Empty(element), Some(unit)) if !is_closed && element.name().0 == "start" => unit.add(start(&element)?)?,
                // The reader has checked that the tag closes the innermost open element.
                (Event::End(_), _) => is_closed = true,
                (Event::Text(text), _) if text.trim_ascii().is_empty() => {}
                (Event::Comment(_) | Event::Decl(_), _) => {}
                (Event::Eof, _) => break,
                _ => {
                    let place = reader.buffer_position();
                    return Err(format!(
                        "byte {place}: there must be one <unit> with elements <start name=\"…\" value=\"…\"/> only"
                    ));
                }
            }
        }
        unit.filter(|_| is_closed).ok_or_else(|| "there must be one <unit>, with an end".to_owned())
    }

    fn add(&mut self, (variable, value): (&'static Variable, Value)) -> Result<(), String> {
        if self.starts.iter().any(|(other, _)| *other == variable) {
            return Err(format!("{} has two start values, it must have one", variable.name));
        }
        self.starts.push((variable, value));
        Ok(())
    }

    /// The unit without start values, from its opening tag.
    fn head(element: &BytesStart<'_>, wanted: &str) -> Result<Self, String> {
        let [name, guid, library] = attributes(element, ["name", "guid", "library"])?;
        if guid != wanted {
            return Err(format!("fmuGUID is {wanted}, these start values belong to the unit {name} with {guid}"));
        }
        if library != GUID {
            return Err(format!("the unit {name} was made for the library {library}, this one is {GUID}: make it again"));
        }
        let guid = guid.as_bytes().try_into().map_err(|_| format!("guid = \"{guid}\" must be a UUID in braces"))?;
        Ok(Self { guid, starts: Vec::new() })
    }
}

/// Folder of resources beside the folder of binaries that a library lies in: `binaries/PLATFORM/NAME.so` → `resources`.
fn resources_of(library: &Path) -> Option<PathBuf> {
    library.ancestors().nth(3).map(|root| root.join("resources"))
}

/// Text of a file of bounded size; devices and folders are refused, because to open or read them may wait or not end.
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

/// Whether there is no file of that name, so that the next place is looked at.
fn leads_nowhere(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory | ErrorKind::InvalidFilename | ErrorKind::InvalidInput)
}

/// Variable and value of an element `<start name="…" value="…"/>`.
fn start(element: &BytesStart<'_>) -> Result<(&'static Variable, Value), String> {
    let [name, text] = attributes(element, ["name", "value"])?;
    let variable = Variable::named(&name).ok_or_else(|| format!("there is no variable {name}"))?;
    let value = match (variable.fmi_type(), text.as_str()) {
        (FmiType::Real, text) => text.parse().ok().map(Value::Real),
        (FmiType::Integer, text) => text.parse().ok().map(Value::Integer),
        (FmiType::Boolean, "true" | "1") => Some(Value::Boolean(true)),
        (FmiType::Boolean, "false" | "0") => Some(Value::Boolean(false)),
        (FmiType::Boolean, _) => None,
    };
    let value = value.ok_or_else(|| format!("{name} = \"{text}\" is not allowed: it must be of type {}", variable.type_name()))?;
    let checked = check_settable(variable, Stage::Instantiated).and_then(|()| check_value(variable, value));
    checked.map_err(|refusal| refusal.message.trim_end_matches('.').to_owned())?;
    Ok((variable, value))
}

/// Values of the attributes of an element, which must be those of the names, each once.
fn attributes<const N: usize>(element: &BytesStart<'_>, names: [&str; N]) -> Result<[String; N], String> {
    let tag = element.name().0;
    let mut values = [const { None }; N];
    for attribute in element.attributes() {
        let attribute = attribute.map_err(|error| format!("<{tag}>: {error}"))?;
        let place = names.iter().position(|name| *name == attribute.key.0);
        let place = place.ok_or_else(|| format!("<{tag}> has {}, it must have {}", attribute.key.0, names.join(", ")))?;
        let value = attribute.normalized_value(XmlVersion::Explicit1_0).map_err(|error| format!("<{tag}>: {error}"))?;
        values[place] = Some(value.trim().to_owned());
    }
    match values.iter().position(Option::is_none) {
        Some(missing) => Err(format!("<{tag}> has no {}, it must have {}", names[missing], names.join(", "))),
        None => Ok(values.map(Option::unwrap_or_default)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OTHER: &str = "{00000000-0000-5000-8000-000000000000}";

    fn head() -> String {
        format!("<unit name=\"My\" guid=\"{OTHER}\" library=\"{GUID}\">")
    }

    /// A file with these elements.
    fn with(starts: &str) -> Result<Unit, String> {
        Unit::parse(
            &format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- of one's own -->\n{}\n{starts}\n</unit>\n", head()),
            OTHER,
        )
    }

    #[test]
    fn values_of_every_type_are_read() {
        let unit = with(
            "<start name=\"base.distance\" value=\"1e-1\"/><start name=\"solver.maxIterations\" value=\"20\"/>
             <start name='solver.method' value='4'/><start value=\"false\" name=\"gravity.enabled\"/>
             <start name=\"payload.enabled\" value=\"1\"/><start name=\"tau[1]\" value=\"-0.25\"/>",
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
        for (name, value, why) in [
            ("base.distance", "-1", "base.distance = -1.0 m is not allowed: it must be at least 0 m"),
            ("base.distance", "inf", "base.distance = inf m is not allowed: it must be finite"),
            ("base.distance", "wide", "base.distance = \"wide\" is not allowed: it must be of type Real"),
            ("solver.method", "99", "solver.method = 99 is not allowed: it must be one of 1 (i3alp)"),
            ("solver.method", "dop853", "solver.method = \"dop853\" is not allowed: it must be of type Enumeration"),
            ("gravity.enabled", "2", "gravity.enabled = \"2\" is not allowed: it must be of type Boolean"),
            ("solver.maxIterations", "2.5", "solver.maxIterations = \"2.5\" is not allowed: it must be of type Integer"),
            ("tip.x", "0", "tip.x is computed and cannot be set"),
            ("der(theta[1])", "0", "there is no variable der(theta[1])"),
            ("tau[3]", "0", "there is no variable tau[3]"),
        ] {
            let refusal = with(&format!("<start name=\"{name}\" value=\"{value}\"/>")).expect_err(why);
            assert!(refusal.starts_with(why), "{refusal}");
        }
    }

    #[test]
    fn what_is_no_such_file_is_refused() {
        let start = "<start name=\"tau[1]\" value=\"1\"/>";
        let only = "there must be one <unit> with elements <start name=\"…\" value=\"…\"/> only";
        for (text, why) in [
            ("".to_owned(), "there must be one <unit>, with an end"),
            ("unit".to_owned(), only),
            (head(), "there must be one <unit>, with an end"),
            (format!("{}{start}", head()), "there must be one <unit>, with an end"),
            (format!("{}{start}</start>", head()), "byte "),
            (format!("{}<start name=\"tau[1]\" value=\"1\"></start></unit>", head()), only),
            (format!("{}{}</unit>", head(), "<unit>".repeat(9)), only),
            (format!("{}</unit>{}</unit>", head(), head()), only),
            (format!("{}</unit>{start}", head()), only),
            (format!("{}{start}{start}</unit>", head()), "tau[1] has two start values, it must have one"),
            (format!("{}<start name=\"tau[1]\"/></unit>", head()), "<start> has no value, it must have name, value"),
            (
                format!("{}<start name=\"tau[1]\" value=\"1\" unit=\"N\"/></unit>", head()),
                "<start> has unit, it must have name, value",
            ),
            (format!("{}<start name=\"tau[1]\" value=\"1\" value=\"2\"/></unit>", head()), "<start>: "),
            (format!("{}<start name=\"tau[1]\" value=\"&one;\"/></unit>", head()), "<start>: "),
            (format!("<!DOCTYPE unit [<!ENTITY one \"1\">]>{}</unit>", head()), only),
            (format!("{}tau</unit>", head()), only),
            ("<unit name=\"My\">".to_owned(), "<unit> has no guid, it must have name, guid, library"),
            (head().replace(OTHER, GUID) + "</unit>", "fmuGUID is {00000000-"),
            (head().replace(GUID, OTHER) + "</unit>", "the unit My was made for the library {00000000-"),
        ] {
            let refusal = Unit::parse(&text, OTHER).expect_err(why);
            assert!(refusal.contains(why), "{text}: {refusal}");
        }
        let short = format!("<unit name=\"My\" guid=\"{{1}}\" library=\"{GUID}\"></unit>");
        assert_eq!(Unit::parse(&short, "{1}"), Err("guid = \"{1}\" must be a UUID in braces".to_owned()));
    }
}
