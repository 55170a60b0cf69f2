//! Tables as CSV and on the screen, with the machine of the measurement.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result};
use serde::Serialize;
use serde_json::json;

use crate::case::{self, Case};
use crate::count::Count;
use crate::{cases, count, scenes};

/// Cost of a case per counted operation.
#[derive(Serialize)]
struct Row<'a> {
    case: &'a str,
    instructions: f64,
    ns: f64,
    /// Instructions relative to the table's first case.
    ratio: f64,
}

/// Counts and times everything and writes `out/<table>.csv` and `out/bench.json`.
pub(crate) fn run(out: &Path, quick: bool) -> Result<()> {
    fs::create_dir_all(out).with_context(|| format!("{} cannot be made", out.display()))?;
    let (cases, counts) = (cases::all()?, count::counts()?);
    let repeats = if quick { 5 } else { 51 };
    for (table, counts) in cases.chunk_by(|a, b| a.table == b.table).zip(chunks(&cases, &counts)) {
        let times = case::times(table, repeats)?;
        let rows: Vec<Row> = table
            .iter()
            .zip(counts.iter().zip(times))
            .map(|(case, (&Count { instructions, .. }, ns))| {
                let ratio = instructions / counts[0].instructions;
                Row { case: &case.name, instructions, ns, ratio }
            })
            .collect();
        println!("\n{}\n{:>14} {:>12} {:>8}", table[0].table, "instructions", "ns", "ratio");
        for Row { case, instructions, ns, ratio } in &rows {
            println!("{instructions:14.1} {ns:12.1} {ratio:8.3}  {case}");
        }
        write(out, table[0].table, &rows)?;
    }
    write(out, "scenes", &scenes::rows(if quick { 2.0 } else { f64::INFINITY })?)?;
    println!("\nscenes\n{}", fs::read_to_string(out.join("scenes.csv"))?);
    let made_on = json!({
        "machine": cpu(),
        "cores": std::thread::available_parallelism().map_or(0, usize::from),
        "system": format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        "compiler": said("rustc", &["--version"]),
        "commit": said("git", &["rev-parse", "HEAD"]),
        "changed": !said("git", &["status", "--porcelain", "--untracked-files=no"]).is_empty(),
        "command": if quick { "cargo xtask bench --quick" } else { "cargo xtask bench" },
        "repeats": repeats,
        "time": "median over the repeats, in falls.csv over the falls; what a table compares takes turns",
    });
    fs::write(out.join("bench.json"), format!("{made_on:#}\n")).context("bench.json cannot be written")
}

/// Splits the counts like the cases by table.
fn chunks<'a>(cases: &[Case], counts: &'a [Count]) -> Vec<&'a [Count]> {
    let mut rest = counts;
    let lengths = cases.chunk_by(|a, b| a.table == b.table).map(<[Case]>::len);
    lengths.map(|length| rest.split_off(..length).unwrap_or_default()).collect()
}

fn write(out: &Path, table: &str, rows: &[impl Serialize]) -> Result<()> {
    let file = out.join(format!("{table}.csv"));
    let mut writer = csv::Writer::from_path(&file).with_context(|| format!("{} cannot be written", file.display()))?;
    rows.iter().try_for_each(|row| writer.serialize(row))?;
    Ok(writer.flush()?)
}

/// The processor's name, if the system reports it.
fn cpu() -> String {
    let text = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| "unknown".into(), |(_, name)| name.trim().to_owned())
}

/// Standard output of a program, empty if it fails.
fn said(program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program).args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output();
    output.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned()).unwrap_or_default()
}
