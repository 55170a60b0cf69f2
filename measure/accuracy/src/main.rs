//! Measures accuracy against wall time and writes the tables; `cargo xtask report` builds and runs it and draws the tables.

use std::path::PathBuf;
use std::process::ExitCode;

use accuracy::{Extent, Folder, Scene, energy, horizon, precision, steps};
use anyhow::Result;
use clap::Parser;

/// Measures accuracy against wall time
#[derive(Parser)]
struct Arguments {
    /// The folder of the tables
    #[arg(long)]
    out: PathBuf,
    /// Machine, compiler, commit and command: the head line of every table
    #[arg(long)]
    about: String,
    /// A sample, within seconds
    #[arg(long)]
    quick: bool,
}

fn main() -> ExitCode {
    match measure(Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn measure(Arguments { out, about, quick }: Arguments) -> Result<()> {
    let extent = if quick { Extent::Quick } else { Extent::Full };
    let folder = Folder::new(out, about)?;

    precision::write(&folder, &Scene::judged(extent)?, extent)?;
    steps::write(&folder, extent)?;
    horizon::write(&folder, extent)?;
    energy::write(&folder, extent)
}
