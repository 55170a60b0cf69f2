//! `cargo xtask wheel`: the package that users have in Python, with the unit, the scenes and the live page inside.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::{Context, Result};
use std::fs;
use std::path::{Path, PathBuf};

/// Packs the unit and builds the wheel in `target/wheel/`, the only file there; gives back its path. The same sources give the same bytes.
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

/// Builds `wheel`, `sdist` or both around a packed unit, in a folder; python/hatch_build.py adds to the package what is shipped.
pub(crate) fn build(fmu: &Path, targets: &[&str], folder: &Path) -> Result<()> {
    process::run(
        venv::python(Packages::Usual)?
            .args(["-m", "hatchling", "build", "--directory"])
            .arg(folder)
            .args(targets.iter().flat_map(|target| ["--target", target]))
            .current_dir(paths::in_root("python"))
            .env("FIVEBAR_FMU", fmu),
    )
}
