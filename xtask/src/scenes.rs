//! The scenes: one JSON file each, variable name to start value, with a `description`.

use crate::paths;
use anyhow::{Context, Result, bail};
use serde_json::{Map, Value};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

/// The file of a scene; an unknown name is answered with the list of those that exist.
pub(crate) fn find(name: &str) -> Result<PathBuf> {
    find_in(&paths::scenes(), name)
}

fn find_in(folder: &Path, name: &str) -> Result<PathBuf> {
    let scenes = list(folder)?;
    match scenes.iter().find(|scene| scene.name == name) {
        Some(scene) => Ok(scene.file.clone()),
        None => bail!("there is no scene `{name}`; the scenes are:\n{}", table(&scenes)),
    }
}

/// A scene as its file has it.
pub(crate) struct Scene {
    /// The file's name without its ending.
    pub(crate) name: String,
    file: PathBuf,
    /// What it shows.
    pub(crate) description: String,
    /// Values that differ from the start values: variable name to value, in the order of the file.
    pub(crate) values: Map<String, Value>,
    /// Inputs that change with time.
    pub(crate) changing: Vec<String>,
}

/// Keys of a scene that are not variables.
const RESERVED: [&str; 4] = ["description", "experiment", "signals", "overlay"];

/// All scenes, by name.
pub(crate) fn all() -> Result<Vec<Scene>> {
    list(&paths::scenes())
}

fn list(folder: &Path) -> Result<Vec<Scene>> {
    let entries = fs::read_dir(folder).with_context(|| format!("the folder of scenes {} cannot be read", paths::short(folder)))?;
    let mut scenes = Vec::new();
    for entry in entries {
        let file = entry?.path();
        if file.extension().is_none_or(|extension| extension != "json") {
            continue;
        }
        let name = file.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
        scenes.push(read(name, file)?);
    }
    scenes.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(scenes)
}

fn read(name: String, file: PathBuf) -> Result<Scene> {
    let text = fs::read_to_string(&file).with_context(|| format!("scene {} cannot be read", paths::short(&file)))?;
    let mut values: Map<String, Value> =
        serde_json::from_str(&text).with_context(|| format!("scene {} is not valid JSON", paths::short(&file)))?;
    let Some(description) = values.get("description").and_then(Value::as_str).map(String::from) else {
        bail!("scene {} has no text `description`", paths::short(&file));
    };
    let signals = values.get("signals").and_then(Value::as_object);
    let changing = signals.map(|signals| signals.keys().cloned().collect()).unwrap_or_default();
    values.retain(|key, _| !RESERVED.contains(&key.as_str()));
    Ok(Scene { name, file, description, values, changing })
}

fn table(scenes: &[Scene]) -> String {
    let width = scenes.iter().map(|scene| scene.name.len()).max().unwrap_or(0);
    let mut table = String::new();
    for scene in scenes {
        writeln!(table, "  {:width$}  {}", scene.name, scene.description).expect("writing to a string does not fail");
    }
    table.truncate(table.trim_end().len());
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            fs::write(folder.path().join(name), text).unwrap();
        }
        folder
    }

    #[test]
    fn a_known_scene_is_found() {
        let folder = folder(&[("fall.json", r#"{"description": "Falls"}"#)]);
        assert_eq!(find_in(folder.path(), "fall").unwrap(), folder.path().join("fall.json"));
    }

    #[test]
    fn an_unknown_scene_lists_those_there_are() {
        let folder = folder(&[
            ("torque.json", r#"{"description": "Turns"}"#),
            ("fall.json", r#"{"description": "Falls"}"#),
            ("notes.txt", "not a scene"),
        ]);
        let error = find_in(folder.path(), "fly").unwrap_err().to_string();
        assert_eq!(error, "there is no scene `fly`; the scenes are:\n  fall    Falls\n  torque  Turns");
    }

    #[test]
    fn a_scene_without_description_is_named() {
        let folder = folder(&[("fall.json", "{}")]);
        let error = find_in(folder.path(), "fall").unwrap_err().to_string();
        assert!(error.contains("fall.json has no text `description`"), "{error}");
    }
}
