//! Energy over 50 s of free fall: what stays meaningful beyond the horizon.

use std::time::Instant;

use anyhow::Result;
use hard_cases::mgl;

use crate::choice::HEAD;
use crate::{COMMUNICATION, Choice, Extent, Folder, Run, scene};

/// The scene that is followed for long.
const SCENE: &str = "fall_90_120";
/// Time between two looks at the energy, s.
const STRIDE: f64 = 0.01;
/// Shorter steps and tighter tolerances than these take minutes over 50 s and show nothing new.
const SHORTEST: f64 = 2.5e-5;
const TIGHTEST: f64 = 1e-12;

/// Writes `energy.csv`: the largest energy error of each choice over 50 s (`Quick`: 2 s).
pub fn write(folder: &Folder, extent: Extent) -> Result<()> {
    let end: f64 = if extent == Extent::Full { 50.0 } else { 2.0 };
    let (parameters, inputs) = scene::load(SCENE)?;
    let unit = mgl(&parameters.geometry);
    let mut rows = Vec::new();
    let least = |choice: &Choice| if choice.knob == "step" { SHORTEST } else { TIGHTEST };
    for choice in Choice::all(extent).into_iter().filter(|choice| choice.value >= least(choice)) {
        let mut run = Run::new(&parameters, &inputs, choice.setting)?;
        let (mut worst, mut ending) = (0.0_f64, "complete".to_owned());
        let start = Instant::now();
        for i in 1..=(end / STRIDE).round() as u32 {
            if let Err(failure) = run.to(f64::from(i) * STRIDE) {
                ending = format!("ended early at {:.4} s: {}", run.time() + failure.elapsed, failure.cause);
                break;
            }
            worst = worst.max(run.energy_error().abs());
        }
        let us_per_ms = 1e6 * start.elapsed().as_secs_f64() * COMMUNICATION / run.time().max(COMMUNICATION);
        eprintln!(
            "energy: {}, {} {:e} {}: {:.1e} mgL, {ending}",
            choice.method,
            choice.knob,
            choice.value,
            choice.unit,
            worst / unit
        );
        let cells = [format!("{:.3e}", worst / unit), format!("{us_per_ms:.4}"), format!("{:.3}", run.time()), ending];
        rows.push(choice.cells().into_iter().chain(cells).collect());
    }
    let head: Vec<&str> = HEAD.into_iter().chain(["worst |dE| [mgL]", "us per simulated ms", "reached [s]", "ending"]).collect();
    folder.write("energy", &head, rows)
}
