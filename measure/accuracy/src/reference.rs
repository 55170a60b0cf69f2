//! Reference solutions: positions of the tip at given times, with their own error.

use std::path::Path;

use anyhow::{Context, Result, ensure};

/// Positions of the tip at given times, and their error.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Time, s, and position, m.
    pub points: Vec<(f64, [f64; 2])>,
    /// Description of the source.
    pub source: String,
    /// Error bound of the reference itself, m.
    pub own_error: f64,
}

/// The files agree to 15 digits or more (see tests/data/reference/README.md); positions are below 1 m.
const QUADRUPLE: f64 = 1e-15;

impl Reference {
    /// The rows of `tests/data/reference/<name>.csv` up to `end` s.
    pub fn read(name: &str, end: f64) -> Result<Self> {
        let file = format!("tests/data/reference/{name}.csv");
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(&file);
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
        Ok(Self { points, source, own_error: QUADRUPLE })
    }

    /// Largest distance of the tip from the reference, m.
    pub fn error(&self, tips: &[[f64; 2]]) -> f64 {
        self.points.iter().zip(tips).map(|((_, a), b)| (a[0] - b[0]).hypot(a[1] - b[1])).fold(0.0, f64::max)
    }
}
