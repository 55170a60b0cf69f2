//! What acts on the mechanism: one file per effect a scene may call for, and the loads that a master sets.
//!
//! An effect that is off is not in memory: [`Effect`]s are made once, from those [`Parameters`] that are enabled, when a scene is
//! made ready, and a step goes through the list without asking. A new effect is one file and one line in [`Parameters::active`],
//! next to its variant.
//!
//! Invariant: does no input or output; the same input bits give the same output bits.

pub mod gravity;
pub mod loads;
mod tangents;

pub use gravity::Gravity;
pub use loads::Inputs;
pub use tangents::{DiagonalTangents, FullTangents, Tangents};

use crate::mechanism::{Coordinates, Mechanism, Refusal};

/// The parameters of every effect, whether the scene calls for it or not.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// See [`gravity`].
    pub gravity: gravity::Parameters,
}

/// An effect that the scene calls for, ready to act.
#[derive(Clone, Debug)]
pub enum Effect {
    /// See [`gravity`].
    Gravity(Gravity),
}

impl Parameters {
    /// The effects that are enabled, in the order in which they act.
    pub fn active(&self, mechanism: &Mechanism) -> Result<Vec<Effect>, Refusal> {
        let gravity = self.gravity.enabled.then(|| Gravity::new(&self.gravity, mechanism)).transpose()?;
        Ok([gravity.map(Effect::Gravity)].into_iter().flatten().collect())
    }
}

impl Effect {
    /// The effect's name, that of its `….enabled` variable.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Gravity(_) => "gravity",
        }
    }

    /// Whether its tangents couple links, so that the general linear solve is needed.
    pub fn couples_links(&self) -> bool {
        match self {
            Self::Gravity(_) => false,
        }
    }

    /// Adds the generalised forces Q.
    #[inline(always)]
    pub fn add_forces(&self, forces: &mut Coordinates) {
        match self {
            Self::Gravity(gravity) => gravity.add_forces(forces),
        }
    }

    /// Adds K = −∂Q/∂q and C = −∂Q/∂q̇.
    #[inline(always)]
    pub fn add_tangents(&self, _tangents: &mut impl Tangents) {
        match self {
            Self::Gravity(_) => {}
        }
    }

    /// Potential energy, J.
    pub fn potential(&self, q: &Coordinates) -> f64 {
        match self {
            Self::Gravity(gravity) => gravity.potential(q),
        }
    }
}
