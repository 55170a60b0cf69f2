//! Dry friction that sticks compared with the smooth law during motion: a fall with friction in all joints, by each method for both.

use anyhow::Result;
use fivebar::variables::{Method, Value};

use super::{STEPS, bare};
use crate::case::Case;
use crate::scene::Scene;

const TABLE: &str = "friction";

/// The fall with either law, by each method.
pub(super) fn cases() -> Result<Vec<Case>> {
    let methods = [("i3alp", Method::I3alp), ("dop853", Method::Dop853), ("automatic", Method::Automatic)];
    let laws = [("smooth", 1), ("sticks", 2)];
    let mut cases = Vec::new();
    for (method, number) in methods {
        for (law, value) in laws {
            let scene = Scene::fall()
                .with("solver.adaptive", Value::Boolean(true))?
                .with("solver.method", Value::Integer(number as i32))?
                .effect("friction", true)?
                .with("friction.law", Value::Integer(value))?;
            cases.push(bare(TABLE, format!("{method}: {law}"), scene, STEPS));
        }
    }
    Ok(cases)
}
