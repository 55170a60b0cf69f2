//! Friction: Coulomb and Stribeck friction in the joints. With `law` 1, smooth:
//!
//! ```text
//! T_j = −[√(2e) (T_brk − T_c) exp(−(w/w_st)²) w/w_st + T_c tanh(w/w_c)]      w_st = √2 w_brk,  w_c = w_brk/10
//! ```
//!
//! with w the joint's rate, T_c = `coulomb[j]`, T_brk = `breakaway[j]` ≥ T_c and w_brk = `breakawayVelocity`. This is the Stribeck curve of
//! a widely used rotational friction block (Simscape's "Rotational Friction", without its viscous term, which is the effect `viscous`;
//! Armstrong-Hélouvry et al., Automatica 30 (1994) 1083). The curve reaches T_brk at w_brk to within 4e-9 T_c. C = −∂T/∂w, K = 0; the power
//! −T w ≥ 0 is dissipated.
//!
//! With `law` 2, stick, friction is set-valued (`hybrid/friction.rs`): a sticking joint transmits the torque that keeps w = 0, up to T_brk,
//! and a slipping joint has
//!
//! ```text
//! T_j = −[T_c + (T_brk − T_c) exp(−(w/w_st)²)] sign w
//! ```
//!
//! which falls from T_brk at rest to T_c.
//! Defaults: 1 mN·m, 1.2 mN·m at 0.1 rad/s, a preloaded miniature bearing.
//! Limits: with the smooth law no joint truly sticks: under a load T below breakaway it creeps at about w_c T/T_c. Near w = 0 the
//! eigenvalue is T_c/(w_c I), about 1,500/s for the paper's links: stiff for explicit methods. Above w_brk the slope is negative. With the
//! set-valued law there is no presliding displacement, and T_brk does not grow with the time at rest.

use super::force_law::{ForceLaw, PowerFlow, Properties};
use super::wrench::{FrictionElement, FrictionElements, JOINT_ARMS, JOINTS, JointMotion, Motion, Wrench};
use crate::hybrid::{FrictionPlace, Law};
use crate::mechanism::exponential::gaussian_and_tanh;
use crate::mechanism::{Mechanism, SceneError};

/// The `friction.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has dry friction.
    pub enabled: bool,
    /// Coulomb torques of joints 1 to 5, N·m.
    pub coulomb: [f64; JOINTS],
    /// Breakaway torques of joints 1 to 5, N·m.
    pub breakaway: [f64; JOINTS],
    /// Rate at which the breakaway torque is reached, rad/s.
    pub breakaway_velocity: f64,
    /// Law of dry friction, smooth or set-valued.
    pub law: Law,
}

/// The friction curve of one joint.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Curve {
    /// Coulomb torque T_c, N·m.
    coulomb: f64,
    /// Breakaway torque T_brk, N·m.
    breakaway: f64,
    /// Amplitude √(2e) (T_brk − T_c) of the Stribeck term, N·m.
    stribeck: f64,
}

/// Dry friction, prepared from its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Friction {
    curves: [Option<Curve>; JOINTS],
    /// Stribeck rate w_st, rad/s.
    stribeck_rate: f64,
    /// Regularisation rate w_c of the Coulomb term, rad/s.
    coulomb_rate: f64,
    law: Law,
}

impl Friction {
    /// Prepares the friction. Refuses a breakaway torque below the Coulomb torque.
    pub(crate) fn new(parameters: &Parameters, _mechanism: &Mechanism) -> Result<Self, SceneError> {
        let mut curves = [None; JOINTS];
        for (joint, curve) in curves.iter_mut().enumerate() {
            let (coulomb, breakaway) = (parameters.coulomb[joint], parameters.breakaway[joint]);
            if breakaway < coulomb {
                return Err(SceneError(format!(
                    "friction.breakaway[{0}] = {breakaway:?} N.m is not allowed: it must be at least friction.coulomb[{0}] = {coulomb:?} N.m.",
                    joint + 1
                )));
            }
            if breakaway > 0.0 {
                let stribeck = (2.0 * std::f64::consts::E).sqrt() * (breakaway - coulomb);
                *curve = Some(Curve { coulomb, breakaway, stribeck });
            }
        }
        let velocity = parameters.breakaway_velocity;
        Ok(Self { curves, stribeck_rate: std::f64::consts::SQRT_2 * velocity, coulomb_rate: velocity / 10.0, law: parameters.law })
    }

    /// Evaluates a quantity of each joint's curve; `none` for joints without friction.
    fn by_joint<T: Copy>(&self, none: T, of: impl Fn(usize, &Curve) -> T) -> [T; JOINTS] {
        std::array::from_fn(|joint| self.curves[joint].as_ref().map_or(none, |curve| of(joint, curve)))
    }

    /// Rates w_st and w_c multiplied by a softening, rad/s.
    fn rates(&self, softening: f64) -> [f64; 2] {
        [softening * self.stribeck_rate, softening * self.coulomb_rate]
    }

    /// Friction torque −T of a joint, N·m.
    fn drag(&self, joint: usize, curve: &Curve, joints: &JointMotion) -> f64 {
        let rate = joints.rates[joint];
        let [stribeck_rate, coulomb_rate] = self.rates(joints.softening);
        let u = rate / stribeck_rate;
        match self.law {
            Law::Smooth => {
                let [bell, tanh] = gaussian_and_tanh(u, rate / coulomb_rate);
                curve.stribeck * bell * u + curve.coulomb * tanh
            }
            Law::Stick => {
                let sliding = curve.coulomb + (curve.breakaway - curve.coulomb) * libm::exp(-u * u);
                joints.mode.stick_slip.direction(joint, rate) * sliding
            }
        }
    }

    /// Derivative −∂T/∂w of a joint, N·m·s/rad.
    fn slope(&self, joint: usize, curve: &Curve, joints: &JointMotion) -> f64 {
        let rate = joints.rates[joint];
        let [stribeck_rate, coulomb_rate] = self.rates(joints.softening);
        let u = rate / stribeck_rate;
        match self.law {
            Law::Smooth => {
                let [bell, tanh] = gaussian_and_tanh(u, rate / coulomb_rate);
                curve.stribeck / stribeck_rate * bell * (1.0 - 2.0 * u * u) + curve.coulomb / coulomb_rate * (1.0 - tanh * tanh)
            }
            Law::Stick => {
                let fall = (curve.breakaway - curve.coulomb) * libm::exp(-u * u) * 2.0 * u / stribeck_rate;
                -joints.mode.stick_slip.direction(joint, rate) * fall
            }
        }
    }
}

impl ForceLaw for Friction {
    fn properties(&self) -> Properties {
        let dissipated = Properties { stiff: true, ..Properties::smooth(PowerFlow::Dissipated) };
        match self.law {
            Law::Smooth => Properties { sharp: true, regularization_velocity: self.coulomb_rate, ..dissipated },
            Law::Stick => Properties { may_stick: true, ..dissipated },
        }
    }

    fn torques(&self, joints: &JointMotion) -> [f64; JOINTS] {
        self.by_joint(0.0, |joint, curve| -self.drag(joint, curve, joints))
    }

    fn slopes(&self, joints: &JointMotion) -> [[f64; 2]; JOINTS] {
        self.by_joint([0.0; 2], |joint, curve| [0.0, self.slope(joint, curve, joints)])
    }

    /// The slope at w = 0 in closed form. Functions of 0 may raise floating-point exceptions, which some masters trap.
    fn largest_slopes(&self, softening: f64) -> [[f64; 2]; JOINTS] {
        let [stribeck_rate, coulomb_rate] = self.rates(softening);
        self.by_joint([0.0; 2], |_, curve| [0.0, curve.stribeck / stribeck_rate + curve.coulomb / coulomb_rate])
    }

    fn add_friction(&self, at: &Motion, elements: &mut FrictionElements) {
        if self.law != Law::Stick {
            return;
        }
        for (joint, curve) in self.curves.iter().enumerate() {
            if let Some(curve) = curve {
                let rate = at.joints.rates[joint];
                let place = FrictionPlace { place: joint, rate, bound: curve.breakaway, arms: JOINT_ARMS[joint] };
                elements.push(FrictionElement { at: place, wrench: Wrench::of_joint(joint) });
            }
        }
    }
}
