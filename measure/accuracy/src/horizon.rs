//! The predictability horizon: time for which a run stays near the exact motion, by tolerance or step.

use anyhow::{Context, Result};
use hard_cases::Setting;

use crate::choice::HEAD;
use crate::{Choice, Extent, Folder, Run, scene};

/// The scene: fast whips of a free fall.
const SCENE: &str = "fall_90_120";
/// Distance between tips, m, above which runs count as diverged.
const APART: f64 = 1e-3;
/// The most accurate setting, rad.
const BEST: Setting = Setting::Dop853(1e-14);
/// A run with different rounding and error control, rad; it diverges from [`BEST`] at the limit of double precision.
const SECOND: Setting = Setting::Dop853(2e-14);
/// A multiple of all communication steps, s.
const STRIDE: f64 = 4e-3;

/// Writes `horizon.csv`, the time when each choice diverges from the best run, and `growth.csv`, the distance of two nearly equal runs.
pub fn write(folder: &Folder, extent: Extent) -> Result<()> {
    let end = if extent == Extent::Full { 12.0 } else { 3.0 };
    let (parameters, inputs) = scene::load(SCENE, end)?;
    let mut best = Run::new(&parameters, &inputs, BEST)?;
    let times: Vec<f64> = (1..=(end / STRIDE).round() as u32).map(|i| f64::from(i) * STRIDE).collect();
    let path: Vec<[f64; 2]> =
        times.iter().map(|t| best.to(*t).map(|()| best.tip())).collect::<Result<_, _>>().context("the best run")?;
    let parting = |setting: Setting| -> Result<(f64, String)> {
        let mut run = Run::new(&parameters, &inputs, setting)?;
        for (t, tip) in times.iter().zip(&path) {
            if let Err(failure) = run.to(*t) {
                return Ok((run.time(), format!("ended early: {}", failure.cause)));
            }
            let [x, y] = run.tip();
            if (x - tip[0]).hypot(y - tip[1]) > APART {
                return Ok((*t, "parted".into()));
            }
        }
        Ok((end, "together to the end".into()))
    };
    let mut rows = Vec::new();
    let (limit, ending) = parting(SECOND)?;
    rows.push(vec!["double precision".into(), "tolerance".into(), "2e-14".into(), "rad".into(), limit.to_string(), ending]);
    for choice in Choice::all(extent).into_iter().filter(|choice| choice.setting != BEST) {
        let (time, ending) = parting(choice.setting)?;
        eprintln!("horizon: {}, {} {:e} {}: {time:.3} s, {ending}", choice.method, choice.knob, choice.value, choice.unit);
        rows.push(choice.cells().into_iter().chain([format!("{time:.3}"), ending]).collect());
    }
    let head: Vec<&str> = HEAD.into_iter().chain(["within 1 mm until [s]", "ending"]).collect();
    folder.write("horizon", &head, rows)?;
    if extent == Extent::Full {
        hard_cases::horizon::write(folder.file("growth")?)?;
    }
    Ok(())
}
