//! The modelDescription.xml inside the .fmu.

use quick_xml::events::{BytesStart, BytesText, Event};
use quick_xml::{Reader, Writer};

use crate::data::{ModelDescription, Unknown};
use crate::edit::{replace, value, write};

/// Comment at the top of the output; it replaces the comment of the source.
const HEAD: &str = "\n<!-- Written by `cargo xtask package` from modelDescription/modelDescription.xml: do not edit. -->\n";

impl ModelDescription {
    /// The FMI 2.0 model description: GUID and version are filled in, names in the model structure are replaced by FMI's 1-based indices,
    /// and other comments and all line breaks of the source are kept.
    pub fn to_fmi(&self, version: &str) -> String {
        const CHECKED: &str = "parse() has read the same text before";
        let mut reader = Reader::from_str(&self.xml);
        let mut writer = Writer::new(Vec::new());
        let mut in_root = false;
        let mut section: &[Unknown] = &[];
        loop {
            let event = reader.read_event().expect(CHECKED);
            let event = match event {
                Event::Eof => break,
                Event::Comment(_) | Event::Text(_) if !in_root => continue,
                Event::Start(start) if start.name().0 == "fmiModelDescription" => {
                    in_root = true;
                    write(&mut writer, Event::Text(BytesText::from_escaped(HEAD)));
                    Event::Start(replace(&replace(&start, "guid", &self.guid()), "version", version).into_owned())
                }
                Event::Start(start) => {
                    section = self.structure.section(start.name().0).unwrap_or(section);
                    Event::Start(start)
                }
                Event::Empty(element) if element.name().0 == "Unknown" => {
                    let (first, rest) = section.split_first().expect(CHECKED);
                    section = rest;
                    Event::Empty(self.unknown(first))
                }
                Event::Empty(element) => Event::Empty(match value(&element, "derivative") {
                    Some(state) => replace(&element, "derivative", &self.index(&state).to_string()),
                    None => element,
                }),
                other => other,
            };
            write(&mut writer, event);
        }
        String::from_utf8(writer.into_inner()).expect("the source is UTF-8")
    }

    /// 1-based position of a variable in ModelVariables.
    fn index(&self, name: &str) -> usize {
        let position = self.variables.iter().position(|variable| variable.name.full == name);
        position.expect("check() has looked every name up") + 1
    }

    fn unknown(&self, unknown: &Unknown) -> BytesStart<'static> {
        let mut known: Vec<usize> = unknown.dependencies.iter().map(|name| self.index(name)).collect();
        known.sort_unstable();
        let known: Vec<String> = known.iter().map(usize::to_string).collect();
        let mut element = BytesStart::new("Unknown");
        element.push_attribute(("index", self.index(&unknown.name).to_string().as_str()));
        element.push_attribute(("dependencies", known.join(" ").as_str()));
        element
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::element::Element;

    fn written() -> (ModelDescription, String, Element) {
        let description = ModelDescription::read().expect("the shipped description");
        let text = description.to_fmi("1.2.3");
        let root = Element::parse(&text).expect("what is written can be read");
        (description, text, root)
    }

    #[test]
    fn guid_and_version_are_filled_in() {
        let (description, _, root) = written();
        assert_eq!(root.attribute("guid"), Some(description.guid().as_str()));
        assert_eq!(root.attribute("version"), Some("1.2.3"));
        assert_eq!(root.attribute("fmiVersion"), Some("2.0"));
    }

    #[test]
    fn another_content_has_another_guid() {
        let other = crate::XML.replacen("Motor torque", "Torque of the motor", 1);
        let other = ModelDescription::parse(&other).expect("a harmless change");
        assert_ne!(other.guid(), ModelDescription::read().expect("the shipped description").guid());
    }

    #[test]
    fn names_become_indices() {
        let (description, text, root) = written();
        let variables = &root.child("ModelVariables").expect("variables").children;
        assert_eq!(variables.len(), description.variables.len());
        let name = |index: &str| variables[index.parse::<usize>().expect("an index") - 1].attribute("name");

        let derivative = variables.iter().find(|v| v.attribute("name") == Some("der(omega[2])")).expect("it");
        assert_eq!(name(derivative.children[0].attribute("derivative").expect("derivative")), Some("omega[2]"));

        let structure = root.child("ModelStructure").expect("the structure");
        let written = ["Outputs", "Derivatives", "InitialUnknowns"].map(|tag| &structure.child(tag).expect(tag).children);
        let sources = &description.structure;
        let sources = sources.outputs.iter().chain(&sources.derivatives).chain(&sources.initial_unknowns);
        assert_eq!(written.map(Vec::len), [16, 4, 20]);
        for (written, source) in written.into_iter().flatten().zip(sources) {
            assert_eq!(name(written.attribute("index").expect("index")), Some(source.name.as_str()));
            let mut names: Vec<&str> = written
                .attribute("dependencies")
                .expect("dependencies")
                .split_whitespace()
                .map(|index| name(index).expect("a name"))
                .collect();
            let mut expected: Vec<&str> = source.dependencies.iter().map(String::as_str).collect();
            names.sort_unstable();
            expected.sort_unstable();
            assert_eq!(names, expected, "{}", source.name);
        }
        assert!(!text.contains("<Unknown name"));
    }

    #[test]
    fn initial_unknowns_are_the_calculated_outputs_and_derivatives() {
        let (description, _, _) = written();
        let structure = &description.structure;
        let names = |list: &[Unknown]| list.iter().map(|unknown| unknown.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&structure.initial_unknowns), [names(&structure.outputs), names(&structure.derivatives)].concat());
    }

    /// The start of the tip follows from the geometry alone, so two units coupled by their tips form no loop.
    #[test]
    fn families_and_beginnings_become_names() {
        let (description, _, _) = written();
        let dependencies = |name: &str| {
            let unknown = description.structure.initial_unknowns.iter().find(|unknown| unknown.name == name).expect(name);
            unknown.dependencies.join(" ")
        };
        assert_eq!(
            dependencies("tip.x"),
            "base.distance link[1].length link[2].length link[3].length link[4].length init.theta[1] init.theta[2] init.assembly"
        );
        assert!(dependencies("der(omega[1])").starts_with("tau[1] tau[2] tip.fx tip.fy base.distance link[1].length link[1].mass"));
    }

    #[test]
    fn what_is_not_completed_stays_as_it_is() {
        let (description, text, _) = written();
        let variables = |xml: &str| {
            let from = xml.find("<UnitDefinitions>").expect("units");
            xml[from..xml.find("<!-- Continuous states").expect("the comment")].to_owned()
        };
        assert_eq!(variables(&text), variables(&description.xml));
        assert!(text.starts_with("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<!-- Written by"));
    }
}
