//! `cargo xtask hard-cases`: the battery of hard cases; tables and pictures under `target/hard-cases/`.

use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::{Context, Result, ensure};
use clap::Args;
use std::fs;
use std::path::PathBuf;
use std::process::Command;

/// The crate with the battery.
const CRATE: &str = "hard-cases";

/// Scope of a run.
#[derive(Args)]
pub(crate) struct Options {
    /// Run only a sample of every case
    #[arg(long)]
    quick: bool,
    /// Do not run; use the last tables, for --update-docs
    #[arg(long, conflicts_with = "quick", requires = "update_docs")]
    reuse: bool,
    /// Also write tables and pictures into docs/hard-cases.md and its notes
    #[arg(long, conflicts_with = "quick")]
    update_docs: bool,
}

pub(crate) fn hard_cases(options: &Options) -> Result<()> {
    if !options.reuse {
        run(options.quick)?;
    }
    if !options.update_docs {
        return Ok(());
    }
    process::run(venv::python(Packages::Usual)?.arg("xtask/python/hard_cases_in_docs.py").arg("--folder").arg(folder()))
}

/// Runs the battery (if `quick`, a sample) and draws its pictures; fails if a judged case fails.
pub(crate) fn run(quick: bool) -> Result<()> {
    let out = folder();
    fs::create_dir_all(&out).with_context(|| format!("{} cannot be made", paths::short(&out)))?;
    let unoptimised = unoptimised_fingerprint(&out)?;
    let mut cases = battery();
    cases.args(["run", "--out"]).arg(&out);
    cases.arg("--unoptimised").arg(unoptimised);
    if quick {
        cases.arg("--quick");
    }
    // Pictures are most useful when a case fails.
    let table = out.join("hard-cases.csv");
    remove(&table)?;
    let outcome = process::run(&mut cases);
    ensure!(table.is_file(), outcome.map_or_else(|error| format!("{error:#}"), |()| "the battery wrote no table".into()));
    process::run(venv::python(Packages::Usual)?.arg("xtask/python/hard_cases.py").arg("--folder").arg(&out))?;
    outcome.with_context(|| {
        format!("a case is not met; {} says which, with exact inputs", paths::short(&out.join("hard-cases.md")))
    })?;
    let scenes = if quick { "14" } else { "420" };
    process::run(battery().args(["coaxial", "--scenes", scenes, "--out"]).arg(&out))
        .with_context(|| format!("a run with coaxial motors is wrong; {} says which", paths::short(&out.join("coaxial.csv"))))
}

fn folder() -> PathBuf {
    paths::in_root("target/hard-cases")
}

/// Command of the battery's program, without arguments.
pub(crate) fn battery() -> Command {
    let mut cargo = process::cargo();
    cargo.args(["run", "--release", "--locked", "--package", CRATE, "--"]);
    cargo
}

/// Writes the bits of a sample of the battery, from an unoptimised build, to a file.
fn unoptimised_fingerprint(out: &std::path::Path) -> Result<PathBuf> {
    let packages = ["fivebar", CRATE, "nalgebra", "wide"];
    let mut cargo = process::cargo();
    cargo.args(["run", "--quiet", "--locked", "--package", CRATE, "--target-dir"]).arg(out.join("unoptimised"));
    for package in packages {
        cargo.arg("--config").arg(format!("profile.dev.package.{package}.opt-level=0"));
    }
    let text = process::run_for_output(cargo.args(["--", "fingerprint"]))?;
    let file = out.join("unoptimised.txt");
    fs::write(&file, text).with_context(|| format!("{} cannot be written", paths::short(&file)))?;
    Ok(file)
}

fn remove(file: &std::path::Path) -> Result<()> {
    match fs::remove_file(file) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("{} cannot be replaced", paths::short(file)))
        }
        _ => Ok(()),
    }
}
