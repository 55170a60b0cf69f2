//! The benchmarks: started by `cargo xtask bench`, which builds this program as the library is built for the .fmu (fat link-time
//! optimisation, one codegen unit).
//!
//! | file | holds |
//! | --- | --- |
//! | `case.rs` | a case: something to do a number of times, counted and timed by the same code |
//! | `cases/` | the cases, one file per table |
//! | `scene.rs` | parameters and inputs by the names of variables |
//! | `host.rs` | a master: the C functions through pointers |
//! | `count.rs` | instructions, by callgrind |
//! | `scenes.rs` | the time of each call along the scenes |
//! | `check.rs` | ceilings, and effects that are off cost nothing |
//! | `report.rs` | tables and the machine they were made on |

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
    /// Times and instructions of everything, as tables
    Run {
        /// Folder of the tables
        #[arg(long)]
        out: PathBuf,
        /// Fewer repeats, scenes up to 2 s
        #[arg(long)]
        quick: bool,
    },
    /// Instructions against their ceilings, and effects that are off cost nothing; no times
    Check,
    /// Every case once, for `run` and `check` under callgrind
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
