//! `cargo xtask package`: `target/fmu/FiveBar.fmu`, the same bytes wherever it is built, verified after packing; with
//! `--all-platforms` one with a library for every machine that is shipped. The scenes, which its documentation lists, are checked.
//!
//! With `--scene FILE` a unit of one's own: the package `fivebar` writes it from the plain unit.

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

/// Content of the archive: name in the archive (`/` separators) to bytes, sorted by name.
pub(crate) type Files = BTreeMap<String, Vec<u8>>;

/// Builds, packs and verifies the unit; gives back the packed file.
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
    // A unit that is not fit for use never gets the name under which one is looked for.
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

/// Lets `fivebar unit` write a unit of one's own beside the packed plain unit, from a shipped scene or one in a file; called `name`, or
/// after the scene.
pub(crate) fn package_own(plain: &Path, scene: &Path, name: Option<&str>) -> Result<()> {
    // The command runs in the workspace root, the path is that of whoever calls.
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

/// The unit's library for a browser, and the licence files of everything in it by their names.
pub(crate) fn web() -> Result<(Vec<u8>, Files)> {
    let platform = platform::Platform::web();
    let mut linked = linked::Linked::read(platform::web_rustc, std::slice::from_ref(&platform))?;
    let library = library::build(&platform, &linked).context("the library for a browser")?;
    linked.crates.retain(|crate_| library.built.contains(&crate_.id));
    let licenses = licenses::collect(&linked, &[platform::standard_library_license()])?;
    Ok((library.bytes, licenses))
}
