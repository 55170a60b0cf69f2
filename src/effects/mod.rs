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

use std::ops::{Deref, Range};

use arrayvec::ArrayVec;

use crate::hybrid::KINKS;
use crate::mechanism::{Coordinates, Geometry, Mechanism, SceneError};

/// Declares the effects in three groups: effects that only add masses, which are constant in M; effects with a constant force; and effects
/// with a force that depends on the motion, in the order of their evaluation. A force with kinks declares their indices in the mode. Its
/// event indicators have the same indices, which do not change when effects are added.
macro_rules! effects {
    (masses: $($mass:ident),+; weights: $($weight:ident),+; forces: $($force:ident: $Force:ident $(with kinks $kinks:expr)?),+;) => {
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

            /// Switch of an effect by its name; `None` if no effect has this name.
            pub fn switch(&mut self, name: &str) -> Option<&mut bool> {
                match name {
                    $(stringify!($mass) => Some(&mut self.$mass.enabled),)+
                    $(stringify!($weight) => Some(&mut self.$weight.enabled),)+
                    $(stringify!($force) => Some(&mut self.$force.enabled),)+
                    _ => None,
                }
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

        $($(
            impl $Force {
                /// Indices of its kinks.
                pub(super) const KINKS: Range<usize> = $kinks;
            }
        )?)+

        const _: () = check_kinks(&[$($($kinks,)?)+]);

        impl Effect {
            /// Whether the force has kinks.
            pub fn has_kinks(&self) -> bool {
                match self { $(Self::$Force(_) => !<[Range<usize>]>::is_empty(&[$($kinks)?]),)+ }
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

/// Stops compilation unless each index of the mode belongs to exactly one kink.
const fn check_kinks(of_effects: &[Range<usize>]) {
    let (mut taken, mut effect, mut count) = ([false; KINKS], 0, 0);
    while effect < of_effects.len() {
        let mut index = of_effects[effect].start;
        while index < of_effects[effect].end {
            assert!(index < KINKS, "effects! has more kinks than KINKS in src/hybrid/mode.rs");
            assert!(!taken[index], "two effects have kinks with the same index");
            (taken[index], count, index) = (true, count + 1, index + 1);
        }
        effect += 1;
    }
    assert!(count == KINKS, "KINKS in src/hybrid/mode.rs is more than the kinks of effects!");
}

/// Enabled effects with a force that depends on the motion. The array is stored in place, so that changing a parameter during a run
/// allocates nothing.
pub type Active = ArrayVec<Effect, FORCES>;

effects! {
    masses: rotor, payload;
    weights: gravity;
    forces: viscous: Viscous, friction: Friction, spring: Spring, stop: Stop with kinks 1..5, contact: Contact with kinks 0..1, servo: Servo;
}
