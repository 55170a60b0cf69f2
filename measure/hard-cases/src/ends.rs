//! Ends of random scenes by the independent programs. These take much longer than the judged runs, so their ends are stored in
//! `data/ends.csv`; a missing end is computed when needed.

use std::collections::HashMap;
use std::f64::consts::TAU;
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::Path;
use std::sync::{LazyLock, Mutex};
use std::time::Instant;

use anyhow::{Context, Result};
use fivebar::simulation::{Inputs, Parameters};
use rayon::prelude::*;

use crate::independent::Independent;
use crate::watch::Watch;
use crate::{Case, Extent};

/// Error of an end, rad, above which it is wrong, unless the scene is sensitive (see [`MULTIPLIED`]).
const WRONG: f64 = 1e-3;
/// Change of the start, rad and rad/s, to measure the sensitivity.
const NUDGE: f64 = 1e-7;
/// If the changed start moves the end by more than `WRONG` divided by this, more error is allowed: bounces multiply errors.
const MULTIPLIED: f64 = 100.0;

/// A scene to run to its end.
#[derive(Clone, Debug)]
pub struct Goal {
    /// Its parameters.
    pub parameters: Parameters,
    /// Constant inputs.
    pub inputs: Inputs,
    /// Duration, s.
    pub duration: f64,
}

/// End of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct End {
    /// Angles of the links, rad.
    pub angles: [f64; 4],
    /// Allowed error, rad.
    pub allowed: f64,
}

/// Ends by scene name; `None` if the program failed.
type Ends = HashMap<String, Option<End>>;

/// Ends read from `data/ends.csv`.
static KEPT: LazyLock<Ends> = LazyLock::new(|| read(include_str!("../data/ends.csv")));

impl Goal {
    /// The stored end, or a newly computed one.
    pub(crate) fn kept_or_new(&self) -> Option<End> {
        KEPT.get(&self.name()).copied().unwrap_or_else(|| self.end())
    }

    /// A name that identifies a scene despite round-off of its values: FNV-1a of nine digits of each. A delay of 0 is not part of it, so that
    /// scenes without one keep their names.
    fn name(&self) -> String {
        let Self { parameters: Parameters { geometry, effects, start, .. }, inputs, duration } = self;
        let text = format!("{:?}", (geometry, effects, start, inputs, duration)).replace(", delay: 0.0", "");
        let words = text.split(|c: char| !(c.is_alphanumeric() || c == '.' || c == '-'));
        let rounded = words.map(|word| word.parse::<f64>().map_or_else(|_| word.to_owned(), |value| format!("{value:.8e}")));
        let hash = rounded
            .flat_map(|word| word.into_bytes())
            .fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
        format!("{hash:016x}")
    }

    fn end(&self) -> Option<End> {
        let Self { parameters, inputs, duration } = self;
        let start = Independent::new(parameters, inputs).start();
        let parameters = &Independent::new(parameters, inputs).merged(&start);
        let program = Independent::new(parameters, inputs);
        let after = |start| program.followed(start, *duration);
        let angles = |start| after(start).map(|end| std::array::from_fn(|i| end[i]));
        let (angles, other) = (angles(start)?, angles(program.closed(start.map(|x| x + NUDGE)))?);
        Some(End { angles, allowed: WRONG.max(MULTIPLIED * apart(&angles, &other)) })
    }
}

/// Largest difference of two postures, rad, without whole turns.
pub(crate) fn apart(x: &[f64; 4], y: &[f64; 4]) -> f64 {
    (0..4).map(|i| ((x[i] - y[i] + TAU / 2.0).rem_euclid(TAU) - TAU / 2.0).abs()).fold(0.0, f64::max)
}

/// Ends from a table with scene, case, number, four angles, allowed error and computing time, s; no angles if the program failed.
fn read(table: &str) -> Ends {
    let numbers = |row: &str| {
        let columns: Vec<f64> = row.split(',').skip(3).filter_map(|column| column.parse().ok()).collect();
        let [a, b, c, d, allowed, ..] = columns[..] else { return None };
        Some(End { angles: [a, b, c, d], allowed })
    };
    table.lines().filter_map(|row| Some((row.split(',').next()?.to_owned(), numbers(row)))).collect()
}

/// Computes missing ends and appends each to the table, so that it can be interrupted and restarted.
///
/// # Errors
///
/// A file that cannot be read or written.
pub fn add(table: &Path, only: &str, count: usize) -> Result<()> {
    let text = if table.exists() { fs::read_to_string(table)? } else { String::new() };
    let known = read(&text);
    let file = OpenOptions::new().create(true).append(true).open(table);
    let file: Mutex<File> = Mutex::new(file.with_context(|| format!("{} cannot be written", table.display()))?);
    for case in Case::of_item(Extent::Full, 9).iter().filter(|case| case.name.contains(only)) {
        case.trials.par_iter().enumerate().take(count).try_for_each(|(number, trial)| {
            let Watch::Follows { goal, .. } = &trial.watch else { return Ok(()) };
            let name = goal.name();
            if known.contains_key(&name) {
                return Ok(());
            }
            let begin = Instant::now();
            let end = goal.end().map_or(",,,,".into(), |End { angles: [a, b, c, d], allowed }| {
                format!("{a:.9},{b:.9},{c:.9},{d:.9},{allowed:.2e}")
            });
            let row = format!("{name},{},{number},{end},{:.2}\n", case.name.replace(',', ""), begin.elapsed().as_secs_f64());
            let mut file = file.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            file.write_all(row.as_bytes()).context("the table cannot be written")
        })?;
    }
    Ok(())
}
