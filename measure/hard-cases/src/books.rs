//! Energy balance in the random scenes with discontinuous loads, at loose to tight tolerances: largest residual, and whether dissipated
//! energy ever decreases.

use std::fmt;
use std::io::{self, Write};

use rayon::prelude::*;

use crate::cases::{TAKEN_BACK, kinks};
use crate::report::{csv_table, markdown_table};
use crate::setting::Setting;
use crate::trial::{Ending, Outcome, Span, Trial};
use crate::watch::Watch;

/// Number of torque changes per run, alternating between the left and the right motor.
const PUSHES: u64 = 7;

/// A kind of scene with one method and one tolerance.
#[derive(Clone, Debug)]
pub struct Books {
    case: &'static str,
    setting: Setting,
    /// Error tolerance, rad.
    tolerance: f64,
    runs: usize,
    /// Runs that ended early, and the reason of the first.
    ended_early: usize,
    status: String,
    /// Worst |energy.error|, J, and the scene.
    error: (f64, String),
    /// Largest decrease of dissipated energy, relative to the energies, and the scene.
    taken_back: (f64, String),
    substeps: u64,
}

/// The error-controlled methods at a tolerance, rad.
fn settings(tolerance: f64) -> [Setting; 3] {
    [Setting::Tolerance(tolerance), Setting::Dop853(tolerance), Setting::Automatic(tolerance)]
}

/// Sample of scenes, methods and tolerances.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Numbers of the scenes of each kind.
    pub scenes: Vec<u64>,
    /// Only kinds with this in their names.
    pub only: String,
    /// Only this method, by its name in `solver.method`.
    pub by: Option<String>,
    /// Tolerances, rad.
    pub tolerances: Vec<f64>,
    /// Number of communication points for each one of the battery.
    pub points: u64,
    /// Amplitude of the torque changes, N·m.
    pub push: f64,
}

/// Energy balance of a sample; passes each row to `done`.
pub fn measure(sample: &Sample, mut done: impl FnMut(&Books)) -> Vec<Books> {
    let mut rows = Vec::new();
    for (case, trials) in kinks::trials(&sample.scenes).into_iter().filter(|(name, _)| name.contains(&sample.only)) {
        let trials: Vec<Trial> = trials.into_iter().map(|trial| looked_at_often(trial, sample.points, sample.push)).collect();
        for (tolerance, setting) in sample.tolerances.iter().flat_map(|at| settings(*at).map(|setting| (*at, setting))) {
            if sample.by.as_ref().is_some_and(|by| setting.method() != by) {
                continue;
            }
            let outcomes: Vec<Outcome> = trials.par_iter().map(|trial| trial.run(setting)).collect();
            let worst = |of: &dyn Fn(&Outcome) -> f64| {
                let pairs = trials.iter().zip(&outcomes).map(|(trial, outcome)| (of(outcome), trial.label.clone()));
                pairs.fold((0.0, String::new()), |most, pair| if pair.0 > most.0 { pair } else { most })
            };
            let early = || trials.iter().zip(&outcomes).filter(|(_, outcome)| outcome.ending != Ending::Complete);
            let row = Books {
                case,
                setting,
                tolerance,
                runs: outcomes.len(),
                ended_early: early().count(),
                status: early().next().map_or(String::new(), |(trial, outcome)| format!("{}: {:?}", trial.label, outcome.ending)),
                error: worst(&|outcome| outcome.joules),
                taken_back: worst(&|outcome| outcome.taken_back),
                substeps: outcomes.iter().map(|outcome| outcome.substeps).sum(),
            };
            done(&row);
            rows.push(row);
        }
    }
    rows
}

/// The scene with more communication points and occasional torque changes; only its energy is judged.
fn looked_at_often(mut trial: Trial, points: u64, by: f64) -> Trial {
    trial.watch = Watch::Nothing;
    let [span] = trial.schedule[..] else { return trial };
    let (size, count) = (span.size / points as f64, span.count * points);
    trial.parameters.settings.step_size = trial.parameters.settings.step_size.min(size);
    let spans = (0..PUSHES).map(|push| {
        let mut inputs = span.inputs;
        inputs.tau[(push % 2) as usize] += by * (push as f64 - 3.0);
        Span { inputs, size, count: count * (push + 1) / PUSHES - count * push / PUSHES }
    });
    trial.schedule = spans.collect();
    trial
}

/// Largest allowed |energy.error|, J, for error tolerances up to each bound, rad.
const ALLOWED: [(f64, f64); 2] = [(1e-12, 1e-9), (3e-9, 1e-6)];

const HEADER: [&str; 11] = [
    "case",
    "method",
    "setting",
    "runs",
    "ended early",
    "worst |energy.error| [J]",
    "its scene",
    "taken back",
    "scene of that",
    "sub-steps",
    "met",
];

impl Books {
    /// Whether every run completes, dissipated energy never decreases, and the energy balance holds.
    pub fn is_met(&self) -> bool {
        let allowed =
            ALLOWED.into_iter().find(|(tolerance, _)| self.tolerance <= *tolerance).map_or(f64::INFINITY, |(_, most)| most);
        self.ended_early == 0 && self.taken_back.0 <= TAKEN_BACK && self.error.0 <= allowed
    }

    /// Row of a table.
    fn cells(&self) -> [String; 11] {
        [
            self.case.to_owned(),
            self.setting.method().to_owned(),
            self.setting.label(),
            self.runs.to_string(),
            self.ended_early.to_string(),
            format!("{:.1e}", self.error.0),
            self.error.1.clone(),
            format!("{:.0e}", self.taken_back.0),
            self.taken_back.1.clone(),
            self.substeps.to_string(),
            if self.is_met() { "yes".into() } else { format!("NO {}", self.status) },
        ]
    }
}

impl fmt::Display for Books {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.cells().join(" | "))
    }
}

/// The rows as CSV.
pub fn write_csv(rows: &[Books], to: impl Write) -> csv::Result<()> {
    csv_table(HEADER, rows.iter().map(Books::cells), to)
}

/// The rows in Markdown.
pub fn write_markdown(rows: &[Books], mut to: impl Write) -> io::Result<()> {
    markdown_table(HEADER, rows.iter().map(Books::cells), &mut to)
}
