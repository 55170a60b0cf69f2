//! Event handling of a step: its mode, the check for events, and the transition at its end.
//!
//! A step is made in the mode of its beginning. Its interpolant shows the first guard that the motion crosses (`search.rs`); the
//! step then ends there, by truncation (`truncation.rs`) or made again with a shorter length.

use std::borrow::Borrow;

use super::search::Found;
use super::step::SHORTEST;
use super::trial::StageDerivative;
use super::{DenseStep, Settings};
use crate::integrator::{Events, Passage, State, System, Work};
use crate::vector::Vector;

/// Guard residual at which a step is to end, in event tolerances: past the guard, so that the next mode begins well inside its own
/// guards.
pub(super) const TARGET_RESIDUAL: f64 = 0.5;
/// Half-width of the accepted window around [`TARGET_RESIDUAL`], in event tolerances.
pub(super) const WINDOW_HALF_WIDTH: f64 = 0.4;
/// Guard residual above which an event has occurred, in event tolerances; less than 1, so that bounds on the residual fit between.
pub(super) const CROSSING_RESIDUAL: f64 = 0.95;
/// Largest number of transitions at one state.
const MOST_TRANSITIONS: u32 = 8;
/// Number of trials to end a step at a guard after which the step is halved instead.
const MOST_TRIES: u32 = 8;
/// Shortest step that is halved, s: nothing moves in shorter ones.
const SHORTEST_HALVED: f64 = 1e-12;
/// Time over which the motion is linearised for the derivative of the guard residual, relative to the step.
const LINEARIZED_PART: f64 = 1e-6;
/// Largest correction of a step's end towards a guard, relative to the step.
const LARGEST_CORRECTION: f64 = 0.1;

/// Factor on the estimated time until a mode ends, so that the guard lies within the step.
const DWELL_MARGIN: f64 = 1.2;

/// Position of a step's end relative to a guard.
pub(super) enum EventWindow {
    /// The guard residual is within the accepted window.
    Within,
    /// The guard residual is outside the window; the correction of the step length, s, if the linearised motion reaches the guard
    /// nearby.
    Outside(Option<f64>),
}

impl EventWindow {
    /// Position of the state q, q̇ and q̈ near the end of a step of `length` seconds.
    pub(super) fn of<const N: usize>(
        system: &impl Events<N>,
        settings: &Settings,
        [q, v, a]: [&Vector<N>; 3],
        length: f64,
    ) -> Self {
        let guard_residual_at = |later: f64| {
            system.guard_residual(&system.guard_values(&(*q + later * *v), &(*v + later * *a)), settings.error_tolerance)
        };
        let guard_residual = guard_residual_at(0.0);
        if (guard_residual - TARGET_RESIDUAL).abs() <= WINDOW_HALF_WIDTH {
            return Self::Within;
        }
        let later = LINEARIZED_PART * length;
        let (gained, missing) = (guard_residual_at(later) - guard_residual, (guard_residual - TARGET_RESIDUAL) * later);
        Self::Outside((missing.abs() < LARGEST_CORRECTION * length * gained.abs()).then(|| -missing / gained))
    }
}

/// Result of the check for events in a step.
pub(super) enum EventCheck {
    /// No event occurs.
    Clear,
    /// The step ends at an event.
    AtEnd,
    /// An event occurs earlier, this many seconds after the beginning of the step.
    Before(f64),
    /// No event occurs, but the error of the work is this multiple of the admissible one.
    WorkError(f64),
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Sets the mode at the beginning of a step, after all transitions due there, and returns the longest useful step in that mode,
    /// s.
    #[inline]
    pub(super) fn reinitialize<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
    ) -> f64 {
        if system.has_modes() { self.find_start_mode(system, settings) } else { f64::INFINITY }
    }

    #[inline(never)]
    fn find_start_mode<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(&mut self, system: &S, settings: &Settings) -> f64 {
        let mut mode = system.select_branch(self.next_mode_at_end, &self.start.q, &self.start.v);
        let mut longest = f64::INFINITY;
        if system.has_events() {
            self.truncated_from = 0.0;
            let guard_values = system.guard_values(&self.start.q, &self.start.v);
            for _ in 0..MOST_TRANSITIONS {
                let in_mode = system.on(mode);
                let in_mode = in_mode.borrow();
                if in_mode.guard_residual(&guard_values, settings.error_tolerance) <= CROSSING_RESIDUAL {
                    break;
                }
                mode = in_mode.next_mode(&self.start.q, &self.start.v, settings.error_tolerance);
            }
            longest = DWELL_MARGIN * system.on(mode).borrow().dwell_time(&guard_values);
        }
        self.set_mode(system, settings, mode);
        longest
    }

    /// Applies the transition at a guard that the step crosses at its very beginning.
    pub(super) fn apply_transition<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(&mut self, system: &S, settings: &Settings) {
        let mode = system.on(self.mode).borrow().next_mode(&self.start.q, &self.start.v, settings.error_tolerance);
        self.set_mode(system, settings, mode);
    }

    /// Sets the mode of the step; if it changes, forces and accelerations are evaluated again.
    fn set_mode<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(&mut self, system: &S, settings: &Settings, mode: K) {
        if mode != self.mode {
            let [before, next_mode] = [system.on(self.mode), system.on(mode)];
            self.start.reinitialize(next_mode.borrow(), &system.pose(&self.start.q), settings.regularization);
            if before.borrow().has_active_contact() != next_mode.borrow().has_active_contact() {
                std::mem::swap(&mut self.start.substep, &mut self.memory.substep_in_other_mode);
                self.before = self.memory;
            }
            self.end = self.start;
        }
        (self.mode, self.next_mode_at_end) = (mode, mode);
    }

    /// Checks a step with an admissible local error for events, after `tries` trials to end it at a guard. `system` is in the mode
    /// of the step, and `dense` evaluates the interpolant's coefficients.
    #[inline(never)]
    pub(super) fn event_check<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        dense: &mut dyn FnMut(&State<N, M>) -> [StageDerivative<N>; 4],
        tries: u32,
    ) -> EventCheck {
        let from = system.guard_values(&self.start.q, &self.start.v);
        let shown = system.separation_energy(&from);
        let event_check = self.event_check_from(system, settings, from, dense, tries);
        if let EventCheck::Before(_) = event_check {
            return event_check;
        }
        let done = Work::of_pair(self.end.work.pair() - self.start.work.pair());
        match settings.checked_work(done) {
            Ok(_) => self.end.work.dissipated = self.end.work.dissipated.max(self.start.work.dissipated),
            Err(error) => return EventCheck::WorkError(error),
        }
        if shown > 0.0 {
            self.end.work.dissipated += self.separation_energy(system, [&self.end.q, &self.end.v]);
        }
        event_check
    }

    /// Checks for events from the guard values at the beginning of the step.
    fn event_check_from<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        from: S::GuardValues,
        dense: &mut dyn FnMut(&State<N, M>) -> [StageDerivative<N>; 4],
        tries: u32,
    ) -> EventCheck {
        let mut crosses = EventCheck::Clear;
        if (1..MOST_TRIES).contains(&tries) {
            let end = self.evaluated_end(system, settings);
            match EventWindow::of(system, settings, [&end.q, &end.v, &end.a], self.length) {
                // Another guard may be crossed earlier.
                EventWindow::Within => crosses = EventCheck::AtEnd,
                // The interpolant was not accurate enough, so the end of the step gives the correction.
                EventWindow::Outside(Some(later)) => return EventCheck::Before(self.length + later),
                EventWindow::Outside(None) => {}
            }
        }
        self.dense = dense(&self.evaluated_end(system, settings));
        match self.first_crossing(system, settings, from) {
            Found::Nothing => crosses,
            Found::Crossing(when) if when >= SHORTEST && self.truncate(system, settings, when) => EventCheck::AtEnd,
            Found::Crossing(when) if tries < MOST_TRIES => EventCheck::Before(when),
            Found::Crossing(_) | Found::TooMuch if self.length > SHORTEST_HALVED => EventCheck::Before(0.5 * self.length),
            Found::Crossing(_) | Found::TooMuch => crosses,
        }
    }

    /// Energy dissipated by separated springs between the beginning of the step and a state q, q̇, J.
    #[cold]
    pub(super) fn separation_energy<S: Events<N>>(&self, system: &S, [q, v]: [&Vector<N>; 2]) -> f64 {
        let shown = system.separation_energy(&system.guard_values(&self.start.q, &self.start.v));
        if shown > 0.0 { (shown - system.separation_energy(&system.guard_values(q, v))).max(0.0) } else { 0.0 }
    }
}
