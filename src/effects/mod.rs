//! Force laws on the mechanism: one file per effect that a scene may enable, and the loads that an FMI master sets.
//!
//! Every effect is a law on the motion of joints and tip: it returns a wrench (five joint torques and a force on the tip), slopes,
//! potential and power. A scene contains only its enabled effects ([`Active`]), and a step evaluates all of them. A new effect is one file,
//! one word in the list `effects!` below, and its variables in the XML with their bindings; `CONTRIBUTING.md` lists all other places.
//!
//! Invariant: no input or output; the same input bits give the same output bits.

mod finite_motion;
mod force_law;
pub mod loads;
mod wrench;

pub use crate::hybrid::{Law, Mode};
pub use finite_motion::{FiniteMotion, TypicalInertia};
pub use force_law::{ForceLaw, PowerFlow, Properties};
pub use loads::Inputs;
pub use wrench::{
    FrictionElement, FrictionElements, JOINT_LINKS, JOINTS, JointMotion, MOTOR_ANGLES, Matrix, Motion, MotionChange, Planar,
    Slopes, Wrench, across_joints, dot, times,
};

use std::ops::Deref;

use arrayvec::ArrayVec;

use crate::mechanism::{Coordinates, Geometry, Mechanism, SceneError};

/// Declares the effects in three groups: effects that only add masses, which are constant in M; effects with a constant force; and effects
/// with a force that depends on the motion, in the order of their evaluation.
macro_rules! effects {
    (masses: $($mass:ident),+; weights: $($weight:ident),+; forces: $($force:ident: $Force:ident),+;) => {
        $(pub mod $mass;)+
        $(pub mod $weight;)+
        $(pub mod $force;)+
        $(pub use $force::$Force;)+

        /// The parameters of every effect, enabled or not.
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct Parameters {
            $(#[doc = concat!("See [`", stringify!($mass), "`].")] pub $mass: $mass::Parameters,)+
            $(#[doc = concat!("See [`", stringify!($weight), "`].")] pub $weight: $weight::Parameters,)+
            $(#[doc = concat!("See [`", stringify!($force), "`].")] pub $force: $force::Parameters,)+
        }

        /// Names of all effects: the prefixes of their `….enabled` variables.
        pub const NAMES: [&str; [$(stringify!($mass),)+ $(stringify!($weight),)+ $(stringify!($force),)+].len()] =
            [$(stringify!($mass),)+ $(stringify!($weight),)+ $(stringify!($force),)+];

        const FORCES: usize = [$(stringify!($force),)+].len();

        /// An enabled effect with a force that depends on the motion.
        #[derive(Clone, Debug, PartialEq)]
        #[expect(missing_docs, reason = "each is the type of the effect's file")]
        pub enum Effect {
            $($Force($Force),)+
        }

        impl Parameters {
            /// Names of the enabled effects.
            pub fn enabled(&self) -> ArrayVec<&'static str, { NAMES.len() }> {
                let all = [
                    $((stringify!($mass), self.$mass.enabled),)+
                    $((stringify!($weight), self.$weight.enabled),)+
                    $((stringify!($force), self.$force.enabled),)+
                ];
                all.into_iter().filter_map(|(name, enabled)| enabled.then_some(name)).collect()
            }

            /// The geometry with the masses, kg, and inertias, kg·m², that the enabled effects add.
            pub fn with_added_masses(&self, geometry: &Geometry) -> Geometry {
                let mut with_added_masses = *geometry;
                $(if self.$mass.enabled { self.$mass.add_masses(&mut with_added_masses); })+
                with_added_masses
            }

            /// Constant generalised force of the enabled effects, N and N·m.
            pub fn weight(&self, mechanism: &Mechanism) -> Coordinates {
                let mut weight = Coordinates::ZERO;
                $(if self.$weight.enabled { self.$weight.add_weight(mechanism, &mut weight); })+
                weight
            }

            /// Prepares the enabled effects with a force that depends on the motion, in the order of their evaluation. Refuses parameters
            /// that an effect refuses.
            pub fn active(&self, mechanism: &Mechanism) -> Result<Active, SceneError> {
                let mut active = Active::new();
                $(if self.$force.enabled { active.push(Effect::$Force($Force::new(&self.$force, mechanism)?)); })+
                Ok(active)
            }
        }

        /// Effects are used through their force law.
        impl Deref for Effect {
            type Target = dyn ForceLaw;

            fn deref(&self) -> &Self::Target {
                match self { $(Self::$Force(force) => force,)+ }
            }
        }
    };
}

/// Enabled effects with a force that depends on the motion. The array is stored in place, so that changing a parameter during a run
/// allocates nothing.
pub type Active = ArrayVec<Effect, FORCES>;

effects! {
    masses: rotor, payload;
    weights: gravity;
    forces: viscous: Viscous, friction: Friction, spring: Spring, stop: Stop, contact: Contact, servo: Servo;
}
