//! Prints the tables of figures; `cargo xtask estimator` builds and runs it.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use tracking::report::Table;
use tracking::{benchmark, causes, compare, detection, faults, forecast, foreign, geometry, learning, quality, singular, starts};

/// Figures of the estimator
#[derive(Parser)]
struct Arguments {
    /// Only tables with this in their names
    #[arg(long, default_value = "")]
    only: String,
    /// Fraction of the runs
    #[arg(long, default_value_t = 1.0)]
    part: f64,
    /// Added to the seeds of all runs; 0 gives the tables in the docs
    #[arg(long, default_value_t = 0)]
    seeds: u64,
    /// Only write the runs of the table `compare` to a folder, for other programs
    #[arg(long)]
    compare: Option<PathBuf>,
}

fn main() -> ExitCode {
    let Arguments { only, part, seeds, compare } = Arguments::parse();
    let runs = |all: u64| ((all as f64 * part).round() as u64).max(2);
    if let Some(folder) = compare {
        compare::write(runs(10), seeds, &folder).unwrap_or_else(|error| panic!("{}: {error:#}", folder.display()));
        return ExitCode::SUCCESS;
    }
    let tables: [(&str, &dyn Fn() -> Table); 14] = [
        ("benchmark", &|| benchmark::table(runs(60), seeds)),
        ("quality", &|| quality::table(runs(100), seeds)),
        ("compare", &|| compare::table(runs(10), seeds)),
        ("singular", &|| singular::table(part, seeds)),
        ("forecast", &|| forecast::table(runs(100), seeds)),
        ("detection", &|| detection::table(runs(60), part, seeds)),
        ("faults", &|| faults::table(runs(20), seeds)),
        ("starts", &|| starts::table(runs(20), seeds)),
        ("causes", &|| causes::table(runs(50), seeds)),
        ("foreign", &|| foreign::table(runs(20), seeds)),
        ("geometry", &|| geometry::table(runs(100), seeds)),
        ("off", &|| geometry::one_thing_off(runs(200), seeds)),
        ("workshop", &|| geometry::learned(runs(25), seeds)),
        ("learning", &|| learning::table(runs(500), seeds)),
    ];
    let mut reached = true;
    for (name, table) in tables {
        if name.contains(&only) {
            let table = table();
            println!("{}", table.markdown());
            reached &= table.figures.iter().all(tracking::report::Figure::is_reached);
        }
    }
    if reached { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
