//! The bare step of every method: macro steps of 1 ms along 1 s of the fall, in one call.

use anyhow::{Context, Result};
use fivebar::integrator::Counters;
use fivebar::variables::{Method, Value, Variable};

use super::{STEPS, advance, bare};
use crate::case::Case;
use crate::scene::Scene;

/// Tolerances, rad, at which the error of the fall after 1 s is below 1e-5, 2e-9 and 1e-12 m (test `the_goals_of_accuracy_are_met`).
const TOLERANCES: [f64; 3] = [1e-6, 1e-9, 1e-14];

/// Evaluations in a step of `dop853`: the stages of a trial, the end of the step, and the further stages of an interpolant.
const STAGES: u64 = 11;
const AT_END: u64 = 1;
const FURTHER: u64 = 3;

/// Full cost of an evaluation within steps of `dop853`: 1 s of the fall at 1e-9 rad in one call, bare and with loads.
pub(super) fn evaluations() -> Result<Vec<Case>> {
    let effects: [(&str, &[&str]); 3] = [("bare", &[]), ("with servos", &["servo"]), ("with friction", &["friction"])];
    let case = |(name, effects): (&str, &[&str])| {
        let scene = Scene::fall().with("solver.method", Value::Integer(Method::Dop853 as i32))?;
        let scene = scene.with("solver.errorTolerance", Value::Real(1e-9))?;
        let scene = effects.iter().try_fold(scene, |scene, effect| scene.effect(effect, true))?;
        let mut simulation = scene.simulation()?;
        advance(&mut simulation, &scene.inputs, STEPS);
        // The last step runs past the end of the call and is interpolated. It was computed in this call, but counts only after time has
        // passed it.
        let passed = simulation.counters().substeps;
        while simulation.counters().substeps == passed {
            advance(&mut simulation, &scene.inputs, 1);
        }
        let Counters { substeps, rejected, .. } = simulation.counters();
        let mut case = bare("evaluations", name, scene, STEPS);
        case.times = STAGES * (substeps + rejected) + AT_END * substeps + FURTHER;
        Ok(case)
    };
    effects.into_iter().map(case).collect()
}

/// One case per item of `solver.method`, and the default method with sub-steps.
pub(super) fn cases() -> Result<Vec<Case>> {
    let methods = Variable::named("solver.method").context("solver.method")?.items();
    let mut cases = Vec::new();
    for method in methods {
        let scene = Scene::fall().with("solver.method", Value::Integer(method.value))?;
        cases.push(bare("steps", method.name, scene, STEPS));
    }
    for tolerance in TOLERANCES {
        let scene = Scene::fall().with("solver.method", Value::Integer(Method::Dop853 as i32))?;
        let scene = scene.with("solver.errorTolerance", Value::Real(tolerance))?;
        cases.push(bare("steps", format!("dop853, {tolerance:e} rad"), scene, STEPS));
    }
    let adaptive = Scene::fall().with("solver.adaptive", Value::Boolean(true))?;
    cases.push(bare("steps", "i3alp, sub-steps of 3e-9 rad", adaptive, STEPS));
    Ok(cases)
}
