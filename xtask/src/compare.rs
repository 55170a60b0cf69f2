//! `cargo xtask compare`: runs every scene by every method on two builds of the library; reports differences, and whether they are
//! round-off.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::{Context, Result};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use zip::ZipArchive;

/// Folder with the builds of other revisions; they are kept.
const FOLDER: &str = "target/compare";

pub(crate) fn compare(revision: &str) -> Result<()> {
    let before = packed(revision).with_context(|| format!("revision {revision} could not be packed"))?;
    let after = package::package(Scope::Here)?;
    process::run(
        venv::python(Packages::Usual)?
            .arg("xtask/python/compare.py")
            .arg("--before")
            .arg(before)
            .arg("--after")
            .arg(after)
            .arg("--scenes")
            .arg(paths::scenes()),
    )
}

/// The unit of a revision. Packs it from its own sources if this was not done before.
fn packed(revision: &str) -> Result<PathBuf> {
    let commit = format!("{revision}^{{commit}}");
    let hash = process::output(process::program("git").args(["rev-parse", "--short=12", "--verify", "--end-of-options", &commit]))?;
    let folder = paths::in_root(FOLDER).join(hash.trim());
    let fmu = folder.join("target/fmu/FiveBar.fmu");
    if !fmu.is_file() {
        if !folder.is_dir() {
            check_out(hash.trim(), &folder)?;
        }
        process::run(
            process::cargo()
                .args(["run", "--quiet", "--locked", "--package", "xtask", "--", "package"])
                .current_dir(&folder)
                // One folder for all revisions, so that external crates are built once.
                .env("CARGO_TARGET_DIR", paths::in_root(FOLDER).join("cargo")),
        )?;
    }
    Ok(fmu)
}

/// Writes the files of a commit to `folder`, without a worktree in `.git`.
fn check_out(commit: &str, folder: &Path) -> Result<()> {
    let unfinished = folder.with_extension("unfinished");
    let archive = folder.with_extension("zip");
    fs::create_dir_all(paths::in_root(FOLDER))?;
    process::run(process::program("git").args(["archive", "--format=zip", "--output"]).arg(&archive).arg(commit))?;
    ZipArchive::new(File::open(&archive)?)?.extract(&unfinished)?;
    fs::remove_file(&archive)?;
    // The folder gets its final name last, so that an interrupted checkout is never used.
    fs::rename(&unfinished, folder).with_context(|| format!("{} cannot be written", paths::short(folder)))
}
