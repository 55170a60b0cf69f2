//! Where a force has a kink, a step ends.
//!
//! A step is made on the sides on which it begins. Its interpolant tells where its motion first crosses a border: it is searched in
//! halves of halves, and a stretch is left out only where both its ends and the greatest acceleration on it say that nothing deeper than
//! the tolerance lies between. Then the step is made once more, up to the border.

use std::borrow::Borrow;

use super::step::SHORTEST;
use super::trial::Slope;
use super::{DenseStep, Settings};
use crate::integrator::{Kinked, Passage, State, System};
use crate::vector::Vector;

/// A step ends at a border where it is beyond it by half of what may be overlooked: on the sides behind it is then well on the near side of
/// the same border.
const AT_BORDER: f64 = 0.5;
/// This near.
const NEAR_ENOUGH: f64 = 0.4;
/// Farther beyond, a border has been crossed.
const CROSSED: f64 = 1.0;
/// The first stretch that is looked at, as a part of the step: of what touches, borders are seen at the ends of stretches only.
const FIRST: f64 = 0.25;
/// A crossing in a stretch no longer than this part of the step is the first one there.
const FINE: f64 = 1.0 / 32.0;
/// No stretch is shorter than this part of the step.
const FINEST: f64 = 1e-6;
/// Most sides that a state passes at once.
const MOST_SIDES: u32 = 8;
/// So many tries to end at a border are enough.
const MOST_TRIES: u32 = 8;
/// The motion is straight over this part of a step.
const NEARBY: f64 = 1e-6;
/// The end of a step that was to end at a border is not farther from it than this part of the step.
const NEAR: f64 = 0.1;
/// By how much what the stages have seen of rates and accelerations may be exceeded on the way between them.
const MARGIN: f64 = 1.5;
/// The false position is good enough after so many rounds.
const ROUNDS: u32 = 60;

/// What the stages of a step say about it: the greatest magnitudes of q̇ and q̈ that they have seen, and the coefficients of the
/// interpolant to an end.
type ByStages<'a, const N: usize, const M: usize> = (&'a [Vector<N>; 2], &'a mut dyn FnMut(&State<N, M>) -> [Slope<N>; 4]);

/// By so much more than a ramp seems to last a step on it is longer, so that the border lies within it.
const LONGER: f64 = 1.2;

/// How a state stands to the border at which a step is to end.
pub(super) enum Window {
    /// It is as far beyond it as it is to be.
    Within,
    /// It is not; by how many seconds later it would be, if the motion goes straight there.
    Off(Option<f64>),
}

impl Window {
    /// How q, q̇ and q̈ near the end of a step of some seconds do.
    pub(super) fn of<const N: usize>(
        system: &impl Kinked<N>,
        settings: &Settings,
        [q, v, a]: [&Vector<N>; 3],
        length: f64,
    ) -> Self {
        let beyond_at =
            |later: f64| system.beyond(&system.touches(&(*q + later * *v), &(*v + later * *a)), settings.error_tolerance);
        let beyond = beyond_at(0.0);
        if (beyond - AT_BORDER).abs() <= NEAR_ENOUGH {
            return Self::Within;
        }
        let later = NEARBY * length;
        let (gained, missing) = (beyond_at(later) - beyond, (beyond - AT_BORDER) * later);
        Self::Off((missing.abs() < NEAR * length * gained.abs()).then(|| -missing / gained))
    }
}

/// How a step stands to the borders of its sides.
pub(super) enum Border {
    /// It crosses none.
    Clear,
    /// It ends at one.
    AtEnd,
    /// It has to end before, so many seconds from its beginning.
    Before(f64),
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Before a step: the sides on which it begins, behind all borders that its beginning is beyond. How long it is worth to be on them, s.
    #[inline]
    pub(super) fn settle<S: System<N, M> + Passage<N> + Kinked<N, Sides = K>>(&mut self, system: &S, settings: &Settings) -> f64 {
        if system.has_sides() { self.settle_sides(system, settings) } else { f64::INFINITY }
    }

    #[inline(never)]
    fn settle_sides<S: System<N, M> + Passage<N> + Kinked<N, Sides = K>>(&mut self, system: &S, settings: &Settings) -> f64 {
        let mut sides = system.branched(self.sides_behind, &self.start.q, &self.start.v);
        let mut longest = f64::INFINITY;
        if system.has_kinks() {
            self.cut_from = 0.0;
            let touches = system.touches(&self.start.q, &self.start.v);
            for _ in 0..MOST_SIDES {
                let on_sides = system.on(sides);
                let on_sides = on_sides.borrow();
                if on_sides.beyond(&touches, settings.error_tolerance) <= CROSSED {
                    break;
                }
                sides = on_sides.behind(&self.start.q, &self.start.v, settings.error_tolerance);
            }
            longest = LONGER * system.on(sides).borrow().lasts(&touches);
        }
        self.begin_on(system, settings, sides);
        longest
    }

    /// The sides behind a border that the step crosses at its very beginning.
    pub(super) fn turn<S: System<N, M> + Passage<N> + Kinked<N, Sides = K>>(&mut self, system: &S, settings: &Settings) {
        let sides = system.on(self.sides).borrow().behind(&self.start.q, &self.start.v, settings.error_tolerance);
        self.begin_on(system, settings, sides);
    }

    /// The sides of the step: where they are others than before, forces and accelerations are those behind the border.
    fn begin_on<S: System<N, M> + Passage<N> + Kinked<N, Sides = K>>(&mut self, system: &S, settings: &Settings, sides: K) {
        if sides != self.sides {
            let [before, behind] = [system.on(self.sides), system.on(sides)];
            self.start.settle(behind.borrow(), &system.pose(&self.start.q), settings.regularization);
            if before.borrow().is_pushed() != behind.borrow().is_pushed() {
                std::mem::swap(&mut self.start.substep, &mut self.memory.elsewhere);
                self.before = self.memory;
            }
            self.end = self.start;
        }
        (self.sides, self.sides_behind) = (sides, sides);
    }

    /// Whether a step that is accepted otherwise has to end before, after so many tries; `system` is on its sides.
    #[inline(never)]
    pub(super) fn border<S: System<N, M> + Passage<N> + Kinked<N, Sides = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        (extremes, dense): ByStages<'_, N, M>,
        tries: u32,
    ) -> Border {
        if tries > 0 {
            let end = self.balanced_end(system, settings);
            match Window::of(system, settings, [&end.q, &end.v, &end.a], self.length) {
                Window::Within => return Border::AtEnd,
                Window::Off(_) if tries >= MOST_TRIES => return Border::Clear,
                // The interpolant was not that exact: the end itself says how far to go.
                Window::Off(Some(later)) => return Border::Before(self.length + later),
                Window::Off(None) => {}
            }
        }
        let from = system.touches(&self.start.q, &self.start.v);
        if self.is_clear(system, settings, &from, extremes) {
            return Border::Clear;
        }
        self.dense = dense(&self.balanced_end(system, settings));
        match self.first_crossing(system, settings, from) {
            None => Border::Clear,
            Some(when) if when >= SHORTEST && self.cut(system, settings, when) => Border::AtEnd,
            Some(when) => Border::Before(when),
        }
    }

    /// Whether the step certainly crosses no border, by what its stages have seen of rates and accelerations.
    fn is_clear<S: Kinked<N>>(&self, system: &S, settings: &Settings, start: &S::Touches, extremes: &[Vector<N>; 2]) -> bool {
        let end = system.touches(&self.end.q, &self.end.v);
        let (extremes, tolerance) = (extremes.map(|most| MARGIN * most), settings.error_tolerance);
        !system.is_touching(start)
            && system.beyond(&end, tolerance) <= CROSSED
            && system.stays_within([start, &end], self.length, &extremes, tolerance)
    }

    /// When the motion of the step first crosses a border, s from its beginning. The interpolant's coefficients must be there.
    #[cold]
    fn first_crossing<S: Kinked<N>>(&self, system: &S, settings: &Settings, from: S::Touches) -> Option<f64> {
        let tolerance = settings.error_tolerance;
        let extremes = self.extremes();
        let at = |part: f64| {
            let [q, v] = self.moved(part);
            system.touches(&q, &v)
        };
        let (mut part, mut here) = (0.0, from);
        let mut stretch = FIRST;
        while part < 1.0 {
            let end = f64::min(part + stretch, 1.0);
            let there = at(end);
            let beyond = system.beyond(&there, tolerance);
            let crossed = beyond > CROSSED;
            if crossed && stretch <= FINE {
                let before = system.beyond(&here, tolerance);
                return Some(self.length * self.border_between(system, tolerance, [[part, before], [end, beyond]]));
            }
            let duration = (end - part) * self.length;
            if crossed || (stretch > FINEST && !system.stays_within([&here, &there], duration, &extremes, tolerance)) {
                stretch /= 2.0;
            } else {
                (part, here) = (end, there);
                stretch = f64::min(2.0 * stretch, FIRST);
            }
        }
        None
    }

    /// The part of the step at which the motion is at a border, between one before it and one beyond, each with how far beyond the borders
    /// it is: by false position (Illinois).
    fn border_between<S: Kinked<N>>(&self, system: &S, tolerance: f64, ends: [[f64; 2]; 2]) -> f64 {
        let beyond = |part: f64| {
            let [q, v] = self.moved(part);
            system.beyond(&system.touches(&q, &v), tolerance) - AT_BORDER
        };
        let [[mut before, mut low], [mut after, mut high]] = ends.map(|[part, beyond]| [part, beyond - AT_BORDER]);
        if low >= 0.0 {
            return before;
        }
        // Of the function only the sign and the size near the border matter.
        low = low.max(-1e12);
        for _ in 0..ROUNDS {
            let part = after - high * (after - before) / (high - low);
            let here = beyond(part);
            if here.abs() <= 0.1 * NEAR_ENOUGH || after - before <= f64::EPSILON {
                return part;
            }
            if here > 0.0 {
                (after, high) = (part, here);
                low /= 2.0;
            } else {
                (before, low) = (part, here);
                high /= 2.0;
            }
        }
        before
    }
}
