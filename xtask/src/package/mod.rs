//! `cargo xtask package`: `target/fmu/FiveBar.fmu`, the same bytes on every build, verified after packing; with `--all-platforms` one
//! with a library for every shipped platform. Also checks the scenes, because the documentation lists them.
//!
//! With `--scene FILE` the package `fivebar` also writes a unit of one's own from the plain unit.

mod archive;
mod documentation;
mod icon;
mod library;
mod licenses;
mod linked;
mod macos;
mod platform;
mod verify;

pub(crate) use platform::Scope;

use crate::venv::{self, Packages};
use crate::{paths, process};
use ::scenes::Scene;
use anyhow::{Context, Result};
use model_description::ModelDescription;
use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::path::{self, Path, PathBuf};

/// Content of the archive: names (with `/` separators) and bytes, sorted by name.
pub(crate) type Files = BTreeMap<String, Vec<u8>>;

/// Builds, packs and verifies the unit; returns the packed file.
pub(crate) fn package(scope: Scope) -> Result<PathBuf> {
    let description = description()?;
    let name = &description.model_identifier;
    let scenes = Scene::all()?;
    let platforms = scope.platforms();
    let mut linked = linked::Linked::read(|| scope.rustc(), &platforms)?;
    let mut files = Files::new();
    let mut built = HashSet::new();
    for platform in &platforms {
        let library = library::build(platform, &linked).with_context(|| format!("the library for {}", platform.folder))?;
        let file = format!("binaries/{}/{name}.{}", platform.folder, platform.extension);
        let bytes = match files.remove(&file) {
            None => library.bytes,
            Some(other) => macos::universal(other, library.bytes)?,
        };
        files.insert(file, bytes);
        built.extend(library.built);
    }
    linked.crates.retain(|crate_| built.contains(&crate_.id));

    let picture = icon::picture()?;

    files.insert("modelDescription.xml".into(), description.to_fmi(env!("CARGO_PKG_VERSION")).into_bytes());
    files.insert("model.png".into(), icon::render(&picture)?);
    files.insert("documentation/index.html".into(), documentation::page(&description, &scenes, &picture)?.into_bytes());
    files.extend(licenses::collect(&linked, &scope.runtime_licenses()?)?);

    let fmu = scope.file(name);
    fs::create_dir_all(fmu.parent().context("the .fmu lies in a folder")?)?;
    // The file gets its final name last, so that an invalid unit is never used.
    let unverified = fmu.with_extension("unverified");
    archive::write(&unverified, &files)?;
    let found = verify::verify(&unverified, scope).with_context(|| format!("{} is not fit for use", paths::short(&unverified)));
    if found.is_err() {
        fs::remove_file(&unverified).with_context(|| format!("{} cannot be removed", paths::short(&unverified)))?;
    }
    let report = found?;
    fs::rename(&unverified, &fmu).with_context(|| format!("{} cannot be written", paths::short(&fmu)))?;
    println!("{}: {report}", paths::short(&fmu));
    Ok(fmu)
}

/// Runs `fivebar unit`, which writes a unit of one's own beside the packed plain unit from a shipped scene or a file. Its name is `name`,
/// or the scene's.
pub(crate) fn package_own(plain: &Path, scene: &Path, name: Option<&str>) -> Result<()> {
    // The command runs in the workspace root, but the path is relative to the caller's folder.
    let scene = if scene.extension().is_some() { path::absolute(scene)? } else { scene.into() };
    process::run(
        venv::python(Packages::Usual)?
            .args(["-m", "fivebar", "unit", "--scene"])
            .arg(scene)
            .arg("--out")
            .arg(plain.parent().context("a unit lies in a folder")?)
            .args(name.map(|name| format!("--name={name}")))
            .env("FIVEBAR_FMU", plain),
    )
}

fn description() -> Result<ModelDescription> {
    ModelDescription::read().context("modelDescription/modelDescription.xml")
}

/// The unit's library for a browser, and all licence files by name.
pub(crate) fn web() -> Result<(Vec<u8>, Files)> {
    let platform = platform::Platform::web();
    let mut linked = linked::Linked::read(platform::web_rustc, std::slice::from_ref(&platform))?;
    let library = library::build(&platform, &linked).context("the library for a browser")?;
    linked.crates.retain(|crate_| library.built.contains(&crate_.id));
    let licenses = licenses::collect(&linked, &[platform::standard_library_license()])?;
    Ok((library.bytes, licenses))
}
