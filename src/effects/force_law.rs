//! Force law of an effect: wrench, slopes and energy at an instant and over a finite step.
//!
//! A law in the joints states torques, slopes and, among its [`Properties`], where its power goes; the methods for an instant and for a
//! finite step follow from them. A law with a contact states these methods itself: the mean force of its potential over a step is a discrete
//! gradient, the change of the potential divided by the displacement.

use super::Inputs;
use super::finite_motion::FiniteMotion;
use super::wrench::{FrictionElements, JOINTS, JointMotion, Motion, Slopes, Wrench};
use crate::hybrid::UnilateralGuards;

/// Account in the energy balance to which the power of a joint law belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowerFlow {
    /// Loss of the law's potential.
    Stored,
    /// Input from outside the mechanism.
    Supplied,
    /// Dissipation.
    Dissipated,
}

impl PowerFlow {
    /// Input and dissipation, W or J, of a law with this power, W, or work, J.
    fn books(self, power: f64) -> [f64; 2] {
        match self {
            Self::Stored => [0.0; 2],
            Self::Supplied => [power, 0.0],
            Self::Dissipated => [0.0, -power],
        }
    }
}

/// Properties of a force law by which methods treat it; they follow from its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Properties {
    /// Account to which the power of the joint torques belongs.
    pub power_flow: PowerFlow,
    /// Whether the whole force has a potential.
    pub conservative: bool,
    /// Whether the force has regions so stiff and so short that a long step may miss them.
    pub stiff: bool,
    /// Whether the force is smooth but has a region so narrow that the stages of a step may lie on both sides of the region and none in it.
    pub sharp: bool,
    /// Rate of a joint over which smooth friction reverses its direction, rad/s; infinite without such a force.
    pub regularization_velocity: f64,
    /// Whether the effect has unilateral springs, whose guards a method may locate.
    pub may_make_contact: bool,
    /// Whether friction of the effect may stick, by its set-valued law.
    pub may_stick: bool,
}

impl Properties {
    /// Smooth torques in the joints with this account of their power.
    pub(super) const fn smooth(power_flow: PowerFlow) -> Self {
        Self {
            power_flow,
            conservative: matches!(power_flow, PowerFlow::Stored),
            stiff: false,
            sharp: false,
            regularization_velocity: f64::INFINITY,
            may_make_contact: false,
            may_stick: false,
        }
    }

    /// Unilateral springs, which are stiff.
    pub(super) const fn contact(conservative: bool) -> Self {
        Self { conservative, stiff: true, may_make_contact: true, ..Self::smooth(PowerFlow::Stored) }
    }
}

/// Force law of an effect, made ready from its parameters. The head of the effect's file gives formula and source.
///
/// The bodies of [`ForceLaw::act`] and its kin are reached through a table of functions: a step holds no copy of them.
pub trait ForceLaw {
    /// Properties by which methods treat the force.
    fn properties(&self) -> Properties;

    /// Torques in the joints, N·m.
    fn torques(&self, _joints: &JointMotion) -> [f64; JOINTS] {
        [0.0; JOINTS]
    }

    /// Stiffness −∂T/∂φ, N·m/rad, and damping −∂T/∂w, N·m·s/rad, of each joint.
    fn slopes(&self, _joints: &JointMotion) -> [[f64; 2]; JOINTS] {
        [[0.0; 2]; JOINTS]
    }

    /// Largest slopes of each joint for a softening, as [`ForceLaw::slopes`]: they set the weight of the step's end in a finite step.
    fn largest_slopes(&self, _softening: f64) -> [[f64; 2]; JOINTS] {
        [[0.0; 2]; JOINTS]
    }

    /// Change of the torques, N·m, for a change of the inputs.
    fn torques_by_inputs(&self, _joints: &JointMotion, _change: &Inputs) -> [f64; JOINTS] {
        [0.0; JOINTS]
    }

    /// Potential energy, J.
    fn potential(&self, _at: &Motion) -> f64 {
        0.0
    }

    /// Adds the wrench at an instant and returns input power and dissipated power, W. The power of the wrench is input − dissipation −
    /// dU/dt.
    fn act(&self, at: &Motion, wrench: &mut Wrench) -> [f64; 2] {
        let torques = self.torques(&at.joints);
        self.properties().power_flow.books(add_torques(&torques, &at.joints.rates, wrench))
    }

    /// Adds the slopes at an instant, with the force on the tip.
    fn add_slopes(&self, at: &Motion, slopes: &mut Slopes) {
        for (sum, own) in slopes.joints.iter_mut().zip(self.slopes(&at.joints)) {
            *sum = [sum[0] + own[0], sum[1] + own[1]];
        }
    }

    /// Adds the mean wrench of a finite step and returns input and dissipation, J. The work of the wrench over the increments is exactly
    /// input − dissipation − the change of the potential.
    fn act_over(&self, over: &FiniteMotion, wrench: &mut Wrench) -> [f64; 2] {
        let torques = self.torques(&over.joints(&end_weights(self, over)));
        self.properties().power_flow.books(add_torques(&torques, &over.changes, wrench))
    }

    /// Adds the slopes of the mean wrench by the increments and by the rates at the step's end, with the mean force on the tip.
    fn add_slopes_over(&self, over: &FiniteMotion, slopes: &mut Slopes) {
        let weights = end_weights(self, over);
        let own = self.slopes(&over.joints(&weights));
        for (joint, weight) in weights.into_iter().enumerate() {
            let [stiffness, damping] = own[joint];
            slopes.joints[joint][0] += 0.5 * (1.0 + weight) * stiffness + (1.0 - weight) * damping / over.h;
            slopes.joints[joint][1] += weight * damping;
        }
    }

    /// Adds the unilateral springs of the effect, with their guard values.
    fn add_guards<'a>(&'a self, _at: &Motion, _guards: &mut UnilateralGuards<'a>) {}

    /// Adds the friction places of the effect that are active.
    fn add_friction(&self, _at: &Motion, _elements: &mut FrictionElements) {}
}

/// Adds joint torques to a wrench and returns their power, W, at joint rates, or their work, J, over increments.
fn add_torques(torques: &[f64; JOINTS], rates: &[f64; JOINTS], wrench: &mut Wrench) -> f64 {
    let mut power = 0.0;
    for (joint, torque) in torques.iter().enumerate() {
        wrench.torques[joint] += torque;
        power += torque * rates[joint];
    }
    power
}

/// Weight of the step's end in each joint (`finite_motion.rs`): 0 for a linear force with a potential, whose mean over a step is the force
/// at the mean angle.
fn end_weights<L: ForceLaw + ?Sized>(law: &L, over: &FiniteMotion) -> [f64; JOINTS] {
    if law.properties().power_flow == PowerFlow::Stored {
        return [0.0; JOINTS];
    }
    law.largest_slopes(over.softening).map(|[stiffness, damping]| over.end_weight(0.5 * over.h * stiffness + damping))
}
