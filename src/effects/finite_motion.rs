//! Motion over a finite step as force laws see it, for the energy-conserving method.
//!
//! Let w̄ be the mean rate of the step, w₁ the rate at its end, h its length and r the decay rate of a law, 1/s. The law is evaluated at
//! the rate w̄ + γ (w₁ − w̄), with γ = x/(1 + x) and x = h r/2, and at an angle after (1 + γ)/2 of the increment. For x → 0 this is the
//! midpoint rule, of second order. For x → ∞ it is implicit Euler, which damps a force that would otherwise reverse within the step. For
//! every γ the work is force times displacement.

use super::wrench::{JOINTS, JointMotion, MOTOR_ANGLES, Planar};
use super::{Inputs, Mode};
use crate::mechanism::Geometry;

/// Motion of joints and tip over a finite step.
#[derive(Clone, Copy, Debug)]
pub struct FiniteMotion<'a> {
    /// Absolute angles of the left and right motor axis at the step's beginning, whole turns included, rad.
    pub angles: [f64; 2],
    /// Increments of the joint angles, rad.
    pub changes: [f64; JOINTS],
    /// Rates of the joints at the step's end, rad/s.
    pub rates: [f64; JOINTS],
    /// Position of the tip at the step's beginning, m.
    pub begin: Planar,
    /// Increment of the tip's position, m.
    pub change: Planar,
    /// Velocity of the tip at the step's end, m/s.
    pub velocity: Planar,
    /// Length of the step, s.
    pub h: f64,
    /// Factor on the widths of smooth nonlinearities; see [`JointMotion::softening`].
    pub softening: f64,
    /// Typical inertias, from which decay rates are estimated.
    pub inertia: TypicalInertia,
    /// Inputs set by the master.
    pub inputs: &'a Inputs,
}

/// Typical inertias, from which the decay rates of dampers are estimated.
#[derive(Clone, Copy, Debug)]
pub struct TypicalInertia {
    /// Moment of inertia of a link about its joint, kg·m².
    pub joint: f64,
    /// Mass at the tip, kg.
    pub tip: f64,
}

impl TypicalInertia {
    /// Means over the links of a geometry.
    pub fn new(geometry: &Geometry) -> Self {
        let about_joint = geometry.links.iter().map(|link| link.inertia + link.mass * link.length * link.length);
        Self { joint: about_joint.sum::<f64>() / 4.0, tip: geometry.mean_mass() }
    }
}

/// Weight γ = x/(1 + x) of the step's end, with x = h r/2 for a damper with decay rate r.
pub(super) fn end_weight(x: f64) -> f64 {
    // In this form an infinite x also gives 1.
    1.0 - 1.0 / (1.0 + x)
}

impl FiniteMotion<'_> {
    /// Weight γ of the step's end for a damping in a joint, N·m·s/rad.
    pub(super) fn end_weight(&self, damping: f64) -> f64 {
        end_weight(0.5 * self.h * damping / self.inertia.joint)
    }

    /// Motion of the joints at which a law is evaluated, for the given weights of the step's end.
    pub(super) fn joints(&self, weights: &[f64; JOINTS]) -> JointMotion<'_> {
        let rate = |joint: usize| {
            let mean = self.changes[joint] / self.h;
            mean + weights[joint] * (self.rates[joint] - mean)
        };
        JointMotion {
            angles: self.angles,
            moved: MOTOR_ANGLES.map(|joint| 0.5 * (1.0 + weights[joint]) * self.changes[joint]),
            rates: std::array::from_fn(rate),
            softening: self.softening,
            inputs: self.inputs,
            mode: Mode::OF_STATE,
        }
    }
}
