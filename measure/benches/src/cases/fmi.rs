//! The C functions: a communication step compared with the bare step, the cost of reading, and a life cycle from instantiation.

use std::hint::black_box;

use anyhow::Result;
use fivebar::variables::{Method, VARIABLES, Value, VariableId};

use super::{H, STEPS, bare};
use crate::case::{Case, Work};
use crate::host::{Host, reference};
use crate::scene::{ESTIMATOR, Scene, other_values};

/// Values of variables for the fall.
fn fall() -> Result<Vec<(u32, Value)>> {
    Ok(vec![
        (reference("init.theta[2]")?, Value::Real(120f64.to_radians())),
        (reference("solver.adaptive")?, Value::Boolean(false)),
    ])
}

/// The fall with one value changed.
fn fall_with(name: &str, value: Value) -> Result<Vec<(u32, Value)>> {
    Ok([fall()?, vec![(reference(name)?, value)]].concat())
}

/// Table of communication steps of the fall, with default and other values of the disabled estimator.
pub(crate) const OFF_CALLS: &str = "off, fmi2DoStep";

/// The fall with other values of the disabled estimator, and unused samples.
fn with_other_estimator() -> Result<Vec<(u32, Value)>> {
    let samples = ["measured.theta[1]", "measured.time[1]"].map(|name| (name, Value::Real(0.0)));
    let others = other_values(ESTIMATOR).chain(samples).map(|(name, value)| Ok((reference(name)?, value)));
    fall()?.into_iter().map(Ok).chain(others).collect()
}

/// Communication steps of one macro step each along the fall; `also` runs after each.
fn calls(table: &'static str, name: impl Into<String>, also: impl FnMut(&mut Host) + Clone + 'static) -> Case {
    calls_along(table, name, fall, also)
}

/// [`calls`] along another scene.
fn calls_along(
    table: &'static str,
    name: impl Into<String>,
    scene: impl Fn() -> Result<Vec<(u32, Value)>> + 'static,
    also: impl FnMut(&mut Host) + Clone + 'static,
) -> Case {
    Case::new(table, name, STEPS, move || {
        let (mut host, mut also) = (Host::ready(&scene()?)?, also.clone());
        let work: Work = Box::new(move || {
            for _ in 0..STEPS {
                host.step(H);
                also(&mut host);
            }
        });
        Ok(work)
    })
}

/// Reads these Reals after every communication step.
fn reading(name: impl Into<String>, references: Vec<u32>) -> Case {
    let mut values = vec![0.0; references.len()];
    calls("outputs", name, move |host| host.read(black_box(&references), &mut values))
}

/// Tables `dostep`, `outputs` and `start-up`.
pub(super) fn cases() -> Result<Vec<Case>> {
    let inputs: Vec<u32> = ["tau[1]", "tau[2]", "tip.fx", "tip.fy"].into_iter().map(reference).collect::<Result<_>>()?;
    let by_dop853 = || fall_with("solver.method", Value::Integer(Method::Dop853 as i32));
    let tip = [reference("tip.x")?, reference("tip.y")?];
    let (tau, mut torque) = (reference("tau[1]")?, 1e-3);
    let mut cases = vec![
        bare("dostep", "bare step, 1000 in a call", Scene::fall(), STEPS),
        bare("dostep", "bare step, 1 in a call", Scene::fall(), 1),
        calls("dostep", "fmi2DoStep of 1 step", |_| ()),
        calls("dostep", "fmi2DoStep of 1 step, 4 inputs set to what they are", move |host| {
            host.write(black_box(&inputs), black_box(&[0.0; 4]));
        }),
        calls_along("dostep", "fmi2DoStep of 1 step, adaptive", || fall_with("solver.adaptive", Value::Boolean(true)), |_| ()),
        calls_along("dostep", "fmi2DoStep of 1 step, dop853", by_dop853, |_| ()),
        calls_along("dostep", "fmi2DoStep of 1 step, dop853, the tip read", by_dop853, move |host| {
            host.read(black_box(&tip), &mut [0.0; 2]);
        }),
        calls_along("dostep", "fmi2DoStep of 1 step, dop853, a torque changed", by_dop853, move |host| {
            torque = -torque;
            host.write(black_box(&[tau]), black_box(&[torque]));
        }),
        calls("outputs", "none", |_| ()),
        calls(OFF_CALLS, "as it is", |_| ()),
        calls_along(OFF_CALLS, ESTIMATOR, with_other_estimator, |_| ()),
    ];
    let outputs = || VARIABLES.iter().filter(|variable| matches!(variable.id, VariableId::RealComputed(_)));
    // Groups by the first part of the name; names without a dot, such as theta[1], form a group.
    let group = |name: &'static str| name.split_once('.').map_or("joints", |(group, _)| group.split('[').next().unwrap_or(group));
    let mut groups: Vec<&str> = Vec::new();
    for output in outputs() {
        if !groups.contains(&group(output.name)) {
            groups.push(group(output.name));
        }
    }
    for wanted in groups {
        let references = outputs().filter(|output| group(output.name) == wanted).map(|output| output.reference).collect();
        cases.push(reading(wanted, references));
    }
    cases.push(reading("all", outputs().map(|output| output.reference).collect()));
    let life = |name: &str, steps: u32| {
        Case::new("start-up", name, 1, move || {
            let fall = fall()?;
            let work: Work = Box::new(move || {
                let mut host = Host::ready(&fall).expect("the fall is a legal scene");
                for _ in 0..steps {
                    host.step(H);
                }
            });
            Ok(work)
        })
    };
    cases.push(life("instantiate to the end of initialisation, and free", 0));
    cases.push(life("instantiate to the first step, and free", 1));
    Ok(cases)
}
