//! The commands of this repository, started as `cargo xtask`; one file per command.

mod bench;
mod compare;
mod estimator;
mod format;
mod hard_cases;
mod kinks;
mod mujoco;
mod package;
mod page;
mod paths;
mod peers;
mod prices;
mod process;
mod release;
mod report;
mod revision;
mod run;
mod scenes;
mod site;
mod stamp;
mod test;
mod twin;
mod venv;
mod walk;
mod wheel;

use anyhow::Result;
use clap::{Parser, Subcommand};
use package::Scope;
use std::path::PathBuf;
use std::process::ExitCode;
use test::Level;

/// The commands of this repository
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Build and pack the FMU, run a scene through FMPy, write CSV, pictures and an animation to target/run/
    Run {
        /// A file of scenes/, without `.json`
        #[arg(long, default_value = "paper_free_fall")]
        scene: String,
        /// A method (an item of `solver.method`) instead of the scene's own
        #[arg(long)]
        method: Option<String>,
    },
    /// Run the live twin in real time: simulated machine, corrector, recorder, watch and dashboard on a broker; write target/twin/
    Twin(twin::Options),
    /// Check everything: format, lints, Rust tests, documentation, packaging, Python tests
    Test {
        /// Also run the tests that need Debian packages (installed by .ci/setup): browsers, other masters, memory and threads under
        /// valgrind. CI runs this
        #[arg(long)]
        full: bool,
        /// Run all of these, long tests, --platforms and --page
        #[arg(long, conflicts_with = "full")]
        nightly: bool,
        /// Pack for all platforms and test this unit; runs libraries under wine and qemu (installed by .ci/setup-platforms)
        #[arg(long, conflicts_with_all = ["full", "nightly"])]
        platforms: bool,
        /// Only build the master fmi-sim, which takes minutes, and drive the FMU with it (needs .ci/setup-fmi-sim)
        #[arg(long, conflicts_with_all = ["full", "nightly", "platforms"])]
        fmi_sim: bool,
        /// Only make the live page, compare its bits with the unit's and open it in a browser (needs .ci/setup-page)
        #[arg(long, conflicts_with_all = ["full", "nightly", "platforms", "fmi_sim"])]
        page: bool,
    },
    /// Format every .rs file, also modules that a macro declares and `cargo fmt` therefore misses
    Format {
        /// Change nothing; fail if a file is not formatted
        #[arg(long)]
        check: bool,
    },
    /// Compare the library with an earlier revision, every scene by every method: same bits, or the size of the differences
    Compare {
        /// A revision that git knows
        #[arg(default_value = "HEAD")]
        revision: String,
    },
    /// Make random calls, legal and illegal, on the packed library and check each against FMI's table of allowed calls
    Walk(walk::Options),
    /// Run the battery of hard cases by every method, write tables and pictures to target/hard-cases/
    HardCases(hard_cases::Options),
    /// Measure how accurately machines are followed, print figures beside their targets; half an hour
    Estimator {
        /// Only tables with this in their names: benchmark, quality, compare, singular, forecast, detection, faults, starts, causes,
        /// foreign, geometry, workshop, learning
        #[arg(long, default_value = "")]
        only: String,
        /// Fraction of the runs
        #[arg(long, default_value_t = 1.0)]
        part: f64,
        /// Added to the seeds of all runs
        #[arg(long, default_value_t = 0)]
        seeds: u64,
    },
    /// Follow a machine with play, soft links and friction that MuJoCo simulates; write target/mujoco/
    Mujoco(mujoco::Options),
    /// Measure accuracy against wall time, write the page target/report/index.html
    Report(report::Options),
    /// Run other programs on the same scenes beside ours, write target/peers/peers.csv; needs packages of some 2 GB
    Peers(peers::Options),
    /// Measure times and instructions, write tables to target/bench/
    Bench(bench::Options),
    /// Measure the cost of the effects of each scene against the bare mechanism, write target/run/prices.csv
    Prices {
        /// An item of solver.method, for all scenes [default: the method of each]
        #[arg(long, value_name = "NAME")]
        method: Option<String>,
    },
    /// Draw stick-slip, a bounce and a hold for docs/effects.md, write docs/images/kinks.svg
    Kinks,
    /// Build the library, pack it as target/fmu/FiveBar.fmu and verify the archive
    Package {
        /// Also make a unit of one's own, target/fmu/NAME.fmu; start values, experiment and description come from this scene file, or from
        /// a shipped scene
        #[arg(long, value_name = "FILE")]
        scene: Option<PathBuf>,
        /// Name of the unit of one's own [default: the file's name in CamelCase]
        #[arg(long, requires = "scene")]
        name: Option<String>,
        /// With libraries for all shipped platforms, in target/fmu/all-platforms/: takes minutes
        #[arg(long)]
        all_platforms: bool,
    },
    /// Build the Python package with the unit, the scenes and the live page (if it has been made): target/wheel/
    Wheel {
        /// With libraries for all shipped platforms: takes minutes
        #[arg(long)]
        all_platforms: bool,
    },
    /// Make the files of a release, target/release-files/: wheel, sdist, FiveBar.fmu, licences, notes, a bill of materials and
    /// checksums; takes minutes
    Release {
        /// With the library of this machine only, for a look at the files
        #[arg(long)]
        this_platform: bool,
    },
    /// Pin the Python packages that python/pyproject.toml names, with hashes, in python/lock.txt; keeps versions already pinned
    Lock,
    /// Write the live page, the library in a browser: target/page/fivebar.html (needs .ci/setup-page)
    Page,
    /// Write the documentation as a site that works from a folder: target/site/, with the live page if it has been made
    Site(site::Options),
}

fn main() -> ExitCode {
    match command(Arguments::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // The failure and its causes on one line. A backtrace would not help.
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn command(command: Command) -> Result<()> {
    match command {
        Command::Run { scene, method } => run::run(&scene, method.as_deref()),
        Command::Twin(options) => twin::twin(&options),
        Command::Test { platforms: true, .. } => test::platforms(),
        Command::Test { fmi_sim: true, .. } => test::fmi_sim(),
        Command::Test { page: true, .. } => test::page(),
        Command::Test { nightly: true, .. } => test::test(Level::Nightly),
        Command::Test { full, .. } => test::test(if full { Level::Full } else { Level::Usual }),
        Command::Lock => venv::lock(),
        Command::Format { check } => format::format(check),
        Command::Compare { revision } => compare::compare(&revision),
        Command::Walk(options) => walk::walk(&options),
        Command::HardCases(options) => hard_cases::hard_cases(&options),
        Command::Estimator { only, part, seeds } => estimator::estimator(&only, part, seeds),
        Command::Mujoco(options) => mujoco::mujoco(&options),
        Command::Report(options) => report::report(&options),
        Command::Peers(options) => peers::peers(&options),
        Command::Bench(options) => bench::bench(&options),
        Command::Prices { method } => prices::prices(method.as_deref()),
        Command::Kinks => kinks::kinks(),
        Command::Page => page::page(),
        Command::Site(options) => site::site(&options),
        Command::Release { this_platform } => release::release(if this_platform { Scope::Here } else { Scope::All }),
        Command::Wheel { all_platforms } => wheel::wheel(if all_platforms { Scope::All } else { Scope::Here }).map(drop),
        Command::Package { scene, name, all_platforms } => {
            let scope = if all_platforms { Scope::All } else { Scope::Here };
            let plain = package::package(scope)?;
            scene.map_or(Ok(()), |file| package::package_own(&plain, &file, name.as_deref()))
        }
    }
}
