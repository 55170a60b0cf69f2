//! Viscous: friction proportional to the joint rate, T_j = −b_j w_j.
//!
//! w_j is the rate of joint j (left base, left elbow, tip, right elbow, right base), +T_j acts on its first link and −T_j on its second.
//! C = b_j over the two links, K = 0; the power b_j w_j² is dissipated. Default: 1e-4 N·m·s/rad, a lubricated miniature bearing with its
//! seal. Limits: linear; no dependence on load or temperature.

use super::force_context::{ForceContext, JOINTS, add_joint_damping, add_joint_torque, is_inner};
use super::step_context::{add_joint_slopes, end_weight};
use super::{Force, MeanForce, StepContext, Tangents};
use crate::mechanism::{Coordinates, Mechanism, SceneError, not_negative};

/// The `viscous.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has viscous friction.
    pub enabled: bool,
    /// Coefficients b of joints 1 to 5, N·m·s/rad.
    pub b: [f64; JOINTS],
}

/// Viscous friction, made ready from its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Viscous {
    b: [f64; JOINTS],
    /// Whether any joint between two links has a coefficient other than 0.
    inner: bool,
}

impl Viscous {
    /// Joints whose coefficient may differ from 0, with the coefficient, N·m·s/rad.
    #[inline]
    fn joints(&self) -> impl Iterator<Item = (usize, f64)> {
        let inner = self.inner;
        self.b.into_iter().enumerate().filter(move |(joint, _)| inner || !is_inner(*joint))
    }
}

impl Force for Viscous {
    type Parameters = Parameters;

    fn new(parameters: &Parameters, _mechanism: &Mechanism) -> Result<Self, SceneError> {
        let b = parameters.b;
        for (i, b) in b.into_iter().enumerate() {
            not_negative(format_args!("viscous.b[{}]", i + 1), b, "N.m.s/rad")?;
        }
        Ok(Self { b, inner: (0..JOINTS).any(|joint| is_inner(joint) && b[joint] != 0.0) })
    }

    fn couples_links(&self) -> bool {
        self.inner
    }

    fn conservative(&self) -> bool {
        false
    }

    #[inline(never)]
    fn add_forces(&self, at: &ForceContext, forces: &mut Coordinates) {
        for (joint, b) in self.joints() {
            add_joint_torque(joint, -b * at.joint_rate(joint), forces);
        }
    }

    #[inline(never)]
    fn add_tangents(&self, _at: &ForceContext, tangents: &mut impl Tangents) {
        for (joint, b) in self.joints() {
            add_joint_damping(joint, b, tangents);
        }
    }

    #[inline(never)]
    fn dissipation(&self, at: &ForceContext) -> f64 {
        self.joints().map(|(joint, b)| b * at.joint_rate(joint) * at.joint_rate(joint)).sum()
    }
}

impl MeanForce for Viscous {
    #[inline(never)]
    fn add_mean_forces(&self, over: &StepContext, forces: &mut Coordinates) {
        for (joint, b) in self.joints() {
            add_joint_torque(joint, -mean_drag(b, joint, over), forces);
        }
    }

    #[inline(never)]
    fn add_mean_tangents(&self, over: &StepContext, tangents: &mut impl Tangents) {
        for (joint, b) in self.joints() {
            let weight = end_weight(over.decay(b));
            add_joint_slopes(joint, [(1.0 - weight) * b / over.h, weight * b], tangents);
        }
    }

    fn dissipated_over(&self, over: &StepContext) -> f64 {
        self.joints().map(|(joint, b)| mean_drag(b, joint, over) * over.joint(joint)[0]).sum()
    }
}

/// Mean friction torque −T over a step, N·m.
fn mean_drag(b: f64, joint: usize, over: &StepContext) -> f64 {
    let [change, end] = over.joint(joint);
    let mean = change / over.h;
    b * (mean + end_weight(over.decay(b)) * (end - mean))
}
