//! Replacement of a run's motion by the corrected one of the estimator.

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
    /// Angles of links 1 to 4, rad, without the whole turns that are counted separately, and their rates, rad/s.
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

    /// Continues from another motion, which closes the loop, with other inputs and, where something has been learned, with another
    /// model. The energy difference counts as input work; sign changes of the configuration do not count as passages.
    pub(super) fn resume_from(&mut self, [before, model]: [&Model; 2], motion: &LinkState, inputs: &Inputs) {
        let turns = self.turns;
        let assembled = |model: &Model, LinkState { theta, omega }: LinkState| {
            closure::assemble(&model.mechanism.geometry, theta.into(), omega.into())
        };
        let energy = |model: &Model, (q, v): &(Coordinates, Coordinates)| {
            let five_bar = FiveBar::new(model, inputs, &turns);
            five_bar.energy(q, &five_bar.pose(q), v)
        };
        let left = assembled(before, self.motion(before));
        let anew @ (q, v) = assembled(model, *motion);
        let external_work = energy(model, &anew) - energy(before, &left);
        match &mut self.integrator {
            Integrator::MacroStepped(run) => run.core.on_ray = false,
            Integrator::DenseOutput(run) => run.abandon(before, &self.inputs, &turns),
            Integrator::Conserving(_) | Integrator::ModelExchange(_) => {}
        }
        self.inputs = *inputs;
        self.resume(model, Some([q, v]), Work { input: external_work, dissipated: 0.0 });
    }
}
