//! `cargo xtask wheel`: the Python package for users, with the unit, the scenes and the live page inside.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::{Context, Result};
use std::fs;
use std::path::{Path, PathBuf};

/// Packs the unit and builds the wheel, the only file in `target/wheel/`; returns its path. The same sources give the same bytes.
pub(crate) fn wheel(scope: Scope) -> Result<PathBuf> {
    let fmu = package::package(scope)?;
    let folder = paths::in_root("target/wheel");
    if folder.exists() {
        fs::remove_dir_all(&folder)?;
    }
    build(&fmu, &["wheel"], &folder)?;
    let mut files = fs::read_dir(&folder)?;
    let wheel = files.next().context("hatchling has built no wheel")??.path();
    println!("{}: {} bytes", paths::short(&wheel), fs::metadata(&wheel)?.len());
    Ok(wheel)
}

/// Builds `wheel`, `sdist` or both around a packed unit, in a folder; python/hatch_build.py adds the shipped files.
pub(crate) fn build(fmu: &Path, targets: &[&str], folder: &Path) -> Result<()> {
    if let Some(sentence) = missing(&paths::page()) {
        println!("{sentence}");
    }
    process::run(
        venv::python(Packages::Usual)?
            .args(["-m", "hatchling", "build", "--directory"])
            .arg(folder)
            .args(targets.iter().flat_map(|target| ["--target", target]))
            .current_dir(paths::in_root("python"))
            .env("FIVEBAR_FMU", fmu),
    )
}

/// A message if the live page for the package is missing.
fn missing(page: &Path) -> Option<String> {
    (!page.is_file()).then(|| {
        format!(
            "the package comes without the live page, for there is no {}: `cargo xtask page`, which needs `.ci/setup-page`, makes it",
            paths::short(page)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_page_is_reported() {
        assert_eq!(missing(&paths::in_root("README.md")), None);
        let sentence = missing(&paths::in_root("target/no/fivebar.html")).unwrap();
        assert!(sentence.contains("no target/no/fivebar.html: `cargo xtask page`") && sentence.contains("`.ci/setup-page`"));
    }
}
