//! `cargo xtask estimator`: how well machines are followed; tables of figures on the terminal.

use anyhow::Result;

use crate::process;

/// Makes a part of the runs of the tables whose name contains `only`; fails if a figure is not reached.
pub(crate) fn estimator(only: &str, part: f64, seeds: u64) -> Result<()> {
    let mut cargo = process::cargo();
    cargo.args(["run", "--release", "--locked", "--package", "tracking", "--", "--only", only]);
    process::run(cargo.args(["--part", &part.to_string(), "--seeds", &seeds.to_string()]))
}
