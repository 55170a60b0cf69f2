//! Work and precision: error against wall time.

use std::time::Instant;

use anyhow::Result;
use fivebar::simulation::Counters;

use crate::choice::HEAD;
use crate::{COMMUNICATION, Choice, Extent, Folder, Run, Scene};

/// Number of timed rounds over all choices.
fn rounds(extent: Extent) -> usize {
    match extent {
        Extent::Full => 9,
        Extent::Quick => 2,
    }
}

/// Length of the timed laps of a run, s. Laps are so short that most run without interruption on a loaded machine, and so long that reading
/// the clock costs little. The length is a multiple of every step and a divisor of all reference times.
const LAP: f64 = 0.02;

/// A choice on a scene.
struct Measured<'a> {
    scene: &'a Scene,
    choice: Choice,
    /// Largest distance of the tip from the reference, m; infinite if the run ended early.
    error: f64,
    /// `complete`, the reason and time of an early end, or the reason for leaving it out.
    ending: String,
    counters: Counters,
    /// Whether stability limited the steps of an explicit method.
    stiff: bool,
    /// Wall times, s, by lap: one entry per round.
    laps: Vec<Vec<f64>>,
}

/// Writes `precision.csv` and `references.csv`; progress goes to standard error.
pub fn write(folder: &Folder, scenes: &[Scene], extent: Extent) -> Result<()> {
    let cells = |scene: &Scene| {
        let reference = &scene.reference;
        vec![scene.title(), scene.kind.name().into(), format!("{:.2e}", reference.own_error), reference.source.clone()]
    };
    folder.write("references", &["scene", "kind", "own error [m]", "source"], scenes.iter().map(cells))?;

    let choices = Choice::all(extent);
    let pairs = scenes.iter().flat_map(|scene| choices.iter().map(move |choice| (scene, *choice)));
    let mut measured = pairs.map(|(scene, choice)| Measured::first(scene, choice)).collect::<Result<Vec<_>>>()?;
    let rounds = rounds(extent);
    for round in 1..rounds {
        eprintln!("precision: round {} of {rounds}, {} runs", round + 1, measured.len());
        // Methods alternate, so that other load on the machine affects all of them.
        for row in measured.iter_mut().filter(|row| row.error.is_finite()) {
            row.again()?;
        }
    }
    let head: Vec<&str> = ["scene", "kind", "end [s]"]
        .into_iter()
        .chain(HEAD)
        .chain(["error [m]", "us per simulated ms", "best us per simulated ms", "worst us per simulated ms"])
        .chain(["sub-steps", "rejected", "iterations", "stiff", "ending"])
        .collect();
    folder.write("precision", &head, measured.into_iter().map(Measured::cells))
}

impl<'a> Measured<'a> {
    fn first(scene: &'a Scene, choice: Choice) -> Result<Self> {
        let mut laps = vec![Vec::new(); (scene.end / LAP).round() as usize];
        if let Some(ending) = scene.leaves_out(&choice) {
            return Ok(Self { scene, choice, error: f64::INFINITY, ending, counters: Counters::default(), stiff: false, laps });
        }
        let mut run = Run::new(&scene.parameters, &scene.inputs, choice.setting)?;
        let (tips, ending) = time(scene, &mut run, &mut laps);
        let error = if tips.len() == scene.reference.points.len() { scene.reference.error(&tips) } else { f64::INFINITY };
        let (counters, stiff) = (run.simulation.state().core.counters, run.simulation.is_stiff());
        eprintln!(
            "precision: {}: {}, {} {:e} {}: {error:.1e} m",
            scene.title(),
            choice.method,
            choice.knob,
            choice.value,
            choice.unit
        );
        Ok(Self { scene, choice, error, ending, counters, stiff, laps })
    }

    fn again(&mut self) -> Result<()> {
        let mut run = Run::new(&self.scene.parameters, &self.scene.inputs, self.choice.setting)?;
        time(self.scene, &mut run, &mut self.laps);
        Ok(())
    }

    fn cells(mut self) -> Vec<String> {
        let per_ms = |seconds: f64| format!("{:.4}", 1e6 * seconds * COMMUNICATION / self.scene.end);
        let rounds = self.laps.iter().map(Vec::len).min().unwrap_or_default();
        let whole = |round: usize| self.laps.iter().map(|lap| lap[round]).sum::<f64>();
        let worst = (0..rounds).map(whole).fold(0.0, f64::max);
        self.laps.iter_mut().for_each(|lap| lap.sort_by(f64::total_cmp));
        // A run that ended early or was left out has no total time.
        let sum = |of: fn(&[f64]) -> f64| if rounds == 0 { f64::NAN } else { self.laps.iter().map(|lap| of(lap)).sum() };
        let (median, best) = (sum(|lap| lap[lap.len() / 2]), sum(|lap| lap[0]));
        let Counters { substeps, rejected, iterations, .. } = self.counters;
        [self.scene.title(), self.scene.kind.name().into(), self.scene.end.to_string()]
            .into_iter()
            .chain(self.choice.cells())
            .chain([format!("{:.3e}", self.error)])
            .chain([median, best, worst].map(per_ms))
            .chain([substeps, rejected, iterations].map(|count| count.to_string()))
            .chain([if self.stiff { "yes" } else { "no" }.into(), self.ending])
            .collect()
    }
}

/// Runs to the end of the scene and adds wall times to `laps`; returns the tip at the reference times, and the ending.
fn time(scene: &Scene, run: &mut Run, laps: &mut [Vec<f64>]) -> (Vec<[f64; 2]>, String) {
    let mut points = scene.reference.points.iter().peekable();
    let mut tips = Vec::with_capacity(scene.reference.points.len());
    for (i, lap) in laps.iter_mut().enumerate() {
        let end = (i + 1) as f64 * LAP;
        let start = Instant::now();
        let due = points.next_if(|(t, _)| (t - end).abs() < LAP / 2.0).is_some();
        let tip = run.to(end).map(|()| due.then(|| run.tip()));
        lap.push(start.elapsed().as_secs_f64());
        match tip {
            Ok(tip) => tips.extend(tip),
            Err(failure) => {
                return (tips, format!("ended early at {:.4} s: {}", run.time() + failure.elapsed, failure.cause));
            }
        }
    }
    (tips, "complete".into())
}
