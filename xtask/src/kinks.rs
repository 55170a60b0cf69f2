//! `cargo xtask kinks`: the picture of loads with kinks in docs/effects.md.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::Result;

/// Packs the unit, runs three scenes and draws stick-slip, a bounce and a hold to docs/images/kinks.svg.
pub(crate) fn kinks() -> Result<()> {
    let fmu = package::package(Scope::Here)?;
    process::run(
        venv::python(Packages::Usual)?
            .arg("xtask/python/kink_pictures.py")
            .arg("--fmu")
            .arg(fmu)
            .arg("--scenes")
            .arg(paths::scenes())
            .arg("--out")
            .arg(paths::in_root("docs/images/kinks.svg")),
    )
}
