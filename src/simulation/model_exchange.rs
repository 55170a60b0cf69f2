//! A run whose angles and rates come from outside: the proximal ones are the states of a model that a master integrates.
//!
//! The rest of the motion follows from them, in the assembly of the start. They are coordinates but in direct singularities, where such a
//! run ends. Where the distal links have turned by more than half a turn between two completed steps, whole turns of their angles are lost.

use std::f64::consts::TAU;

use borsh::{BorshDeserialize, BorshSerialize};

use super::angles::{Angles, PLACES};
use super::five_bar::FiveBar;
use super::model::Stepper;
use super::run::IntegratorState;
use super::state::Core;
use super::{Inputs, Model, Simulation};
use crate::integrator::{Bounds, Inconsistency, Work};
use crate::mechanism::{Assembly, SceneError, Start, closure};

/// Number of states: the proximal angles, rad, left and right, and their rates, rad/s.
pub const STATES: usize = 4;

/// Where the master has put the machine.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct ModelExchangeState {
    /// Angles of links 1 to 4, rad.
    theta: [f64; 4],
    /// Their rates, rad/s.
    omega: [f64; 4],
    /// Angles of the distal links at the last completed step, rad: whole turns are counted from there.
    completed: [f64; 2],
    /// What changes of the payload have put in and lost.
    work: Work,
}

impl ModelExchangeState {
    /// At these angles and rates of links 1 to 4.
    pub(super) fn start(theta: [f64; 4], omega: [f64; 4]) -> Self {
        Self { theta, omega, completed: [theta[1], theta[2]], work: Work::default() }
    }

    /// The run with other states; refused where they are no coordinates.
    pub(super) fn moved(&self, model: &Model, assembly: Assembly, states: [f64; STATES]) -> Result<Self, SceneError> {
        let [left, right, left_rate, right_rate] = states;
        let start = Start { theta: [left, right], omega: [left_rate, right_rate], assembly };
        let [mut theta, omega] = closure::links_from_proximal(&model.mechanism.geometry, &start)?;
        for (angle, completed) in theta[1..3].iter_mut().zip(self.completed) {
            *angle += TAU * ((completed - *angle) / TAU).round();
        }
        Ok(Self { theta, omega, ..self.clone() })
    }

    /// The master has accepted a step that ends here.
    pub(super) fn complete(&mut self) {
        self.completed = [self.theta[1], self.theta[2]];
    }

    /// Rates change at once, where they are given, and some work is done.
    pub(super) fn jump(&mut self, work: Work, rates: Option<Angles>) {
        self.work += work;
        if let Some(rates) = rates {
            self.omega = PLACES.map(|i| rates[i]);
        }
    }

    /// What holds, with the q̈ and λ that belong to some inputs.
    pub(super) fn core(&self, model: &Model, inputs: &Inputs) -> Core {
        let (q, v) = closure::assemble(&model.mechanism.geometry, self.theta, self.omega);
        let core = Core::start(&FiveBar::<false>::new(model, inputs, &[0; 4]), q, v, model.regularization);
        Core { work: self.work, ..core }
    }

    /// Refuses a run that is none of this model.
    pub(super) fn check(&self, model: &Model, inputs: &Inputs, bounds: &Bounds) -> Result<(), Inconsistency> {
        if !self.completed.iter().all(|angle| angle.is_finite()) {
            return Err("an angle is not finite");
        }
        self.core(model, inputs).check(&FiveBar::<false>::new(model, inputs, &[0; 4]), bounds)
    }
}

/// Of a run made by [`Simulation::for_model_exchange`].
impl Simulation {
    /// Puts the machine to these states: the proximal angles, rad, left and right, and their rates, rad/s. Refused, with everything as
    /// before, where they are no coordinates.
    pub fn set_states(&mut self, states: [f64; STATES]) -> Result<(), SceneError> {
        let (model, assembly, for_model_exchange) = self.model_exchange_parts();
        *for_model_exchange = for_model_exchange.moved(model, assembly, states)?;
        Ok(())
    }

    /// A step that ends at the present states under these inputs has been accepted.
    pub fn complete(&mut self, inputs: &Inputs) {
        self.model_exchange_parts().2.complete();
        self.run.inputs = *inputs;
    }

    fn model_exchange_parts(&mut self) -> (&Model, Assembly, &mut ModelExchangeState) {
        match (&self.model.stepper, &mut self.run.integrator) {
            (Stepper::ModelExchange(assembly), IntegratorState::ModelExchange(for_model_exchange)) => {
                (&self.model, *assembly, for_model_exchange)
            }
            _ => unreachable!("a run is made for its method"),
        }
    }
}
