//! Two builds of the library side by side: this process loads both and lets them step each scene in turns, so that other load on the
//! machine affects both alike. A pair is one run of a scene by each build; the ratio of a cell is the median over its pairs. Times are CPU
//! times of the thread: with two busy processes on each core, ratios of runs of 15 ms by the clock on the wall were from 0.2 to 7.7.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use cpu_time::ThreadTime;
use fivebar::variables::Variable;
use scenes::{Scene, Value};
use serde::Serialize;

use crate::case::quantile;
use crate::loaded::{Guest, Loaded};

/// Length of a call, s.
const STEP: f64 = 1e-3;

/// Methods by which each scene runs: the ones that are recommended for some use. `rk4` and `i3alpPrinted` serve comparisons only.
const METHODS: [&str; 4] = ["automatic", "dop853", "i3alp", "i3alpConserving"];

/// Length of a turn. A turn is much shorter than a time slice of the system, and much longer than loading a build into the caches again.
const TURN: Duration = Duration::from_millis(1);

/// Coverage of the intervals.
const COVERAGE: f64 = 0.95;

/// Extent of a comparison.
pub(crate) struct Extent<'a> {
    /// Only cells with this in `scene by method`.
    pub(crate) only: &'a str,
    /// Longest motion of a cell, s.
    longest: f64,
    /// Fewest and most pairs of a cell.
    pairs: [usize; 2],
    /// Time after which a cell ends, if it has its fewest pairs.
    time: Duration,
}

impl<'a> Extent<'a> {
    pub(crate) fn new(only: &'a str, quick: bool) -> Self {
        if quick {
            Self { only, longest: 0.1, pairs: [7, 7], time: Duration::ZERO }
        } else {
            Self { only, longest: 2.0, pairs: [21, 401], time: Duration::from_millis(500) }
        }
    }
}

/// A scene by a method.
struct Cell {
    scene: Scene,
    method: &'static str,
}

/// Result of a cell.
#[derive(Serialize)]
struct Row<'a> {
    scene: &'a str,
    method: &'a str,
    calls: usize,
    pairs: usize,
    before_ns: f64,
    after_ns: f64,
    ratio: f64,
    ratio_low: f64,
    ratio_high: f64,
}

/// Times all cells and writes `out/pair.csv`; fails if no cell runs on both builds.
pub(crate) fn run(before: &Path, after: &Path, out: &Path, extent: &Extent<'_>) -> Result<()> {
    let builds = [Loaded::open(before)?, Loaded::open(after)?];
    let cells = cells(extent)?;
    ensure!(!cells.is_empty(), "no cell is called {}; a cell is called such as `swing by dop853`", extent.only);
    fs::create_dir_all(out).with_context(|| format!("{} cannot be made", out.display()))?;
    let file = out.join("pair.csv");
    let mut table = csv::Writer::from_path(&file).with_context(|| format!("{} cannot be written", file.display()))?;
    println!(
        "{:>12} {:>12} {:>7} {:^15} {:>5}   calls of {} ms",
        "before, ns",
        "after, ns",
        "ratio",
        format!("{:.0} %", 100.0 * COVERAGE),
        "pairs",
        1e3 * STEP
    );
    let mut ratios = Vec::new();
    for Cell { scene, method } in &cells {
        let name = format!("{} by {method}", scene.name);
        let (calls, pairs) = match timed(scene, method, &builds, extent) {
            Ok(measured) => measured,
            // A scene may need a variable, or a method a force, that one of the builds does not have.
            Err(error) => {
                println!("{:57}{name}: left out, {error:#}", "");
                continue;
            }
        };
        let Paired { before, after, ratio, interval: [low, high] } = Paired::of(&pairs)?;
        println!("{before:12.1} {after:12.1} {ratio:7.3} {low:7.3} {high:7.3} {:5}   {name}", pairs.len());
        ratios.push((ratio, name));
        let (scene, pairs) = (scene.name.as_str(), pairs.len());
        let (before_ns, after_ns, ratio_low, ratio_high) = (before, after, low, high);
        table.serialize(Row { scene, method, calls, pairs, before_ns, after_ns, ratio, ratio_low, ratio_high })?;
    }
    table.flush()?;
    ratios.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (largest, name) = ratios.last().context("no cell runs on both builds")?;
    let all = ratios.iter().map(|(ratio, _)| *ratio).collect();
    println!(
        "ratio over {} cells: median {:.3}, largest {largest:.3} ({name}); {}",
        ratios.len(),
        quantile(all, 0.5),
        file.display()
    );
    Ok(())
}

/// Every scene of `scenes/` by every method.
fn cells(extent: &Extent<'_>) -> Result<Vec<Cell>> {
    let cells = Scene::all()?.into_iter().flat_map(|scene| METHODS.map(|method| Cell { scene: scene.clone(), method }));
    Ok(cells.filter(|cell| format!("{} by {}", cell.scene.name, cell.method).contains(extent.only)).collect())
}

/// A cell on one build: variables by its value references.
struct Course<'a> {
    build: &'a Loaded,
    start: Vec<(u32, Value)>,
    inputs: Vec<u32>,
}

impl<'a> Course<'a> {
    fn new(scene: &Scene, method: &str, build: &'a Loaded) -> Result<Self> {
        let items = Variable::named("solver.method").context("solver.method")?.items();
        let number = items.iter().find(|item| item.name == method).context("solver.method has no such item")?.value;
        let given =
            scene.values.iter().copied().chain(scene.signals_at(0.0)).map(|(variable, value)| (&*variable.name.full, value));
        let given = given.filter(|(name, _)| *name != "solver.method").chain([("solver.method", Value::Integer(number))]);
        Ok(Self {
            build,
            start: given.map(|(name, value)| Ok((build.reference(name)?, value))).collect::<Result<_>>()?,
            inputs: scene.signals.iter().map(|signal| build.reference(&signal.variable.name.full)).collect::<Result<_>>()?,
        })
    }

    /// Makes calls `range` of an instance; returns the time.
    fn advance(&self, guest: &mut Guest<'_>, inputs: &[Vec<f64>], range: std::ops::Range<usize>) -> Result<Duration> {
        let begin = ThreadTime::now();
        for values in &inputs[range] {
            if !values.is_empty() {
                guest.write(&self.inputs, values)?;
            }
            guest.step(STEP)?;
        }
        Ok(begin.elapsed())
    }
}

/// Number of calls of a cell, and the times per call of each pair, ns.
fn timed(scene: &Scene, method: &str, builds: &[Loaded; 2], extent: &Extent<'_>) -> Result<(usize, Vec<[f64; 2]>)> {
    let calls = (scene.stop_time.min(extent.longest) / STEP).round() as usize;
    let inputs = (0..calls).map(|call| scene.signals.iter().map(|signal| signal.at(call as f64 * STEP)).collect());
    let inputs: Vec<Vec<f64>> = inputs.collect();
    let [before, after] = builds;
    let courses = [("before", before), ("after", after)].map(|(which, build)| Course::new(scene, method, build).context(which));
    let [before, after] = courses;
    let courses = [before?, after?];
    // The first runs warm the caches, tell whether the scene runs, and how many calls fit into a turn.
    let mut slowest = Duration::ZERO;
    for (which, course) in ["before", "after"].into_iter().zip(&courses) {
        let mut guest = course.build.ready(&course.start).context(which)?;
        slowest = slowest.max(course.advance(&mut guest, &inputs, 0..calls).context(which)?);
    }
    let turn = (calls as f64 * TURN.as_secs_f64() / slowest.as_secs_f64()).clamp(1.0, calls as f64) as usize;
    let (begin, mut pairs) = (Instant::now(), Vec::new());
    while pairs.len() < extent.pairs[0] || (begin.elapsed() < extent.time && pairs.len() < extent.pairs[1]) {
        let [before, after] = &courses;
        let mut guests = [before.build.ready(&before.start)?, after.build.ready(&after.start)?];
        let mut passed = [Duration::ZERO; 2];
        for (round, first) in (0..calls).step_by(turn).enumerate() {
            // The build that begins changes, so that neither always follows the other.
            let begins = (round + pairs.len()) % 2;
            for which in [begins, 1 - begins] {
                passed[which] += courses[which].advance(&mut guests[which], &inputs, first..calls.min(first + turn))?;
            }
        }
        pairs.push(passed.map(|time| time.as_nanos() as f64 / calls as f64));
    }
    Ok((calls, pairs))
}

/// Medians of pairs of times.
#[derive(Debug, PartialEq)]
struct Paired {
    before: f64,
    after: f64,
    /// Median of the ratios after / before.
    ratio: f64,
    /// Interval that contains the true median of the ratios with the probability `COVERAGE` or more.
    interval: [f64; 2],
}

impl Paired {
    fn of(pairs: &[[f64; 2]]) -> Result<Self> {
        let mut ratios: Vec<f64> = pairs.iter().map(|[before, after]| after / before).collect();
        ratios.sort_by(f64::total_cmp);
        let below = left_out(pairs.len()).with_context(|| format!("{} pairs are too few for an interval", pairs.len()))?;
        Ok(Self {
            before: quantile(pairs.iter().map(|[before, _]| *before).collect(), 0.5),
            after: quantile(pairs.iter().map(|[_, after]| *after).collect(), 0.5),
            ratio: quantile(ratios.clone(), 0.5),
            interval: [ratios[below], ratios[ratios.len() - 1 - below]],
        })
    }
}

/// Number of the smallest and of the largest of `count` independent values outside the interval of their median. A value lies below the
/// true median with probability 1/2, so the number of values below is binomial, whatever their distribution. None if even the
/// smallest and the largest value do not contain the median often enough.
fn left_out(count: usize) -> Option<usize> {
    let mut chance = 0.5f64.powi(count as i32);
    let (mut below, mut left) = (0.0, None);
    for k in 0..count / 2 {
        below += chance;
        if 2.0 * below > 1.0 - COVERAGE {
            break;
        }
        left = Some(k);
        chance *= (count - k) as f64 / (k + 1) as f64;
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ranks of the table of Conover, Practical Nonparametric Statistics, for 95 %: from 1, both included.
    #[test]
    fn intervals_of_medians_have_the_ranks_of_the_tables() {
        for (count, low, high) in [(6, 1, 6), (8, 1, 8), (9, 2, 8), (10, 2, 9), (20, 6, 15), (25, 8, 18), (50, 18, 33)] {
            let left = left_out(count).unwrap();
            assert_eq!((left + 1, count - left), (low, high), "{count} values");
        }
        assert_eq!(left_out(5), None);
        // Most pairs of a cell: the probability of the first term is not rounded to 0.
        assert!(left_out(Extent::new("", false).pairs[1]).is_some_and(|left| left > 150));
    }

    /// Times of the same build with noise that hits both builds alike: the ratio stays at 1, although times vary by a factor of 10.
    #[test]
    fn load_that_hits_both_builds_cancels() {
        let pairs: Vec<[f64; 2]> = (0..21).map(|i| [100.0 + 50.0 * f64::from(i % 7), 100.0 + 50.0 * f64::from(i % 7)]).collect();
        assert_eq!(Paired::of(&pairs).unwrap(), Paired { before: 250.0, after: 250.0, ratio: 1.0, interval: [1.0, 1.0] });
    }

    /// A few pairs in which another process interrupts one build do not move the ratio out of the others.
    #[test]
    fn interrupted_pairs_are_outside_the_interval() {
        let mut pairs: Vec<[f64; 2]> = (0..21).map(|i| [100.0, 120.0 + 0.1 * f64::from(i)]).collect();
        for (i, pair) in pairs.iter_mut().enumerate().filter(|(i, _)| i % 6 == 0) {
            pair[i % 2] *= 50.0;
        }
        let Paired { ratio, interval: [low, high], .. } = Paired::of(&pairs).unwrap();
        assert!(
            (1.20..=1.22).contains(&low) && low < ratio && ratio < high && (1.20..=1.22).contains(&high),
            "{low} {ratio} {high}"
        );
        assert!(Paired::of(&pairs[..5]).is_err());
    }

    #[test]
    fn cells_are_chosen_by_their_names() {
        let named = |only| cells(&Extent::new(only, true)).unwrap().into_iter().map(|cell| (cell.scene.name, cell.method));
        assert_eq!(named("swing by dop853").collect::<Vec<_>>(), [("swing".to_owned(), "dop853")]);
        assert_eq!(named("no such scene").count(), 0);
    }
}
