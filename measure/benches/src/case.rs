//! A case: something to do a number of times, counted and timed by the same code.

use std::time::{Duration, Instant};

use anyhow::Result;

/// Work to be measured: prepared again for every repeat, so that each starts from one state.
pub(crate) type Work = Box<dyn FnMut()>;

/// Something to measure.
pub(crate) struct Case {
    /// The table it belongs to.
    pub(crate) table: &'static str,
    /// Its name, unique within the table.
    pub(crate) name: String,
    /// Number of counted operations in the work, such as steps.
    pub(crate) times: u64,
    prepare: Box<dyn Fn() -> Result<Work>>,
}

impl Case {
    /// A case; `prepare` makes the work ready and is not measured.
    pub(crate) fn new(
        table: &'static str,
        name: impl Into<String>,
        times: u64,
        prepare: impl Fn() -> Result<Work> + 'static,
    ) -> Self {
        Self { table, name: name.into(), times, prepare: Box::new(prepare) }
    }

    /// Does the work once.
    pub(crate) fn once(&self) -> Result<Duration> {
        let mut work = (self.prepare)()?;
        let start = Instant::now();
        measured(&mut *work);
        Ok(start.elapsed())
    }
}

/// The region that callgrind counts, found by its name.
#[inline(never)]
fn measured(work: &mut dyn FnMut()) {
    work();
}

/// Median times of the cases, ns, over `repeats` runs side by side: disturbances of the machine meet all cases alike.
pub(crate) fn times(cases: &[Case], repeats: usize) -> Result<Vec<f64>> {
    let mut samples = vec![Vec::with_capacity(repeats); cases.len()];
    for _ in 0..repeats {
        for (case, samples) in cases.iter().zip(&mut samples) {
            samples.push(case.once()?.as_nanos() as f64 / case.times as f64);
        }
    }
    Ok(samples.into_iter().map(|samples| quantile(samples, 0.5)).collect())
}

/// The value below which this part of the samples lies.
pub(crate) fn quantile(mut samples: Vec<f64>, part: f64) -> f64 {
    samples.sort_by(f64::total_cmp);
    samples[(part * (samples.len() - 1) as f64).round() as usize]
}
