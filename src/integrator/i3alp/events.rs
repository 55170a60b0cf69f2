//! Event location for stick-slip friction: a sub-step ends where a friction element sticks, slips or changes its direction.
//!
//! Each sub-step is computed in the mode of its beginning. A sub-step that ends past a guard is repeated with another length, found
//! by false position (Illinois), until it ends at the guard.

use std::borrow::Borrow;

use super::Settings;
use crate::integrator::{Events, Implicit, Passage, State, StepEnd};
use crate::vector::Vector;

/// Guard residual at which a sub-step is to end, in event tolerances: past the guard, but not by more than admissible.
const TARGET_RESIDUAL: f64 = 0.5;
/// Half-width of the accepted window around [`TARGET_RESIDUAL`], in event tolerances.
const WINDOW_HALF_WIDTH: f64 = 0.4;
/// Guard residual above which an event has occurred, in event tolerances.
const CROSSING_RESIDUAL: f64 = 1.0;
/// Largest number of trials of one event location; the sub-step then ends past the guard.
const MOST_TRIES: u32 = 60;
/// Largest number of bisections of a sub-step because of an event suspected in its middle.
const MOST_BISECTIONS: u32 = 8;
/// Shortest bracket of an event, s.
const SHORTEST: f64 = 1e-11;
/// Lower bound of guard residuals, so that false position stays finite where there is no guard, in event tolerances.
const LEAST_RESIDUAL: f64 = -1e15;
/// Smallest distance of a trial from the ends of the bracket, relative to the bracket.
const LEAST_FRACTION: f64 = 1e-9;

/// Decision about a sub-step with an admissible local error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// The sub-step is repeated with another length.
    Retry,
    /// The sub-step ends at an event: the mode changes.
    Event,
    /// The sub-step ends in its mode.
    NoEvent,
}

/// Search for the sub-step length that ends at an event.
#[derive(Clone, Copy, Debug)]
pub(super) struct Search {
    /// Lower end of the bracket: sub-step length, s, and its guard residual relative to the target, in event tolerances.
    before: [f64; 2],
    /// Upper end of the bracket, once an event is bracketed: sub-step length, s, and its guard residual relative to the target.
    after: Option<[f64; 2]>,
    /// Half of a sub-step in whose middle an event is suspected, s.
    half: Option<f64>,
    /// Whether the last trial has left more than half of the bracket.
    is_slow: bool,
    tries: u32,
    /// Whether the last trial ends within the window of the event.
    at_event: bool,
}

impl Search {
    /// No search is under way.
    pub(super) const NONE: Self = Self { before: [0.0; 2], after: None, half: None, is_slow: false, tries: 0, at_event: false };

    /// Sub-step length of the next trial, s.
    #[inline(always)]
    pub(super) fn next(&self) -> Option<f64> {
        let Some([far, above]) = self.after else { return self.half };
        let [near, below] = self.before;
        if self.is_over() {
            return Some(far);
        }
        // The maximum over several guards has corners, where false position stalls; bisection follows.
        let part = if self.is_slow { 0.5 } else { (-below / (above - below)).clamp(LEAST_FRACTION, 1.0 - LEAST_FRACTION) };
        Some(near + (far - near) * part)
    }

    /// Whether the search is exhausted: the sub-step then ends past the guard.
    fn is_over(&self) -> bool {
        self.tries >= MOST_TRIES || self.after.is_some_and(|[far, _]| far - self.before[0] < SHORTEST)
    }

    /// Decides about a sub-step of `h` seconds whose local error is admissible.
    #[cold]
    pub(super) fn judge<const N: usize, const M: usize, S: Implicit<N, M> + Events<N>>(
        &mut self,
        system: &S,
        settings: &Settings,
        from: &State<N, M>,
        (to, h): (&StepEnd<N, M>, f64),
    ) -> Outcome {
        let end = system.guard_values(&to.q, &to.v);
        let guard_residual = system.guard_residual(&end, settings.error_tolerance).max(LEAST_RESIDUAL);
        if self.must_retry(system, settings, from, (to, h), guard_residual) {
            Outcome::Retry
        } else if self.at_event || !system.knows_stick_slip(&end) {
            Outcome::Event
        } else {
            Outcome::NoEvent
        }
    }

    /// Whether a sub-step of `h` seconds that ends at this guard residual is to be repeated with another length.
    fn must_retry<const N: usize, const M: usize, S: Implicit<N, M> + Events<N>>(
        &mut self,
        system: &S,
        settings: &Settings,
        from: &State<N, M>,
        (to, h): (&StepEnd<N, M>, f64),
        guard_residual: f64,
    ) -> bool {
        let tolerance = settings.error_tolerance;
        let guard_residual_at = |q: &Vector<N>, v: &Vector<N>| system.guard_residual(&system.guard_values(q, v), tolerance);
        let Some([far, above]) = &mut self.after else {
            if guard_residual > CROSSING_RESIDUAL {
                let start = guard_residual_at(&from.q, &from.v).min(0.0) - TARGET_RESIDUAL;
                (self.before, self.after) = ([0.0, start.max(LEAST_RESIDUAL)], Some([h, guard_residual - TARGET_RESIDUAL]));
                return true;
            }
            // A friction element may reverse twice within the sub-step, or exceed its breakaway bound for a while: checked at the
            // middle.
            self.tries += 1;
            let turns = || system.reverses_between([[&from.q, &from.v, &from.a], [&to.q, &to.v, &to.a]], h, tolerance);
            let overstrained = || {
                let q = 0.5 * (from.q + to.q) + h / 8.0 * (from.v - to.v);
                let v = 0.5 * (from.v + to.v) + h / 8.0 * (from.a - to.a);
                system.has_sticking() && guard_residual_at(&q, &v) > CROSSING_RESIDUAL
            };
            self.half = (self.tries <= MOST_BISECTIONS && (turns() || overstrained())).then_some(0.5 * h);
            return self.half.is_some();
        };
        // A guard that is exceeded at the beginning changes the mode at once.
        self.at_event = (guard_residual - TARGET_RESIDUAL).abs() <= WINDOW_HALF_WIDTH || h >= *far;
        let left = *far - self.before[0];
        // Illinois rule: after two ends on the same side the residual of the other end is halved.
        if guard_residual > TARGET_RESIDUAL {
            (*far, *above) = (h, guard_residual - TARGET_RESIDUAL);
            self.before[1] *= 0.5;
        } else {
            self.before = [h, guard_residual - TARGET_RESIDUAL];
            *above *= 0.5;
        }
        self.is_slow = *far - self.before[0] > 0.5 * left;
        self.tries += 1;
        !self.at_event
    }
}

/// Applies the transition: the mode that follows from the state, with accelerations of that mode.
#[cold]
pub(super) fn apply_transition<const N: usize, const M: usize, S: Implicit<N, M> + Passage<N> + Events<N>>(
    system: &S,
    settings: &Settings,
    state: &mut State<N, M>,
    mode: &mut S::Mode,
) {
    *mode = system.mode_of(&state.q, &state.v);
    let in_mode = system.on(*mode);
    state.reinitialize(in_mode.borrow(), &system.pose(&state.q), settings.regularization);
}
