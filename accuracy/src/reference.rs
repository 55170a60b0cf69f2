//! What scenes are judged against.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use fivebar::simulation::{Inputs, Parameters};
use hard_cases::Setting;

use crate::Run;

/// Positions of the tip at some times, and how well they are known.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Time, s, and position, m.
    pub points: Vec<(f64, [f64; 2])>,
    /// Where it comes from.
    pub source: String,
    /// How far it may be off, m.
    pub own_error: f64,
    /// The setting that made it, if it is our own: that is then not judged by it.
    pub made_by: Option<Setting>,
}

/// The files agree with each other to 15 digits or more (see tests/data/reference/README.md), of positions below 1 m.
const QUADRUPLE: f64 = 1e-15;
/// Time between two points of our own references, s.
const STRIDE: f64 = 0.1;
/// Tolerances of our own references, rad: the solution, and one that says what the tolerance does.
const TOLERANCES: [f64; 2] = [1e-13, 1e-12];

impl Reference {
    /// The rows of `tests/data/reference/<name>.csv` up to `end` s.
    pub fn read(name: &str, end: f64) -> Result<Self> {
        let file = format!("tests/data/reference/{name}.csv");
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(&file);
        let mut reader = csv::ReaderBuilder::new().comment(Some(b'#')).from_path(path).with_context(|| file.clone())?;
        let mut points = Vec::new();
        for row in reader.records() {
            let row = row.with_context(|| file.clone())?;
            let number =
                |i: usize| row.get(i).and_then(|cell| cell.parse::<f64>().ok()).with_context(|| format!("{file}: column {i}"));
            let t = number(0)?;
            if t > 0.0 && t <= end {
                points.push((t, [number(1)?, number(2)?]));
            }
        }
        ensure!(points.last().is_some_and(|(t, _)| *t == end), "{file} does not reach t = {end} s");
        let source = format!("quadruple precision, two methods that share no code with ours ({file})");
        Ok(Self { points, source, own_error: QUADRUPLE, made_by: None })
    }

    /// Our own, for want of one from outside: DOP853 at a tolerance near round-off. How far it may be off is how far it is from a looser tolerance and
    /// from projected RK4 at `step` s, which shares neither tableau nor coordinates with it.
    pub fn compute(parameters: &Parameters, inputs: &Inputs, end: f64, step: f64) -> Result<Self> {
        let times: Vec<f64> = (1..=(end / STRIDE).round() as u32).map(|i| f64::from(i) * STRIDE).collect();
        let tips = |setting: Setting| -> Result<Vec<[f64; 2]>> {
            let mut run = Run::new(parameters, inputs, setting)?;
            let tips = times.iter().map(|t| run.to(*t).map(|()| run.tip())).collect::<Result<_, _>>();
            tips.with_context(|| format!("{} at {}", setting.method(), setting.label()))
        };
        let ours = tips(Setting::Dop853(TOLERANCES[0]))?;
        let mut own_error = QUADRUPLE;
        for other in [Setting::Dop853(TOLERANCES[1]), Setting::Rk4(step)] {
            for (a, b) in ours.iter().zip(tips(other)?) {
                own_error = own_error.max((a[0] - b[0]).hypot(a[1] - b[1]));
            }
        }
        let source = format!(
            "DOP853 at {:e} rad, checked against {:e} rad and against projected RK4 at {:e} s",
            TOLERANCES[0], TOLERANCES[1], step
        );
        Ok(Self { points: times.into_iter().zip(ours).collect(), source, own_error, made_by: Some(Setting::Dop853(TOLERANCES[0])) })
    }

    /// Largest distance of the tip from the reference, m.
    pub fn error(&self, tips: &[[f64; 2]]) -> f64 {
        self.points.iter().zip(tips).map(|((_, a), b)| (a[0] - b[0]).hypot(a[1] - b[1])).fold(0.0, f64::max)
    }
}
