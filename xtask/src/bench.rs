//! `cargo xtask bench`: times and instructions, and the falls of the battery; tables under `target/bench/`. With `--check` the
//! instructions that CI checks.

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
    Ok(())
}

/// Instructions against their ceilings, and that what is off costs nothing.
pub(crate) fn check() -> Result<()> {
    process::run(benches().arg("check"))
}

fn benches() -> Command {
    let mut cargo = process::cargo();
    cargo.args(["run", "--profile", "bench", "--locked", "--package", CRATE, "--"]);
    cargo
}
