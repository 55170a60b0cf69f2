//! Checks of CI: instructions stay below their ceilings, and disabled effects cost nothing. No times.

use anyhow::{Context, Result, ensure};
use serde::Deserialize;

use crate::cases::{self, FOLLOWING, OFF, OFF_CALLS};
use crate::count;
use crate::scene::{ESTIMATOR, Scene, effects};

/// The ceilings, each with its reason.
const CEILINGS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/ceilings.csv");

#[derive(Deserialize)]
struct Ceiling {
    table: String,
    case: String,
    instructions: f64,
    reason: String,
}

/// Fails with the names of all cases above their ceiling, and of all effects that cost something while disabled.
pub(crate) fn check() -> Result<()> {
    let (cases, seen) = (cases::all()?, count::counts()?);
    let counts: Vec<f64> = seen.iter().map(|count| count.instructions).collect();
    let measured = |table: &str, name: &str| {
        let found = cases.iter().zip(&counts).find(|(case, _)| case.table == table && case.name == name);
        found.map(|(_, count)| *count).with_context(|| format!("ceilings.csv names {table}, {name}, which is no case"))
    };
    let mut faults = Vec::new();
    for ceiling in csv::Reader::from_path(CEILINGS).context("ceilings.csv")?.deserialize() {
        let Ceiling { table, case, instructions, reason } = ceiling.context("ceilings.csv")?;
        let count = measured(&table, &case)?;
        println!("{table}, {case}: {count:.0} instructions, ceiling {instructions:.0} ({reason})");
        if count > instructions {
            faults.push(format!("{table}, {case}: {count:.0} instructions, the ceiling is {instructions:.0}: {reason}"));
        }
    }
    let mut free = 0;
    for table in [OFF, OFF_CALLS] {
        let off: Vec<_> = cases.iter().zip(&counts).filter(|(case, _)| case.table == table).collect();
        let (_, usual) = off.first().context("no case of what is off")?;
        free += off.len() - 1;
        for (case, count) in &off {
            if count != usual {
                faults.push(format!("{}, which is off, with other values: {count} instructions per step, not {usual}", case.name));
            }
        }
    }
    // Cases that follow a machine must show the estimator; otherwise this check would not see it.
    for (case, seen) in cases.iter().zip(&seen) {
        if seen.estimates != (case.table == FOLLOWING) {
            faults.push(format!(
                "{}, {}: the estimator {}",
                case.table,
                case.name,
                if seen.estimates { "runs" } else { "does not run" }
            ));
        }
    }
    for effect in effects().filter(|effect| *effect != "gravity").chain([ESTIMATOR]) {
        if end(&cases::off(effect)?)? != end(&Scene::fall())? {
            faults.push(format!("{effect}, which is off, with other values: another trajectory"));
        }
    }
    ensure!(faults.is_empty(), "{}", faults.join("\n"));
    println!("{free} effects that are off, and the estimator, cost nothing: same instructions, same bits");
    Ok(())
}

/// The bits of positions and velocities after 1 s.
fn end(scene: &Scene) -> Result<Vec<u64>> {
    let mut simulation = scene.simulation()?;
    simulation.advance(&scene.inputs, 1e-3, 1000)?;
    let core = &simulation.state().core;
    Ok(core.q.iter().chain(&core.v).map(|x| x.to_bits()).collect())
}
