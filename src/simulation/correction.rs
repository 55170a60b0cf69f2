//! Replacement of a run's motion by the corrected one of the estimator.

use super::Inputs;
use super::angles::{LINK_INDICES, angles_of};
use super::five_bar::FiveBar;
use super::model::{Model, Stepper};
use super::run::{IntegratorState, Run};
use crate::integrator::{System, Work};
use crate::mechanism::Coordinates;
use crate::mechanism::closure;
use crate::mechanism::coordinates::THETA;

impl Run {
    /// Angles of links 1 to 4, rad, without the whole turns that are counted separately, and their rates, rad/s.
    #[inline(never)]
    pub(super) fn motion(&self, model: &Model) -> ([f64; 4], [f64; 4]) {
        let of = |q: &Coordinates, v: &Coordinates| (THETA.map(|i| q[i]), THETA.map(|i| v[i]));
        match &self.integrator {
            IntegratorState::MacroStepped(core, _) => of(&core.q, &core.v),
            IntegratorState::Conserving(run) => of(&run.q, &run.v),
            IntegratorState::DenseOutput(run) => {
                let (q, v) = run.motion(model, &self.inputs, &self.turns);
                (LINK_INDICES.map(|i| q[i]), LINK_INDICES.map(|i| v[i]))
            }
            IntegratorState::ModelExchange(_) => unreachable!("no estimator follows a machine that a master drives"),
        }
    }

    /// Continues from other angles, rad, and rates, rad/s, which close the loop, with other inputs. The energy difference counts as input
    /// work; sign changes of the configuration do not count as passages.
    #[inline(never)]
    pub(super) fn resume_from(&mut self, model: &Model, (theta, omega): ([f64; 4], [f64; 4]), inputs: &Inputs) {
        let geometry = &model.mechanism.geometry;
        let (before_theta, before_omega) = self.motion(model);
        let before = closure::assemble(geometry, before_theta, before_omega);
        let (q, v) = closure::assemble(geometry, theta, omega);
        let turns = self.turns;
        let energy = |q: &Coordinates, v: &Coordinates| {
            let five_bar = FiveBar::<false>::new(model, inputs, &turns);
            let pose = five_bar.pose(q);
            model.mechanism.mass_times(v).dot(v) / 2.0 + model.potential(q, &five_bar.motion(q, &pose, v))
        };
        let external_work = energy(&q, &v) - energy(&before.0, &before.1);
        let held = std::mem::replace(&mut self.inputs, *inputs);
        let system = FiveBar::<false>::new(model, inputs, &turns);
        match (&model.stepper, &mut self.integrator) {
            (Stepper::MacroStep(_), IntegratorState::MacroStepped(core, stick_slip)) => {
                let system = FiveBar::<false>::resolved(model, inputs, &turns, [&q, &v]);
                *stick_slip = system.mode.stick_slip;
                (core.q, core.v, core.on_ray) = (q, v, false);
                core.configuration_signs = system.configuration_signs(&system.pose(&q));
                core.work.input += external_work;
                core.restart(&system, &system.pose(&core.q), model.regularization);
            }
            (Stepper::Conserving(_), IntegratorState::Conserving(run)) => {
                (run.q, run.v) = (q, v);
                run.configuration_signs = system.configuration_signs(&system.pose(&q));
                run.restart(Work { input: external_work, dissipated: 0.0 });
            }
            (Stepper::Dense(settings), IntegratorState::DenseOutput(run)) => {
                run.resume_from(model, settings, ([&held, inputs], &turns), [angles_of(&q), angles_of(&v)], external_work);
            }
            _ => unreachable!("a run is made for its method"),
        }
    }
}
