//! Names of scenes.

use anyhow::{Result, ensure};
use scenes::Scene;
use std::fmt::Write;

/// Fails if there is no scene of this name; the error lists the existing ones.
pub(crate) fn check(name: &str) -> Result<()> {
    check_in(&Scene::all()?, name)
}

fn check_in(scenes: &[Scene], name: &str) -> Result<()> {
    let known = scenes.iter().any(|scene| scene.name == name);
    ensure!(known, "there is no scene `{name}`; the scenes are:\n{}", table(scenes));
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
}
