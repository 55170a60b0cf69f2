//! `cargo xtask package`: `target/fmu/FiveBar.fmu`, the same bytes wherever it is built, verified after packing.

mod archive;
mod documentation;
mod icon;
mod library;
mod licenses;
mod linked;
mod verify;

use crate::paths;
use anyhow::{Context, Result};
use model_description::ModelDescription;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// What goes into the archive: name in the archive (`/` separators) to content, sorted by name.
type Files = BTreeMap<String, Vec<u8>>;

/// Builds, packs, verifies; gives back the file of the packed unit.
pub(crate) fn package() -> Result<PathBuf> {
    let description = ModelDescription::read().context("modelDescription/modelDescription.xml")?;
    let linked = linked::Linked::read()?;
    let library = library::build(&linked)?;
    let picture = icon::picture()?;

    let mut files = Files::new();
    files.insert(
        "modelDescription.xml".into(),
        description.to_fmi(env!("CARGO_PKG_VERSION")).into_bytes(),
    );
    files.insert("model.png".into(), icon::render(&picture)?);
    files.insert(
        "documentation/index.html".into(),
        documentation::page(&description, &picture)?.into_bytes(),
    );
    files.extend(licenses::collect(&linked)?);
    files.insert(
        format!(
            "binaries/{}/{}.{}",
            library::fmi_platform(),
            description.model_identifier,
            std::env::consts::DLL_EXTENSION
        ),
        library,
    );

    let fmu = paths::fmu();
    archive::write(&fmu, &files)?;
    let report = verify::verify(&fmu)
        .with_context(|| format!("{} does not hold what it must", paths::short(&fmu)))?;
    println!("{}: {report}", paths::short(&fmu));
    Ok(fmu)
}
