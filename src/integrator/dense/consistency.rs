//! Consistency check of a stored current step: the step is made again and compared.

use std::borrow::Borrow;

use super::driver::{LONGEST, Outcome, Plan, Try};
use super::explicit::{Dop853, Explicit, Tsit5};
use super::rosenbrock::{Rodas4, Rodas5p, Rosenbrock};
use super::trial::{Origin, StageDerivative, Trial};
use super::{DenseStep, Horizon, LEAST_LOG_ERROR, Memory, Scheme, Settings};
use crate::integrator::consistency::{Bounds, Inconsistency};
use crate::integrator::{Approach, Departure, Events, Passage, State, StepError, System};
use crate::vector::Vector;

/// Admissible relative deviation of a repeated straight motion, which another limit may have cut short.
const TRANSIT_DEVIATION: f64 = 1e-9;

fn close<const K: usize>(x: &Vector<K>, y: &Vector<K>) -> bool {
    (*x - *y).max_norm() <= TRANSIT_DEVIATION * (1.0 + y.max_norm())
}

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
    /// Beginning of the step with its mode, and end of the step with the mode from there on.
    pub fn ends(&self) -> [(&State<N, M>, K); 2] {
        [(&self.start, self.mode), (&self.end, self.next_mode_at_end)]
    }

    /// Checks that both ends are possible states and that the step leads from one to the other.
    #[cold]
    pub fn check<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &self,
        system: &S,
        settings: &Settings,
        bounds: &Bounds,
    ) -> Result<(), Inconsistency> {
        let in_mode = system.on(self.mode);
        self.start.check(in_mode.borrow(), bounds)?;
        // A straight motion through a vertex has no mode.
        self.evaluated_end(in_mode.borrow(), settings).check(if self.is_linear { system } else { in_mode.borrow() }, bounds)?;
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
        match self.reproduces_end(system, settings) {
            Ok(true) => Ok(()),
            _ => Err("the current step does not lead from its start to its end"),
        }
    }

    /// Whether the step, made again, has the stored end.
    #[cold]
    fn reproduces_end<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &self,
        system: &S,
        settings: &Settings,
    ) -> Result<bool, StepError> {
        let mut end = self.start;
        if self.is_linear {
            let from = Departure { q: &self.start.q, v: &self.start.v, on_ray: self.start.on_ray, rest: self.length };
            let Approach::Passed(transit) = system.approach(&settings.passage(), &from) else { return Ok(false) };
            end.pass_through(system, &transit, settings.regularization)?;
            let same = (transit.duration - self.length).abs() <= TRANSIT_DEVIATION * self.length && end.on_ray == self.end.on_ray;
            return Ok(same
                && self.dense == [StageDerivative::NONE; 4]
                && close(&end.q, &self.end.q)
                && close(&end.v, &self.end.v));
        }
        let system = system.on(self.mode);
        let system = system.borrow();
        Ok(match self.scheme {
            scheme if !settings.schemes.allow(scheme, settings.error_tolerance) => false,
            Scheme::Tsit5 => self.reproduces_end_by::<Explicit<Tsit5, N>, S>(system, settings),
            Scheme::Dop853 => self.reproduces_end_by::<Explicit<Dop853, N>, S>(system, settings),
            Scheme::Rodas4 => self.reproduces_end_by::<Rosenbrock<Rodas4, N>, S>(system, settings),
            Scheme::Rodas5p => self.reproduces_end_by::<Rosenbrock<Rodas5p, N>, S>(system, settings),
        })
    }

    /// Whether the step, made again by [`DenseStep::try_once`] in one scheme, has the stored end and coefficients.
    fn reproduces_end_by<T: Trial<N>, S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &self,
        system: &S,
        settings: &Settings,
    ) -> bool {
        let origin = Origin::new(system, &self.start.q, &system.pose(&self.start.q), settings.regularization);
        let Some(linearization) = T::linearize(system, settings, (&self.start, &origin)) else { return false };
        let is_truncated = self.truncated_from > 0.0;
        let length = if is_truncated { self.truncated_from } else { self.length };
        // A step without coefficients is over, so no state inside it can be read.
        let needless = self.dense == [StageDerivative::NONE; 4] && self.elapsed == self.length;
        let horizon = Horizon { output: if needless && !is_truncated { f64::INFINITY } else { 0.0 }, limit: f64::INFINITY };
        let plan = Plan { h: length, wanted: length, longest: length, near: true, locates_events: false, horizon, pose: None };
        let this = Try::of(length);
        let mut redone = *self;
        redone.reset_to_start();
        let Outcome::Accepted = redone.try_once::<T, S>(system, settings, &plan, (&linearization, &origin), &this) else {
            return false;
        };
        if is_truncated && !redone.truncate_again(system, settings, self.length) {
            return false;
        }
        if system.has_events() {
            redone.end.work.dissipated = redone.end.work.dissipated.max(redone.start.work.dissipated);
            redone.end.work.dissipated += redone.separation_energy(system, [&redone.end.q, &redone.end.v]);
        }
        let end = &redone.end;
        let same = [end.q, end.v, end.a] == [self.end.q, self.end.v, self.end.a]
            && end.lambda == self.end.lambda
            && end.work == self.end.work;
        same && (needless || redone.dense == self.dense)
    }
}
