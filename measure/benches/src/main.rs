//! The benchmarks. `cargo xtask bench` builds and starts this program, with the options of the library in the .fmu (fat link-time
//! optimisation, one codegen unit).
//!
//! | file | content |
//! | --- | --- |
//! | `case.rs` | a case: work of many equal operations, counted and timed by the same code |
//! | `cases/` | the cases, one file per table |
//! | `scene.rs` | parameters and inputs by the names of variables |
//! | `host.rs` | a master that calls the C functions through pointers |
//! | `count.rs` | instructions, by callgrind |
//! | `scenes.rs` | the time of each call along the scenes |
//! | `check.rs` | ceilings, and that disabled effects cost nothing |
//! | `report.rs` | tables and the machine of the measurement |

mod case;
mod cases;
mod check;
mod count;
mod host;
mod report;
mod scene;
mod scenes;

use clap::{Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

/// The benchmarks; started by `cargo xtask bench`
#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Measure times and instructions of everything, as tables
    Run {
        /// Folder of the tables
        #[arg(long)]
        out: PathBuf,
        /// Fewer repeats, scenes up to 2 s
        #[arg(long)]
        quick: bool,
    },
    /// Check instructions against their ceilings, and that disabled effects cost nothing; no times
    Check,
    /// Run every case once; `run` and `check` call it under callgrind
    Count,
}

fn main() -> ExitCode {
    let outcome = match Arguments::parse().command {
        Command::Run { out, quick } => report::run(&out, quick),
        Command::Check => check::check(),
        Command::Count => count::each_once(),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
