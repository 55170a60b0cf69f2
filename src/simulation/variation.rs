//! Linearised equations of motion: derivatives of accelerations and multipliers with respect to the inputs and to the proximal angles and
//! rates, the minimal coordinates.
//!
//! ```text
//! M δq̈ + Φ_qᵀ δλ = δQ − ∂(Φ_qᵀλ)/∂q δq           δQ = −K δq − C δq̇ + ∂Q/∂u δu
//! Φ_q δq̈ − e δλ  = −δ(Φ_q) q̈ − δ(Φ̇_q q̇)
//! ```
//!
//! The matrix is that of the equations of motion; K and C are those of the implicit steps; δq and δq̇ follow from the proximal variations
//! by J_x ([`closure::varied`]).

use super::{Model, State};
use crate::dynamics::change_of_motion;
use crate::effects::{Effect, Inputs, Motion, MotionChange, Slopes, Wrench};
use crate::hybrid::Frictional;
use crate::mechanism::coordinates::{D_THETA, P_THETA, THETA, legs_of, set_legs};
use crate::mechanism::{Coordinates, Multipliers, SceneError, closure};

/// Direction of a directional derivative.
#[derive(Clone, Copy, Debug, Default)]
pub struct Direction {
    /// Changes of the inputs.
    pub inputs: Inputs,
    /// Changes of the proximal angles, rad, and of the proximal rates, rad/s, left and right; `None` where inputs alone are varied.
    pub proximal: Option<[[f64; 2]; 2]>,
}

/// First-order change of a state.
#[derive(Clone, Copy, Debug)]
pub struct Variation {
    /// Change δq of the coordinates, m and rad.
    pub q: Coordinates,
    /// Change δv of the velocities, m/s and rad/s.
    pub v: Coordinates,
    /// Change of the motion of joints and tip.
    pub motion: MotionChange,
    /// Change of the inputs.
    pub inputs: Inputs,
    /// Accelerations.
    pub a: Coordinates,
    /// Changes of the multipliers.
    pub lambda: Multipliers,
}

impl State {
    /// Directional derivative of the state. Variations of proximal angles or rates are refused where |det J_x| is below 1e-8 of its largest
    /// possible value; inputs can be varied everywhere.
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
        let motion = change_of_motion(&pose, &core.v, [&q, &v]);

        let (system, inputs) = (self.system(model), direction.inputs);
        let at = system.motion(&core.q, &pose, &core.v);
        let effects = model.effects.iter().map(|effect| wrench_change(effect, &at, &motion, &inputs));
        let wrench = effects.fold(inputs.wrench(), |sum, wrench| sum.plus(1.0, &wrench));
        let mut force = wrench.in_coordinates(&pose) + system.slopes(at).turned_force(&pose, &q);
        let (stiffness_p, stiffness_d) = pose.geometric_stiffness(&core.lambda);
        for (angles, stiffness) in [(P_THETA, stiffness_p), (D_THETA, stiffness_d)] {
            let left = legs_of(&force, angles) - stiffness * legs_of(&q, angles);
            set_legs(&mut force, angles, left);
        }

        // The convective term Φ̇_q q̇ changes with the arms and with both factors of the rates.
        let turning = pose.phi_q_varied_times(&q, &core.a);
        let arms = pose.varied(&q).phi_q_dot_times(&core.v);
        let rates = pose.phi_q_varied_times(&core.v, &v);
        let centripetal = -turning - arms - 2.0 * rates;
        let (a, lambda) = self.solve(model, &pose, &force, &centripetal);
        let (a, lambda) = system.varied([&core.q, &core.v], (a, lambda))?;
        Ok(Variation { q, v, motion, inputs, a, lambda })
    }
}

/// Change of the wrench of an effect for changes of the motion and of the inputs.
pub fn wrench_change(effect: &Effect, at: &Motion, motion: &MotionChange, inputs: &Inputs) -> Wrench {
    let mut slopes = Slopes::default();
    effect.add_slopes(at, &mut slopes);
    let by_inputs = Wrench { torques: effect.torques_by_inputs(&at.joints, inputs), ..Wrench::default() };
    slopes.change(motion).plus(1.0, &by_inputs)
}
