//! `cargo xtask peers`: other programs and the packed unit over the same scenes; no part of CI. Sources of compiled peers are in
//! `xtask/peers/`, outside the workspace.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process, report};
use anyhow::Result;
use clap::Args;

/// Programs to run, and where their tables go.
#[derive(Args)]
pub(crate) struct Options {
    /// Names of the programs to run [default: all]
    only: Vec<String>,
    /// Do not measure; for --update-docs, from the last measurements
    #[arg(long, conflicts_with = "only", requires = "update_docs")]
    reuse: bool,
    /// Also write the tables into docs/notes/peers.md
    #[arg(long, conflicts_with = "only")]
    update_docs: bool,
}

/// Runs programs and writes their measurements.
pub(crate) fn peers(options: &Options) -> Result<()> {
    if !options.reuse {
        measure(&options.only)?;
    }
    if !options.update_docs {
        return Ok(());
    }
    process::run(
        venv::python(Packages::Usual)?.arg("xtask/python/peers_in_docs.py").arg("--peers").arg(paths::in_root("target/peers")),
    )
}

/// Runs those named in `only`, or all; the table goes to `target/peers/peers.csv`.
fn measure(only: &[String]) -> Result<()> {
    let fmu = package::package(Scope::Here)?;
    let mut command = venv::python(Packages::Peers)?;
    command.arg("xtask/python/peers/run.py").arg("--fmu").arg(fmu);
    command.arg("--references").arg(paths::in_root("tests/data/reference"));
    command.arg("--about").arg(report::about(
        &["cargo xtask peers"].into_iter().chain(only.iter().map(String::as_str)).collect::<Vec<_>>().join(" "),
    )?);
    command.arg("--out").arg(paths::in_root("target/peers/peers.csv"));
    if !only.is_empty() {
        command.arg("--only").args(only);
    }
    process::run(&mut command)
}
