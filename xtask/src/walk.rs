//! `cargo xtask walk`: the random walk of the conformance tests, with any length and seed.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::Result;

/// Length, seed and range of values.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Calls to make
    #[arg(long, default_value_t = 1_000_000)]
    calls: u64,
    /// Seed of the random numbers; the same seed gives the same calls
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Largest power of ten of extreme values
    #[arg(long, default_value_t = 308)]
    largest: u32,
}

pub(crate) fn walk(options: &Options) -> Result<()> {
    let Options { calls, seed, largest } = options;
    let fmu = package::package(Scope::Here)?;
    process::run(
        venv::python(Packages::Usual)?
            .args(["-m", "pytest", "-rP", "tests/python/test_conformance.py", "-k", "test_random_walk"])
            .arg("--override-ini")
            .arg(format!("cache_dir={}", paths::in_root("target/pytest").display()))
            .env("FIVEBAR_FMU", fmu)
            .env("FIVEBAR_WALK", format!("{calls} {seed} {largest}")),
    )
}
