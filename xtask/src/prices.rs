//! `cargo xtask prices`: what the effects of each scene cost against the bare mechanism.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::Result;

/// Packs the unit and measures every scene with its effects and without; the table goes to `target/run/prices.csv`.
pub(crate) fn prices() -> Result<()> {
    let fmu = package::package(Scope::Here)?;
    process::run(
        venv::python(Packages::Usual)?
            .arg("xtask/python/prices.py")
            .arg("--fmu")
            .arg(fmu)
            .arg("--scenes")
            .arg(paths::resolved_scenes())
            .arg("--out")
            .arg(paths::in_root("target/run/prices.csv")),
    )
}
