//! State of the simulation at an instant, in the twelve coordinates: the data that observers read.

use std::f64::consts::TAU;

use super::Model;
use super::five_bar::FiveBar;
use crate::dynamics::Conditions;
use crate::effects::{Inputs, Motion};
use crate::hybrid::{FRICTION_PLACES, Frictional, Mode, StickSlips};
use crate::integrator::{self, Posed};
use crate::mechanism::coordinates::{THETA, largest_angle};
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS};

/// State of the integrator: coordinates, velocities, accelerations, multipliers and step memory.
pub type Core = integrator::State<COORDINATES, MULTIPLIERS>;

/// State at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Coordinates, velocities, accelerations, multipliers, predictor, sub-step memory, work, counters.
    pub core: Core,
    /// Whole turns by which the angles of links 1 to 4 exceed the angles in q. Angles in q stay within a few turns, so that their round-off
    /// does not grow while a link spins.
    pub turns: [i64; 4],
    /// Inputs that q̈ and λ belong to.
    pub inputs: Inputs,
    /// Kinetic plus potential energy at the start, J.
    pub energy_at_start: f64,
    /// Stick-slip states of dry friction.
    pub stick_slip: StickSlips,
}

impl State {
    /// Kinetic energy, J.
    pub fn kinetic_energy(&self, model: &Model) -> f64 {
        model.mechanism.mass_times(&self.core.v).dot(&self.core.v) / 2.0
    }

    /// Potential energy of the active effects, J. Constant loads are not included: they count as work.
    pub fn potential_energy(&self, model: &Model) -> f64 {
        model.potential(&self.core.q, &self.motion(model))
    }

    /// Kinetic and potential energy, J.
    pub(super) fn energy(&self, model: &Model) -> f64 {
        self.kinetic_energy(model) + self.potential_energy(model)
    }

    /// Kinetic + potential + dissipated − input, minus its value at the start, J.
    pub fn energy_error(&self, model: &Model) -> f64 {
        let work = self.core.work;
        self.energy(model) + work.dissipated - work.input - self.energy_at_start
    }

    /// Motion of joints and tip.
    pub fn motion(&self, model: &Model) -> Motion<'_> {
        let State { core, inputs, turns, stick_slip, .. } = self;
        let mode = Mode::of_stick_slip(*stick_slip);
        Conditions { inputs, turns, mode }.motion([&core.q, &core.v], &model.mechanism.pose(&core.q))
    }

    /// Friction reactions of sticking contacts: torques in the joints, N·m, and force on the tip, N; 0 if nothing sticks.
    pub fn holding(&self, model: &Model) -> [f64; FRICTION_PLACES] {
        if !self.stick_slip.any_sticks() {
            return [0.0; FRICTION_PLACES];
        }
        let Core { q, v, .. } = &self.core;
        self.system(model).holding(Posed { q, pose: &model.mechanism.pose(q), v })
    }

    /// System under the present inputs, with the present stick-slip states.
    pub(super) fn system<'a>(&'a self, model: &'a Model) -> FiveBar<'a> {
        FiveBar::new(model, &self.inputs, &self.turns).on(Mode::of_stick_slip(self.stick_slip))
    }

    /// Absolute angles of links 1 to 4, rad, not wrapped.
    pub fn angles(&self) -> [f64; 4] {
        std::array::from_fn(|link| self.core.q[THETA[link]] + self.turns[link] as f64 * TAU)
    }
}

/// Moves whole turns from angles of q that exceed two turns into `turns`.
pub(super) fn remove_whole_turns(q: &mut Coordinates, turns: &mut [i64; 4]) {
    if largest_angle(q) > 2.0 * TAU {
        for (turns, i) in turns.iter_mut().zip(THETA) {
            q[i] -= whole_turns(q[i], turns) * TAU;
        }
    }
}

/// Whole turns of an angle that exceeds two turns, which are also added to `turns`; otherwise 0.
pub(super) fn whole_turns(angle: f64, turns: &mut i64) -> f64 {
    if angle.abs() <= 2.0 * TAU {
        return 0.0;
    }
    let whole = (angle / TAU).round();
    *turns = turns.saturating_add(whole as i64);
    whole
}
