//! `cargo xtask prices`: the cost of the effects of each scene against the bare mechanism.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::Result;

/// Packs the unit and measures every scene with and without its effects; writes `target/run/prices.csv`.
pub(crate) fn prices(method: Option<&str>) -> Result<()> {
    let fmu = package::package(Scope::Here)?;
    let mut python = venv::python(Packages::Usual)?;
    python.arg("xtask/python/prices.py").arg("--fmu").arg(fmu).arg("--scenes").arg(paths::scenes());
    python.arg("--out").arg(paths::in_root("target/run/prices.csv"));
    if let Some(method) = method {
        python.args(["--method", method]);
    }
    process::run(&mut python)
}
