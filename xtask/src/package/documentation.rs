//! `documentation/index.html`: inserts the picture, the tables of variables and scenes, and the change log into the page of
//! `modelDescription/documentation/`.

use crate::paths;
use anyhow::{Context, Result, ensure};
use model_description::{Causality, Kind, ModelDescription, TypeKind, Variability, Variable};
use pulldown_cmark::{Event, HeadingLevel, Parser, Tag, TagEnd};
use scenes::Scene;
use std::fmt::{Display, Write};
use std::fs;

const SOURCE: &str = "modelDescription/documentation/index.html";

const CHANGES: &str = "CHANGELOG.md";

/// Marks in the page, replaced by generated text.
const PLACES: [&str; 6] =
    ["<!-- name -->", "<!-- picture -->", "<!-- scenes -->", "<!-- variables -->", "<!-- enumerations -->", "<!-- changes -->"];

/// Mark that stays in the page: `python/src/fivebar/own_unit.py` inserts its section on a unit of one's own there.
const OWN: &str = "<!-- own -->";

/// The finished page; it loads nothing from elsewhere.
pub(super) fn page(description: &ModelDescription, scenes: &[Scene], picture: &str) -> Result<String> {
    let mut page = fs::read_to_string(paths::in_root(SOURCE)).with_context(|| format!("{SOURCE} cannot be read"))?;
    let changes = fs::read_to_string(paths::in_root(CHANGES)).with_context(|| format!("{CHANGES} cannot be read"))?;
    let contents = [
        escape(&description.model_name),
        inline(picture).to_owned(),
        scene_rows(description, scenes),
        variables(description),
        enumerations(description),
        change_log(&changes),
    ];
    for (place, content) in PLACES.iter().zip(contents) {
        ensure!(page.matches(place).count() == 1, "{SOURCE} must have {place} once");
        page = page.replace(place, &content);
    }
    ensure!(page.matches(OWN).count() == 1, "{SOURCE} must have {OWN} once");
    Ok(page)
}

/// The SVG without its XML declaration and leading comments, which HTML does not allow.
fn inline(svg: &str) -> &str {
    &svg[svg.find("<svg").unwrap_or(0)..]
}

fn variables(description: &ModelDescription) -> String {
    let mut rows = String::new();
    for variable in &description.variables {
        let (start, min, max) = values(description, variable);
        let cells = [&variable.description, variable.unit.as_deref().unwrap_or(""), role(variable), &start, &min, &max];
        write!(rows, "<tr><td><code>{}</code></td>", escape(&variable.name.full)).expect("writing to a string does not fail");
        for cell in cells {
            write!(rows, "<td>{}</td>", escape(cell)).expect("writing to a string does not fail");
        }
        rows.push_str("</tr>\n");
    }
    rows
}

/// How the master uses a variable.
fn role(variable: &Variable) -> &'static str {
    match variable.causality {
        Causality::Parameter if variable.variability == Variability::Tunable => "tunable parameter",
        Causality::Parameter => "parameter",
        Causality::Input => "input",
        Causality::Output => "output",
        Causality::Local => "local",
    }
}

/// Start, minimum and maximum as text; empty if absent.
fn values(description: &ModelDescription, variable: &Variable) -> (String, String, String) {
    fn text<T: Display>(value: &Option<T>) -> String {
        value.as_ref().map(T::to_string).unwrap_or_default()
    }
    match &variable.kind {
        Kind::Real { start, bounds } => (
            start.map(real).unwrap_or_default(),
            bounds.min.map(real).unwrap_or_default(),
            bounds.max.map(real).unwrap_or_default(),
        ),
        Kind::Integer { start, bounds } => (text(start), text(&bounds.min), text(&bounds.max)),
        Kind::Boolean { start } => (text(start), String::new(), String::new()),
        Kind::Enumeration { start } => {
            let name = start.and_then(|value| item(description, variable, value));
            (name.unwrap_or_default(), String::new(), String::new())
        }
    }
}

/// A real number in readable form: `6.23e-5`, not `0.0000623`.
fn real(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e5).contains(&value.abs()) { format!("{value:e}") } else { value.to_string() }
}

/// Name of an enumeration item from its number.
fn item(description: &ModelDescription, variable: &Variable, value: i32) -> Option<String> {
    let type_ = description.types.iter().find(|type_| Some(&type_.name) == variable.declared_type.as_ref())?;
    match &type_.kind {
        TypeKind::Enumeration(enumeration) => {
            enumeration.items.iter().find(|item| item.value == value).map(|item| item.name.clone())
        }
        _ => None,
    }
}

fn enumerations(description: &ModelDescription) -> String {
    let mut rows = String::new();
    for type_ in &description.types {
        let TypeKind::Enumeration(enumeration) = &type_.kind else {
            continue;
        };
        for item in &enumeration.items {
            writeln!(
                rows,
                "<tr><td>{}</td><td>{}</td><td><code>{}</code></td><td>{}</td></tr>",
                escape(&type_.name),
                item.value,
                escape(&item.name),
                escape(&item.description)
            )
            .expect("writing to a string does not fail");
        }
    }
    rows
}

fn scene_rows(description: &ModelDescription, scenes: &[Scene]) -> String {
    let mut rows = String::new();
    for scene in scenes {
        let constant = scene.values.iter().map(|(variable, value)| {
            let whole = |number: i32| item(description, variable, number).unwrap_or_else(|| number.to_string());
            format!("{} = {}", variable.name.full, value.fold(real, whole, |truth| truth.to_string()))
        });
        let changing = scene.signals.iter().map(|signal| format!("{} changes with time", signal.variable.name.full));
        let values: Vec<String> = constant.chain(changing).collect();
        writeln!(
            rows,
            "<tr><td><code>{}</code></td><td>{}</td><td>{}</td></tr>",
            escape(&scene.name),
            escape(&scene.description),
            escape(&values.join(", "))
        )
        .expect("writing to a string does not fail");
    }
    rows
}

/// The change log as HTML, with headings one level lower and without its title, which the page already has.
fn change_log(markdown: &str) -> String {
    let below = markdown.split_once("\n## ").map_or("", |(_, rest)| rest);
    let text = format!("## {below}");
    let one_down = |level| match level {
        HeadingLevel::H2 => HeadingLevel::H3,
        HeadingLevel::H3 => HeadingLevel::H4,
        other => other,
    };
    let events = Parser::new(&text).map(|event| match event {
        Event::Start(Tag::Heading { level, id, classes, attrs }) => {
            Event::Start(Tag::Heading { level: one_down(level), id, classes, attrs })
        }
        Event::End(TagEnd::Heading(level)) => Event::End(TagEnd::Heading(one_down(level))),
        other => other,
    });
    let mut html = String::new();
    pulldown_cmark::html::push_html(&mut html, events);
    html
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::package::icon;

    #[test]
    fn the_page_names_every_variable_and_needs_nothing_outside_itself() {
        let description = ModelDescription::read().unwrap();
        let scenes = Scene::all().unwrap();
        let page = page(&description, &scenes, &icon::picture().unwrap()).unwrap();
        assert!(page.contains("<title>FiveBar</title>"));
        for variable in &description.variables {
            let name = format!("<code>{}</code>", variable.name.full);
            assert!(page.contains(&name), "{name} is missing");
        }
        for scene in scenes {
            assert!(page.contains(&format!("<code>{}</code>", scene.name)), "{} is missing", scene.name);
        }
        for outside in ["<link", "<script", "<img", "src=", "url(http", "@import"] {
            assert!(!page.contains(outside), "the page has {outside}");
        }
    }

    #[test]
    fn the_change_log_stands_below_the_headings_of_the_page() {
        let html = change_log("# Changelog\n\nForm.\n\n## 0.2.0\n\n### Added\n\n- A & `b`.\n\n## 0.1.0\n");
        assert_eq!(html, "<h3>0.2.0</h3>\n<h4>Added</h4>\n<ul>\n<li>A &amp; <code>b</code>.</li>\n</ul>\n<h3>0.1.0</h3>\n");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(real(0.21), "0.21");
        assert_eq!(real(6.23e-5), "6.23e-5");
        assert_eq!(real(1e12), "1e12");
        assert_eq!(real(0.0), "0");
    }
}
