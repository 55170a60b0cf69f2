//! The linearised equations of motion: how accelerations and multipliers change with inputs, and with the proximal angles and rates as
//! the minimal coordinates.
//!
//! ```text
//! M δq̈ + Φ_qᵀ δλ = δQ − ∂(Φ_qᵀλ)/∂q δq           δQ = −K δq − C δq̇ + ∂Q/∂u δu
//! Φ_q δq̈ − e δλ  = −δ(Φ_q) q̈ − δ(Φ̇_q q̇)
//! ```
//!
//! The matrix is the one of the equations of motion themselves, K and C are those of the implicit steps; δq and δq̇ follow from the
//! proximal ones by J_x ([`closure::varied`]).

use super::{Model, State, stick_slip};
use crate::effects::{Inputs, Perturbation};
use crate::mechanism::coordinates::{D_THETA, P_THETA, THETA, legs_of, set_legs};
use crate::mechanism::{Coordinates, Multipliers, SceneError, closure};

/// What is varied.
#[derive(Clone, Copy, Debug, Default)]
pub struct Direction {
    /// Changes of the inputs.
    pub inputs: Inputs,
    /// Changes of the proximal angles, rad, and of the proximal rates, rad/s, left and right; `None` where inputs alone are varied.
    pub proximal: Option<[[f64; 2]; 2]>,
}

/// How a state changes, to first order.
#[derive(Clone, Copy, Debug)]
pub struct Variation {
    /// Coordinates, velocities, inputs.
    pub change: Perturbation,
    /// Accelerations.
    pub a: Coordinates,
    /// Multipliers.
    pub lambda: Multipliers,
}

impl State {
    /// How the state changes in a direction. With proximal angles or rates: refused where |det J_x| is below 1e-8 of its largest possible
    /// value. Inputs can be varied everywhere.
    pub fn varied(&self, model: &Model, direction: &Direction) -> Result<Variation, SceneError> {
        let core = &self.core;
        let pose = model.mechanism.pose(&core.q);
        let (mut q, mut v) = (Coordinates::ZERO, Coordinates::ZERO);
        if let Some(proximal) = direction.proximal {
            let geometry = &model.mechanism.geometry;
            let [_, left, right, _] = pose.directions();
            closure::check_direct_singularity(left[0] * right[1] - left[1] * right[0])?;
            (q, v) = closure::varied(geometry, THETA.map(|i| core.q[i]), THETA.map(|i| core.v[i]), proximal);
        }
        let change = Perturbation { q, v, inputs: direction.inputs };

        let mut force = self.at(model, |at| {
            let effects = model.effects.iter().map(|effect| effect.force_change(at, &change));
            effects.fold(self.inputs.force_change(at, &change), |sum, force| sum + force)
        });
        let (stiffness_p, stiffness_d) = pose.geometric_stiffness(&core.lambda);
        for (angles, stiffness) in [(P_THETA, stiffness_p), (D_THETA, stiffness_d)] {
            let left = legs_of(&force, angles) - stiffness * legs_of(&q, angles);
            set_legs(&mut force, angles, left);
        }

        // Φ̇_q q̇ changes with its arms and with both rates.
        let turning = pose.phi_q_varied_times(&q, &core.a);
        let arms = pose.varied(&q).phi_q_dot_times(&core.v);
        let rates = pose.phi_q_varied_times(&core.v, &v);
        let centripetal = -turning - arms - 2.0 * rates;
        let (a, lambda) = self.solve(model, &pose, &force, &centripetal);
        let (a, lambda) = stick_slip::varied(&self.system(model), [&core.q, &core.v], (a, lambda))?;
        Ok(Variation { change, a, lambda })
    }
}
