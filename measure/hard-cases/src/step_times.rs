//! Typical and worst wall time of a single fixed step, for real-time users. Each step of the battery's first falls is timed alone, by the
//! conserving method. Part of `cargo xtask bench`.

use std::io::{self, Write};
use std::time::Instant;

use crate::cases::Extent;
use crate::machine::NO_LOAD;
use crate::report;
use crate::setting::Setting;
use crate::speed::falls;

/// Step lengths, s, with bounds on the iterations of a step (`solver.maxWork`).
const SETTINGS: [(f64, u32); 5] = [(1e-3, UNBOUNDED), (1e-3, 150), (1e-3, 40), (1e-3, 0), (4e-3, UNBOUNDED)];
/// The default: all rescues are tried.
const UNBOUNDED: u32 = 400_000;
/// Quantiles in the table.
const PARTS: [f64; 6] = [0.5, 0.99, 0.999, 0.9999, 0.99999, 1.0];
/// Bins of times per decade, from 1 ns.
const PER_DECADE: f64 = 10.0;
const BINS: usize = 80;
/// More iterations than the fallback takes.
#[cfg(test)]
const LAST_RESORT: usize = 30;
/// Larger numbers of iterations are counted as this.
const MOST: usize = 2000;

/// The steps of one setting.
#[derive(Clone, Debug)]
pub struct StepTimes {
    /// Macro step, s.
    pub step: f64,
    /// `solver.maxWork`.
    pub max_work: u32,
    /// Number of steps in each bin of time: tenths of decades from 1 ns.
    pub times: [u64; BINS],
    /// Longest step, ns.
    pub longest: f64,
    /// Number of steps for each number of iterations.
    pub iterations: Vec<u64>,
    /// Steps that needed more than the first guess; steps by the fallback; falls that ended with a status because no rescue was left.
    pub rescued: [u64; 3],
}

/// Times every step of the falls; in full, 1e7 steps of 1 ms.
pub fn measure(extent: Extent) -> Result<Vec<StepTimes>, String> {
    let falls = falls(extent, f64::INFINITY);
    let of = |&(step, max_work): &(f64, u32)| {
        let mut found =
            StepTimes { step, max_work, times: [0; BINS], longest: 0.0, iterations: vec![0; MOST + 1], rescued: [0; 3] };
        for fall in &falls.trials {
            let mut fall = fall.clone();
            fall.parameters.settings.max_work = max_work;
            let mut simulation = fall.start(Setting::Conserving(step)).map_err(|refusal| refusal.to_string())?;
            let mut before = 0;
            for _ in 0..(fall.duration() / step).round() as u64 {
                let begin = Instant::now();
                if let Err(failure) = simulation.advance(&NO_LOAD, step, 1) {
                    if max_work > 0 {
                        return Err(format!("{}: {failure}", fall.label));
                    }
                    found.rescued[2] += 1;
                    break;
                }
                let ns = begin.elapsed().as_nanos() as f64;
                found.longest = found.longest.max(ns);
                found.times[((PER_DECADE * ns.max(1.0).log10()) as usize).min(BINS - 1)] += 1;
                let after = simulation.counters().iterations;
                found.iterations[((after - before) as usize).min(MOST)] += 1;
                before = after;
            }
            let counters = simulation.counters();
            found.rescued[0] += counters.rescued;
            found.rescued[1] += counters.fallbacks;
        }
        Ok(found)
    };
    SETTINGS.iter().map(of).collect()
}

/// Quantile `part` of the counts, as an index.
fn quantile(counts: &[u64], part: f64) -> usize {
    let wanted = part * counts.iter().sum::<u64>() as f64;
    let mut sum = 0;
    counts
        .iter()
        .position(|count| {
            sum += count;
            sum as f64 >= wanted
        })
        .unwrap_or(counts.len() - 1)
}

/// The upper end of a bin, ns.
fn upper(bin: usize) -> f64 {
    10f64.powf((bin + 1) as f64 / PER_DECADE)
}

impl StepTimes {
    /// Number of steps.
    pub fn count(&self) -> u64 {
        self.times.iter().sum()
    }

    /// For each of [`PARTS`], quantiles of time, ns, and iterations.
    fn rows(&self) -> impl Iterator<Item = [String; 7]> {
        PARTS.into_iter().map(|part| {
            let ns = if part < 1.0 { upper(quantile(&self.times, part)).min(self.longest) } else { self.longest };
            [
                format!("{}", self.step),
                self.max_work.to_string(),
                self.count().to_string(),
                part.to_string(),
                format!("{:.2}", ns / 1e3),
                quantile(&self.iterations, part).to_string(),
                self.rescued.map(|count| count.to_string()).join(" / "),
            ]
        })
    }
}

/// A table of quantiles of time and iterations.
pub fn write_markdown(all: &[StepTimes], mut to: impl Write) -> io::Result<()> {
    let header = ["step [s]", "solver.maxWork", "steps", "part", "time [us]", "iterations", "rescued / fallbacks / ended"];
    report::markdown_table(header, all.iter().flat_map(StepTimes::rows), &mut to)
}

/// For every setting: iterations, and number of steps that needed more than the first guess; independent of any clock.
pub fn write_work(all: &[StepTimes], to: impl Write) -> csv::Result<()> {
    let header =
        ["step [s]", "solver.maxWork", "steps", "median", "99.99 %", "most iterations", "rescued", "by the fallback", "ended"];
    let rows = all.iter().map(|found| {
        let [median, rare, most] = [0.5, 0.9999, 1.0].map(|part| quantile(&found.iterations, part).to_string());
        let [rescued, fallbacks, ended] = found.rescued.map(|count| count.to_string());
        [
            found.step.to_string(),
            found.max_work.to_string(),
            found.count().to_string(),
            median,
            rare,
            most,
            rescued,
            fallbacks,
            ended,
        ]
    });
    report::csv_table(header, rows, to)
}

/// The histogram of every setting: upper end of each bin and number of steps.
pub fn write_csv(all: &[StepTimes], to: impl Write) -> csv::Result<()> {
    let header = ["step [s]", "solver.maxWork", "up to [ns]", "steps"];
    let bins = all.iter().flat_map(|found| {
        found.times.iter().enumerate().filter(|(_, count)| **count > 0).map(|(bin, count)| {
            [found.step.to_string(), found.max_work.to_string(), format!("{:.1}", upper(bin)), count.to_string()]
        })
    });
    report::csv_table(header, bins, to)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_step_is_in_the_histogram() {
        assert_eq!([quantile(&[1, 2, 7], 0.1), quantile(&[1, 2, 7], 0.3), quantile(&[1, 2, 7], 1.0)], [0, 1, 2]);
        let all = measure(Extent::Quick).expect("falls that come to their end");
        for found in &all {
            let (steps, ended) = (if found.step > 1e-3 { 25_000 } else { 100_000 }, found.rescued[2] > 0);
            assert!(if ended { found.max_work == 0 && found.count() < steps } else { found.count() == steps }, "{found:?}");
        }
        // Typical and rare steps, as in docs/conserving.md: 99.99 % take at most 8 iterations at 1 ms, and 50 at 4 ms.
        for found in &all {
            let [median, rare] = [0.5, 0.9999].map(|part| quantile(&found.iterations, part));
            let most = if found.step > 1e-3 { [4, 50] } else { [3, 8] };
            assert!(median <= most[0] && rare <= most[1], "{} s: {median}, {rare}", found.step);
            let bound = if found.max_work == UNBOUNDED { MOST } else { found.max_work.max(30) as usize + LAST_RESORT };
            assert!(quantile(&found.iterations, 1.0) <= bound, "solver.maxWork = {}", found.max_work);
        }
        assert!(all.iter().all(|found| found.iterations.iter().sum::<u64>() == found.count() && found.longest > 0.0));
        let mut table = Vec::new();
        write_markdown(&all, &mut table).expect("a table");
        assert_eq!(String::from_utf8(table).expect("text").lines().count(), 2 + all.len() * PARTS.len());
        let mut work = Vec::new();
        write_work(&all, &mut work).expect("a table");
        let work = String::from_utf8(work).expect("text");
        assert!(work.lines().count() == 1 + all.len() && work.contains("\n0.001,400000,100000,2,"), "{work}");
    }
}
