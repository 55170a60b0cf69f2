//! Replacement of a run's motion by the estimator's corrected motion.

use super::Inputs;
use super::five_bar::FiveBar;
use super::model::Model;
use super::run::{Integrator, Run};
use crate::dynamics::angles::in_link_order;
use crate::estimator::LinkState;
use crate::integrator::{System, Work};
use crate::mechanism::Coordinates;
use crate::mechanism::closure;
use crate::mechanism::coordinates::link_angles;

impl Run {
    /// Angles, rad, and rates, rad/s, of links 1 to 4. Whole turns are counted separately and not part of the angles.
    pub(super) fn motion(&self, model: &Model) -> LinkState {
        let of = |q: &Coordinates, v: &Coordinates| LinkState::new(link_angles(q), link_angles(v));
        match &self.integrator {
            Integrator::MacroStepped(run) => of(&run.core.q, &run.core.v),
            Integrator::Conserving(run) => of(&run.state.q, &run.state.v),
            Integrator::DenseOutput(run) => {
                let (q, v) = run.motion(model, &self.inputs, &self.turns);
                LinkState::new(in_link_order(&q), in_link_order(&v))
            }
            Integrator::ModelExchange(run) => {
                let (theta, omega) = run.motion();
                LinkState::new(theta, omega)
            }
        }
    }

    /// Leaves the present motion; a step under way is discarded. Returns the energy of this motion under the next inputs, J.
    pub(super) fn leave(&mut self, model: &Model, motion: &LinkState, inputs: &Inputs) -> f64 {
        match &mut self.integrator {
            Integrator::MacroStepped(run) => run.core.on_ray = false,
            Integrator::DenseOutput(run) => run.abandon(model, &self.inputs, &self.turns),
            Integrator::Conserving(_) | Integrator::ModelExchange(_) => {}
        }
        self.energy(model, &assembled(model, motion), inputs)
    }

    /// Continues from another motion, which closes the loop, with other inputs and, if something has been learned, another model. The
    /// energy gained relative to the motion left counts as input work. Sign changes of the configuration do not count as passages.
    pub(super) fn resume_at(&mut self, model: &Model, motion: &LinkState, inputs: &Inputs, energy_left: f64) {
        let next = assembled(model, motion);
        let input = self.energy(model, &next, inputs) - energy_left;
        self.inputs = *inputs;
        self.resume(model, Some(next), Work { input, dissipated: 0.0 });
    }

    fn energy(&self, model: &Model, [q, v]: &[Coordinates; 2], inputs: &Inputs) -> f64 {
        let five_bar = FiveBar::new(model, inputs, &self.turns);
        five_bar.energy(q, &five_bar.pose(q), v)
    }
}

/// Coordinates and velocities of a motion.
fn assembled(model: &Model, &LinkState { theta, omega }: &LinkState) -> [Coordinates; 2] {
    closure::assemble(&model.mechanism.geometry, theta.into(), omega.into()).into()
}
