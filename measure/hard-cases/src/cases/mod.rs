//! The cases, in numbered groups: the column *item* of `docs/hard-cases.md`.

mod bits;
mod falls;
mod followed;
mod hour;
pub(crate) mod kinks;
mod postures;
mod scales;
mod torque;
mod vertex_rest;
mod vertices;

use std::collections::BTreeMap;
use std::time::Instant;

use rayon::prelude::*;

pub use bits::{bits_row, fingerprint};
pub use falls::falls_of_seed;
pub use followed::{followed, followed_count};
pub use hour::hour;

use crate::report::{Row, Verdict};
use crate::setting::Setting;
use crate::trial::{Ending, Outcome, Trial};

/// Extent of a case.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// The full case.
    Full,
    /// A sample that takes seconds.
    Quick,
}

impl Extent {
    /// Selects one of two values.
    pub(crate) fn pick<T>(self, full: T, quick: T) -> T {
        match self {
            Self::Full => full,
            Self::Quick => quick,
        }
    }
}

/// Requirements on every run of a case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Demand {
    /// Largest |balance residual of the energy|, in the trial's unit.
    pub energy: f64,
    /// Largest constraint violation at position level, m, and at velocity level, m/s, for a machine of the paper's size.
    pub constraints: [f64; 2],
    /// Whether the path of the motion is judged.
    pub path: bool,
    /// Whether a run may end with a status.
    pub status_allowed: bool,
}

/// Largest constraint violation, scaled to the paper's machine: at position level, m, and at velocity level, m/s.
const CONSTRAINTS: [f64; 2] = [1e-12, 1e-9];

/// Largest allowed decrease of the dissipated energy, relative to the largest energy. It allows for round-off only.
pub const TAKEN_BACK: f64 = 1e-12;

/// Requirements on the conserving step at 1 ms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conserving {
    /// Largest |balance residual of the energy|, in the trial's unit.
    pub energy: f64,
    /// Largest constraint violations, as in [`Demand`].
    pub constraints: [f64; 2],
    /// Whether the path of the motion is judged.
    pub path: bool,
    /// Whether other step lengths are also judged.
    pub all_steps: bool,
}

impl Conserving {
    /// Requirements of most cases.
    const USUAL: Self = Self { energy: 1e-7, constraints: CONSTRAINTS, path: true, all_steps: false };
}

/// A case, as data.
#[derive(Clone, Debug)]
pub struct Case {
    /// Number in the list.
    pub item: u8,
    /// Name in the tables.
    pub name: &'static str,
    /// Description of a requirement beyond energy and constraints.
    pub also: &'static str,
    /// Required energy at the default tolerance and at the tighter one.
    pub energy: [f64; 2],
    /// Required energy for the explicit method.
    pub explicit_energy: f64,
    /// Requirements on the conserving step.
    pub conserving: Conserving,
    /// Whether a run may end with a status.
    pub status_allowed: bool,
    /// Methods and settings of the runs.
    pub settings: Vec<Setting>,
    /// The runs.
    pub trials: Vec<Trial>,
    /// Number of trials that are also run for comparison.
    pub compared: usize,
}

impl Case {
    /// A case that runs with all settings and may not end early.
    fn new(item: u8, name: &'static str, energy: [f64; 2], trials: Vec<Trial>) -> Self {
        Self {
            item,
            name,
            also: "",
            energy,
            explicit_energy: energy[0],
            conserving: Conserving::USUAL,
            status_allowed: false,
            settings: Setting::ALL.to_vec(),
            compared: trials.len(),
            trials,
        }
    }

    /// All cases judged by trials. The list also has [`hour`], [`bits_row`] and [`followed()`].
    pub fn all(extent: Extent) -> Vec<Self> {
        [1, 2, 3, 4, 5, 6, 9].into_iter().flat_map(|item| Self::of_item(extent, item)).collect()
    }

    /// The cases of an item of the list.
    pub fn of_item(extent: Extent, item: u8) -> Vec<Self> {
        match item {
            1 => vec![falls::falls(extent), falls::more_falls(extent)],
            2 => vertices::cases(extent),
            3 => vertex_rest::cases(extent),
            4 => postures::cases(extent),
            5 => torque::cases(),
            6 => scales::cases(extent),
            9 => kinks::cases(extent),
            _ => Vec::new(),
        }
    }

    /// Requirements on a setting. Settings for comparison use the requirement at the default tolerance.
    pub fn demand(&self, setting: Setting) -> Demand {
        let [default, tight] = self.energy;
        let energy = match setting {
            Setting::TIGHT => tight,
            Setting::EXPLICIT | Setting::AUTOMATIC => self.explicit_energy,
            Setting::Conserving(step) => {
                let Conserving { energy, constraints, path, .. } = self.conserving;
                // Paths are judged at times that longer steps do not meet.
                let path = path && Setting::Conserving(step) == Setting::CONSERVING;
                return Demand { energy, constraints, path, status_allowed: false };
            }
            _ => default,
        };
        Demand { energy, constraints: CONSTRAINTS, path: true, status_allowed: self.status_allowed }
    }

    /// Whether the battery judges a setting; others are for comparison.
    pub fn is_judged(&self, setting: Setting) -> bool {
        match setting {
            Setting::Default | Setting::Tolerance(_) | Setting::Dop853(_) | Setting::Automatic(_) | Setting::CONSERVING => true,
            Setting::Conserving(_) => self.conserving.all_steps,
            Setting::Fixed(_) | Setting::Printed(_) | Setting::Rk4(_) => false,
        }
    }

    /// Runs the case with one setting on all processors.
    pub fn measure(&self, setting: Setting) -> Row {
        let begin = Instant::now();
        let trials = if self.is_judged(setting) { &self.trials[..] } else { &self.trials[..self.compared] };
        let outcomes: Vec<Outcome> = trials.par_iter().map(|trial| trial.run(setting)).collect();
        let demand = self.demand(setting);
        let mut row = Row {
            item: self.item,
            case: self.name,
            method: setting.method(),
            setting: if trials.iter().all(|trial| trial.keeps_settings) { "own settings".into() } else { setting.label() },
            runs: trials.len(),
            criterion: self.criterion(&demand),
            ..Row::default()
        };
        let mut statuses: BTreeMap<String, usize> = BTreeMap::new();
        let (mut substeps, mut steps) = (0, 0);
        for (trial, outcome) in trials.iter().zip(&outcomes) {
            substeps += outcome.substeps;
            steps += outcome.steps;
            row.energy = row.energy.max(outcome.energy);
            row.taken_back = row.taken_back.max(outcome.taken_back);
            row.position = row.position.max(outcome.position);
            row.velocity = row.velocity.max(outcome.velocity);
            row.most = row.most.max(outcome.most);
            match &outcome.ending {
                Ending::Complete => {}
                Ending::Status(text, _) => {
                    row.ended_early += 1;
                    *statuses.entry(without_figures(text)).or_default() += 1;
                }
                Ending::Refused(text) => {
                    row.ended_early += 1;
                    *statuses.entry(format!("refused: {text}")).or_default() += 1;
                }
                Ending::NotFinite(_) => {
                    row.ended_early += 1;
                    *statuses.entry("NOT FINITE".into()).or_default() += 1;
                }
            }
            if let Some(objection) = demand.objection(outcome) {
                row.failures += 1;
                row.objections.push(format!("{}: {objection}", trial.label));
            }
        }
        if let Setting::Conserving(step) = setting {
            let fallbacks: u64 =
                outcomes.iter().filter_map(|outcome| outcome.state).map(|state| state.core.counters.fallbacks).sum();
            if substeps != steps {
                row.failures += 1;
                row.objections.push(format!("{substeps} sub-steps in {steps} strictly fixed steps"));
            }
            if self.conserving.all_steps && fallbacks > allowed_last_resorts(step, steps) {
                row.failures += 1;
                row.objections.push(format!("{fallbacks} of {steps} steps by the fallback"));
            }
            if fallbacks > 0 {
                statuses.insert(format!("of {steps} steps by the fallback"), fallbacks as usize);
            }
        }
        row.mean = if steps == 0 { 0.0 } else { substeps as f64 / steps as f64 };
        row.statuses = statuses.into_iter().map(|(text, count)| format!("{count} x {text}")).collect::<Vec<_>>().join("; ");
        row.verdict = match (self.is_judged(setting), row.failures == 0) {
            (true, true) => Verdict::Pass,
            (true, false) => Verdict::Fail,
            (false, _) => Verdict::ForComparison,
        };
        row.seconds = begin.elapsed().as_secs_f64();
        row
    }

    fn criterion(&self, demand: &Demand) -> String {
        let mut text = if demand.status_allowed { String::from("complete or a status") } else { String::from("complete") };
        if demand.energy.is_finite() {
            text += &format!(", |dE| <= {:e} mgL", demand.energy);
            if let Some(trial) = self.trials.iter().find(|trial| trial.kinetic_part > 0.0) {
                text += &format!(" (of the larger of mgL and {:e} of the peak kinetic energy)", trial.kinetic_part);
            }
        }
        text += &format!(", what is dissipated is not taken back ({TAKEN_BACK:e} of the energies)");
        let [position, velocity] = demand.constraints;
        text += &format!(", Phi <= {position:e} m, Phidot <= {velocity:e} m/s");
        if self.trials.iter().any(|trial| trial.vertex_outputs) {
            text += " (outputs in a vertex aside)";
        }
        if !self.also.is_empty() && demand.path {
            text += ", ";
            text += self.also;
        }
        text
    }
}

impl Demand {
    /// Violated requirement of an outcome, if any.
    pub fn objection(&self, outcome: &Outcome) -> Option<String> {
        let mut objections = Vec::new();
        match &outcome.ending {
            Ending::Complete => {}
            Ending::Status(_, _) if self.status_allowed => {}
            Ending::Status(text, time) => objections.push(format!("status at {time} s, {text}")),
            Ending::Refused(text) => objections.push(format!("refused, {text}")),
            Ending::NotFinite(time) => objections.push(format!("not finite at {time} s")),
        }
        for (what, value, bound) in [
            ("|dE|/unit", outcome.energy, self.energy),
            ("dissipated, and taken back,", outcome.taken_back, TAKEN_BACK),
            ("Phi", outcome.judged[0], self.constraints[0]),
            ("Phidot", outcome.judged[1], self.constraints[1]),
        ] {
            if value > bound {
                objections.push(format!("{what} {value:.2e}, allowed {bound:e}"));
            }
        }
        objections.extend(outcome.objection.clone().filter(|_| self.path));
        (!objections.is_empty()).then(|| objections.join("; "))
    }
}

/// Steps of a fall that the conserving method may make by its fallback: one in a million, or two in a million if longer than 1 ms.
fn allowed_last_resorts(step: f64, steps: u64) -> u64 {
    (if step > 1e-3 { 2 * steps } else { steps }).div_ceil(1_000_000)
}

/// A status without its numbers, so that equal reasons are counted together.
fn without_figures(text: &str) -> String {
    text.split(':').next().unwrap_or(text).to_owned()
}
