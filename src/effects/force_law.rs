//! Force law of an effect: wrench, slopes and energy, at an instant and over a finite step.
//!
//! A law in the joints defines torques, slopes and, in its [`Properties`], the account of its power; the methods for an instant and for a
//! finite step follow from these. A law with a contact defines these methods itself. The mean force of its potential over a step is a
//! discrete gradient: the change of the potential divided by the displacement.

use super::Inputs;
use super::finite_motion::FiniteMotion;
use super::wrench::{FrictionElements, JOINTS, JointMotion, Motion, Slopes, Wrench};
use crate::hybrid::Kinks;

/// Account of the energy balance for the power of a joint law.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PowerFlow {
    /// Change of the law's potential.
    Stored,
    /// Supplied from outside the mechanism.
    Supplied,
    /// Dissipated.
    Dissipated,
}

impl PowerFlow {
    /// Input and dissipation for a given power, W, or work, J, of the law.
    fn account(self, power: f64) -> [f64; 2] {
        match self {
            Self::Stored => [0.0; 2],
            Self::Supplied => [power, 0.0],
            Self::Dissipated => [0.0, -power],
        }
    }
}

/// Properties of a force law that decide how methods treat it. They follow from its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Properties {
    /// Account of the energy balance for the power of the joint torques.
    pub power_flow: PowerFlow,
    /// Whether the whole force has a potential.
    pub conservative: bool,
    /// Whether the force has regions so stiff and short that a long step may miss them.
    pub stiff: bool,
    /// Whether the force is smooth but has a region so narrow that the stages of a step may lie on both sides of it and none inside.
    pub sharp: bool,
    /// Range of joint rates over which smooth friction reverses its direction, rad/s; infinite if there is no such force.
    pub regularization_velocity: f64,
    /// Whether friction of the effect can stick: only with its set-valued law.
    pub may_stick: bool,
}

impl Properties {
    /// Properties of smooth joint torques with the given account of their power.
    pub(super) const fn smooth(power_flow: PowerFlow) -> Self {
        Self {
            power_flow,
            conservative: matches!(power_flow, PowerFlow::Stored),
            stiff: false,
            sharp: false,
            regularization_velocity: f64::INFINITY,
            may_stick: false,
        }
    }

    /// Properties of unilateral springs, which are stiff.
    pub(super) const fn contact(conservative: bool) -> Self {
        Self { conservative, stiff: true, ..Self::smooth(PowerFlow::Stored) }
    }
}

/// Force law of an effect, prepared from its parameters. The head of the effect's file gives formula and source.
///
/// [`ForceLaw::act`] and the other methods are called through a table of functions, so that a step contains no copy of their bodies.
pub trait ForceLaw {
    /// Properties that decide how methods treat the force.
    fn properties(&self) -> Properties;

    /// Torques in the joints, N·m.
    fn torques(&self, _joints: &JointMotion) -> [f64; JOINTS] {
        [0.0; JOINTS]
    }

    /// Stiffness −∂T/∂φ, N·m/rad, and damping −∂T/∂w, N·m·s/rad, of each joint.
    fn slopes(&self, _joints: &JointMotion) -> [[f64; 2]; JOINTS] {
        [[0.0; 2]; JOINTS]
    }

    /// Largest slopes of each joint for a softening, in the form of [`ForceLaw::slopes`]. They set the weight of the step's end in a finite
    /// step.
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

    /// Adds the wrench at an instant. Returns input power and dissipated power, W; the power of the wrench is input − dissipation − dU/dt.
    fn act(&self, at: &Motion, wrench: &mut Wrench) -> [f64; 2] {
        let torques = self.torques(&at.joints);
        self.properties().power_flow.account(add_torques(&torques, &at.joints.rates, wrench))
    }

    /// Adds the slopes at an instant, and the force on the tip.
    fn add_slopes(&self, at: &Motion, slopes: &mut Slopes) {
        for (sum, own) in slopes.joints.iter_mut().zip(self.slopes(&at.joints)) {
            *sum = [sum[0] + own[0], sum[1] + own[1]];
        }
    }

    /// Adds the mean wrench of a finite step. Returns input and dissipation, J; the work of the wrench over the increments is exactly input
    /// − dissipation − change of the potential.
    fn act_over(&self, over: &FiniteMotion, wrench: &mut Wrench) -> [f64; 2] {
        let torques = self.torques(&over.joints(&end_weights(self, over)));
        self.properties().power_flow.account(add_torques(&torques, &over.changes, wrench))
    }

    /// Adds the slopes of the mean wrench with respect to the increments and to the rates at the step's end, and the mean force on the tip.
    fn add_slopes_over(&self, over: &FiniteMotion, slopes: &mut Slopes) {
        let weights = end_weights(self, over);
        let own = self.slopes(&over.joints(&weights));
        for (joint, weight) in weights.into_iter().enumerate() {
            let [stiffness, damping] = own[joint];
            slopes.joints[joint][0] += 0.5 * (1.0 + weight) * stiffness + (1.0 - weight) * damping / over.h;
            slopes.joints[joint][1] += weight * damping;
        }
    }

    /// Adds all kinks of the effect, with the indices that the list in `effects/mod.rs` gives them.
    fn add_kinks<'a>(&'a self, _at: &Motion, _kinks: &mut Kinks<'a>) {}

    /// Adds the active friction places of the effect.
    fn add_friction(&self, _at: &Motion, _elements: &mut FrictionElements) {}
}

/// Adds joint torques to a wrench. Returns their power, W, for joint rates, or their work, J, for increments.
fn add_torques(torques: &[f64; JOINTS], rates: &[f64; JOINTS], wrench: &mut Wrench) -> f64 {
    let mut power = 0.0;
    for (joint, torque) in torques.iter().enumerate() {
        wrench.torques[joint] += torque;
        power += torque * rates[joint];
    }
    power
}

/// Weight of the step's end in each joint (`finite_motion.rs`). It is 0 for a linear force with a potential: the mean force over a step is
/// the force at the mean angle.
fn end_weights<L: ForceLaw + ?Sized>(law: &L, over: &FiniteMotion) -> [f64; JOINTS] {
    if law.properties().power_flow == PowerFlow::Stored {
        return [0.0; JOINTS];
    }
    law.largest_slopes(over.softening).map(|[stiffness, damping]| over.end_weight(0.5 * over.h * stiffness + damping))
}
