//! Work and precision: error against wall time.

use std::time::{Duration, Instant};

use anyhow::Result;
use fivebar::simulation::Counters;

use crate::choice::HEAD;
use crate::{COMMUNICATION, Choice, Extent, Folder, Run, Scene};

/// Rounds over all choices; the median of their times counts.
fn rounds(extent: Extent) -> usize {
    match extent {
        Extent::Full => 9,
        Extent::Quick => 2,
    }
}

/// A choice on a scene.
struct Measured<'a> {
    scene: &'a Scene,
    choice: Choice,
    /// Largest distance of the tip from the reference, m; infinite if the run ended early.
    error: f64,
    /// `complete`, or why and when it ended early.
    ending: String,
    counters: Counters,
    /// Wall times of the rounds.
    times: Vec<Duration>,
}

/// Writes `precision.csv` and `references.csv`; tells what it does on standard error.
pub fn write(folder: &Folder, scenes: &[Scene], extent: Extent) -> Result<()> {
    let judged = |scene: &Scene| {
        let reference = &scene.reference;
        vec![scene.title(), scene.kind.name().into(), format!("{:.2e}", reference.own_error), reference.source.clone()]
    };
    folder.write("references", &["scene", "kind", "own error [m]", "source"], scenes.iter().map(judged))?;

    let choices = Choice::all(extent);
    let pairs = scenes.iter().flat_map(|scene| choices.iter().map(move |choice| (scene, *choice)));
    let mut measured = pairs.map(|(scene, choice)| Measured::first(scene, choice)).collect::<Result<Vec<_>>>()?;
    let rounds = rounds(extent);
    for round in 1..rounds {
        eprintln!("precision: round {} of {rounds}, {} runs", round + 1, measured.len());
        // Methods take turns, so that what else the machine does meets all of them.
        for row in measured.iter_mut().filter(|row| row.error.is_finite()) {
            row.again()?;
        }
    }
    let head: Vec<&str> = ["scene", "kind", "end [s]"]
        .into_iter()
        .chain(HEAD)
        .chain(["error [m]", "us per simulated ms", "best us per simulated ms", "worst us per simulated ms"])
        .chain(["sub-steps", "rejected", "iterations", "ending"])
        .collect();
    folder.write("precision", &head, measured.into_iter().map(Measured::cells))
}

impl<'a> Measured<'a> {
    fn first(scene: &'a Scene, choice: Choice) -> Result<Self> {
        let mut run = Run::new(&scene.parameters, &scene.inputs, choice.setting)?;
        let (elapsed, tips, ending) = time(scene, &mut run);
        let error = if tips.len() == scene.reference.points.len() { scene.reference.error(&tips) } else { f64::INFINITY };
        let counters = run.simulation.state().core.counters;
        eprintln!(
            "precision: {}: {}, {} {:e} {}: {error:.1e} m",
            scene.title(),
            choice.method,
            choice.knob,
            choice.value,
            choice.unit
        );
        Ok(Self { scene, choice, error, ending, counters, times: vec![elapsed] })
    }

    fn again(&mut self) -> Result<()> {
        let mut run = Run::new(&self.scene.parameters, &self.scene.inputs, self.choice.setting)?;
        self.times.push(time(self.scene, &mut run).0);
        Ok(())
    }

    fn cells(mut self) -> Vec<String> {
        self.times.sort();
        let per_ms = |time: Duration| format!("{:.4}", 1e6 * time.as_secs_f64() * COMMUNICATION / self.scene.end);
        let (best, median, worst) = (self.times[0], self.times[self.times.len() / 2], self.times[self.times.len() - 1]);
        let Counters { substeps, rejected, iterations, .. } = self.counters;
        [self.scene.title(), self.scene.kind.name().into(), self.scene.end.to_string()]
            .into_iter()
            .chain(self.choice.cells())
            .chain([format!("{:.3e}", self.error)])
            .chain([median, best, worst].map(per_ms))
            .chain([substeps, rejected, iterations].map(|count| count.to_string()))
            .chain([self.ending])
            .collect()
    }
}

/// The run to the end of the scene: wall time, the tip at the times of the reference, and how it ended.
fn time(scene: &Scene, run: &mut Run) -> (Duration, Vec<[f64; 2]>, String) {
    let mut tips = Vec::with_capacity(scene.reference.points.len());
    let start = Instant::now();
    for (t, _) in &scene.reference.points {
        if let Err(failure) = run.to(*t) {
            return (start.elapsed(), tips, format!("ended early at {:.4} s: {}", run.time() + failure.elapsed, failure.cause));
        }
        tips.push(run.tip());
    }
    (start.elapsed(), tips, "complete".into())
}
