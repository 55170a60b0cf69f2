//! `cargo xtask page`: the live page, the unit's own library in a browser. `target/page/fivebar.html` is a single file that opens from
//! disk; `target/page/site/` is the same page as separate files, for a web server.

use crate::package::{self, Files};
use crate::paths;
use crate::stamp::{self, State};
use anyhow::{Context, Result, bail, ensure};
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use flate2::Compression;
use flate2::write::GzEncoder;
use model_description::{Enumeration, Kind, ModelDescription, TypeKind, Variable};
use scenes::Scene;
use serde_json::{Map, Value as Json, json};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::io::Write;
use std::path::Path;

/// Sources of the page.
const SOURCES: &str = "page";

/// The first module of the page.
const MAIN: &str = "main.js";

/// Size limit of the single file, bytes.
const LARGEST: usize = 2_000_000;

/// Builds the library for a browser and writes both forms of the page.
pub(crate) fn page() -> Result<()> {
    let sources = sources()?;
    let (library, licenses) = package::web()?;
    let unit = unit()?.to_string();
    let licenses = notices(&licenses);

    let whole = whole(&library, &unit, &licenses)?;
    ensure!(whole.len() < LARGEST, "the page has {} bytes, which must be less than {LARGEST}", whole.len());
    let file = paths::page();
    let folder = file.parent().context("the page lies in a folder")?;
    if folder.exists() {
        fs::remove_dir_all(folder)?;
    }
    let site = folder.join("site");
    fs::create_dir_all(&site)?;
    for entry in fs::read_dir(paths::in_root(SOURCES))? {
        let path = entry?.path();
        fs::copy(&path, site.join(path.file_name().context("a source has a name")?))?;
    }
    fs::write(site.join("fivebar.wasm"), &library)?;
    fs::write(site.join("unit.json"), unit)?;
    fs::write(site.join("licenses.txt"), licenses)?;
    fs::write(&file, &whole)?;
    println!("{}: {} bytes, of which the library, packed, has {}", paths::short(&file), whole.len(), packed(&library)?.len());
    stamp::write(folder, &sources)?;
    println!("{}: for a web server; the library has {} bytes", paths::short(&site), library.len());
    Ok(())
}

/// Whether the page is there, and made from the present sources.
pub(crate) fn state() -> Result<State> {
    Ok(stamp::state(&paths::page(), &sources()?))
}

/// What the page is made from.
fn sources() -> Result<String> {
    let folders = ["Cargo.lock", "Cargo.toml", "build.rs", "modelDescription", SOURCES, "scenes", "src", "xtask/src"];
    stamp::sources(&folders, &[])
}

/// Data of the unit for the page: GUID, version, variables with their references, and scenes.
fn unit() -> Result<Json> {
    let description = ModelDescription::read().map_err(|error| anyhow::anyhow!("the model description: {error}"))?;
    let variables: Map<String, Json> =
        description.variables.iter().map(|variable| (variable.name.full.clone(), variable_of(&description, variable))).collect();
    let scenes = Scene::all()?.iter().map(scene).collect::<Result<Vec<Json>>>()?;
    Ok(json!({ "guid": description.guid(), "version": env!("CARGO_PKG_VERSION"), "variables": variables, "scenes": scenes }))
}

/// A variable: reference, kind, role; start, unit and items if it has them.
fn variable_of(description: &ModelDescription, variable: &Variable) -> Json {
    let start = match &variable.kind {
        Kind::Real { start, .. } => json!(start),
        Kind::Integer { start, .. } | Kind::Enumeration { start } => json!(start),
        Kind::Boolean { start } => json!(start),
    };
    let mut json = json!({
        "reference": variable.reference,
        "kind": variable.kind.label(),
        "role": format!("{:?}", variable.causality).to_lowercase(),
        "variability": format!("{:?}", variable.variability).to_lowercase(),
    });
    let mut add = |key: &str, value: Json| {
        if !value.is_null() {
            json[key] = value;
        }
    };
    add("start", start);
    add("unit", json!(variable.unit));
    if variable.is_alias() {
        add("alias", json!(true));
    }
    let declared = description.types.iter().find(|declared| Some(&declared.name) == variable.declared_type.as_ref());
    if let Some(TypeKind::Enumeration(Enumeration { items })) = declared.map(|declared| &declared.kind) {
        add("items", items.iter().map(|item| (item.name.clone(), json!(item.value))).collect::<Map<_, _>>().into());
    }
    json
}

/// A scene: its values as encoded for calls, its signals as in the file.
fn scene(scene: &Scene) -> Result<Json> {
    let file = paths::in_root("scenes").join(&scene.name).with_extension("json");
    let text = fs::read_to_string(&file).with_context(|| paths::short(&file))?;
    let written: Json = serde_json::from_str(&text).with_context(|| paths::short(&file))?;
    let resolved = scene.resolved()?;
    Ok(json!({
        "name": scene.name,
        "description": scene.description,
        "stopTime": scene.stop_time,
        "values": resolved["variants"][0]["values"],
        "signals": written.get("signals").unwrap_or(&json!({})),
    }))
}

/// All licence files as one text; a text shared by several parts appears once.
pub(crate) fn notices(licenses: &Files) -> String {
    let mut names: BTreeMap<&[u8], Vec<&str>> = BTreeMap::new();
    for (name, text) in licenses {
        names.entry(text).or_default().push(name.rsplit_once("licenses/").map_or(name.as_str(), |(_, short)| short));
    }
    let mut sections: Vec<_> = names.into_iter().map(|(text, names)| (names.join("\n"), text)).collect();
    // The list of all parts comes first.
    sections.sort_by_key(|(names, _)| (names != "license.txt", names.clone()));
    let mut all = String::new();
    for (names, text) in sections {
        write!(all, "== {names} ==\n\n{}\n\n", String::from_utf8_lossy(text)).expect("writing to a string does not fail");
    }
    all
}

/// The single file: style, modules, library, variables and licences inside the document.
fn whole(library: &[u8], unit: &str, licenses: &str) -> Result<String> {
    let document = source("index.html")?;
    let mut script = String::new();
    bundle(MAIN, &mut Vec::new(), &mut script)?;
    let block = |id: &str, content: &[u8]| -> Result<String> {
        Ok(format!("<script type=\"application/gzip\" id=\"packed-{id}\">{}</script>\n", packed(content)?))
    };
    let blocks = [("library", library), ("unit", unit.as_bytes()), ("licenses", licenses.as_bytes())];
    let blocks = blocks.into_iter().map(|(id, content)| block(id, content)).collect::<Result<String>>()?;
    let parts = [
        ("<link rel=\"stylesheet\" href=\"style.css\">", format!("<style>\n{}</style>", source("style.css")?)),
        (
            "<script type=\"module\" src=\"main.js\"></script>",
            format!("{blocks}<script type=\"module\">\n{}</script>", inside_script(&script)?),
        ),
    ];
    parts.into_iter().try_fold(document, |document, (reference, content)| {
        ensure!(document.matches(reference).count() == 1, "page/index.html must have the line {reference} once");
        Ok(document.replace(reference, &content))
    })
}

/// Appends a module to the script after its imports, each once. All modules share one scope; `import` lines and the word `export` are
/// removed.
fn bundle(name: &str, done: &mut Vec<String>, script: &mut String) -> Result<()> {
    if done.iter().any(|other| other == name) {
        return Ok(());
    }
    done.push(name.to_owned());
    let mut own = String::new();
    for line in source(name)?.lines() {
        if line.starts_with("import ") {
            match line.strip_suffix("\";").and_then(|line| line.split_once(" } from \"./")) {
                Some((_, imported)) => bundle(imported, done, script)?,
                None => bail!("page/{name} must import by `import {{ … }} from \"./FILE\";`, not by {line}"),
            }
        } else {
            writeln!(own, "{}", line.strip_prefix("export ").unwrap_or(line)).expect("writing to a string does not fail");
        }
    }
    script.push_str(&own);
    Ok(())
}

/// A script, escaped for use inside a document.
fn inside_script(script: &str) -> Result<&str> {
    ensure!(!script.contains("</script"), "a module of the page ends the script that it stands in");
    Ok(script)
}

/// Deflated, as base64.
fn packed(content: &[u8]) -> Result<String> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(content)?;
    Ok(BASE64.encode(encoder.finish()?))
}

fn source(name: &str) -> Result<String> {
    let file = Path::new(SOURCES).join(name);
    fs::read_to_string(paths::in_root(&file)).with_context(|| format!("{} cannot be read", file.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_modules_become_one_script_without_imports() {
        let (mut done, mut script) = (Vec::new(), String::new());
        bundle(MAIN, &mut done, &mut script).unwrap();
        for line in script.lines() {
            assert!(!line.starts_with("import ") && !line.starts_with("export "), "{line}");
        }
        let mut modules: Vec<String> =
            fs::read_dir(paths::in_root(SOURCES)).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        modules.retain(|name| name.ends_with(".js"));
        modules.sort();
        done.sort();
        assert_eq!(done, modules, "every module of page/ is part of the page");
    }

    #[test]
    fn the_page_knows_references_starts_items_and_scenes() {
        let unit = unit().unwrap();
        let method = &unit["variables"]["solver.method"];
        assert_eq!((&method["start"], &method["items"]["automatic"]), (&json!(1), &json!(6)));
        assert_eq!(unit["variables"]["gravity.g"]["unit"], "m/s2");
        let scene = unit["scenes"].as_array().unwrap().iter().find(|scene| scene["name"] == "haptic").unwrap();
        assert_eq!(scene["values"]["contact.offset"], 0.2);
        assert_eq!(scene["signals"]["tip.fx"]["minimumJerk"][1], json!([0.9, 1.2]));
    }

    #[test]
    fn a_shared_licence_appears_once() {
        let files = [("a/licenses/x/LICENSE", "same"), ("a/licenses/y/LICENSE", "same"), ("a/licenses/license.txt", "list")];
        let files = files.map(|(name, text)| (name.to_owned(), text.as_bytes().to_vec()));
        assert_eq!(notices(&files.into()), "== license.txt ==\n\nlist\n\n== x/LICENSE\ny/LICENSE ==\n\nsame\n\n");
    }
}
