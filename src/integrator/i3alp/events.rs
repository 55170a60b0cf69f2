//! Where dry friction stops something, or lets it go, a sub-step ends.
//!
//! A sub-step is made with every grip doing what it does at its beginning. One that ends beyond the border at which any of them does
//! something else is tried again, shorter, until it ends at the border: by false position on its length.

use std::borrow::Borrow;

use super::Settings;
use crate::integrator::{Events, Implicit, Passage, State, StepEnd};
use crate::vector::Vector;

/// A sub-step ends at a border where it is beyond it by half of what may be overlooked.
const AT_BORDER: f64 = 0.5;
/// This near.
const NEAR_ENOUGH: f64 = 0.4;
/// Farther beyond, a border has been crossed.
const CROSSED: f64 = 1.0;
/// So many tries to end at a border are enough: the sub-step then ends beyond it.
const MOST_TRIES: u32 = 60;
/// So many times a sub-step is halved because of what its middle seems to be.
const MOST_HALVES: u32 = 8;
/// No border is sought between lengths that differ by less, s.
const SHORTEST: f64 = 1e-11;
/// As far from a border as matters; where there is none it is infinite.
const FAR: f64 = -1e15;
/// A sub-step is at least this part longer than one that does not come to the border.
const LEAST: f64 = 1e-9;

/// What becomes of a sub-step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    /// It is tried once more, shorter or longer.
    Again,
    /// It ends where grips do something else, or are no longer those there were.
    Turns,
    /// No grip does anything else.
    Passes,
}

/// The search for the length of a sub-step that ends at a border.
#[derive(Clone, Copy, Debug)]
pub(super) struct Search {
    /// Lengths that end before and beyond the border, s, and how far beyond.
    before: [f64; 2],
    guard_residual: Option<[f64; 2]>,
    /// Half of a sub-step in whose middle a border may have been crossed, s.
    half: Option<f64>,
    /// Whether the last try has left more than half of what lies between them.
    is_slow: bool,
    tries: u32,
    at_border: bool,
}

impl Search {
    /// Nothing is sought.
    pub(super) const NONE: Self =
        Self { before: [0.0; 2], guard_residual: None, half: None, is_slow: false, tries: 0, at_border: false };

    /// The length to try next, s.
    #[inline(always)]
    pub(super) fn next(&self) -> Option<f64> {
        let Some([far, above]) = self.guard_residual else { return self.half };
        let [near, below] = self.before;
        if self.is_over() {
            return Some(far);
        }
        // Borders of several grips make one function with corners, from one of which false position may hardly move: then in halves.
        let part = if self.is_slow { 0.5 } else { (-below / (above - below)).clamp(LEAST, 1.0 - LEAST) };
        Some(near + (far - near) * part)
    }

    /// Whether what is left between the lengths is not worth a try: the sub-step then ends beyond the border.
    fn is_over(&self) -> bool {
        self.tries >= MOST_TRIES || self.guard_residual.is_some_and(|[far, _]| far - self.before[0] < SHORTEST)
    }

    /// What becomes of a sub-step of h seconds that is accepted otherwise.
    #[cold]
    pub(super) fn judge<const N: usize, const M: usize, S: Implicit<N, M> + Events<N>>(
        &mut self,
        system: &S,
        settings: &Settings,
        from: &State<N, M>,
        (to, h): (&StepEnd<N, M>, f64),
    ) -> Outcome {
        let end = system.guard_values(&to.q, &to.v);
        let guard_residual = system.guard_residual(&end, settings.error_tolerance).max(FAR);
        if self.goes_on(system, settings, from, (to, h), guard_residual) {
            Outcome::Again
        } else if self.at_border || !system.knows_stick_slip(&end) {
            Outcome::Turns
        } else {
            Outcome::Passes
        }
    }

    /// Whether a sub-step of h seconds that ends so far beyond the borders has to be tried once more, shorter or longer.
    fn goes_on<const N: usize, const M: usize, S: Implicit<N, M> + Events<N>>(
        &mut self,
        system: &S,
        settings: &Settings,
        from: &State<N, M>,
        (to, h): (&StepEnd<N, M>, f64),
        guard_residual: f64,
    ) -> bool {
        let tolerance = settings.error_tolerance;
        let guard_residual_at = |q: &Vector<N>, v: &Vector<N>| system.guard_residual(&system.guard_values(q, v), tolerance);
        let Some([far, above]) = &mut self.guard_residual else {
            if guard_residual > CROSSED {
                let start = guard_residual_at(&from.q, &from.v).min(0.0) - AT_BORDER;
                (self.before, self.guard_residual) = ([0.0, start.max(FAR)], Some([h, guard_residual - AT_BORDER]));
                return true;
            }
            // A grip may turn twice within the sub-step, or be overstrained for a while: seen in its middle.
            self.tries += 1;
            let turns = || system.reverses_between([[&from.q, &from.v, &from.a], [&to.q, &to.v, &to.a]], h, tolerance);
            let overstrained = || {
                let q = 0.5 * (from.q + to.q) + h / 8.0 * (from.v - to.v);
                let v = 0.5 * (from.v + to.v) + h / 8.0 * (from.a - to.a);
                system.holds() && guard_residual_at(&q, &v) > CROSSED
            };
            self.half = (self.tries <= MOST_HALVES && (turns() || overstrained())).then_some(0.5 * h);
            return self.half.is_some();
        };
        // What is beyond a border already turns at once.
        self.at_border = (guard_residual - AT_BORDER).abs() <= NEAR_ENOUGH || h >= *far;
        let left = *far - self.before[0];
        // Of two ends on the same side in a row the other's weight is halved (Illinois).
        if guard_residual > AT_BORDER {
            (*far, *above) = (h, guard_residual - AT_BORDER);
            self.before[1] *= 0.5;
        } else {
            self.before = [h, guard_residual - AT_BORDER];
            *above *= 0.5;
        }
        self.is_slow = *far - self.before[0] > 0.5 * left;
        self.tries += 1;
        !self.at_border
    }
}

/// From here on the grips do what follows from the state.
#[cold]
pub(super) fn turn<const N: usize, const M: usize, S: Implicit<N, M> + Passage<N> + Events<N>>(
    system: &S,
    settings: &Settings,
    state: &mut State<N, M>,
    mode: &mut S::Mode,
) {
    *mode = system.mode_of(&state.q, &state.v);
    let in_mode = system.on(*mode);
    state.reinitialize(in_mode.borrow(), &system.pose(&state.q), settings.regularization);
}
