//! Rows of the battery's tables, one per case and method, with the verdict; tables in CSV and Markdown.

use std::fmt;
use std::io::{self, Write};

/// Verdict on a row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Verdict {
    /// Meets the criterion.
    Pass,
    /// Does not meet the criterion.
    Fail,
    /// Shown, not judged.
    #[default]
    ForComparison,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Pass => "pass",
            Self::Fail => "FAIL",
            Self::ForComparison => "for comparison",
        })
    }
}

/// A case with one method and setting.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Row {
    /// Group number: the column *item* of `docs/hard-cases.md`.
    pub item: u8,
    /// The case.
    pub case: &'static str,
    /// `solver.method`.
    pub method: &'static str,
    /// Step or tolerance.
    pub setting: String,
    /// Number of runs.
    pub runs: usize,
    /// Runs that do not meet the criterion.
    pub failures: usize,
    /// Runs that ended early.
    pub ended_early: usize,
    /// Reasons for early ends, with counts.
    pub statuses: String,
    /// Largest |balance residual of the energy|, in mgL or the trial's larger unit.
    pub energy: f64,
    /// Largest decrease of dissipated energy, relative to the largest energy.
    pub taken_back: f64,
    /// Largest constraint violation, m, scaled to the paper's machine.
    pub position: f64,
    /// Largest constraint violation at velocity level, m/s, scaled to the paper's machine.
    pub velocity: f64,
    /// Largest number of sub-steps in a macro step.
    pub most: u64,
    /// Mean sub-steps per macro step.
    pub mean: f64,
    /// Text of the criterion.
    pub criterion: String,
    /// Verdict on the row.
    pub verdict: Verdict,
    /// Exact inputs and violation of every run that does not meet the criterion.
    pub objections: Vec<String>,
    /// Wall time, s.
    pub seconds: f64,
}

const HEADER: [&str; 18] = [
    "item",
    "case",
    "method",
    "setting",
    "runs",
    "not met",
    "ended early",
    "status",
    "worst |dE| [mgL]",
    "taken back",
    "worst Phi [m]",
    "worst Phidot [m/s]",
    "most sub-steps",
    "mean sub-steps",
    "criterion",
    "verdict",
    "wall [s]",
    "first not met",
];

impl Row {
    fn cells(&self) -> [String; 18] {
        [
            self.item.to_string(),
            self.case.to_owned(),
            self.method.to_owned(),
            self.setting.clone(),
            self.runs.to_string(),
            self.failures.to_string(),
            self.ended_early.to_string(),
            self.statuses.clone(),
            format!("{:.2e}", self.energy),
            format!("{:.0e}", self.taken_back),
            format!("{:.1e}", self.position),
            format!("{:.1e}", self.velocity),
            self.most.to_string(),
            format!("{:.2}", self.mean),
            self.criterion.clone(),
            self.verdict.to_string(),
            format!("{:.2}", self.seconds),
            self.objections.first().cloned().unwrap_or_default(),
        ]
    }
}

impl fmt::Display for Row {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { item, case, method, setting, runs, failures, ended_early, energy, position, velocity, .. } = self;
        let Self { most, mean, verdict, seconds, .. } = self;
        write!(
            f,
            "{verdict}: {item} {case} by {method}, {setting}: {failures} of {runs} runs do not meet the criterion, {ended_early} ended early, \
             |dE| {energy:.1e} mgL, Phi {position:.1e} m, Phidot {velocity:.1e} m/s, sub-steps {mean:.2} (most {most}), {seconds:.1} s"
        )
    }
}

/// The rows as CSV.
pub fn write_csv(rows: &[Row], to: impl Write) -> csv::Result<()> {
    csv_table(HEADER, rows.iter().map(Row::cells), to)
}

/// A table as CSV.
pub(crate) fn csv_table<const N: usize>(
    header: [&str; N],
    rows: impl Iterator<Item = [String; N]>,
    to: impl Write,
) -> csv::Result<()> {
    let mut writer = csv::Writer::from_writer(to);
    writer.write_record(header)?;
    for row in rows {
        writer.write_record(row)?;
    }
    Ok(writer.flush()?)
}

/// A table in Markdown.
pub(crate) fn markdown_table<const N: usize>(
    header: [&str; N],
    rows: impl Iterator<Item = [String; N]>,
    to: &mut impl Write,
) -> io::Result<()> {
    let line = |cells: [String; N]| format!("| {} |", cells.map(|cell| cell.replace('|', "\\|")).join(" | "));
    writeln!(to, "{}\n|{}", line(header.map(String::from)), " --- |".repeat(N))?;
    rows.map(line).try_for_each(|line| writeln!(to, "{line}"))
}

/// The rows as a Markdown table, followed by the violations of judged rows.
pub fn write_markdown(rows: &[Row], mut to: impl Write) -> io::Result<()> {
    // Criteria and exact inputs are too long for a table.
    let columns = [0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12, 13, 15, 16];
    let cells = |row: &Row| {
        let cells = row.cells();
        columns.map(|i| cells[i].clone())
    };
    markdown_table(columns.map(|i| HEADER[i]), rows.iter().map(cells), &mut to)?;
    writeln!(to, "\nCriteria:\n")?;
    for row in rows.iter().filter(|row| row.verdict != Verdict::ForComparison) {
        writeln!(to, "- {} {}, {}: {}.", row.item, row.case, row.setting, row.criterion)?;
    }
    let statuses: Vec<&Row> = rows.iter().filter(|row| !row.statuses.is_empty()).collect();
    if !statuses.is_empty() {
        writeln!(to, "\nWhat runs ended with:\n")?;
    }
    for row in statuses {
        writeln!(to, "- {} {}, {} {}: {}.", row.item, row.case, row.method, row.setting, row.statuses)?;
    }
    let failed: Vec<&Row> = rows.iter().filter(|row| row.verdict == Verdict::Fail).collect();
    if !failed.is_empty() {
        writeln!(to, "\nNot met, with exact inputs:\n")?;
    }
    for row in failed {
        for objection in &row.objections {
            writeln!(to, "- {} {}, {} {}: {objection}.", row.item, row.case, row.method, row.setting)?;
        }
    }
    Ok(())
}
