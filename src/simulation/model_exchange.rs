//! Model exchange: proximal angles and rates are continuous states that a master integrates.
//!
//! Distal angles and rates follow from the closure, in the assembly of the start. The states are coordinates except at direct
//! singularities, where a run ends. Whole turns of the distal angles are counted from the last completed step; between two completed steps
//! they must turn by less than half a turn.

use std::f64::consts::TAU;

use borsh::{BorshDeserialize, BorshSerialize};

use super::five_bar::FiveBar;
use super::state::Core;
use super::{Inputs, Model};
use crate::integrator::{Bounds, Inconsistency, Work};
use crate::mechanism::coordinates::link_angles;
use crate::mechanism::{Assembly, Coordinates, SceneError, Start, closure};

/// Number of states: the proximal angles, rad, left and right, and their rates, rad/s.
pub const STATES: usize = 4;

/// States set by the master, with the motion that follows from them.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct ModelExchangeState {
    /// Angles of links 1 to 4, rad.
    theta: [f64; 4],
    /// Rates of links 1 to 4, rad/s.
    omega: [f64; 4],
    /// Angles of the distal links at the last completed step, rad: the reference for counting whole turns.
    completed: [f64; 2],
    /// Work put in and dissipated by changes of the payload, J.
    work: Work,
    /// Assembly of the distal links.
    assembly: Assembly,
}

impl ModelExchangeState {
    /// Starts at these angles, rad, and rates, rad/s, of links 1 to 4.
    pub(super) fn start(theta: [f64; 4], omega: [f64; 4], assembly: Assembly) -> Self {
        Self { theta, omega, completed: [theta[1], theta[2]], work: Work::default(), assembly }
    }

    /// Run with other states; refused at a direct singularity.
    pub(super) fn moved(&self, model: &Model, states: [f64; STATES]) -> Result<Self, SceneError> {
        let [left, right, left_rate, right_rate] = states;
        let start = Start { theta: [left, right], omega: [left_rate, right_rate], assembly: self.assembly };
        let [mut theta, omega] = closure::links_from_proximal(&model.mechanism.geometry, &start)?;
        for (angle, completed) in theta[1..3].iter_mut().zip(self.completed) {
            *angle += TAU * ((completed - *angle) / TAU).round();
        }
        Ok(Self { theta, omega, ..self.clone() })
    }

    /// Completes an integrator step: the master has accepted the present states.
    pub(super) fn complete(&mut self) {
        self.completed = [self.theta[1], self.theta[2]];
    }

    /// Angles, rad, and rates, rad/s, of links 1 to 4.
    pub(super) fn motion(&self) -> ([f64; 4], [f64; 4]) {
        (self.theta, self.omega)
    }

    /// Continues after a change that did this work, J, and may have led to other coordinates and velocities.
    pub(super) fn resume(&mut self, motion: Option<[Coordinates; 2]>, work: Work) {
        self.work += work;
        if let Some([q, v]) = motion {
            (self.theta, self.omega) = (link_angles(&q), link_angles(&v));
        }
    }

    /// Present state, with the q̈ and λ that belong to `inputs`.
    pub(super) fn core(&self, model: &Model, inputs: &Inputs) -> Core {
        let (q, v) = closure::assemble(&model.mechanism.geometry, self.theta, self.omega);
        let core = Core::start(&FiveBar::new(model, inputs, &[0; 4]), q, v, model.regularization);
        Core { work: self.work, ..core }
    }

    /// Refuses a run that is inconsistent with this model.
    pub(super) fn check(&self, model: &Model, inputs: &Inputs, bounds: &Bounds) -> Result<(), Inconsistency> {
        if !self.completed.iter().all(|angle| angle.is_finite()) {
            return Err("an angle is not finite");
        }
        self.core(model, inputs).check(&FiveBar::new(model, inputs, &[0; 4]), bounds)
    }
}
