//! Runs the battery and writes its tables; `cargo xtask hard-cases` builds and runs it and draws the pictures.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use anyhow::{Context, Result, ensure};
use clap::{Parser, Subcommand};
use hard_cases::cases::{bits_row, falls_of_seed, fingerprint, followed, followed_count, hour};
use hard_cases::{
    Case, Extent, Row, Setting, Verdict, books, checks, coaxial, ends, horizon, speed, step_times, write_csv, write_markdown,
};

/// The battery of hard cases
#[derive(Parser)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Run the cases; write hard-cases.csv, hard-cases.md and horizon.csv
    Run {
        /// Output folder
        #[arg(long)]
        out: PathBuf,
        /// Only a sample of every case
        #[arg(long)]
        quick: bool,
        /// Only cases with this in their names
        #[arg(long)]
        only: Option<String>,
        /// Only items 1 to 6 and 9 with this method, by its name in `solver.method`
        #[arg(long)]
        by: Option<String>,
        /// A file with the fingerprint of a build without optimisation
        #[arg(long)]
        unoptimised: Option<PathBuf>,
    },
    /// Time the falls by the explicit method, and each of their steps by the conserving one; write falls.csv, step-times.csv and
    /// step-work.csv
    Falls {
        /// Output folder
        #[arg(long)]
        out: PathBuf,
        /// Only a sample
        #[arg(long)]
        quick: bool,
    },
    /// Run falls of 50 s with several seeds by the explicit method; write seeds.csv
    Seeds {
        /// Output folder
        #[arg(long)]
        out: PathBuf,
        /// Number of seeds, starting at 1
        #[arg(long, default_value_t = 10)]
        seeds: u64,
        /// Number of falls for each
        #[arg(long, default_value_t = 1000)]
        falls: usize,
    },
    /// Check the energy balance of random scenes with kinks at tolerances from 1e-4 to 1e-12 rad; write books.csv
    Books {
        /// Output folder
        #[arg(long)]
        out: PathBuf,
        /// Number of scenes of each kind
        #[arg(long, default_value_t = 20)]
        scenes: u64,
        /// Number of the first scene
        #[arg(long, default_value_t = 200)]
        from: u64,
        /// Only kinds with this in their names
        #[arg(long, default_value = "")]
        only: String,
        /// Only this method, by its name in `solver.method`
        #[arg(long)]
        by: Option<String>,
        /// Communication points for each one of the battery; macro steps are equally short
        #[arg(long, default_value_t = 1)]
        points: u64,
        /// Unit of the occasional torque changes, N·m
        #[arg(long, default_value_t = 1e-3)]
        push: f64,
        /// Tolerances, rad
        #[arg(long, value_delimiter = ',', default_value = "1e-4,1e-6,3e-9,1e-12")]
        tolerances: Vec<f64>,
    },
    /// Run random scenes of every kind by every method with checked steps, at tolerances from 1e-11 to 1e-3 rad: no check may stop one
    Checks {
        /// Number of scenes
        #[arg(long, default_value_t = 20_000)]
        scenes: u64,
        /// Number of the first scene
        #[arg(long, default_value_t = 0)]
        from: u64,
    },
    /// Compare random scenes with coaxial motors by every method with a second program; write coaxial.csv
    Coaxial {
        /// Output folder
        #[arg(long)]
        out: PathBuf,
        /// Number of scenes
        #[arg(long, default_value_t = 5000)]
        scenes: u64,
        /// Number of the first scene, its seed
        #[arg(long, default_value_t = 0)]
        from: u64,
    },
    /// Compute where random scenes with non-smooth loads end, by the independent programs; append scenes that the table lacks
    Ends {
        /// The table
        #[arg(long, default_value = "measure/hard-cases/data/ends.csv")]
        table: PathBuf,
        /// Only cases with this in their names
        #[arg(long, default_value = "")]
        only: String,
        /// Maximum number of scenes of each
        #[arg(long, default_value_t = usize::MAX)]
        count: usize,
    },
    /// Print the bits of a sample of the battery
    Fingerprint,
}

fn main() -> ExitCode {
    match Arguments::parse().task.run() {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}

impl Task {
    /// True if every judged case passes.
    fn run(self) -> Result<bool> {
        match self {
            Self::Run { out, quick, only, by, unoptimised } => {
                let rows = rows(extent(quick), (only.as_deref().unwrap_or_default(), by.as_deref()), unoptimised.as_deref())?;
                write(&out, &rows)?;
                Ok(rows.iter().all(|row| row.verdict != Verdict::Fail))
            }
            Self::Falls { out, quick } => {
                let rows = speed::rows(extent(quick)).map_err(anyhow::Error::msg)?;
                println!("\nfalls\n");
                speed::write_markdown(&rows, io::stdout())?;
                speed::write_csv(&rows, file(&out, "falls.csv")?)?;
                let times = step_times::measure(extent(quick)).map_err(anyhow::Error::msg)?;
                println!("\nstep times of i3alpConserving\n");
                step_times::write_markdown(&times, io::stdout())?;
                step_times::write_csv(&times, file(&out, "step-times.csv")?)?;
                step_times::write_work(&times, file(&out, "step-work.csv")?)?;
                Ok(rows.iter().all(|row| row.falls.verdict == Verdict::Pass))
            }
            Self::Seeds { out, seeds, falls } => {
                let mut rows = Vec::new();
                for seed in 1..=seeds {
                    let row =
                        Row { setting: format!("1e-10 rad, seed {seed}"), ..falls_of_seed(seed, falls).measure(Setting::EXPLICIT) };
                    eprintln!("[{seed}/{seeds}] {row}");
                    row.objections.iter().for_each(|objection| eprintln!("    {objection}"));
                    rows.push(row);
                }
                let worst = rows.iter().map(|row| row.energy).fold(0.0, f64::max);
                println!("worst |dE| of {} falls of 50 s: {worst:.1e} mgL", rows.iter().map(|row| row.runs).sum::<usize>());
                write_csv(&rows, file(&out, "seeds.csv")?)?;
                Ok(rows.iter().all(|row| row.verdict == Verdict::Pass))
            }
            Self::Books { out, scenes, from, only, by, points, push, tolerances } => {
                let sample = books::Sample { scenes: (from..from + scenes).collect(), only, by, tolerances, points, push };
                let rows = books::measure(&sample, |row| eprintln!("{row}"));
                books::write_markdown(&rows, io::stdout())?;
                books::write_csv(&rows, file(&out, "books.csv")?)?;
                Ok(rows.iter().all(books::Books::is_met))
            }
            Self::Checks { scenes, from } => {
                let rows = checks::measure(from, scenes);
                checks::write_markdown(&rows, io::stdout())?;
                Ok(rows.iter().all(checks::Row::is_met))
            }
            Self::Coaxial { out, scenes, from } => {
                let rows = coaxial::measure(&Vec::from_iter(from..from + scenes), |complaint| eprintln!("{complaint}"));
                coaxial::write_markdown(&rows, io::stdout())?;
                coaxial::write_csv(&rows, file(&out, "coaxial.csv")?)?;
                Ok(rows.iter().all(coaxial::Coaxial::is_met))
            }
            Self::Ends { table, only, count } => {
                ends::add(&table, &only, count)?;
                Ok(true)
            }
            Self::Fingerprint => {
                print!("{}", fingerprint());
                Ok(true)
            }
        }
    }
}

fn extent(quick: bool) -> Extent {
    if quick { Extent::Quick } else { Extent::Full }
}

/// Rows of the cases with `only` in their names, for all methods or one.
fn rows(extent: Extent, (only, by): (&str, Option<&str>), unoptimised: Option<&Path>) -> Result<Vec<Row>> {
    let mut cases: Vec<Case> = Case::all(extent).into_iter().filter(|case| case.name.contains(only)).collect();
    cases.iter_mut().for_each(|case| case.settings.retain(|setting| by.is_none_or(|by| setting.method() == by)));
    let of_all = if by.is_none() { followed_count(only) + 2 } else { 0 };
    let count = cases.iter().map(|case| case.settings.len()).sum::<usize>() + of_all;
    let mut rows: Vec<Row> = Vec::new();
    let mut done = |row: Row| {
        eprintln!("[{}/{count}] {row}", rows.len() + 1);
        if row.verdict == Verdict::Fail {
            row.objections.iter().take(3).for_each(|objection| eprintln!("    {objection}"));
        }
        rows.push(row);
    };
    for case in &cases {
        case.settings.iter().for_each(|setting| done(case.measure(*setting)));
    }
    if by.is_some() {
        return Ok(rows);
    }
    followed(extent, only, &mut done);
    if "one hour".contains(only) {
        done(hour(extent));
    }
    if "same bits".contains(only) {
        let mut others = vec![("in another process", other_process()?)];
        if let Some(file) = unoptimised {
            let text = fs::read_to_string(file).with_context(|| format!("{} cannot be read", file.display()))?;
            others.push(("built without optimisation", text));
        }
        done(bits_row(&others));
    }
    Ok(rows)
}

/// Fingerprint printed by another process of this program.
fn other_process() -> Result<String> {
    let program = std::env::current_exe().context("this program's own path")?;
    let output = Command::new(program).arg("fingerprint").output().context("this program could not be started again")?;
    ensure!(output.status.success(), "the other process failed: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).context("the other process wrote no UTF-8")
}

fn write(folder: &Path, rows: &[Row]) -> Result<()> {
    write_csv(rows, file(folder, "hard-cases.csv")?)?;
    write_markdown(rows, file(folder, "hard-cases.md")?)?;
    horizon::write(file(folder, "horizon.csv")?)?;
    Ok(())
}

/// A new file in a folder, which is created if missing.
fn file(folder: &Path, name: &str) -> Result<File> {
    fs::create_dir_all(folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    let path = folder.join(name);
    File::create(&path).with_context(|| format!("{} cannot be written", path.display()))
}
