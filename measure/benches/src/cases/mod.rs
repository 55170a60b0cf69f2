//! The cases, one file per table.

mod automatic;
mod conserving;
mod effects;
mod fmi;
mod following;
mod growth;
mod phases;
mod state;
mod steps;
mod sticking;

use anyhow::Result;
use fivebar::simulation::Simulation;
use std::hint::black_box;

use crate::case::{Case, Work};
use crate::scene::Scene;

pub(crate) use effects::{OFF, off};
pub(crate) use fmi::OFF_CALLS;
pub(crate) use following::FOLLOWING;

/// Macro step of all cases, s.
const H: f64 = 1e-3;
/// Steps of the fall in a case: 1 s, with every posture between hanging and folded.
const STEPS: u64 = 1000;

/// All cases, in the order of counting.
pub(crate) fn all() -> Result<Vec<Case>> {
    let mut cases = steps::cases()?;
    cases.extend(steps::evaluations()?);
    cases.extend(phases::cases()?);
    cases.extend(effects::cases()?);
    cases.extend(automatic::cases()?);
    cases.extend(conserving::cases()?);
    cases.extend(sticking::cases()?);
    cases.extend(fmi::cases()?);
    cases.extend(following::cases());
    cases.extend(state::cases()?);
    cases.extend(growth::cases());
    Ok(cases)
}

/// The bare step along a scene: `steps` macro steps, `each` per call.
fn bare(table: &'static str, name: impl Into<String>, scene: Scene, each: u64) -> Case {
    Case::new(table, name, STEPS, move || {
        let (mut simulation, inputs) = (scene.simulation()?, scene.inputs);
        let work: Work = Box::new(move || {
            for _ in 0..STEPS / each {
                advance(black_box(&mut simulation), black_box(&inputs), each);
            }
        });
        Ok(work)
    })
}

/// A torque that changes before each step: six jumps up, then back.
fn held(table: &'static str, scene: Scene, jump: f64) -> Case {
    Case::new(table, "inputs held for 1 ms each", STEPS, move || {
        let (mut simulation, mut inputs) = (scene.simulation()?, scene.inputs);
        let work: Work = Box::new(move || {
            for step in 0..STEPS {
                inputs.tau[0] = jump * (step % 7) as f64;
                advance(black_box(&mut simulation), black_box(&inputs), 1);
            }
        });
        Ok(work)
    })
}

fn advance(simulation: &mut Simulation, inputs: &fivebar::simulation::Inputs, steps: u64) {
    simulation.advance(inputs, H, steps).expect("the fall does not fail");
}
