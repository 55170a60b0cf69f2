//! The strictly fixed step that conserves: what each effect costs by it.

use anyhow::Result;
use fivebar::variables::{Method, Value};

use super::effects::each_effect;
use crate::case::Case;
use crate::scene::Scene;

/// The fall with each effect, and with all.
pub(super) fn cases() -> Result<Vec<Case>> {
    each_effect("conserving", &Scene::fall().with("solver.method", Value::Integer(Method::I3alpConserving as i32))?)
}
