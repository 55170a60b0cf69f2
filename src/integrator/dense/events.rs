//! Where a force has a kink, a step ends.
//!
//! A step is made on the sides on which it begins. Its interpolant tells where its motion first crosses a border (`search.rs`). Then the step
//! ends at the border, or is made once more up to there.

use std::borrow::Borrow;

use super::search::Found;
use super::step::SHORTEST;
use super::trial::StageDerivative;
use super::{DenseStep, Settings};
use crate::integrator::{Events, Passage, State, System, Work};
use crate::vector::Vector;

/// A step ends at a border where it is beyond it by half of what may be overlooked: on the sides behind it is then well on the near side of
/// the same border.
pub(super) const AT_BORDER: f64 = 0.5;
/// This near.
pub(super) const NEAR_ENOUGH: f64 = 0.4;
/// Farther beyond, a border has been crossed: less than may be overlooked, so that a bound may lie between.
pub(super) const CROSSED: f64 = 0.95;
/// Most sides that a state passes at once.
const MOST_SIDES: u32 = 8;
/// After so many tries to end at a border the step is halved instead.
const MOST_TRIES: u32 = 8;
/// No step is halved to less than this, s: nothing moves in it.
const NOTHING_MOVES: f64 = 1e-12;
/// The motion is straight over this part of a step.
const NEARBY: f64 = 1e-6;
/// The end of a step that was to end at a border is not farther from it than this part of the step.
const NEAR: f64 = 0.1;

/// By so much more than a ramp seems to last a step on it is longer, so that the border lies within it.
const LONGER: f64 = 1.2;

/// How a state stands to the border at which a step is to end.
pub(super) enum EventWindow {
    /// It is as far beyond it as it is to be.
    Within,
    /// It is not; by how many seconds later it would be, if the motion goes straight there.
    Off(Option<f64>),
}

impl EventWindow {
    /// How q, q̇ and q̈ near the end of a step of some seconds do.
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
        if (guard_residual - AT_BORDER).abs() <= NEAR_ENOUGH {
            return Self::Within;
        }
        let later = NEARBY * length;
        let (gained, missing) = (guard_residual_at(later) - guard_residual, (guard_residual - AT_BORDER) * later);
        Self::Off((missing.abs() < NEAR * length * gained.abs()).then(|| -missing / gained))
    }
}

/// How a step stands to the borders of its sides.
pub(super) enum EventCheck {
    /// It crosses none.
    Clear,
    /// It ends at one.
    AtEnd,
    /// It has to end before, so many seconds from its beginning.
    Before(f64),
    /// It crosses none, but its work is off by so many times what is allowed.
    Off(f64),
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Before a step: the sides on which it begins, behind all borders that its beginning is beyond. How long it is worth to be on them, s.
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
            self.cut_from = 0.0;
            let guard_values = system.guard_values(&self.start.q, &self.start.v);
            for _ in 0..MOST_SIDES {
                let in_mode = system.on(mode);
                let in_mode = in_mode.borrow();
                if in_mode.guard_residual(&guard_values, settings.error_tolerance) <= CROSSED {
                    break;
                }
                mode = in_mode.next_mode(&self.start.q, &self.start.v, settings.error_tolerance);
            }
            longest = LONGER * system.on(mode).borrow().dwell_time(&guard_values);
        }
        self.begin_on(system, settings, mode);
        longest
    }

    /// The sides behind a border that the step crosses at its very beginning.
    pub(super) fn turn<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(&mut self, system: &S, settings: &Settings) {
        let mode = system.on(self.mode).borrow().next_mode(&self.start.q, &self.start.v, settings.error_tolerance);
        self.begin_on(system, settings, mode);
    }

    /// The sides of the step: where they are others than before, forces and accelerations are those behind the border.
    fn begin_on<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(&mut self, system: &S, settings: &Settings, mode: K) {
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

    /// Whether a step that is accepted otherwise has to end before, after so many tries; `system` is on its sides, and the coefficients of the
    /// interpolant to an end are there where they are asked for.
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
        match settings.credible(done) {
            Ok(_) => self.end.work.dissipated = self.end.work.dissipated.max(self.start.work.dissipated),
            Err(error) => return EventCheck::Off(error),
        }
        if shown > 0.0 {
            self.end.work.dissipated += self.separation_energy(system, [&self.end.q, &self.end.v]);
        }
        event_check
    }

    /// The same, from what touches at its beginning.
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
            let end = self.balanced_end(system, settings);
            match EventWindow::of(system, settings, [&end.q, &end.v, &end.a], self.length) {
                // Another border may be crossed before.
                EventWindow::Within => crosses = EventCheck::AtEnd,
                // The interpolant was not that exact: the end itself says how far to go.
                EventWindow::Off(Some(later)) => return EventCheck::Before(self.length + later),
                EventWindow::Off(None) => {}
            }
        }
        self.dense = dense(&self.balanced_end(system, settings));
        match self.first_crossing(system, settings, from) {
            Found::Nothing => crosses,
            Found::Crossing(when) if when >= SHORTEST && self.cut(system, settings, when) => EventCheck::AtEnd,
            Found::Crossing(when) if tries < MOST_TRIES => EventCheck::Before(when),
            Found::Crossing(_) | Found::TooMuch if self.length > NOTHING_MOVES => EventCheck::Before(0.5 * self.length),
            Found::Crossing(_) | Found::TooMuch => crosses,
        }
    }

    /// What is dissipated between the beginning of the step and a place of it, q and q̇, by forces that act no more, J.
    #[cold]
    pub(super) fn separation_energy<S: Events<N>>(&self, system: &S, [q, v]: [&Vector<N>; 2]) -> f64 {
        let shown = system.separation_energy(&system.guard_values(&self.start.q, &self.start.v));
        if shown > 0.0 { (shown - system.separation_energy(&system.guard_values(q, v))).max(0.0) } else { 0.0 }
    }
}
