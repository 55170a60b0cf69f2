//! A case: work of many equal operations, counted and timed by the same code.

use std::time::{Duration, Instant};

use anyhow::Result;

/// Work to measure; prepared again for every repeat, so that each starts from the same state.
pub(crate) type Work = Box<dyn FnMut()>;

pub(crate) struct Case {
    /// The table of the case.
    pub(crate) table: &'static str,
    /// Name, unique within the table.
    pub(crate) name: String,
    /// Number of counted operations in the work, such as steps.
    pub(crate) times: u64,
    prepare: Box<dyn Fn() -> Result<Work>>,
}

impl Case {
    /// A case; the time of `prepare` is not measured.
    pub(crate) fn new(
        table: &'static str,
        name: impl Into<String>,
        times: u64,
        prepare: impl Fn() -> Result<Work> + 'static,
    ) -> Self {
        Self { table, name: name.into(), times, prepare: Box::new(prepare) }
    }

    /// Whether the work is calls of C functions, as a master makes them.
    pub(crate) fn is_call(&self) -> bool {
        ["dostep", "start-up", "state"].contains(&self.table)
    }

    /// Does the work once; returns its time.
    pub(crate) fn once(&self) -> Result<Duration> {
        let mut work = (self.prepare)()?;
        let start = Instant::now();
        measured(&mut *work);
        Ok(start.elapsed())
    }
}

/// The region counted by callgrind, which finds it by name.
#[inline(never)]
fn measured(work: &mut dyn FnMut()) {
    work();
}

/// Median times of the cases, ns, over `repeats` rounds. Cases alternate, so that other load on the machine affects all alike.
pub(crate) fn times(cases: &[Case], repeats: usize) -> Result<Vec<f64>> {
    let mut samples = vec![Vec::with_capacity(repeats); cases.len()];
    for _ in 0..repeats {
        for (case, samples) in cases.iter().zip(&mut samples) {
            samples.push(case.once()?.as_nanos() as f64 / case.times as f64);
        }
    }
    Ok(samples.into_iter().map(|samples| quantile(samples, 0.5)).collect())
}

/// Quantile of the samples at `part`.
pub(crate) fn quantile(mut samples: Vec<f64>, part: f64) -> f64 {
    samples.sort_by(f64::total_cmp);
    samples[(part * (samples.len() - 1) as f64).round() as usize]
}
