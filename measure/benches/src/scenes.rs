//! Times for real-time users: duration of each call along the scenes, and the largest number of sub-steps per call.

use std::time::Instant;

use ::scenes::Scene;
use anyhow::{Context, Result};
use fivebar::variables::Value;
use serde::Serialize;

use crate::case::quantile;
use crate::host::{Host, reference};

/// Calls of fmi2DoStep along a scene.
#[derive(Serialize)]
pub(crate) struct Row {
    scene: String,
    calls: usize,
    communication_step_s: f64,
    mean_ns: f64,
    p50_ns: f64,
    p99_ns: f64,
    largest_ns: f64,
    mean_substeps: f64,
    most_substeps: i32,
}

/// One row per file of scenes/, up to `longest` seconds.
pub(crate) fn rows(longest: f64) -> Result<Vec<Row>> {
    let row = |scene: Scene| row(&scene, longest).with_context(|| scene.name.clone());
    Scene::all()?.into_iter().map(row).collect()
}

fn row(scene: &Scene, longest: f64) -> Result<Row> {
    let start = scene.values.iter().copied().chain(scene.signals_at(0.0));
    let start = start.map(|(variable, value)| (variable.reference, value.fold(Value::Real, Value::Integer, Value::Boolean)));
    let mut host = Host::ready(&start.collect::<Vec<_>>())?;
    let (step, substeps) = (scene.step_size, reference("solver.substeps")?);
    let calls = (scene.stop_time.min(longest) / step).round() as usize;
    let references: Vec<u32> = scene.signals.iter().map(|signal| signal.variable.reference).collect();
    let (mut times, mut most, mut before) = (Vec::with_capacity(calls), 0, host.integer(substeps));
    for call in 0..calls {
        // As in `cargo xtask run`: set at the communication point, constant over the next step.
        let inputs: Vec<f64> = scene.signals.iter().map(|signal| signal.at(call as f64 * step)).collect();
        host.write(&references, &inputs);
        let start = Instant::now();
        host.step(step);
        times.push(start.elapsed().as_nanos() as f64);
        let after = host.integer(substeps);
        (most, before) = (most.max(after - before), after);
    }
    Ok(Row {
        scene: scene.name.clone(),
        calls,
        communication_step_s: step,
        mean_ns: times.iter().sum::<f64>() / calls as f64,
        p50_ns: quantile(times.clone(), 0.5),
        p99_ns: quantile(times.clone(), 0.99),
        largest_ns: quantile(times, 1.0),
        mean_substeps: f64::from(before) / calls as f64,
        most_substeps: most,
    })
}
