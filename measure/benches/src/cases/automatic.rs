//! The method that chooses the scheme of its steps: inputs that change every step, a stiff servo, and the cost of each effect.

use anyhow::Result;
use fivebar::variables::{Method, Value};

use super::effects::each_effect;
use super::{STEPS, bare, held};
use crate::case::Case;
use crate::scene::Scene;

const TABLE: &str = "automatic";

/// A step with changing inputs, a stiff step, the fall with each effect and with all.
pub(super) fn cases() -> Result<Vec<Case>> {
    let fall = || Scene::fall().with("solver.method", Value::Integer(Method::Automatic as i32));
    let mut cases = vec![held(TABLE, fall()?, 1e-6), bare(TABLE, "stiff: a clamp by servos", clamp(fall()?)?, STEPS)];
    cases.extend(each_effect(TABLE, &fall()?)?);
    Ok(cases)
}

/// Servos on both motors, so stiff that stability limits explicit steps to 0.1 ms.
fn clamp(scene: Scene) -> Result<Scene> {
    let gains = [("servo.kp", 200.0), ("servo.kd", 2.0), ("servo.limit", 50.0)];
    let set = gains.into_iter().flat_map(|(name, value)| [1, 2].map(|side| (format!("{name}[{side}]"), value)));
    set.into_iter().try_fold(scene.effect("servo", true)?, |scene, (name, value)| scene.with(&name, Value::Real(value)))
}
