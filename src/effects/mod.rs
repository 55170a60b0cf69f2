//! Force laws on the mechanism: one file per effect that a scene may enable, and the loads that an FMI master sets.
//!
//! Every effect is a law on the motion of joints and tip: it answers with a wrench (five joint torques and a force on the tip), its slopes,
//! its potential and its power. A scene holds only the effects that are enabled ([`Active`]), and a step evaluates all of that list. A new
//! effect is one file, one word in the list `effects!` below, and its variables in the XML with their bindings; `CONTRIBUTING.md` names
//! every other place that a new effect touches.
//!
//! Invariant: does no input or output; the same input bits give the same output bits.

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

/// Makes the list of effects: effects that only add masses, constant in M; effects with a constant force; and effects whose force depends
/// on the motion, in the order of their evaluation.
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

        /// Names of all effects, the prefixes of their `….enabled` variables.
        pub const NAMES: [&str; [$(stringify!($mass),)+ $(stringify!($weight),)+ $(stringify!($force),)+].len()] =
            [$(stringify!($mass),)+ $(stringify!($weight),)+ $(stringify!($force),)+];

        const FORCES: usize = [$(stringify!($force),)+].len();

        /// An enabled effect whose force depends on the motion.
        #[derive(Clone, Debug, PartialEq)]
        #[expect(missing_docs, reason = "each is the type of the effect's file")]
        pub enum Effect {
            $($Force($Force),)+
        }

        impl Parameters {
            /// Names of the effects that are enabled.
            pub fn enabled(&self) -> ArrayVec<&'static str, { NAMES.len() }> {
                let all = [
                    $((stringify!($mass), self.$mass.enabled),)+
                    $((stringify!($weight), self.$weight.enabled),)+
                    $((stringify!($force), self.$force.enabled),)+
                ];
                all.into_iter().filter_map(|(name, enabled)| enabled.then_some(name)).collect()
            }

            /// The geometry with the masses, kg, and inertias, kg·m², of the effects that are enabled.
            pub fn with_added_masses(&self, geometry: &Geometry) -> Geometry {
                let mut with_added_masses = *geometry;
                $(if self.$mass.enabled { self.$mass.add_masses(&mut with_added_masses); })+
                with_added_masses
            }

            /// The constant generalised force of the effects that are enabled, N and N·m.
            pub fn weight(&self, mechanism: &Mechanism) -> Coordinates {
                let mut weight = Coordinates::ZERO;
                $(if self.$weight.enabled { self.$weight.add_weight(mechanism, &mut weight); })+
                weight
            }

            /// The enabled effects whose force depends on the motion, in the order of their evaluation.
            pub fn active(&self, mechanism: &Mechanism) -> Result<Active, SceneError> {
                let mut active = Active::new();
                $(if self.$force.enabled { active.push(Effect::$Force($Force::new(&self.$force, mechanism)?)); })+
                Ok(active)
            }
        }

        /// An effect is its force law.
        impl Deref for Effect {
            type Target = dyn ForceLaw;

            fn deref(&self) -> &Self::Target {
                match self { $(Self::$Force(force) => force,)+ }
            }
        }
    };
}

/// The enabled effects whose force depends on the motion: an array in place, so that a parameter changed during a run allocates nothing.
pub type Active = ArrayVec<Effect, FORCES>;

effects! {
    masses: rotor, payload;
    weights: gravity;
    forces: viscous: Viscous, friction: Friction, spring: Spring, stop: Stop, contact: Contact, servo: Servo;
}
