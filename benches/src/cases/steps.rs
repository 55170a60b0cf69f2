//! The bare step of every method: macro steps of 1 ms along 1 s of the fall, in one call.

use anyhow::{Context, Result};
use fivebar::variables::{Value, Variable};

use super::{STEPS, bare};
use crate::case::Case;
use crate::scene::Scene;

/// One case per item of `solver.method`, and the default with its sub-steps.
pub(super) fn cases() -> Result<Vec<Case>> {
    let methods = Variable::named("solver.method").context("solver.method")?.items;
    let mut cases = Vec::new();
    for method in methods {
        let scene = Scene::fall().with("solver.method", Value::Integer(method.value))?;
        cases.push(bare("steps", method.name, scene, STEPS));
    }
    let adaptive = Scene::fall().with("solver.adaptive", Value::Boolean(true))?;
    cases.push(bare("steps", "i3alp, sub-steps of 3e-9 rad", adaptive, STEPS));
    Ok(cases)
}
