//! Where the motion of a step first crosses a border: bounds on the interpolant's polynomials say of a stretch that nothing deeper than the
//! tolerance lies between its ends, or its halves are looked at. Of what grips hold the summits are looked for.

use std::cell::Cell;

use super::events::{AT_BORDER, CROSSED, NEAR_ENOUGH};
use super::interpolant::Interpolant;
use super::{DenseStep, Scheme, Settings};
use crate::integrator::{Events, Extremes};
use crate::vector::Vector;

/// Parabolas are trusted for what grips hold on stretches of this part of the step at most.
const COARSEST_SUMMIT: f64 = 0.25;
/// On stretches of this part of it, or less, that has one summit at most.
const FINEST_SUMMIT: f64 = 1.0 / 16.0;
/// So many parabolas lead to it.
const SUMMIT_ROUNDS: u32 = 6;
/// A summit is seen within this part of the places around it: what is left is the square of it.
const SEEN: f64 = 1e-3;
/// No stretch is shorter than this part of the step: what lies between its ends is round-off.
const FINEST: f64 = 1e-6;
/// The false position is good enough after so many rounds.
const ROUNDS: u32 = 60;
/// A step that takes more places to be cleared is too long for its interpolant, and halved.
const MOST_PLACES: u32 = 200;

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// When the motion of the step first crosses a border. The interpolant's coefficients must be there.
    #[inline(never)]
    pub(super) fn first_crossing<S: Events<N>>(&self, system: &S, settings: &Settings, from: S::GuardValues) -> Found {
        let motion = self.resolved_motion();
        let extremes = self.extremes(&motion);
        let search =
            Search { step: self, system, tolerance: settings.error_tolerance, motion, extremes, left: Cell::new(MOST_PLACES) };
        let to = system.guard_values(&self.end.q, &self.end.v);
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
        if self.scheme == Scheme::Dop853 {
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
pub(super) enum Found {
    /// It crosses no border.
    Nothing,
    /// It crosses one, so many seconds from the beginning.
    Crossing(f64),
    /// It took too many places to tell.
    TooMuch,
}

/// A place on the interpolant of a step.
struct Probe<T> {
    /// Part of the step.
    part: f64,
    guard_values: T,
    /// How far beyond the borders it is.
    guard_residual: f64,
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

impl<S: Events<N>, const N: usize, const M: usize, K: Copy + PartialEq> Search<'_, S, N, M, K> {
    fn place(&self, part: f64, guard_values: S::GuardValues) -> Probe<S::GuardValues> {
        let guard_residual = self.system.guard_residual(&guard_values, self.tolerance);
        Probe { part, guard_values, guard_residual }
    }

    fn at(&self, part: f64) -> Probe<S::GuardValues> {
        self.left.set(self.left.get().saturating_sub(1));
        // One polynomial for both, which the bounds are of.
        let (q, v) = (self.step.start.q + self.motion.at(part), (1.0 / self.step.length) * self.motion.rate_at(part));
        self.place(part, self.system.guard_values(&q, &v))
    }

    /// The part of the step at which the first border is crossed between two places, of which the first is not beyond any.
    fn first(&self, from: &Probe<S::GuardValues>, to: &Probe<S::GuardValues>) -> Option<f64> {
        if to.guard_residual > CROSSED {
            // Somewhere it is crossed; whether it, or another one, is crossed before, too, the way there says.
            let at = self.border_between(from, to);
            let before = if at.guard_residual <= CROSSED { self.first(from, &at) } else { None };
            return before.or(Some(at.part));
        }
        let stretch = to.part - from.part;
        if stretch <= FINEST || self.left.get() == 0 {
            return None;
        }
        let duration = stretch * self.step.length;
        let stays = self.system.stays_within([&from.guard_values, &to.guard_values], duration, &self.extremes, self.tolerance);
        if stays && !self.system.sticks_in_motion(&from.guard_values) {
            return None;
        }
        let middle = self.at(0.5 * (from.part + to.part));
        if stays && middle.guard_residual <= CROSSED && stretch <= COARSEST_SUMMIT {
            let places =
                [from, &middle, to].map(|place| [place.part, self.system.breakaway_residual(&place.guard_values, self.tolerance)]);
            if maximum_is_below(places) {
                return None;
            }
            if stretch <= FINEST_SUMMIT {
                return self.refine_maximum(from, places);
            }
        }
        self.first(from, &middle).or_else(|| self.first(&middle, to))
    }

    /// The same where what grips hold has one summit at most: by parabolas through the highest places.
    #[cold]
    fn refine_maximum(&self, from: &Probe<S::GuardValues>, [mut left, mut top, mut right]: [[f64; 2]; 3]) -> Option<f64> {
        for _ in 0..SUMMIT_ROUNDS {
            let slope = |[x, y]: [f64; 2], [z, w]: [f64; 2]| (w - y) / (z - x);
            let (rise, bend) = (slope(left, top), slope(left, top) - slope(top, right));
            let part = 0.5 * (left[0] + top[0]) + 0.5 * rise / bend * (right[0] - left[0]);
            let is_seen = (part - top[0]).abs() <= SEEN * (right[0] - left[0]);
            if bend <= 0.0 || is_seen || !(left[0] < part && part < right[0]) {
                return None;
            }
            let place = self.at(part);
            if place.guard_residual > CROSSED {
                return self.first(from, &place);
            }
            let summit = [part, self.system.breakaway_residual(&place.guard_values, self.tolerance)];
            [left, top, right] = match (part < top[0], summit[1] > top[1]) {
                (true, true) => [left, summit, top],
                (true, false) => [summit, top, right],
                (false, true) => [top, summit, right],
                (false, false) => [left, top, summit],
            };
        }
        None
    }

    /// Where the motion is at a border, between a place before it and one beyond: by false position (Anderson and Björck, *BIT* 13, 1973).
    fn border_between(&self, from: &Probe<S::GuardValues>, to: &Probe<S::GuardValues>) -> Probe<S::GuardValues> {
        let [mut before, mut after] = [from.part, to.part];
        // Of the function only the sign and the size near the border matter.
        let (mut low, mut high) = ((from.guard_residual - AT_BORDER).max(-1e12), to.guard_residual - AT_BORDER);
        let mut last_was_positive = None;
        if low < 0.0 {
            for _ in 0..ROUNDS {
                let part = after - high * (after - before) / (high - low);
                let place = self.at(part);
                let here = place.guard_residual - AT_BORDER;
                if here.abs() <= 0.5 * NEAR_ENOUGH {
                    return place;
                }
                if after - before <= f64::EPSILON {
                    break;
                }
                // The value at an end that stays twice in a row counts less.
                let guard_residual = here > 0.0;
                let (value, opposite) = if guard_residual { (high, &mut low) } else { (low, &mut high) };
                if last_was_positive == Some(guard_residual) {
                    let less = 1.0 - here / value;
                    // Where another border was the farthest so far the values tell nothing of the slope there.
                    *opposite *= if less > 0.0 { less.max(0.1) } else { 0.5 };
                }
                last_was_positive = Some(guard_residual);
                if guard_residual {
                    (after, high) = (part, here);
                } else {
                    (before, low) = (part, here);
                }
            }
        }
        self.at(before)
    }
}

/// Whether what grips hold has no summit above what they can hold between three places as far from each other: that of the parabola
/// through all of them, with a margin.
fn maximum_is_below([[_, from], [_, middle], [_, to]]: [[f64; 2]; 3]) -> bool {
    /// A parabola rises above its chords by an eighth of its second difference.
    const ABOVE: f64 = 0.5;
    from.max(to).max(middle) + ABOVE * (from - 2.0 * middle + to).abs() <= CROSSED
}
