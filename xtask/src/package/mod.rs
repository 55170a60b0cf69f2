//! `cargo xtask package`: `target/fmu/FiveBar.fmu`, the same bytes wherever it is built, verified after packing; with
//! `--all-platforms` one with a library for every machine that is shipped. The scenes, which its documentation lists, are checked and
//! written to `target/scenes/` for the Python programs that drive it.

mod archive;
mod documentation;
mod icon;
mod library;
mod licenses;
mod linked;
mod platform;
mod verify;

pub(crate) use platform::Scope;

use crate::{paths, scenes};
use ::scenes::Scene;
use anyhow::{Context, Result};
use model_description::ModelDescription;
use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::path::PathBuf;

/// What goes into the archive: name in the archive (`/` separators) to content, sorted by name.
type Files = BTreeMap<String, Vec<u8>>;

/// Builds, packs, verifies; gives back the file of the packed unit.
pub(crate) fn package(scope: Scope) -> Result<PathBuf> {
    let description = ModelDescription::read().context("modelDescription/modelDescription.xml")?;
    let scenes = Scene::all()?;
    scenes::write(&scenes)?;
    let mut linked = linked::Linked::read(scope)?;
    let mut files = Files::new();
    let mut built = HashSet::new();
    for platform in scope.platforms() {
        let library = library::build(&platform, &linked).with_context(|| format!("the library for {}", platform.folder))?;
        let name = format!("binaries/{}/{}.{}", platform.folder, description.model_identifier, platform.extension);
        files.insert(name, library.bytes);
        built.extend(library.built);
    }
    linked.crates.retain(|crate_| built.contains(&crate_.id));

    let picture = icon::picture()?;

    files.insert("modelDescription.xml".into(), description.to_fmi(env!("CARGO_PKG_VERSION")).into_bytes());
    files.insert("model.png".into(), icon::render(&picture)?);
    files.insert("documentation/index.html".into(), documentation::page(&description, &scenes, &picture)?.into_bytes());
    files.extend(licenses::collect(&linked, scope)?);

    let fmu = scope.file();
    fs::create_dir_all(fmu.parent().context("the .fmu lies in a folder")?)?;
    // A unit that is not fit for use never gets the name under which one is looked for.
    let unverified = fmu.with_extension("unverified");
    archive::write(&unverified, &files)?;
    let report = verify::verify(&unverified, scope.glibc_floor())
        .with_context(|| format!("{} is not fit for use", paths::short(&unverified)))?;
    fs::rename(&unverified, &fmu).with_context(|| format!("{} cannot be written", paths::short(&fmu)))?;
    println!("{}: {report}", paths::short(&fmu));
    Ok(fmu)
}
