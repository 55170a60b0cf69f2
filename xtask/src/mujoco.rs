//! `cargo xtask mujoco`: the unit follows a machine that MuJoCo simulates; a table of errors, bands, forecasts and alarms.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::Result;
use clap::Args;

/// Output folder.
const OUT: &str = "target/mujoco";

#[derive(Args)]
pub(crate) struct Options {
    /// Duration of the motion, minutes
    #[arg(long, default_value_t = 20.0)]
    minutes: f64,
    /// Seed of the machine, its motion and the pushes
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Packs the unit, simulates the machine and follows it.
pub(crate) fn mujoco(options: &Options) -> Result<()> {
    let fmu = package::package(Scope::Here)?;
    let mut python = venv::python(Packages::Mujoco)?;
    python.arg(paths::in_root("measure/mujoco/follow.py")).arg("--fmu").arg(fmu).arg("--out").arg(paths::in_root(OUT));
    python.arg("--minutes").arg(options.minutes.to_string()).arg("--seed").arg(options.seed.to_string());
    process::run(&mut python)
}
