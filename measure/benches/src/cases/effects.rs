//! The cost of effects: the fall with one effect changed, with all effects, and with other parameters of disabled effects.

use anyhow::Result;
use fivebar::variables::Value;

use super::{STEPS, bare};
use crate::case::Case;
use crate::scene::{ESTIMATOR, Scene, effects, other_values};

/// The table of scenes with other parameters of disabled effects.
pub(crate) const OFF: &str = "off";

/// The fall under gravity alone; with each effect changed; with all effects; and with other values of each disabled effect.
pub(super) fn cases() -> Result<Vec<Case>> {
    let fall = || Scene::fall().with("solver.adaptive", Value::Boolean(false));
    let mut cases = vec![bare("effects", "gravity only", fall()?, STEPS)];
    let mut together = fall()?;
    for effect in effects() {
        together = together.effect(effect, true)?;
        if effect == "gravity" {
            // At rest and without forces nothing would move.
            let scene = fall()?.effect(effect, false)?.with("init.omega[1]", Value::Real(5.0))?;
            cases.push(bare("effects", "none", scene, STEPS));
        } else {
            cases.push(bare("effects", effect, fall()?.effect(effect, true)?, STEPS));
        }
    }
    cases.push(bare("effects", "all together", together, STEPS));
    cases.push(bare(OFF, "as they are", fall()?, STEPS));
    for effect in effects().filter(|effect| *effect != "gravity").chain([ESTIMATOR]) {
        cases.push(bare(OFF, effect, off(effect)?, STEPS));
    }
    Ok(cases)
}

/// A fall under gravity with each effect, and with all of them.
pub(super) fn each_effect(table: &'static str, fall: &Scene) -> Result<Vec<Case>> {
    let mut together = fall.clone();
    let mut cases = Vec::new();
    for effect in effects().filter(|effect| *effect != "gravity") {
        together = together.effect(effect, true)?;
        cases.push(bare(table, effect, fall.clone().effect(effect, true)?, STEPS));
    }
    cases.push(bare(table, "all together", together, STEPS));
    Ok(cases)
}

/// The fall with other values of a disabled effect.
pub(crate) fn off(effect: &str) -> Result<Scene> {
    other_values(effect).try_fold(Scene::fall(), |scene, (name, value)| scene.with(name, value))
}
