//! Where a force has a kink, a step ends.
//!
//! A step is made on the sides on which it begins. Its interpolant tells where its motion first crosses a border: of a stretch bounds on
//! its polynomials say that nothing deeper than the tolerance lies between its ends, or its halves are looked at. Then the step ends at the
//! border, or is made once more up to there.

use std::borrow::Borrow;
use std::cell::Cell;

use super::interpolant::Interpolant;
use super::step::SHORTEST;
use super::trial::Slope;
use super::{DenseStep, Kind, Settings};
use crate::integrator::{Extremes, Kinked, Passage, State, System};
use crate::vector::Vector;

/// A step ends at a border where it is beyond it by half of what may be overlooked: on the sides behind it is then well on the near side of
/// the same border.
const AT_BORDER: f64 = 0.5;
/// This near.
const NEAR_ENOUGH: f64 = 0.4;
/// Farther beyond, a border has been crossed: less than may be overlooked, so that a bound may lie between.
const CROSSED: f64 = 0.95;
/// What grips hold has no bound: on stretches of this part of the step, or less, its summits are not looked for.
const FINEST_SUMMIT: f64 = 0.125;
/// No stretch is shorter than this part of the step: what lies between its ends is round-off.
const FINEST: f64 = 1e-6;
/// Most sides that a state passes at once.
const MOST_SIDES: u32 = 8;
/// After so many tries to end at a border the step is halved instead.
const MOST_TRIES: u32 = 8;
/// No step is halved to less than this, s: nothing moves in it.
const NOTHING_MOVES: f64 = 1e-12;
/// A step that takes more places to be cleared is too long for its interpolant, and halved.
const MOST_PLACES: u32 = 200;
/// The motion is straight over this part of a step.
const NEARBY: f64 = 1e-6;
/// The end of a step that was to end at a border is not farther from it than this part of the step.
const NEAR: f64 = 0.1;
/// The false position is good enough after so many rounds.
const ROUNDS: u32 = 60;

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

    /// Whether a step that is accepted otherwise has to end before, after so many tries; `system` is on its sides, and the coefficients of the
    /// interpolant to an end are there where they are asked for.
    #[inline(never)]
    pub(super) fn border<S: System<N, M> + Passage<N> + Kinked<N, Sides = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        dense: &mut dyn FnMut(&State<N, M>) -> [Slope<N>; 4],
        tries: u32,
    ) -> Border {
        let from = system.touches(&self.start.q, &self.start.v);
        let shown = system.released(&from);
        let border = self.border_from(system, settings, from, dense, tries);
        if shown > 0.0 && !matches!(border, Border::Before(_)) {
            self.end.work.dissipated += self.released(system, [&self.end.q, &self.end.v]);
        }
        border
    }

    /// The same, from what touches at its beginning.
    fn border_from<S: System<N, M> + Passage<N> + Kinked<N, Sides = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        from: S::Touches,
        dense: &mut dyn FnMut(&State<N, M>) -> [Slope<N>; 4],
        tries: u32,
    ) -> Border {
        let mut crosses = Border::Clear;
        if (1..MOST_TRIES).contains(&tries) {
            let end = self.balanced_end(system, settings);
            match Window::of(system, settings, [&end.q, &end.v, &end.a], self.length) {
                // Another border may be crossed before.
                Window::Within => crosses = Border::AtEnd,
                // The interpolant was not that exact: the end itself says how far to go.
                Window::Off(Some(later)) => return Border::Before(self.length + later),
                Window::Off(None) => {}
            }
        }
        self.dense = dense(&self.balanced_end(system, settings));
        match self.first_crossing(system, settings, from) {
            Found::Nothing => crosses,
            Found::Crossing(when) if when >= SHORTEST && self.cut(system, settings, when) => Border::AtEnd,
            Found::Crossing(when) if tries < MOST_TRIES => Border::Before(when),
            Found::Crossing(_) | Found::TooMuch if self.length > NOTHING_MOVES => Border::Before(0.5 * self.length),
            Found::Crossing(_) | Found::TooMuch => crosses,
        }
    }

    /// What is dissipated between the beginning of the step and a place of it, q and q̇, by forces that act no more, J.
    #[cold]
    pub(super) fn released<S: Kinked<N>>(&self, system: &S, [q, v]: [&Vector<N>; 2]) -> f64 {
        let shown = system.released(&system.touches(&self.start.q, &self.start.v));
        if shown > 0.0 { (shown - system.released(&system.touches(q, v))).max(0.0) } else { 0.0 }
    }

    /// When the motion of the step first crosses a border. The interpolant's coefficients must be there.
    #[inline(never)]
    fn first_crossing<S: Kinked<N>>(&self, system: &S, settings: &Settings, from: S::Touches) -> Found {
        let motion = self.resolved_motion();
        let extremes = self.extremes(&motion);
        let search =
            Search { step: self, system, tolerance: settings.error_tolerance, motion, extremes, left: Cell::new(MOST_PLACES) };
        let to = system.touches(&self.end.q, &self.end.v);
        match search.first(&search.place(0.0, from), &search.place(1.0, to)) {
            _ if search.left.get() == 0 => Found::TooMuch,
            Some(part) => Found::Crossing(self.length * part),
            None => Found::Nothing,
        }
    }

    /// The interpolant of the coordinates from where the step begins. In a short step the round-off of coordinates would be more than all
    /// tolerances in its rates: there the way is that of the rates, which it is within that round-off.
    fn resolved_motion(&self) -> Interpolant<N> {
        /// Places on the step and weights of Gauss's rule, exact for the interpolant of the rates.
        const GAUSS: [[f64; 2]; 4] = [
            [0.069_431_844_202_973_71, 0.173_927_422_568_726_93],
            [0.330_009_478_207_571_87, 0.326_072_577_431_273_07],
            [0.669_990_521_792_428_1, 0.326_072_577_431_273_07],
            [0.930_568_155_797_026_3, 0.173_927_422_568_726_93],
        ];
        /// Of a coordinate at both ends, and of what has been corrected.
        const ROUND_OFF: f64 = 4.0 * f64::EPSILON;
        let Self { start, end, length, .. } = self;
        let mut moved = end.q - start.q;
        if self.kind == Kind::Eighth {
            let velocities = self.velocities();
            let way = GAUSS.iter().fold(Vector::ZERO, |sum, [part, weight]| sum + weight * length * velocities.at(*part));
            let is_round_off = |i: usize| (way[i] - moved[i]).abs() <= ROUND_OFF * (1.0 + end.q[i].abs());
            moved = Vector::from_fn(|i| if is_round_off(i) { way[i] } else { moved[i] });
        }
        Interpolant::new([Vector::ZERO, moved], [*length * start.v, *length * end.v], std::array::from_fn(|k| self.dense[k].q))
    }

    /// Bounds on the motion of an interpolant: on the derivatives of its coordinates.
    fn extremes(&self, motion: &Interpolant<N>) -> Extremes<N> {
        let mut per = 1.0;
        let [rates, accelerations, jerks, snaps] = motion.greatest().map(|greatest| {
            per /= self.length;
            per * greatest
        });
        Extremes { rates, accelerations, higher: Some([jerks, snaps]) }
    }
}

/// What a search of an interpolant has found.
enum Found {
    /// It crosses no border.
    Nothing,
    /// It crosses one, so many seconds from the beginning.
    Crossing(f64),
    /// It took too many places to tell.
    TooMuch,
}

/// A place on the interpolant of a step.
struct Place<T> {
    /// Part of the step.
    part: f64,
    touches: T,
    /// How far beyond the borders it is.
    beyond: f64,
}

/// A search of the interpolant of a step for the first border that it crosses.
struct Search<'a, S, const N: usize, const M: usize, K> {
    step: &'a DenseStep<N, M, K>,
    system: &'a S,
    tolerance: f64,
    /// From where the step begins.
    motion: Interpolant<N>,
    /// Of the whole step.
    extremes: Extremes<N>,
    /// So many more places may be looked at.
    left: Cell<u32>,
}

impl<S: Kinked<N>, const N: usize, const M: usize, K: Copy + PartialEq> Search<'_, S, N, M, K> {
    fn place(&self, part: f64, touches: S::Touches) -> Place<S::Touches> {
        let beyond = self.system.beyond(&touches, self.tolerance);
        Place { part, touches, beyond }
    }

    fn at(&self, part: f64) -> Place<S::Touches> {
        self.left.set(self.left.get().saturating_sub(1));
        // One polynomial for both, which the bounds are of.
        let (q, v) = (self.step.start.q + self.motion.at(part), (1.0 / self.step.length) * self.motion.rate_at(part));
        self.place(part, self.system.touches(&q, &v))
    }

    /// The part of the step at which the first border is crossed between two places, of which the first is not beyond any.
    fn first(&self, from: &Place<S::Touches>, to: &Place<S::Touches>) -> Option<f64> {
        if to.beyond > CROSSED {
            // Somewhere it is crossed; whether it, or another one, is crossed before, too, the way there says.
            let at = self.border_between(from, to);
            let before = if at.beyond <= CROSSED { self.first(from, &at) } else { None };
            return before.or(Some(at.part));
        }
        let stretch = to.part - from.part;
        if stretch <= FINEST || self.left.get() == 0 {
            return None;
        }
        let duration = stretch * self.step.length;
        let stays = self.system.stays_within([&from.touches, &to.touches], duration, &self.extremes, self.tolerance);
        if stays && (stretch <= FINEST_SUMMIT || !self.system.holds_in_motion(&from.touches)) {
            return None;
        }
        let middle = self.at(0.5 * (from.part + to.part));
        if stays && self.holds_on([from, &middle, to]) {
            return None;
        }
        self.first(from, &middle).or_else(|| self.first(&middle, to))
    }

    /// Whether what grips hold has no summit above what they can hold between places as far from each other: that of the parabola through
    /// all three, with a margin.
    fn holds_on(&self, places: [&Place<S::Touches>; 3]) -> bool {
        /// A parabola rises above its chords by an eighth of its second difference.
        const ABOVE: f64 = 0.5;
        let [from, middle, to] = places.map(|place| self.system.strain(&place.touches, self.tolerance));
        f64::max(from, to).max(middle) + ABOVE * (from - 2.0 * middle + to).abs() <= CROSSED
    }

    /// Where the motion is at a border, between a place before it and one beyond: by false position (Anderson and Björck, *BIT* 13, 1973).
    fn border_between(&self, from: &Place<S::Touches>, to: &Place<S::Touches>) -> Place<S::Touches> {
        let [mut before, mut after] = [from.part, to.part];
        // Of the function only the sign and the size near the border matter.
        let (mut low, mut high) = ((from.beyond - AT_BORDER).max(-1e12), to.beyond - AT_BORDER);
        let mut last_beyond = None;
        if low < 0.0 {
            for _ in 0..ROUNDS {
                let part = after - high * (after - before) / (high - low);
                let place = self.at(part);
                let here = place.beyond - AT_BORDER;
                if here.abs() <= 0.5 * NEAR_ENOUGH {
                    return place;
                }
                if after - before <= f64::EPSILON {
                    break;
                }
                // The value at an end that stays twice in a row counts less.
                let beyond = here > 0.0;
                let (value, opposite) = if beyond { (high, &mut low) } else { (low, &mut high) };
                if last_beyond == Some(beyond) {
                    let less = 1.0 - here / value;
                    // Where another border was the farthest so far the values tell nothing of the slope there.
                    *opposite *= if less > 0.0 { less.max(0.1) } else { 0.5 };
                }
                last_beyond = Some(beyond);
                if beyond {
                    (after, high) = (part, here);
                } else {
                    (before, low) = (part, here);
                }
            }
        }
        self.at(before)
    }
}
