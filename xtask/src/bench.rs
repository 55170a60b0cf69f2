//! `cargo xtask bench`: times and instructions, the falls of the battery, predictions through FMPy; tables under `target/bench/`. With `--check` the
//! instructions that CI checks.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{hard_cases, paths, process};
use anyhow::Result;
use std::process::Command;

/// The crate that holds the benchmarks.
const CRATE: &str = "benches";

/// Measures everything, `quick` with few repeats.
pub(crate) fn bench(quick: bool) -> Result<()> {
    for (mut program, task) in [(benches(), "run"), (hard_cases::battery(), "falls")] {
        program.args([task, "--out"]).arg(paths::in_root("target/bench"));
        if quick {
            program.arg("--quick");
        }
        process::run(&mut program)?;
    }
    let mut look_ahead = venv::python(Packages::Usual)?;
    look_ahead.arg("xtask/python/look_ahead.py").arg("--fmu").arg(package::package(Scope::Here)?);
    look_ahead.arg("--out").arg(paths::in_root("target/bench/look-ahead.csv"));
    if quick {
        look_ahead.arg("--quick");
    }
    process::run(&mut look_ahead)
}

/// The program that checks instructions against their ceilings, and that effects that are off cost nothing.
pub(crate) fn instructions() -> Command {
    let mut program = benches();
    program.arg("check");
    program
}

fn benches() -> Command {
    let mut cargo = process::cargo();
    cargo.args(["run", "--profile", "bench", "--locked", "--package", CRATE, "--"]);
    cargo
}
