//! Scenes: the files of `scenes/`, and those that are judged against a reference.

use anyhow::{Result, ensure};
use fivebar::simulation::{Inputs, Parameters};
use scenes::Scene as File;

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
    /// Stops and contacts, hit and left.
    Impacts,
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
            Self::Impacts => "with impacts",
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

/// Name, kind, length (s), file of the reference.
type Judged = (&'static str, Kind, f64, &'static str);

const JUDGED: [Judged; 11] = [
    ("swing", Kind::Smooth, 2.0, "swing"),
    ("fall_90_120", Kind::Whipping, 1.0, "fall_90_120"),
    ("fall_90_120", Kind::Whipping, 2.0, "fall_90_120"),
    ("paper_torque", Kind::Whipping, 0.5, "torque"),
    ("spring_payload", Kind::Effects, 1.0, "spring_payload"),
    ("friction_fall", Kind::Effects, 1.0, "friction_fall"),
    ("run_down", Kind::Effects, 1.0, "run_down"),
    ("end_stops", Kind::Impacts, 1.0, "end_stops"),
    ("bounce", Kind::Impacts, 1.0, "bounce"),
    ("stiff_servo", Kind::Stiff, 0.5, "stiff_servo"),
    ("servo_step", Kind::Stiff, 1.0, "servo_step"),
];

/// Those of them that a quick run judges: one of each kind, but the smooth one, which is the longest.
const QUICK: [&str; 4] = ["fall_90_120", "spring_payload", "bounce", "stiff_servo"];

impl Scene {
    /// The scenes that have a reference; `Quick` leaves out those whose like is there.
    pub fn judged(extent: Extent) -> Result<Vec<Self>> {
        let wanted = |(name, _, end, _): &&Judged| extent == Extent::Full || (QUICK.contains(name) && *end <= 1.0);
        JUDGED.iter().filter(wanted).map(Self::with_reference).collect()
    }

    fn with_reference(&(name, kind, end, reference): &Judged) -> Result<Self> {
        let (parameters, inputs) = load(name)?;
        Ok(Self { name, kind, end, parameters, inputs, reference: Reference::read(reference, end)? })
    }

    /// Name and length: what tells the scenes apart.
    pub fn title(&self) -> String {
        format!("{}, {} s", self.name, self.end)
    }
}

/// Parameters and inputs of a file of `scenes/`; one with signals is refused: held over communication steps, whose length depends on
/// the setting, they would be another motion for each.
pub(crate) fn load(name: &str) -> Result<(Parameters, Inputs)> {
    let scene = File::read(name)?;
    ensure!(scene.signals.is_empty(), "scenes/{name}.json has signals, which are not constant; a scene without them is needed");
    scene.start()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_that_change_are_refused() {
        let refusal = load("pick_and_place").expect_err("it has signals").to_string();
        assert_eq!(refusal, "scenes/pick_and_place.json has signals, which are not constant; a scene without them is needed");
    }
}
