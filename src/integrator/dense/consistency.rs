//! Check of a stored current step: its ends and the states inside close the loop, and its lengths and memory are possible.

use super::step::LONGEST;
use super::trial::StageDerivative;
use super::{DenseStep, LEAST_LOG_ERROR, Memory, Settings};
use crate::integrator::consistency::{Bounds, Inconsistency};
use crate::integrator::{Mechanics, State};

/// Number of states that are checked in the rest of a step: more than the interpolant's degree, so that they bound the interpolant.
const INSIDE: u32 = 9;

impl Memory {
    fn is_possible(&self, settings: &Settings) -> bool {
        // The error of an accepted step is at most 1 tolerance.
        (LEAST_LOG_ERROR..=0.0).contains(&self.log_error)
            && self.substep_in_other_mode > 0.0
            && self.stiffness.is_consistent()
            && self.stiffness_switch.is_possible(settings.schemes)
    }
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Beginning of the step with its mode, and end of the step with the mode that follows.
    pub fn ends(&self) -> [(&State<N, M>, K); 2] {
        [(&self.start, self.mode), (&self.end, self.next_mode_at_end)]
    }

    /// Refuses ends that are impossible states, and a step that does not lead from one end to the other.
    pub fn check<S: Mechanics<N, M, Mode = K>>(
        &self,
        system: &S,
        settings: &Settings,
        bounds: &Bounds,
    ) -> Result<(), Inconsistency> {
        let in_mode = system.on(self.mode);
        self.start.check(&*in_mode, bounds)?;
        // A straight motion through a vertex has no mode.
        self.evaluated_end(&*in_mode, settings).check(if self.is_linear { system } else { &*in_mode }, bounds)?;
        if !(self.memory.is_possible(settings) && self.before.is_possible(settings)) {
            return Err("a value of the step-size controller is out of bounds");
        }
        if !(0.0..=LONGEST).contains(&self.length) || !(0.0..=self.length).contains(&self.elapsed) {
            return Err("the time is outside the current step");
        }
        if !(self.truncated_from == 0.0 || (self.truncated_from > self.length && self.truncated_from <= LONGEST)) {
            return Err("a truncated step is longer than its original");
        }
        if self.length == 0.0 {
            let same = self.start == self.end && self.dense == [StageDerivative::NONE; 4] && !self.is_linear;
            return if same { Ok(()) } else { Err("a step of length 0 changes the state") };
        }
        if !settings.schemes.allow(self.scheme, settings.error_tolerance) {
            return Err("the current step was made by another scheme than this method uses");
        }
        if self.elapsed == self.length { Ok(()) } else { self.check_inside(system, settings, bounds) }
    }

    /// Refuses states between the present time and the end of the step that do not close the loop. The states are checked in the form in
    /// which they will be read.
    fn check_inside<S>(&self, system: &S, settings: &Settings, bounds: &Bounds) -> Result<(), Inconsistency>
    where
        S: Mechanics<N, M, Mode = K>,
    {
        let (mut there, rest) = (*self, self.length - self.elapsed);
        (0..INSIDE).try_for_each(|part| {
            there.elapsed = self.elapsed + rest * f64::from(part) / f64::from(INSIDE);
            let sample = there.sample(system, settings);
            bounds.hold(&*system.on(self.mode), [&sample.q, &sample.v], self.is_linear)
        })
    }
}
