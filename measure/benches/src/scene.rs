//! Parameters and inputs by the names of variables.

use anyhow::{Context, Result, ensure};
use fivebar::simulation::bindings::{default_inputs, default_parameters, write};
use fivebar::simulation::{Inputs, Parameters, Simulation};
use fivebar::variables::{VARIABLES, Value, Variable, VariableId};

/// A scene before initialisation.
#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) parameters: Parameters,
    pub(crate) inputs: Inputs,
}

impl Scene {
    /// The fall with reference values: 90° / 120° at rest under gravity, with fixed steps.
    pub(crate) fn fall() -> Self {
        let mut parameters = default_parameters();
        parameters.start.theta[1] = 120f64.to_radians();
        parameters.settings.adaptive = false;
        Self { parameters, inputs: default_inputs() }
    }

    /// The scene with a variable set.
    pub(crate) fn with(mut self, name: &str, value: Value) -> Result<Self> {
        let variable = Variable::named(name).with_context(|| format!("there is no variable {name}"))?;
        ensure!(write(&mut self.parameters, &mut self.inputs, variable, value), "{name} cannot be set to {value}");
        Ok(self)
    }

    /// The scene with an effect on or off; a newly enabled effect gets values at which it acts on the fall.
    pub(crate) fn effect(self, name: &str, on: bool) -> Result<Self> {
        let mut scene = self.with(&format!("{name}.enabled"), Value::Boolean(on))?;
        let reached: &[(&str, f64)] = match name {
            // The left arm rests on its stop, the tip falls on the plane, the servos hold the start angles.
            "stop" => &[("stop.upper[1]", 1.5), ("stop.lower[1]", 1.3)],
            "contact" => &[("contact.offset", 0.3)],
            "servo" => &[("servo.theta[1]", 1.6), ("servo.theta[2]", 2.1)],
            _ => &[],
        };
        if on {
            for (name, value) in reached {
                scene = scene.with(name, Value::Real(*value))?;
            }
        }
        Ok(scene)
    }

    /// The initialised simulation.
    pub(crate) fn simulation(&self) -> Result<Simulation> {
        Ok(Simulation::new(&self.parameters, &self.inputs)?)
    }
}

/// The estimator has a variable `….enabled` but is no effect.
pub(crate) const ESTIMATOR: &str = "estimator";

/// Names with a variable `….enabled`, except the estimator.
pub(crate) fn effects() -> impl Iterator<Item = &'static str> {
    VARIABLES.iter().filter_map(|variable| variable.name.strip_suffix(".enabled")).filter(|name| *name != ESTIMATOR)
}

/// Changed values for the Real parameters of an effect.
pub(crate) fn other_values(effect: &str) -> impl Iterator<Item = (&'static str, Value)> {
    VARIABLES.iter().filter_map(move |variable| {
        let own = variable.name.strip_prefix(effect).is_some_and(|rest| rest.starts_with('.'));
        match (variable.id, variable.start) {
            (VariableId::Parameter(_), Some(Value::Real(start))) if own => {
                Some((variable.name, Value::Real((1.25 * start + 0.125).min(variable.max.unwrap_or(f64::INFINITY)))))
            }
            _ => None,
        }
    })
}
