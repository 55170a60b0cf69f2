//! Replacement of a run's motion by the corrected one of the estimator.

use super::Inputs;
use super::angles::angles_of;
use super::five_bar::FiveBar;
use super::model::Model;
use super::run::{Conserving, Integrator, Run};
use crate::dynamics::angles::in_link_order;
use crate::estimator::LinkState;
use crate::integrator::{Implicit, System, Work};
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
        let held = std::mem::replace(&mut self.inputs, *inputs);
        let system = FiveBar::new(model, inputs, &turns);
        let signs = || system.configuration_signs(&system.pose(&q));
        let work = Work { input: external_work, dissipated: 0.0 };
        match &mut self.integrator {
            Integrator::MacroStepped(run) => {
                (run.core.q, run.core.v, run.core.on_ray, run.core.configuration_signs) = (q, v, false, signs());
                run.restart(model, (inputs, &turns), work);
            }
            Integrator::Conserving(Conserving { state, .. }) => {
                (state.q, state.v, state.configuration_signs) = (q, v, signs());
                state.restart(work);
            }
            Integrator::DenseOutput(run) => {
                run.resume_from([before, model], ([&held, inputs], &turns), [angles_of(&q), angles_of(&v)], external_work);
            }
            Integrator::ModelExchange(run) => run.move_to(motion.theta.into(), motion.omega.into(), work),
        }
    }
}
