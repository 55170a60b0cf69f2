//! Energy error and wall time per simulated second of the battery's first 200 perturbed falls, by the explicit method with communication
//! steps of several lengths. Part of `cargo xtask bench`.

use std::io::{self, Write};

use crate::cases::{Case, Extent};
use crate::report;
use crate::setting::Setting;

/// Number of falls.
const FALLS: usize = 200;
/// Communication steps, s: a whole fall in one call, then shorter ones.
const STEPS: [f64; 3] = [f64::INFINITY, 50e-3, 1e-3];

/// The falls with communication steps of one length.
#[derive(Clone, Debug)]
pub struct Row {
    /// Length of a communication step, s.
    pub step: f64,
    /// Duration of a fall, s.
    pub duration: f64,
    /// Verdict of the battery.
    pub falls: report::Row,
    /// Wall time per simulated second, ms, on one core: median and maximum over the falls.
    pub cost: [f64; 2],
}

const HEADER: [&str; 8] = [
    "communication step [s]",
    "falls",
    "each of [s]",
    "verdict",
    "worst |dE| [mgL]",
    "sub-steps per ms",
    "median time [ms/s]",
    "largest time [ms/s]",
];

/// First falls of the battery, in communication steps of `step` s, or in a single call if `step` is longer.
pub fn falls(extent: Extent, step: f64) -> Case {
    let mut case = Case::of_item(extent, 1).swap_remove(0);
    case.trials.truncate(FALLS);
    for span in case.trials.iter_mut().flat_map(|trial| &mut trial.schedule) {
        let duration = span.duration();
        span.size = step.min(duration);
        span.count = (duration / span.size).round() as u64;
    }
    case
}

/// Times the falls one by one. Each fall runs with all communication steps in turn, so that other load on the machine affects all of them
/// alike. Then judges them; returns the failure if a fall does not complete.
pub fn rows(extent: Extent) -> Result<Vec<Row>, String> {
    let cases = STEPS.map(|step| falls(extent, step));
    let mut costs = [const { Vec::new() }; STEPS.len()];
    for i in 0..cases[0].trials.len() {
        for (case, costs) in cases.iter().zip(&mut costs) {
            let trial = &case.trials[i];
            costs.push(1e3 * trial.time(Setting::EXPLICIT)? / trial.duration());
        }
    }
    let row = |(case, mut costs): (&Case, Vec<f64>)| {
        costs.sort_by(f64::total_cmp);
        let fall = &case.trials[0];
        Row {
            step: fall.schedule[0].size,
            duration: fall.duration(),
            falls: case.measure(Setting::EXPLICIT),
            cost: [costs[costs.len() / 2], costs[costs.len() - 1]],
        }
    };
    Ok(cases.iter().zip(costs).map(row).collect())
}

impl Row {
    fn cells(&self) -> [String; 8] {
        [
            self.step.to_string(),
            self.falls.runs.to_string(),
            self.duration.to_string(),
            self.falls.verdict.to_string(),
            format!("{:.1e}", self.falls.energy),
            format!("{:.2}", self.falls.mean),
            format!("{:.3}", self.cost[0]),
            format!("{:.3}", self.cost[1]),
        ]
    }
}

/// The rows as CSV.
pub fn write_csv(rows: &[Row], to: impl Write) -> csv::Result<()> {
    report::csv_table(HEADER, rows.iter().map(Row::cells), to)
}

/// The rows as a Markdown table, followed by targets that were not met.
pub fn write_markdown(rows: &[Row], mut to: impl Write) -> io::Result<()> {
    report::markdown_table(HEADER, rows.iter().map(Row::cells), &mut to)?;
    let objections = rows.iter().flat_map(|row| &row.falls.objections);
    objections.into_iter().try_for_each(|objection| writeln!(to, "- {objection}."))
}
