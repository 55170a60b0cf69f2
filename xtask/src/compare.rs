//! `cargo xtask compare`: runs every scene by every method on two builds of the library; reports differences, and whether they are
//! round-off.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process, revision};
use anyhow::Result;

pub(crate) fn compare(revision: &str) -> Result<()> {
    let before = revision::packed(revision)?;
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
