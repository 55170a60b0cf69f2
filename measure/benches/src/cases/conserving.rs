//! The fixed conserving step: inputs that change before every step, and the cost of each effect.

use anyhow::Result;
use fivebar::variables::{Method, Value};

use super::effects::each_effect;
use super::held;
use crate::case::Case;
use crate::scene::Scene;

const TABLE: &str = "conserving";

/// The fall with a torque that jumps by 0.01 to 0.06 N·m before each step, with each effect and with all.
pub(super) fn cases() -> Result<Vec<Case>> {
    let fall = || Scene::fall().with("solver.method", Value::Integer(Method::I3alpConserving as i32));
    let mut cases = vec![held(TABLE, fall()?, 0.01)];
    cases.extend(each_effect(TABLE, &fall()?)?);
    Ok(cases)
}
