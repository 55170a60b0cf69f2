//! The benchmarks. `cargo xtask bench` builds and starts this program, with the options of the library in the .fmu (fat link-time
//! optimisation, one codegen unit).
//!
//! | file | content |
//! | --- | --- |
//! | `case.rs` | a case: work of many equal operations, counted and timed by the same code |
//! | `cases/` | the cases, one file per table |
//! | `scene.rs` | parameters and inputs by the names of variables |
//! | `host.rs` | a master that calls the C functions through pointers |
//! | `count.rs` | instructions, accesses to data and cache misses, by callgrind |
//! | `pair.rs` | two builds of the library side by side |
//! | `loaded.rs` | another build of the library, loaded from its .fmu |
//! | `scenes.rs` | the time of each call along the scenes |
//! | `check.rs` | ceilings, and that disabled effects cost nothing |
//! | `report.rs` | tables and the machine of the measurement |

mod case;
mod cases;
mod check;
mod count;
mod host;
mod loaded;
mod pair;
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
    /// Time two builds of the library side by side: every scene by every method
    Pair {
        /// Folder of an unpacked .fmu
        #[arg(long)]
        before: PathBuf,
        /// Folder of the other one
        #[arg(long)]
        after: PathBuf,
        /// Folder of the table
        #[arg(long)]
        out: PathBuf,
        /// Only cells with this in their names
        #[arg(long, default_value = "")]
        only: String,
        /// Few pairs of scenes up to 0.1 s
        #[arg(long)]
        quick: bool,
    },
    /// Check instructions, accesses to data and cache misses against their ceilings, and that disabled effects cost nothing; no times
    Check {
        /// First replace the ceilings of memory.csv by what is measured, with its margins
        #[arg(long)]
        renew_memory: bool,
    },
    /// Run cases once; `run` and `check` call it under callgrind
    Count {
        /// Only cases that call C functions, instead of all others
        #[arg(long)]
        calls: bool,
    },
}

fn main() -> ExitCode {
    let outcome = match Arguments::parse().command {
        Command::Run { out, quick } => report::run(&out, quick),
        Command::Pair { before, after, out, only, quick } => pair::run(&before, &after, &out, &pair::Extent::new(&only, quick)),
        Command::Check { renew_memory } => check::check(renew_memory),
        Command::Count { calls } => count::each_once(calls),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
