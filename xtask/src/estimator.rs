//! `cargo xtask estimator`: accuracy of following machines; tables on the terminal.

use anyhow::Result;

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process};

/// The comparison table, which also needs Python.
const COMPARE: &str = "compare";

/// Runs the tables with `only` in their names, with the fraction `part` of their runs; fails if a figure misses its target.
pub(crate) fn estimator(only: &str, part: f64, seeds: u64) -> Result<()> {
    let tracking = || {
        let mut cargo = process::cargo();
        cargo.args(["run", "--release", "--locked", "--package", "tracking", "--", "--part", &part.to_string()]);
        cargo.args(["--seeds", &seeds.to_string()]);
        cargo
    };
    // If only the comparison is requested, skip the tables. The block below writes the runs, which the Python filters then read.
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
