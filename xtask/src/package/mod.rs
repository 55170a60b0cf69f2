//! `cargo xtask package`: `target/fmu/FiveBar.fmu`, the same bytes wherever it is built, verified after packing; with
//! `--all-platforms` one with a library for every machine that is shipped. The scenes, which its documentation lists, are checked.
//!
//! With `--scene FILE` a unit of one's own: the text of its model description is made first, the library is built with that text
//! instead of the XML, and the packed unit says itself whether it accepts its start.

mod archive;
mod documentation;
mod icon;
mod library;
mod licenses;
mod linked;
mod platform;
mod start;
mod unit;
mod verify;

pub(crate) use platform::Scope;

use crate::paths;
use ::scenes::Scene;
use anyhow::{Context, Result};
use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};
use unit::{OwnScene, Unit};

/// Content of the archive: name in the archive (`/` separators) to bytes, sorted by name.
pub(crate) type Files = BTreeMap<String, Vec<u8>>;

/// The plain unit: builds, packs, verifies; gives back the packed file.
pub(crate) fn package(scope: Scope) -> Result<PathBuf> {
    pack(&Unit::plain()?, scope)
}

/// A unit of one's own, from the scene in `file`; called `name`, or after the file.
pub(crate) fn package_own(file: &Path, name: Option<&str>, scope: Scope) -> Result<PathBuf> {
    let unit = Unit::own(file, name)?;
    if let Some(scene) = &unit.own {
        start::check_before(scene, scope)?;
    }
    let fmu = pack(&unit, scope)?;
    for sentence in unit.own.iter().flat_map(OwnScene::left_out) {
        println!("  {sentence}");
    }
    Ok(fmu)
}

/// The plain unit's library for a browser, and the licence files of everything in it by their names.
pub(crate) fn web() -> Result<(Vec<u8>, Files)> {
    let platform = platform::Platform::web();
    let mut linked = linked::Linked::read(platform::debian_rustc, std::slice::from_ref(&platform))?;
    let library = library::build(&platform, &linked, &Unit::plain()?).context("the library for a browser")?;
    linked.crates.retain(|crate_| library.built.contains(&crate_.id));
    let licenses = licenses::collect(&linked, &[platform::standard_library_license()])?;
    Ok((library.bytes, licenses))
}

fn pack(unit: &Unit, scope: Scope) -> Result<PathBuf> {
    let scenes = Scene::all()?;
    let platforms = scope.platforms();
    let mut linked = linked::Linked::read(|| scope.rustc(), &platforms)?;
    let mut files = Files::new();
    let mut built = HashSet::new();
    for platform in &platforms {
        let library = library::build(platform, &linked, unit).with_context(|| format!("the library for {}", platform.folder))?;
        files.insert(format!("binaries/{}/{}.{}", platform.folder, unit.name(), platform.extension), library.bytes);
        built.extend(library.built);
    }
    linked.crates.retain(|crate_| built.contains(&crate_.id));

    let picture = icon::picture()?;

    files.insert("modelDescription.xml".into(), unit.description.to_fmi(env!("CARGO_PKG_VERSION")).into_bytes());
    files.insert("model.png".into(), icon::render(&picture)?);
    files.insert("documentation/index.html".into(), documentation::page(unit, &scenes, &picture)?.into_bytes());
    files.extend(licenses::collect(&linked, &scope.runtime_licenses()?)?);

    let fmu = scope.file(unit.name());
    fs::create_dir_all(fmu.parent().context("the .fmu lies in a folder")?)?;
    // A unit that is not fit for use never gets the name under which one is looked for.
    let unverified = fmu.with_extension("unverified");
    archive::write(&unverified, &files)?;
    let found = judge(&unverified, unit, scope);
    if found.is_err() {
        fs::remove_file(&unverified).with_context(|| format!("{} cannot be removed", paths::short(&unverified)))?;
    }
    let report = found?;
    fs::rename(&unverified, &fmu).with_context(|| format!("{} cannot be written", paths::short(&fmu)))?;
    println!("{}: {report}", paths::short(&fmu));
    Ok(fmu)
}

/// Report on a packed unit; fails if the unit is not fit for use.
fn judge(unverified: &Path, unit: &Unit, scope: Scope) -> Result<verify::Report> {
    let report = verify::verify(unverified, scope).with_context(|| format!("{} is not fit for use", paths::short(unverified)))?;
    if unit.own.is_some() {
        start::check(unverified)?;
    }
    Ok(report)
}
