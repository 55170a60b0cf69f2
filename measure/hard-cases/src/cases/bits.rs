//! Item 8 of the battery: the same input gives the same bits.

use std::fmt::Write;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::time::Instant;

use rayon::prelude::*;

use super::{Case, Extent};
use crate::report::{Row, Verdict};
use crate::setting::Setting;
use crate::trial::{Outcome, Trial};

/// The bits of an outcome: ending, last state, figures.
fn bits(outcome: &Outcome) -> u64 {
    let mut hasher = DefaultHasher::new();
    format!("{:?}", outcome.ending).hash(&mut hasher);
    if let Some(state) = &outcome.state {
        let core = &state.core;
        for value in core.q.iter().chain(&core.v).chain(&core.a).chain(&core.lambda).chain(&core.jerk) {
            value.to_bits().hash(&mut hasher);
        }
        for value in [core.substep, core.error_estimate, core.work.input, core.work.dissipated] {
            value.to_bits().hash(&mut hasher);
        }
        [core.counters.steps, core.counters.substeps, core.counters.iterations, core.counters.rejected].hash(&mut hasher);
    }
    [outcome.energy, outcome.position, outcome.velocity].map(f64::to_bits).hash(&mut hasher);
    hasher.finish()
}

/// Short runs of every kind: falls, motions through and past vertices, rest in a vertex, the torque test.
fn sample() -> Vec<(Trial, Setting)> {
    let mut sample = Vec::new();
    for (item, count) in [(1, 4), (2, 4), (3, 9), (5, 2)] {
        for case in Case::of_item(Extent::Quick, item) {
            for setting in [Setting::Default, Setting::EXPLICIT, Setting::Printed(1e-3), Setting::Rk4(1e-3)] {
                sample.extend(case.trials.iter().take(count).map(|trial| (trial.clone(), setting)));
            }
        }
    }
    sample
}

/// One line per run of a sample of the battery: bits and name.
pub fn fingerprint() -> String {
    let lines: Vec<String> = sample()
        .par_iter()
        .map(|(trial, setting)| {
            let (bits, label) = (bits(&trial.run(*setting)), &trial.label);
            format!("{bits:016x} {} {}: {label}", setting.method(), setting.label())
        })
        .collect();
    lines.iter().fold(String::new(), |mut text, line| {
        writeln!(text, "{line}").expect("writing to a string does not fail");
        text
    })
}

/// Compares the fingerprint of this process with others: (origin, fingerprint).
pub fn bits_row(others: &[(&str, String)]) -> Row {
    let begin = Instant::now();
    let own = fingerprint();
    let mut row = Row {
        item: 8,
        case: "same bits",
        method: "all",
        setting: "a sample of the battery".into(),
        runs: own.lines().count(),
        criterion: format!(
            "equal bits: twice in this process, {}",
            others.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ")
        ),
        ..Row::default()
    };
    let again = [("twice in this process", fingerprint())];
    for (name, other) in again.iter().chain(others) {
        let different = own.lines().zip(other.lines()).filter(|(a, b)| a != b).collect::<Vec<_>>();
        if own.lines().count() != other.lines().count() {
            row.failures += 1;
            row.objections.push(format!("{name}: {} runs instead of {}", other.lines().count(), row.runs));
        } else if let Some((first, _)) = different.first() {
            row.failures += different.len();
            row.objections.push(format!("{name}: {} of {} runs differ, the first is {first}", different.len(), row.runs));
        }
    }
    row.verdict = if row.failures == 0 { Verdict::Pass } else { Verdict::Fail };
    row.seconds = begin.elapsed().as_secs_f64();
    row
}
