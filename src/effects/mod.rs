//! Force laws on the mechanism: one file per effect that a scene may enable, and the loads that an FMI master sets.
//!
//! Every effect answers with a generalised force Q in the 12 coordinates, its tangents K = −∂Q/∂q and C = −∂Q/∂q̇, its potential and
//! its dissipated power. A scene holds only the effects that are enabled ([`Active`]), and a step evaluates all of that list. A new
//! effect is one file, one word in the list `effects!` below, and its variables in the XML with their bindings; `CONTRIBUTING.md` names
//! every other place that a new effect touches.
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
pub use unilateral_spring::cubic_minimum;
pub use variation::Perturbation;

use arrayvec::ArrayVec;

use crate::mechanism::{COORDINATES, Coordinates, Geometry, Mechanism, SceneError};

/// An effect whose force depends on the motion, made ready from its parameters. The head of its file gives the formula and the source.
///
/// Bodies of more than a few additions are not inlined: otherwise the step of every method would hold a copy of every effect.
trait Force: Sized {
    /// Variables of the effect.
    type Parameters;

    /// Makes the effect ready; refuses parameters that are not allowed.
    fn new(parameters: &Self::Parameters, mechanism: &Mechanism) -> Result<Self, SceneError>;

    /// Whether the tangents couple links, which rules out the two-leg linear solve.
    fn couples_links(&self) -> bool {
        false
    }

    /// Whether the whole force has a potential.
    fn conservative(&self) -> bool {
        true
    }

    /// Adds the generalised force Q, N and N·m.
    fn add_forces(&self, at: &ForceContext, forces: &mut Coordinates);

    /// Adds the generalised force Q, N and N·m, and returns the input power and the dissipated power, W: one call for all three is
    /// cheaper than three.
    fn act(&self, at: &ForceContext, forces: &mut Coordinates) -> [f64; 2] {
        self.add_forces(at, forces);
        [self.input_power(at), self.dissipation(at)]
    }

    /// Adds K = −∂Q/∂q and C = −∂Q/∂q̇.
    fn add_tangents(&self, _at: &ForceContext, _tangents: &mut impl Tangents) {}

    /// Adds ∂Q/∂u δu for the inputs u that the effect reads, N and N·m.
    fn add_input_change(&self, _at: &ForceContext, _change: &Inputs, _forces: &mut Coordinates) {}

    /// Potential energy, J.
    fn potential(&self, _at: &ForceContext) -> f64 {
        0.0
    }

    /// Power put in from outside the mechanism, W.
    fn input_power(&self, _at: &ForceContext) -> f64 {
        0.0
    }

    /// Dissipated power, W. The power of the force is input − dissipation − dU/dt.
    fn dissipation(&self, _at: &ForceContext) -> f64 {
        0.0
    }

    /// Whether the force has regions so stiff and so short that a long step may miss them.
    const HAS_STIFF_FORCES: bool = false;

    /// Whether the effect has unilateral springs, whose guards a method may locate.
    const HAS_CONTACT: bool = false;

    /// Unilateral springs of the effect, with their guard values.
    fn guard_values(&self, _at: &ForceContext) -> ArrayVec<UnilateralGuard<'_>, SPRINGS> {
        ArrayVec::new()
    }

    /// Whether the effect has set-valued dry friction.
    fn sticks(&self) -> bool {
        false
    }

    /// Rate of a joint over which smooth friction reverses its direction, rad/s; infinite without such a force.
    fn regularization_velocity(&self) -> f64 {
        f64::INFINITY
    }

    /// Whether the force is smooth but has a region so narrow that the stages of a step may lie on both sides of the region and none in it.
    fn has_sharp_nonlinearity(&self) -> bool {
        false
    }

    /// Adds the friction constraints of the effect.
    fn add_friction_constraints(&self, _at: &ForceContext, _grasps: &mut FrictionConstraints<COORDINATES>) {}
}

/// Mean of a force over a finite step, for the energy-conserving method: its work, force times displacement, equals exactly the loss of
/// potential plus the input less the dissipation, J.
trait MeanForce: Force {
    /// Adds the mean generalised force Q̄ of a step, N and N·m.
    fn add_mean_forces(&self, over: &StepContext, forces: &mut Coordinates);

    /// Adds K = −∂Q̄/∂d and C = −∂Q̄/∂q̇₁, with d the increment of the coordinates and q̇₁ the velocities at the step's end.
    fn add_mean_tangents(&self, over: &StepContext, tangents: &mut impl Tangents);

    /// Work put in from outside the mechanism over a step, J.
    fn input_over(&self, _over: &StepContext) -> f64 {
        0.0
    }

    /// Energy dissipated over a step, J.
    fn dissipated_over(&self, _over: &StepContext) -> f64 {
        0.0
    }
}

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
            pub fn with_added_masses(&self, geometry: &Geometry) -> Result<Geometry, SceneError> {
                let mut with_added_masses = *geometry;
                $(if self.$mass.enabled { self.$mass.add_masses(&mut with_added_masses)?; })+
                Ok(with_added_masses)
            }

            /// The constant generalised force of the effects that are enabled, N and N·m.
            pub fn weight(&self, mechanism: &Mechanism) -> Result<Coordinates, SceneError> {
                let mut weight = Coordinates::ZERO;
                $(if self.$weight.enabled { self.$weight.add_weight(mechanism, &mut weight)?; })+
                Ok(weight)
            }

            /// The enabled effects whose force depends on the motion, in the order of their evaluation.
            pub fn active(&self, mechanism: &Mechanism) -> Result<Active, SceneError> {
                let mut active = Active::new();
                $(if self.$force.enabled { active.push(Effect::$Force($Force::new(&self.$force, mechanism)?)); })+
                Ok(active)
            }
        }

        impl Effect {
            /// Name of the effect, the prefix of its `….enabled` variable.
            pub fn name(&self) -> &'static str {
                match self { $(Self::$Force(_) => stringify!($force),)+ }
            }

            /// Whether the tangents couple links, which rules out the two-leg linear solve.
            pub fn couples_links(&self) -> bool {
                match self { $(Self::$Force(force) => force.couples_links(),)+ }
            }

            /// Whether the whole force has a potential.
            pub fn conservative(&self) -> bool {
                match self { $(Self::$Force(force) => force.conservative(),)+ }
            }

            /// Adds the generalised force Q, N and N·m.
            #[inline]
            pub fn add_forces(&self, at: &ForceContext, forces: &mut Coordinates) {
                match self { $(Self::$Force(force) => force.add_forces(at, forces),)+ }
            }

            /// Adds the generalised force Q, N and N·m, and returns the input power and the dissipated power, W.
            #[inline]
            pub fn act(&self, at: &ForceContext, forces: &mut Coordinates) -> [f64; 2] {
                match self { $(Self::$Force(force) => force.act(at, forces),)+ }
            }

            /// Adds K = −∂Q/∂q and C = −∂Q/∂q̇.
            #[inline]
            pub fn add_tangents(&self, at: &ForceContext, tangents: &mut impl Tangents) {
                match self { $(Self::$Force(force) => force.add_tangents(at, tangents),)+ }
            }

            /// Adds ∂Q/∂u δu for the inputs u that the effect reads, N and N·m.
            fn add_input_change(&self, at: &ForceContext, change: &Inputs, forces: &mut Coordinates) {
                match self { $(Self::$Force(force) => force.add_input_change(at, change, forces),)+ }
            }

            /// Adds the mean generalised force Q̄ of a step, N and N·m.
            pub fn add_mean_forces(&self, over: &StepContext, forces: &mut Coordinates) {
                match self { $(Self::$Force(force) => force.add_mean_forces(over, forces),)+ }
            }

            /// Adds K = −∂Q̄/∂d and C = −∂Q̄/∂q̇₁, with d the increment of the coordinates and q̇₁ the velocities at the step's end.
            pub fn add_mean_tangents(&self, over: &StepContext, tangents: &mut impl Tangents) {
                match self { $(Self::$Force(force) => force.add_mean_tangents(over, tangents),)+ }
            }

            /// Work put in from outside the mechanism over a step, J.
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

            /// Power put in from outside the mechanism, W.
            pub fn input_power(&self, at: &ForceContext) -> f64 {
                match self { $(Self::$Force(force) => force.input_power(at),)+ }
            }

            /// Dissipated power, W.
            pub fn dissipation(&self, at: &ForceContext) -> f64 {
                match self { $(Self::$Force(force) => force.dissipation(at),)+ }
            }

            /// Whether the force has guards that a method may locate.
            pub fn has_events(&self) -> bool {
                self.may_make_contact() || self.sticks()
            }

            /// Whether the effect has unilateral springs.
            pub fn may_make_contact(&self) -> bool {
                match self { $(Self::$Force(_) => $Force::HAS_CONTACT,)+ }
            }

            /// Whether the effect has set-valued dry friction.
            pub fn sticks(&self) -> bool {
                match self { $(Self::$Force(force) => force.sticks(),)+ }
            }

            /// Adds the friction constraints of the effect.
            pub fn add_friction_constraints(&self, at: &ForceContext, friction_constraints: &mut FrictionConstraints<COORDINATES>) {
                match self { $(Self::$Force(force) => force.add_friction_constraints(at, friction_constraints),)+ }
            }

            /// Whether the force has regions so stiff and so short that a long step may miss them.
            pub fn has_stiff_forces(&self) -> bool {
                match self { $(Self::$Force(_) => $Force::HAS_STIFF_FORCES,)+ }
            }

            /// Rate of a joint over which smooth friction reverses its direction, rad/s; infinite without such a force.
            pub fn regularization_velocity(&self) -> f64 {
                match self { $(Self::$Force(force) => force.regularization_velocity(),)+ }
            }

            /// Whether the force is smooth but has a region that the stages of a step may miss.
            pub fn has_sharp_nonlinearity(&self) -> bool {
                match self { $(Self::$Force(force) => force.has_sharp_nonlinearity(),)+ }
            }

            /// Unilateral springs of the effect, with their guard values.
            fn guard_values(&self, at: &ForceContext) -> ArrayVec<UnilateralGuard<'_>, SPRINGS> {
                match self { $(Self::$Force(force) => force.guard_values(at),)+ }
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
