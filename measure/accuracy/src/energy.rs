//! Energy over 50 s of free fall; it stays meaningful beyond the predictability horizon.

use std::time::Instant;

use anyhow::Result;
use hard_cases::mgl;

use crate::choice::HEAD;
use crate::{COMMUNICATION, Choice, Extent, Folder, Run, scene};

/// The scene of the long run.
const SCENE: &str = "fall_90_120";
/// Runs of each choice. For each stretch between two reads the median of its times counts.
const ROUNDS: usize = 3;
/// Time between two reads of the energy, s.
const STRIDE: f64 = 0.01;
/// Shorter steps and tighter tolerances would take minutes over 50 s and show nothing new.
const SHORTEST: f64 = 2.5e-5;
const TIGHTEST: f64 = 1e-12;

/// Writes `energy.csv`: the largest energy error of each choice over 50 s (`Quick`: 2 s).
pub fn write(folder: &Folder, extent: Extent) -> Result<()> {
    let end: f64 = if extent == Extent::Full { 50.0 } else { 2.0 };
    let (parameters, inputs) = scene::load(SCENE, end)?;
    let unit = mgl(&parameters.geometry);
    let mut rows = Vec::new();
    let least = |choice: &Choice| if choice.knob == "step" { SHORTEST } else { TIGHTEST };
    for choice in Choice::all(extent).into_iter().filter(|choice| choice.value >= least(choice)) {
        let start = Run::new(&parameters, &inputs, choice.setting)?;
        let mut laps = vec![[0.0; ROUNDS]; (end / STRIDE).round() as usize];
        let (mut worst, mut reached, mut ending) = (0.0_f64, 0.0, "complete".to_owned());
        for round in 0..ROUNDS {
            let mut run = start.clone();
            for (i, lap) in laps.iter_mut().enumerate() {
                let begin = Instant::now();
                let done = run.to((i + 1) as f64 * STRIDE);
                lap[round] = begin.elapsed().as_secs_f64();
                if let Err(failure) = done {
                    ending = format!("ended early at {:.4} s: {}", run.time() + failure.elapsed, failure.cause);
                    break;
                }
                worst = worst.max(run.energy_error().abs());
            }
            reached = run.time();
        }
        laps.iter_mut().for_each(|lap| lap.sort_by(f64::total_cmp));
        let us_per_ms = 1e6 * laps.iter().map(|lap| lap[ROUNDS / 2]).sum::<f64>() * COMMUNICATION / reached.max(COMMUNICATION);
        eprintln!(
            "energy: {}, {} {:e} {}: {:.1e} mgL, {ending}",
            choice.method,
            choice.knob,
            choice.value,
            choice.unit,
            worst / unit
        );
        let cells = [format!("{:.3e}", worst / unit), format!("{us_per_ms:.4}"), format!("{reached:.3}"), ending];
        rows.push(choice.cells().into_iter().chain(cells).collect());
    }
    let head: Vec<&str> = HEAD.into_iter().chain(["worst |dE| [mgL]", "us per simulated ms", "reached [s]", "ending"]).collect();
    folder.write("energy", &head, rows)
}
