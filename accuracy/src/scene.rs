//! Scenes: the files of `scenes/`, and those that are judged against a reference.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use fivebar::fmi::bindings::{self, default_inputs, default_parameters};
use fivebar::simulation::{Inputs, Parameters};
use fivebar::variables::{Access, Value, Variable};

use crate::{Extent, Reference};

/// What makes a scene hard or easy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// No singularity near, no fast motion.
    Smooth,
    /// Links whip round near singularities.
    Whipping,
    /// Motion with effects: springs, payload, rotors, friction.
    Effects,
    /// Loads far faster than the motion.
    Stiff,
}

impl Kind {
    /// As it stands in the tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Smooth => "smooth",
            Self::Whipping => "whipping",
            Self::Effects => "with effects",
            Self::Stiff => "stiff",
        }
    }
}

/// A scene with the reference it is judged against.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Name of the file of `scenes/`, without its ending.
    pub name: &'static str,
    /// What makes it hard or easy.
    pub kind: Kind,
    /// How long it is followed, s.
    pub end: f64,
    /// The machine, its start and its effects.
    pub parameters: Parameters,
    /// Held all the time.
    pub inputs: Inputs,
    /// What it is judged against.
    pub reference: Reference,
}

/// Name, kind, length (s), reference file or step (s) of the Runge-Kutta run that checks our own.
type Judged = (&'static str, Kind, f64, Result<&'static str, f64>);

const JUDGED: [Judged; 7] = [
    ("swing", Kind::Smooth, 2.0, Err(1e-5)),
    ("fall_90_120", Kind::Whipping, 1.0, Ok("fall_90_120")),
    ("fall_90_120", Kind::Whipping, 2.0, Ok("fall_90_120")),
    ("paper_torque", Kind::Whipping, 0.5, Ok("torque")),
    ("spring_payload", Kind::Effects, 1.0, Ok("spring_payload")),
    ("friction_fall", Kind::Effects, 1.0, Ok("friction_fall")),
    ("stiff_servo", Kind::Stiff, 0.5, Err(2e-6)),
];

impl Scene {
    /// The scenes that have a reference; `Quick` leaves out those whose like is there.
    pub fn judged(extent: Extent) -> Result<Vec<Self>> {
        let wanted = |(name, _, end, _): &&Judged| {
            extent == Extent::Full || (*end == 1.0 && *name != "friction_fall") || *name == "stiff_servo"
        };
        JUDGED.iter().filter(wanted).map(Self::with_reference).collect()
    }

    fn with_reference(&(name, kind, end, reference): &Judged) -> Result<Self> {
        eprintln!("reference: {name}, {end} s");
        let (parameters, inputs) = load(name)?;
        let reference = match reference {
            Ok(file) => Reference::read(file, end)?,
            Err(step) => Reference::compute(&parameters, &inputs, end, step).with_context(|| format!("the reference of {name}"))?,
        };
        Ok(Self { name, kind, end, parameters, inputs, reference })
    }

    /// Name and length: what tells the scenes apart.
    pub fn title(&self) -> String {
        format!("{}, {} s", self.name, self.end)
    }
}

/// Parameters and inputs of a file of `scenes/`; one with signals is refused, its inputs being no constants.
pub(crate) fn load(name: &str) -> Result<(Parameters, Inputs)> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenes").join(name).with_extension("json");
    let text = std::fs::read_to_string(&file).with_context(|| format!("scenes/{name}.json cannot be read"))?;
    let scene: serde_json::Map<String, serde_json::Value> =
        serde_json::from_str(&text).with_context(|| format!("scenes/{name}.json is no JSON object"))?;
    let (mut parameters, mut inputs) = (default_parameters(), default_inputs());
    for (key, value) in &scene {
        match key.as_str() {
            "description" | "experiment" | "overlay" => {}
            "signals" => bail!("scenes/{name}.json has signals, which are not constant; a scene without them is needed"),
            key => {
                let variable = Variable::named(key).with_context(|| format!("scenes/{name}.json: there is no variable {key}"))?;
                let value = match variable.access() {
                    Access::Real => value.as_f64().map(Value::Real),
                    Access::Boolean => value.as_bool().map(Value::Boolean),
                    Access::Integer => value.as_i64().and_then(|n| i32::try_from(n).ok()).map(Value::Integer),
                };
                let written = value.is_some_and(|value| bindings::write(&mut parameters, &mut inputs, variable, value));
                ensure!(written, "scenes/{name}.json: {key} has a value that does not fit its type {}", variable.access());
            }
        }
    }
    Ok((parameters, inputs))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_is_what_its_file_says() {
        let (parameters, inputs) = load("stiff_servo").expect("a shipped scene");
        assert!(parameters.effects.servo.enabled);
        assert_eq!((parameters.effects.servo.kp, inputs.servo_theta[0]), ([1e6, 0.0], std::f64::consts::FRAC_PI_2));
        assert_eq!(parameters.geometry, default_parameters().geometry);
    }

    #[test]
    fn inputs_that_change_are_refused() {
        let refusal = load("pick_and_place").expect_err("it has signals").to_string();
        assert_eq!(refusal, "scenes/pick_and_place.json has signals, which are not constant; a scene without them is needed");
    }
}
