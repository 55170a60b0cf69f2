//! `cargo xtask bench`: times and instructions, falls of the battery, predictions through FMPy; tables in `target/bench/`. With
//! `--check`, only the instruction counts that CI checks.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{hard_cases, paths, process};
use anyhow::Result;
use clap::Args;
use std::process::Command;

/// The crate with the benchmarks.
const CRATE: &str = "benches";

/// Scope of a run.
#[derive(Args)]
pub(crate) struct Options {
    /// Few repeats, scenes of at most 2 s, a sample of the falls
    #[arg(long)]
    quick: bool,
    /// Only check instructions against the ceilings of measure/benches/ceilings.csv; needs valgrind, like the whole command
    #[arg(long, conflicts_with = "quick")]
    check: bool,
    /// Do not measure; use the last tables, for --update-docs
    #[arg(long, conflicts_with_all = ["quick", "check"], requires = "update_docs")]
    reuse: bool,
    /// Also write times and work of fixed steps into the docs
    #[arg(long, conflicts_with_all = ["quick", "check"])]
    update_docs: bool,
}

pub(crate) fn bench(options: &Options) -> Result<()> {
    if options.check {
        return process::run(&mut instructions());
    }
    if !options.reuse {
        measure(options.quick)?;
    }
    if !options.update_docs {
        return Ok(());
    }
    let mut python = venv::python(Packages::Usual)?;
    process::run(python.arg("xtask/python/step_times_in_docs.py").arg("--folder").arg(paths::in_root("target/bench")))
}

/// Measures everything; if `quick`, with few repeats.
pub(crate) fn measure(quick: bool) -> Result<()> {
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

/// The program that checks instructions against their ceilings, and that disabled effects cost nothing.
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
