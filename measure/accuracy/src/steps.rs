//! Cost of single milliseconds: wall time, sub-steps and iterations of every call, and the distance from singularities.

use std::hint::black_box;
use std::time::Instant;

use anyhow::Result;
use fivebar::observers;
use hard_cases::Setting;

use crate::{COMMUNICATION, Extent, Folder, Run, scene};

/// The scene: a fall with many whips.
const SCENE: &str = "fall_90_120";
/// The settings, with their names in the legends.
const SETTINGS: [(&str, Setting); 5] = [
    ("i3alp, default tolerance", Setting::Default),
    ("i3alp, fixed 1 ms", Setting::Fixed(1e-3)),
    ("i3alpConserving, 1 ms", Setting::Conserving(1e-3)),
    ("dop853, 1e-8 rad", Setting::Dop853(1e-8)),
    ("rk4, 1 ms", Setting::Rk4(1e-3)),
];

/// Writes `steps.csv`: one row per call of 1 ms, followed by reading the tip. The run is repeated. The smallest time of a call is the cost
/// of the method; the first is the time that a master would have seen on this machine.
pub fn write(folder: &Folder, extent: Extent) -> Result<()> {
    let (calls, repeats) = if extent == Extent::Full { (5_000, 9) } else { (500, 2) };
    let (parameters, inputs) = scene::load(SCENE, calls as f64 * COMMUNICATION)?;
    let mut rows = Vec::new();
    for (name, setting) in SETTINGS {
        eprintln!("steps: {name}");
        let start = Run::new(&parameters, &inputs, setting)?;
        let mut times: Vec<[f64; 2]> = vec![[f64::INFINITY; 2]; calls];
        for repeat in 0..repeats {
            let mut run = start.clone();
            for time in &mut times {
                let begin = Instant::now();
                // Includes reading the tip, because `dop853` interpolates only then.
                let done = run.advance().map(|()| black_box(run.tip()));
                let us = 1e6 * begin.elapsed().as_secs_f64();
                if done.is_err() {
                    break;
                }
                *time = [us.min(time[0]), if repeat == 0 { us } else { time[1] }];
            }
        }
        // A second run reads everything else, so that it does not disturb the times.
        let mut run = start;
        for [best, first] in times {
            let before = run.simulation.state().core.counters;
            if run.advance().is_err() {
                break;
            }
            let after = run.simulation.state().core.counters;
            let singularity = observers::singularity(run.simulation.model(), &run.simulation.state());
            rows.push(vec![
                name.to_owned(),
                format!("{:.3}", run.time()),
                format!("{best:.3}"),
                format!("{first:.3}"),
                (after.substeps - before.substeps).to_string(),
                (after.iterations - before.iterations).to_string(),
                format!("{:.3e}", singularity.sigma_phi),
                format!("{:.3e}", singularity.jacobians.sigma_jx),
                format!("{:.3e}", singularity.jacobians.sigma_jq),
            ]);
        }
    }
    let head = ["setting", "time [s]", "best [us]", "first [us]", "sub-steps", "iterations"];
    let sigmas = ["sigmaPhi", "sigmaJx [m]", "sigmaJq [m2]"];
    folder.write("steps", &[head.as_slice(), &sigmas].concat(), rows)
}
