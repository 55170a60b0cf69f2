//! What a real-time user asks: how long each call takes along the scenes, and how many sub-steps the worst one needs.

use std::fs;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use fivebar::variables::{Slot, Value, Variable};
use serde::Serialize;
use serde_json::Value as Json;

use crate::case::quantile;
use crate::host::{Host, reference};

/// A scene's calls of fmi2DoStep.
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
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes");
    let mut files: Vec<_> = fs::read_dir(&folder).context("scenes/")?.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
    files.retain(|file| file.extension().is_some_and(|extension| extension == "json"));
    files.sort();
    files.iter().map(|file| row(file, longest).with_context(|| file.display().to_string())).collect()
}

fn row(file: &Path, longest: f64) -> Result<Row> {
    let scene: serde_json::Map<String, Json> = serde_json::from_str(&fs::read_to_string(file)?)?;
    let values = scene.iter().filter_map(|(name, value)| {
        let variable = Variable::named(name)?;
        Some(typed(variable, value).map(|value| (variable.reference, value)))
    });
    let mut host = Host::ready(&values.collect::<Result<Vec<_>>>()?)?;
    let experiment = |key: &str| scene["experiment"][key].as_f64().with_context(|| format!("experiment.{key}"));
    let (step, substeps) = (experiment("stepSize")?, reference("solver.substeps")?);
    let calls = (experiment("stopTime")?.min(longest) / step).round() as usize;
    let (mut times, mut most, mut before) = (Vec::with_capacity(calls), 0, host.integer(substeps));
    for _ in 0..calls {
        let start = Instant::now();
        host.step(step);
        times.push(start.elapsed().as_nanos() as f64);
        let after = host.integer(substeps);
        (most, before) = (most.max(after - before), after);
    }
    Ok(Row {
        scene: file.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
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

/// A value of a scene's file as the variable wants it; enumerations by the name of their item.
fn typed(variable: &Variable, value: &Json) -> Result<Value> {
    let typed = match (variable.slot, value) {
        (Slot::BooleanParameter(_), Json::Bool(value)) => Some(Value::Boolean(*value)),
        (Slot::RealParameter(_) | Slot::RealInput(_), value) => value.as_f64().map(Value::Real),
        (Slot::IntegerParameter(_), value) => value.as_i64().and_then(|value| i32::try_from(value).ok()).map(Value::Integer),
        (Slot::EnumerationParameter(_), value) => {
            variable.items.iter().find(|item| value.as_str() == Some(item.name)).map(|item| Value::Integer(item.value))
        }
        _ => None,
    };
    typed.with_context(|| format!("{} cannot be {value}", variable.name))
}
