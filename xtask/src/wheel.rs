//! `cargo xtask wheel`: the Python package for users, with the unit, the scenes and the live page inside.

use crate::package::{self, Scope};
use crate::stamp::State;
use crate::venv::{self, Packages};
use crate::{page, paths, process, site};
use anyhow::{Context, Result, bail};
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

/// Builds `wheel`, `sdist` or both around a packed unit, in a folder; python/hatch_build.py adds the shipped files. An old site is made
/// again. An old live page is refused, because it needs more than Rust and Python.
pub(crate) fn build(fmu: &Path, targets: &[&str], folder: &Path) -> Result<()> {
    match page::state()? {
        State::Current => {}
        State::Missing => println!("{}", missing(&paths::page())),
        State::Old => bail!("{}", old(&paths::page())),
    }
    site::refresh()?;
    process::run(
        venv::python(Packages::Usual)?
            .args(["-m", "hatchling", "build", "--directory"])
            .arg(folder)
            .args(targets.iter().flat_map(|target| ["--target", target]))
            .current_dir(paths::in_root("python"))
            .env("FIVEBAR_FMU", fmu),
    )
}

/// The message if the live page for the package is missing.
fn missing(page: &Path) -> String {
    format!(
        "the package comes without the live page, for there is no {}: `cargo xtask page`, which needs `.ci/setup-page`, makes it",
        paths::short(page)
    )
}

/// The error if the live page was made from other sources, and so has another library than the package's unit.
fn old(page: &Path) -> String {
    let page = paths::short(page);
    format!(
        "{page} was made from other sources: make it again by `cargo xtask page`, or remove it for a package without the live page"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_that_is_missing_or_old_is_named() {
        let page = paths::in_root("target/no/fivebar.html");
        assert!(
            missing(&page).contains("no target/no/fivebar.html: `cargo xtask page`") && missing(&page).contains("`.ci/setup-page`")
        );
        assert!(old(&page).starts_with("target/no/fivebar.html was made from other sources"));
    }
}
