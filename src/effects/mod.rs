//! What acts on the mechanism: one file per effect a scene may call for, and the loads that a master sets.
//!
//! An effect that is off is not in memory: a scene made ready holds those that are enabled, and a step goes through that list
//! without asking. A new effect is one file and one word in the list below, and its variables in the XML with their bindings; `CONTRIBUTING.md` names
//! everything else that it touches.
//!
//! Invariant: does no input or output; the same input bits give the same output bits.

mod force_context;
mod guards;
pub mod loads;
mod step_context;
pub mod stick_slip;
pub mod tangents;
mod unilateral_spring;
mod variation;

pub use force_context::{ForceContext, JOINTS};
pub use guards::{Extremes, FrictionGuard, FrictionGuards, GuardValues, INDICATORS, Mode, stick_velocity};
use guards::{SPRINGS, UnilateralGuard};
pub use loads::Inputs;
pub use step_context::{StepContext, TypicalInertia};
pub use stick_slip::{FRICTION_PLACES, FrictionConstraint, FrictionConstraints, Law, StickSlips};
pub use tangents::Tangents;
pub use unilateral_spring::lowest;
pub use variation::Perturbation;

use arrayvec::ArrayVec;

use crate::mechanism::{COORDINATES, Coordinates, Geometry, Mechanism, SceneError};

/// An effect with a force that depends on the motion, ready to act. Its file says what it adds and where it comes from.
///
/// What is more than a few additions is not inlined: the steps of every method would each hold a copy of every effect.
trait Force: Sized {
    /// Its variables.
    type Parameters;

    /// Made ready from checked parameters.
    fn new(parameters: &Self::Parameters, mechanism: &Mechanism) -> Result<Self, SceneError>;

    /// Whether its tangents couple links, so that the fast linear solve will not do.
    fn couples_links(&self) -> bool {
        false
    }

    /// Whether all of its force has a potential.
    fn conservative(&self) -> bool {
        true
    }

    /// Adds the generalised force Q.
    fn add_forces(&self, at: &ForceContext, forces: &mut Coordinates);

    /// Adds the generalised force Q, and answers with the power put in and that dissipated, W, as below: for less than one by one.
    fn act(&self, at: &ForceContext, forces: &mut Coordinates) -> [f64; 2] {
        self.add_forces(at, forces);
        [self.input_power(at), self.dissipation(at)]
    }

    /// Adds K = −∂Q/∂q and C = −∂Q/∂q̇.
    fn add_tangents(&self, _at: &ForceContext, _tangents: &mut impl Tangents) {}

    /// Adds ∂Q/∂u δu for inputs u that it reads.
    fn add_input_change(&self, _at: &ForceContext, _change: &Inputs, _forces: &mut Coordinates) {}

    /// Potential energy, J.
    fn potential(&self, _at: &ForceContext) -> f64 {
        0.0
    }

    /// Power put in from outside, W.
    fn input_power(&self, _at: &ForceContext) -> f64 {
        0.0
    }

    /// Power dissipated, W. The force's power is input − dissipation − dU/dt.
    fn dissipation(&self, _at: &ForceContext) -> f64 {
        0.0
    }

    /// Whether the force changes so steeply in places that a long step may miss it.
    const HAS_STIFF_FORCES: bool = false;

    /// Whether it has one-sided springs, whose kinks a method may follow.
    const HAS_CONTACT: bool = false;

    /// Its one-sided springs.
    fn guard_values(&self, _at: &ForceContext) -> ArrayVec<UnilateralGuard<'_>, SPRINGS> {
        ArrayVec::new()
    }

    /// Whether it has dry friction that sticks.
    fn sticks(&self) -> bool {
        false
    }

    /// The change of a joint's rate by which its force turns round without a kink, rad/s.
    fn regularization_velocity(&self) -> f64 {
        f64::INFINITY
    }

    /// Whether it bends so sharply, without a kink, that stages of a step may stand on both sides and none within.
    fn has_sharp_nonlinearity(&self) -> bool {
        false
    }

    /// Adds the grips that it has.
    fn add_friction_constraints(&self, _at: &ForceContext, _grasps: &mut FrictionConstraints<COORDINATES>) {}
}

/// The same force over a finite step, for the method that conserves: its work, force times displacement, is exactly what its potential
/// loses, what is put in and what is dissipated.
trait MeanForce: Force {
    /// Adds the mean generalised force Q̄ of a step.
    fn add_mean_forces(&self, over: &StepContext, forces: &mut Coordinates);

    /// Adds K = −∂Q̄/∂d and C = −∂Q̄/∂q̇₁, of the change of the coordinates and the rates at the end.
    fn add_mean_tangents(&self, over: &StepContext, tangents: &mut impl Tangents);

    /// Work put in from outside, J.
    fn input_over(&self, _over: &StepContext) -> f64 {
        0.0
    }

    /// Energy dissipated, J.
    fn dissipated_over(&self, _over: &StepContext) -> f64 {
        0.0
    }
}

/// Makes the list of effects: those that only add masses, constant in M, those with a constant force, and those whose force depends
/// on the motion, in the order in which they act.
macro_rules! effects {
    (masses: $($mass:ident),+; weights: $($weight:ident),+; forces: $($force:ident: $Force:ident),+;) => {
        $(pub mod $mass;)+
        $(pub mod $weight;)+
        $(pub mod $force;)+
        $(pub use $force::$Force;)+

        /// The parameters of every effect, whether the scene calls for it or not.
        #[derive(Clone, Debug, Default, PartialEq)]
        pub struct Parameters {
            $(#[doc = concat!("See [`", stringify!($mass), "`].")] pub $mass: $mass::Parameters,)+
            $(#[doc = concat!("See [`", stringify!($weight), "`].")] pub $weight: $weight::Parameters,)+
            $(#[doc = concat!("See [`", stringify!($force), "`].")] pub $force: $force::Parameters,)+
        }

        /// Names of all effects: those of their `….enabled` variables.
        pub const NAMES: [&str; [$(stringify!($mass),)+ $(stringify!($weight),)+ $(stringify!($force),)+].len()] =
            [$(stringify!($mass),)+ $(stringify!($weight),)+ $(stringify!($force),)+];

        const FORCES: usize = [$(stringify!($force),)+].len();

        /// An effect with a force that depends on the motion, which the scene calls for, ready to act.
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

            /// The geometry with the masses of the effects that are enabled.
            pub fn with_added_masses(&self, geometry: &Geometry) -> Result<Geometry, SceneError> {
                let mut with_added_masses = *geometry;
                $(if self.$mass.enabled { self.$mass.add_masses(&mut with_added_masses)?; })+
                Ok(with_added_masses)
            }

            /// The constant generalised force of the effects that are enabled.
            pub fn weight(&self, mechanism: &Mechanism) -> Result<Coordinates, SceneError> {
                let mut weight = Coordinates::ZERO;
                $(if self.$weight.enabled { self.$weight.add_weight(mechanism, &mut weight)?; })+
                Ok(weight)
            }

            /// The effects whose force depends on the motion that are enabled, in the order in which they act.
            pub fn active(&self, mechanism: &Mechanism) -> Result<Active, SceneError> {
                let mut active = Active::new();
                $(if self.$force.enabled { active.push(Effect::$Force($Force::new(&self.$force, mechanism)?)); })+
                Ok(active)
            }
        }

        impl Effect {
            /// The effect's name, that of its `….enabled` variable.
            pub fn name(&self) -> &'static str {
                match self { $(Self::$Force(_) => stringify!($force),)+ }
            }

            /// Whether its tangents couple links, so that the fast linear solve will not do.
            pub fn couples_links(&self) -> bool {
                match self { $(Self::$Force(force) => force.couples_links(),)+ }
            }

            /// Whether all of its force has a potential.
            pub fn conservative(&self) -> bool {
                match self { $(Self::$Force(force) => force.conservative(),)+ }
            }

            /// Adds the generalised force Q.
            #[inline]
            pub fn add_forces(&self, at: &ForceContext, forces: &mut Coordinates) {
                match self { $(Self::$Force(force) => force.add_forces(at, forces),)+ }
            }

            /// Adds the generalised force Q, and answers with the power put in and that dissipated, W.
            #[inline]
            pub fn act(&self, at: &ForceContext, forces: &mut Coordinates) -> [f64; 2] {
                match self { $(Self::$Force(force) => force.act(at, forces),)+ }
            }

            /// Adds K = −∂Q/∂q and C = −∂Q/∂q̇.
            #[inline]
            pub fn add_tangents(&self, at: &ForceContext, tangents: &mut impl Tangents) {
                match self { $(Self::$Force(force) => force.add_tangents(at, tangents),)+ }
            }

            /// Adds ∂Q/∂u δu for inputs u that it reads.
            fn add_input_change(&self, at: &ForceContext, change: &Inputs, forces: &mut Coordinates) {
                match self { $(Self::$Force(force) => force.add_input_change(at, change, forces),)+ }
            }

            /// Adds the mean generalised force Q̄ of a step.
            pub fn add_mean_forces(&self, over: &StepContext, forces: &mut Coordinates) {
                match self { $(Self::$Force(force) => force.add_mean_forces(over, forces),)+ }
            }

            /// Adds K = −∂Q̄/∂d and C = −∂Q̄/∂q̇₁.
            pub fn add_mean_tangents(&self, over: &StepContext, tangents: &mut impl Tangents) {
                match self { $(Self::$Force(force) => force.add_mean_tangents(over, tangents),)+ }
            }

            /// Work put in from outside over a step, J.
            pub fn input_over(&self, over: &StepContext) -> f64 {
                match self { $(Self::$Force(force) => force.input_over(over),)+ }
            }

            /// Energy dissipated over a step, J.
            pub fn dissipated_over(&self, over: &StepContext) -> f64 {
                match self { $(Self::$Force(force) => force.dissipated_over(over),)+ }
            }

            /// Potential energy, J.
            pub fn potential(&self, at: &ForceContext) -> f64 {
                match self { $(Self::$Force(force) => force.potential(at),)+ }
            }

            /// Power put in from outside, W.
            pub fn input_power(&self, at: &ForceContext) -> f64 {
                match self { $(Self::$Force(force) => force.input_power(at),)+ }
            }

            /// Power dissipated, W.
            pub fn dissipation(&self, at: &ForceContext) -> f64 {
                match self { $(Self::$Force(force) => force.dissipation(at),)+ }
            }

            /// Whether its force has kinks that a method may follow.
            pub fn has_events(&self) -> bool {
                self.may_make_contact() || self.sticks()
            }

            /// Whether it has one-sided springs.
            pub fn may_make_contact(&self) -> bool {
                match self { $(Self::$Force(_) => $Force::HAS_CONTACT,)+ }
            }

            /// Whether it has dry friction that sticks.
            pub fn sticks(&self) -> bool {
                match self { $(Self::$Force(force) => force.sticks(),)+ }
            }

            /// Adds the grips that it has.
            pub fn add_friction_constraints(&self, at: &ForceContext, friction_constraints: &mut FrictionConstraints<COORDINATES>) {
                match self { $(Self::$Force(force) => force.add_friction_constraints(at, friction_constraints),)+ }
            }

            /// Whether the force changes so steeply in places that a long step may miss it.
            pub fn has_stiff_forces(&self) -> bool {
                match self { $(Self::$Force(_) => $Force::HAS_STIFF_FORCES,)+ }
            }

            /// The change of a joint's rate by which its force turns round without a kink, rad/s.
            pub fn regularization_velocity(&self) -> f64 {
                match self { $(Self::$Force(force) => force.regularization_velocity(),)+ }
            }

            /// Whether it bends sharply without a kink.
            pub fn has_sharp_nonlinearity(&self) -> bool {
                match self { $(Self::$Force(force) => force.has_sharp_nonlinearity(),)+ }
            }

            /// Its one-sided springs.
            fn guard_values(&self, at: &ForceContext) -> ArrayVec<UnilateralGuard<'_>, SPRINGS> {
                match self { $(Self::$Force(force) => force.guard_values(at),)+ }
            }
        }
    };
}

/// The effects that act: in place, so that a parameter changed during a run allocates nothing.
pub type Active = ArrayVec<Effect, FORCES>;

effects! {
    masses: rotor, payload;
    weights: gravity;
    forces: viscous: Viscous, friction: Friction, spring: Spring, stop: Stop, contact: Contact, servo: Servo;
}
