//! Check that a unit accepts its own start: the library is asked, through FMPy. A plain unit of the same sources that is packed
//! already is asked before anything is built.

use super::platform::Scope;
use super::unit::{OwnScene, Unit};
use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::{Result, ensure};
use std::fs;
use std::path::Path;
use std::time::SystemTime;

/// Sources of a unit: a packed unit older than any of them is out of date.
const SOURCES: [&str; 5] = ["src", "modelDescription", "build.rs", "Cargo.toml", "Cargo.lock"];

/// Fails with the unit's own sentence, if it refuses.
pub(super) fn check(fmu: &Path) -> Result<()> {
    ask(fmu, None)
}

/// Fails with the sentence of the plain unit, if one of these sources is there and refuses the start of a scene.
pub(super) fn check_before(scene: &OwnScene, scope: Scope) -> Result<()> {
    let plain = scope.file(Unit::plain()?.name());
    let written = |file: &Path| fs::metadata(file).and_then(|found| found.modified());
    let Ok(packed) = written(&plain) else { return Ok(()) };
    for source in SOURCES {
        if newest(&paths::in_root(source))? > packed {
            return Ok(());
        }
    }
    ask(&plain, Some(&scene.start_values()))
}

fn ask(fmu: &Path, values: Option<&str>) -> Result<()> {
    let mut python = venv::python(Packages::Usual)?;
    let sentence = process::output(python.args(["-m", "fivebar.start"]).arg(fmu).args(values))?;
    ensure!(sentence.is_empty(), "the start is refused: {}", sentence.trim_end());
    Ok(())
}

/// When a file, or the last one in a folder, was written.
fn newest(path: &Path) -> Result<SystemTime> {
    let mut newest = fs::metadata(path)?.modified()?;
    if path.is_dir() {
        for entry in fs::read_dir(path)? {
            newest = newest.max(self::newest(&entry?.path())?);
        }
    }
    Ok(newest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_folder_is_as_new_as_its_newest_file() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("deep")).unwrap();
        let file = folder.path().join("deep/file");
        fs::write(&file, "x").unwrap();
        let later = SystemTime::now() + Duration::from_secs(60);
        fs::File::options().write(true).open(&file).unwrap().set_modified(later).unwrap();
        assert_eq!(newest(folder.path()).unwrap(), newest(&file).unwrap());
        assert!(newest(folder.path()).unwrap() > SystemTime::now());
    }
}
