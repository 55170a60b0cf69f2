//! `cargo xtask peers`: other programs and the packed unit on the same scenes; not part of CI. Sources of compiled peers are in
//! `xtask/peers/`, outside the workspace.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process, report};
use anyhow::Result;
use clap::Args;

/// Programs to run, and use of their tables.
#[derive(Args)]
pub(crate) struct Options {
    /// Names of the programs to run [default: all]
    only: Vec<String>,
    /// Do not measure; use the last measurements, for --update-docs
    #[arg(long, conflicts_with = "only", requires = "update_docs")]
    reuse: bool,
    /// Also write the tables into docs/notes/peers.md
    #[arg(long, conflicts_with = "only")]
    update_docs: bool,
}

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

/// Runs the programs in `only`, or all; writes `target/peers/peers.csv`.
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
