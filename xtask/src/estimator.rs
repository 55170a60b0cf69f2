//! `cargo xtask estimator`: how well machines are followed; tables of figures on the terminal.

use anyhow::Result;

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process};

/// The table of other ways to follow, which asks for Python's as well.
const COMPARE: &str = "compare";

/// Makes a part of the runs of the tables whose name contains `only`; fails if a figure is not reached.
pub(crate) fn estimator(only: &str, part: f64, seeds: u64) -> Result<()> {
    let tracking = || {
        let mut cargo = process::cargo();
        cargo.args(["run", "--release", "--locked", "--package", "tracking", "--", "--part", &part.to_string()]);
        cargo.args(["--seeds", &seeds.to_string()]);
        cargo
    };
    // All parts but the comparison, which follows with the filters written in Python.
    let own = if COMPARE.contains(only) && !only.is_empty() { Ok(()) } else { process::run(tracking().args(["--only", only])) };
    if COMPARE.contains(only) {
        let folder = paths::in_root("target/estimator");
        process::run(tracking().arg("--compare").arg(&folder))?;
        let fmu = package::package(Scope::Here)?;
        process::run(
            venv::python(Packages::Filters)?
                .arg("xtask/python/followers.py")
                .arg("--fmu")
                .arg(fmu)
                .arg("--runs")
                .arg(folder)
                .arg("--picture")
                .arg(paths::in_root("docs/images/followers.svg")),
        )?;
    }
    own
}
