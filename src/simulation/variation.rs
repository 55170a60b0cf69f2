//! Directional derivatives of a state: of accelerations and joint forces with respect to the inputs and the proximal angles and rates,
//! which are minimal coordinates.
//!
//! Changes of all angles and rates follow from the proximal changes by J_x ([`closure::varied`]). Changes of the accelerations and of the
//! tip force follow from the equations of motion linearised in the link angles (`src/dynamics/angles.rs`), and changes of the other joint
//! forces link by link.

use super::angles::{angles, angles_of, legs};
use super::{Model, State};
use crate::dynamics::angles::{AtTip, Closure, Equations, in_link_order};
use crate::dynamics::change_of_motion;
use crate::effects::{Effect, Inputs, Motion, MotionChange, Slopes, Wrench};
use crate::hybrid::Frictional;
use crate::mechanism::coordinates::{TIP_X, TIP_Y, link_angles, set_angles};
use crate::mechanism::legs::both;
use crate::mechanism::placement::joint_forces;
use crate::mechanism::{Coordinates, Multipliers, SceneError, closure};

/// Direction of a directional derivative.
#[derive(Clone, Copy, Debug, Default)]
pub struct Direction {
    /// Changes of the inputs.
    pub inputs: Inputs,
    /// Changes of the proximal angles, rad, and rates, rad/s, left and right; `None` if only inputs vary.
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
    /// Changes of the accelerations.
    pub a: Coordinates,
    /// Changes of the multipliers.
    pub lambda: Multipliers,
}

impl State {
    /// Directional derivative of the state. Variations of proximal angles or rates are refused if |det J_x| is below 1e-8 of its largest
    /// possible value; inputs can be varied everywhere.
    pub fn varied(&self, model: &Model, direction: &Direction) -> Result<Variation, SceneError> {
        let core = &self.core;
        let pose = model.mechanism.pose(&core.q);
        let (mut q, mut v) = (Coordinates::ZERO, Coordinates::ZERO);
        if let Some(proximal) = direction.proximal {
            let geometry = &model.mechanism.geometry;
            let [_, left, right, _] = pose.directions();
            closure::check_direct_singularity(left[0] * right[1] - left[1] * right[0])?;
            (q, v) = closure::varied(geometry, link_angles(&core.q), link_angles(&core.v), proximal);
        }
        let motion = change_of_motion(&pose, &core.v, [&q, &v]);

        let (system, inputs) = (self.system(model), direction.inputs);
        let at = system.motion(&core.q, &pose, &core.v);
        let by_inputs = model.effects.iter().map(|effect| torques_by_inputs(effect, &at, &inputs));
        let by_inputs = by_inputs.fold(inputs.wrench(), |sum, wrench| sum.plus(1.0, &wrench));
        let wrench = by_inputs.plus(1.0, &system.slopes(at).change(&motion));

        // The linearised equations in the link angles.
        let [rates, alpha, turned, quickened] = [&core.v, &core.a, &q, &v].map(angles_of);
        let closure = Closure::new(&model.mechanism, None);
        let equations = Equations::<false>::new(&model.inertia, &closure, &pose, &rates, model.regularization_by_angles);
        let tip = AtTip::from([core.lambda[TIP_X], core.lambda[TIP_Y]]);
        let slopes = system.slopes_of_torques(&pose, at, in_link_order(&rates));
        let near = equations.linearised(&alpha, &tip, slopes);
        let (d_alpha, d_tip) = near.change([&turned, &quickened], &angles(by_inputs.torques_in_angles(&pose)));

        // Accelerations q̈ = T α + Ṫ ω of the links, and the remaining forces on them, which the joints supply.
        let arms = pose.varied(&q);
        let [w, dw] = [&rates, &quickened].map(legs);
        let doubled = [0, 1].map(|i| both(2.0) * w[i] * dw[i]);
        let mut a = pose.velocities(legs(&d_alpha)) + arms.velocities(legs(&alpha)) + arms.centripetal(w) + pose.inward(doubled);
        set_angles(&mut a, legs(&d_alpha));
        let left = wrench.in_coordinates(&pose) - model.mechanism.mass_times(&a);
        let lambda = joint_forces(&left, *d_tip);
        let (a, lambda) = system.varied([&core.q, &core.v], (a, lambda))?;
        Ok(Variation { q, v, motion, inputs, a, lambda })
    }
}

/// Change of the wrench of an effect for changes of the motion and of the inputs.
pub fn wrench_change(effect: &Effect, at: &Motion, motion: &MotionChange, inputs: &Inputs) -> Wrench {
    let mut slopes = Slopes::default();
    effect.add_slopes(at, &mut slopes);
    slopes.change(motion).plus(1.0, &torques_by_inputs(effect, at, inputs))
}

/// Change of the wrench of an effect for a change of the inputs.
fn torques_by_inputs(effect: &Effect, at: &Motion, inputs: &Inputs) -> Wrench {
    Wrench { torques: effect.torques_by_inputs(&at.joints, inputs), ..Wrench::default() }
}
