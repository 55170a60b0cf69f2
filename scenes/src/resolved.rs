//! Scenes with all names and units resolved, as JSON.

use anyhow::{Result, ensure};
use serde_json::{Map, Value as Json, json};

use crate::{Scene, Values};

/// Largest number of communication points of a run.
const MOST_POINTS: f64 = 1e6;

impl Scene {
    /// Every run with its label and its values as FMI calls pass them, and every signal at every communication point. Refuses scenes with
    /// too many communication points.
    pub fn resolved(&self) -> Result<Json> {
        let runs = [&self.values].into_iter().chain(self.overlays.iter().map(|overlay| &overlay.values));
        let variants: Vec<Json> = self
            .labels()?
            .into_iter()
            .zip(runs)
            .map(|(label, values)| json!({ "label": label, "values": by_name(values) }))
            .collect();
        let points = if self.signals.is_empty() { Vec::new() } else { self.communication_points()? };
        let signals: Map<String, Json> = self
            .signals
            .iter()
            .map(|signal| (signal.variable.name.full.clone(), points.iter().map(|&time| signal.at(time)).collect()))
            .collect();
        Ok(json!({
            "name": self.name,
            "description": self.description,
            "stopTime": self.stop_time,
            "stepSize": self.step_size,
            "variants": variants,
            "signals": signals,
        }))
    }

    /// 0, H, 2H, ... and the stop time; a remainder within rounding is not a step.
    fn communication_points(&self) -> Result<Vec<f64>> {
        let Self { stop_time, step_size, .. } = self;
        let steps = stop_time / step_size - 1e-9;
        ensure!(
            steps < MOST_POINTS,
            "{stop_time} s in steps of {step_size} s are too many: up to {MOST_POINTS} communication points are allowed"
        );
        let count = steps.ceil().max(1.0) as u32;
        Ok((0..count).map(|i| f64::from(i) * step_size).chain([*stop_time]).collect())
    }
}

fn by_name(values: &Values) -> Map<String, Json> {
    values.iter().map(|(variable, value)| (variable.name.full.clone(), value.fold(Json::from, Json::from, Json::from))).collect()
}
