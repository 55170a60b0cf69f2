//! `cargo xtask bench`: times and instructions, falls of the battery, predictions through FMPy; tables in `target/bench/`. With
//! `--check`, only the counts that CI checks; with `--pair`, the times of two builds side by side.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{hard_cases, paths, process, revision};
use anyhow::Result;
use clap::Args;
use std::path::Path;
use std::process::Command;

/// The crate with the benchmarks.
const CRATE: &str = "benches";

/// Scope of a run.
#[derive(Args)]
pub(crate) struct Options {
    /// Few repeats, scenes of at most 2 s, a sample of the falls
    #[arg(long)]
    quick: bool,
    /// Only check instructions, accesses to data and cache misses against ceilings.csv and memory.csv in measure/benches/; needs
    /// valgrind, like the whole command
    #[arg(long, conflicts_with = "quick")]
    check: bool,
    /// First replace the ceilings of memory.csv by what is measured, with its margins
    #[arg(long, requires = "check")]
    renew_memory: bool,
    /// Do not measure; use the last tables, for --update-docs
    #[arg(long, conflicts_with_all = ["quick", "check"], requires = "update_docs")]
    reuse: bool,
    /// Also write times and work of fixed steps into the docs
    #[arg(long, conflicts_with_all = ["quick", "check"])]
    update_docs: bool,
    /// Only time the present library beside the library of this commit: every scene by every method, in turns
    #[arg(long, value_name = "COMMIT", conflicts_with_all = ["check", "reuse", "update_docs"])]
    pair: Option<String>,
    /// Only cells of --pair with this in their names, such as `swing by dop853`
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true, requires = "pair")]
    only: String,
}

pub(crate) fn bench(options: &Options) -> Result<()> {
    if options.check {
        let mut program = instructions();
        if options.renew_memory {
            program.arg("--renew-memory");
        }
        return process::run(&mut program);
    }
    if let Some(commit) = &options.pair {
        return pair(&revision::packed(commit)?, &package::package(Scope::Here)?, &options.only, options.quick);
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

/// Times the library of a packed unit beside the library of another one; writes `target/bench/pair.csv`.
pub(crate) fn pair(before: &Path, after: &Path, only: &str, quick: bool) -> Result<()> {
    let out = paths::in_root("target/bench");
    let mut program = benches();
    program.args(["pair", "--only", only, "--out"]).arg(&out);
    for (which, fmu) in [("before", before), ("after", after)] {
        let folder = out.join(which);
        revision::unpack(fmu, &folder)?;
        program.arg(format!("--{which}")).arg(folder);
    }
    if quick {
        program.arg("--quick");
    }
    process::run(&mut program)
}

/// The program that checks instructions, accesses to data and cache misses against their ceilings, and that disabled effects cost nothing.
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
