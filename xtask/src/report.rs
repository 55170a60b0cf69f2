//! `cargo xtask report`: accuracy against wall time, measured and drawn; the page under `target/report/`.

use crate::venv::{self, Packages};
use crate::{bench, hard_cases, paths, process, run};
use anyhow::Result;
use clap::Args;
use std::fs;

/// The crate that measures.
const CRATE: &str = "accuracy";
/// The scenes of the paper, shown on the page.
const PAPER: [&str; 2] = ["paper_torque", "paper_free_fall"];

/// Scope of a run.
#[derive(Args)]
pub(crate) struct Options {
    /// Measure only a sample of everything
    #[arg(long)]
    quick: bool,
    /// Do not measure; draw the last measurements again
    #[arg(long, conflicts_with = "quick")]
    reuse: bool,
    /// Also write tables and pictures into the docs: accuracy, ratios, times of steps, hard cases
    #[arg(long, conflicts_with = "quick")]
    update_docs: bool,
}

/// Measures and writes `target/report/index.html`.
pub(crate) fn report(options: &Options) -> Result<()> {
    let folder = paths::in_root("target/report");
    if !options.reuse {
        measure(options.quick)?;
    }
    let mut python = venv::python(Packages::Usual)?;
    python.arg("xtask/python/write_report.py").arg("--folder").arg(&folder);
    for name in ["bench", "hard-cases", "peers"] {
        python.arg(format!("--{name}")).arg(paths::in_root("target").join(name));
    }
    python.arg("--runs").arg(paths::in_root("target/run"));
    if options.update_docs {
        python.arg("--update-docs");
    }
    process::run(&mut python)
}

fn measure(quick: bool) -> Result<()> {
    let mut accuracy = process::cargo();
    accuracy.args(["run", "--release", "--locked", "--package", CRATE, "--", "--out"]).arg(paths::in_root("target/report/data"));
    accuracy.arg("--about").arg(about(if quick { "cargo xtask report --quick" } else { "cargo xtask report" })?);
    if quick {
        accuracy.arg("--quick");
    }
    process::run(&mut accuracy)?;
    for scene in PAPER {
        run::run(scene, None)?;
    }
    // The page is written even if a case fails or valgrind, which counts instructions, is missing.
    for outcome in [hard_cases::run(quick), bench::measure(quick)] {
        if let Err(error) = outcome {
            eprintln!("the page will mention it: {error:#}");
        }
    }
    Ok(())
}

/// Machine, load, compiler, commit and command; heads every table.
pub(crate) fn about(command: &str) -> Result<String> {
    let said = |program: &str, arguments: &[&str]| process::output(process::program(program).args(arguments));
    let cpu_info = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let cpu = cpu_info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    let cpu = cpu.map_or("an unnamed processor", |(_, name)| name.trim());
    let cores = std::thread::available_parallelism()?;
    let load = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let load = load.split(' ').next().filter(|load| !load.is_empty()).unwrap_or("unknown");
    let changed = if said("git", &["status", "--porcelain", "--untracked-files=no"])?.is_empty() { "" } else { " with changes" };
    Ok(format!(
        "{cpu}, {cores} cores, {} {}, load {load} at the start; {}; commit {}{changed}; {command}",
        std::env::consts::OS,
        std::env::consts::ARCH,
        said("rustc", &["--version"])?.trim(),
        said("git", &["rev-parse", "--short=12", "HEAD"])?.trim(),
    ))
}
