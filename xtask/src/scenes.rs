//! The scenes: known by their names, and written as Python reads them.

use crate::paths;
use anyhow::{Context, Result, ensure};
use scenes::Scene;
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// Whether there is a scene of that name; an unknown one is answered with the list of those that exist.
pub(crate) fn check(name: &str) -> Result<()> {
    check_in(&Scene::all()?, name)
}

fn check_in(scenes: &[Scene], name: &str) -> Result<()> {
    let known = scenes.iter().any(|scene| scene.name == name);
    ensure!(known, "there is no scene `{name}`; the scenes are:\n{}", table(scenes));
    Ok(())
}

/// Writes them to `target/scenes/`, and nothing else is left there.
pub(crate) fn write(scenes: &[Scene]) -> Result<()> {
    let folder = paths::resolved_scenes();
    write_to(&folder, scenes).with_context(|| format!("the scenes cannot be written to {}", paths::short(&folder)))
}

fn write_to(folder: &Path, scenes: &[Scene]) -> Result<()> {
    if folder.exists() {
        fs::remove_dir_all(folder)?;
    }
    fs::create_dir_all(folder)?;
    for scene in scenes {
        fs::write(folder.join(&scene.name).with_extension("json"), scene.resolved()?.to_string())?;
    }
    Ok(())
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

    fn scenes() -> [Scene; 2] {
        let scene = |name, text| Scene::parse(name, text).unwrap();
        [scene("fall", r#"{"description": "Falls"}"#), scene("torque", r#"{"description": "Turns", "tau[1]": 1}"#)]
    }

    #[test]
    fn an_unknown_scene_lists_those_there_are() {
        assert!(check_in(&scenes(), "fall").is_ok());
        let error = check_in(&scenes(), "fly").unwrap_err().to_string();
        assert_eq!(error, "there is no scene `fly`; the scenes are:\n  fall    Falls\n  torque  Turns");
    }

    #[test]
    fn what_python_reads_is_what_there_is() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("scenes");
        write_to(&target, &scenes()).unwrap();
        write_to(&target, &scenes()[1..]).unwrap();
        let files: Vec<_> = fs::read_dir(&target).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(files, ["torque.json"]);
        let text = fs::read_to_string(target.join("torque.json")).unwrap();
        assert!(text.contains(r#""values":{"tau[1]":1.0}"#), "{text}");
    }
}
