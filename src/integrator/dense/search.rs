//! Event location on the interpolant of a step: interval bounds prove that a stretch crosses no guard, otherwise it is halved;
//! crossings are refined by false position. Reactions of sticking friction have no such bounds, so their maxima are located.

use std::cell::Cell;

use super::events::{CROSSING_RESIDUAL, TARGET_RESIDUAL, WINDOW_HALF_WIDTH};
use super::interpolant::Interpolant;
use super::{DenseStep, Scheme, Settings};
use crate::integrator::{Events, Extremes};
use crate::vector::Vector;

/// Longest stretch, relative to the step, on which the reaction of sticking friction is interpolated by a parabola.
const LONGEST_PARABOLA: f64 = 0.25;
/// Length of a stretch, relative to the step, on which the reaction is assumed to have one maximum at most.
const ONE_MAXIMUM: f64 = 1.0 / 16.0;
/// Largest number of parabolas per maximum.
const MAXIMUM_ROUNDS: u32 = 6;
/// Accuracy of the place of a maximum, relative to the bracket; the error of its value is of second order.
const MAXIMUM_ACCURACY: f64 = 1e-3;
/// Shortest stretch, relative to the step; below it only round-off lies between the ends.
const SHORTEST_STRETCH: f64 = 1e-6;
/// Largest number of rounds of false position.
const ROUNDS: u32 = 60;
/// Largest number of evaluations per step; a step that needs more is too long for its interpolant and is halved.
const MOST_EVALUATIONS: u32 = 200;

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Time of the first event in the step, s from its beginning; the interpolant's coefficients must be set.
    #[inline(never)]
    pub(super) fn first_crossing<S: Events<N>>(&self, system: &S, settings: &Settings, from: S::GuardValues) -> Found {
        let motion = self.resolved_motion();
        let extremes = self.extremes(&motion);
        let search =
            Search { step: self, system, tolerance: settings.error_tolerance, motion, extremes, left: Cell::new(MOST_EVALUATIONS) };
        let to = system.guard_values(&self.end.q, &self.end.v);
        match search.first(&search.probe(0.0, from), &search.probe(1.0, to)) {
            _ if search.left.get() == 0 => Found::TooMuch,
            Some(part) => Found::Crossing(self.length * part),
            None => Found::Nothing,
        }
    }

    /// Interpolant of the coordinates relative to the beginning of the step. In short steps, round-off of coordinates would exceed
    /// all tolerances of the rates: there the increment is the integral of the rates, which agrees within that round-off.
    fn resolved_motion(&self) -> Interpolant<N> {
        /// Nodes and weights of Gauss quadrature with four points, exact for the interpolant of the rates.
        const GAUSS: [[f64; 2]; 4] = [
            [0.069_431_844_202_973_71, 0.173_927_422_568_726_93],
            [0.330_009_478_207_571_87, 0.326_072_577_431_273_07],
            [0.669_990_521_792_428_1, 0.326_072_577_431_273_07],
            [0.930_568_155_797_026_3, 0.173_927_422_568_726_93],
        ];
        /// Round-off of a coordinate at both ends and of its projection, relative to 1 rad plus its magnitude.
        const ROUND_OFF: f64 = 4.0 * f64::EPSILON;
        let Self { start, end, length, .. } = self;
        let mut displacement = end.q - start.q;
        if self.scheme == Scheme::Dop853 {
            let velocities = self.velocities();
            let integrated = GAUSS.iter().fold(Vector::ZERO, |sum, [part, weight]| sum + weight * length * velocities.at(*part));
            let is_round_off = |i: usize| (integrated[i] - displacement[i]).abs() <= ROUND_OFF * (1.0 + end.q[i].abs());
            displacement = Vector::from_fn(|i| if is_round_off(i) { integrated[i] } else { displacement[i] });
        }
        Interpolant::new(
            [Vector::ZERO, displacement],
            [*length * start.v, *length * end.v],
            std::array::from_fn(|k| self.dense[k].q),
        )
    }

    /// Bounds on the derivatives of the coordinates over the step.
    fn extremes(&self, motion: &Interpolant<N>) -> Extremes<N> {
        let mut per = 1.0;
        let [rates, accelerations, jerks, snaps] = motion.derivative_bounds().map(|derivative_bounds| {
            per /= self.length;
            per * derivative_bounds
        });
        Extremes { rates, accelerations, higher: Some([jerks, snaps]) }
    }
}

/// Result of an event location.
pub(super) enum Found {
    /// No event occurs in the step.
    Nothing,
    /// An event occurs this many seconds after the beginning.
    Crossing(f64),
    /// The limit of evaluations is reached.
    TooMuch,
}

/// Evaluated place on the interpolant.
struct Probe<T> {
    /// Place, as a part of the step.
    part: f64,
    /// Guard values at the place.
    guard_values: T,
    /// Largest guard residual, in event tolerances.
    guard_residual: f64,
}

/// Location of the first event on the interpolant of a step.
struct Search<'a, S, const N: usize, const M: usize, K> {
    step: &'a DenseStep<N, M, K>,
    system: &'a S,
    /// Error tolerance of a coordinate, rad.
    tolerance: f64,
    /// Interpolant relative to the beginning of the step.
    motion: Interpolant<N>,
    /// Bounds on the derivatives over the whole step.
    extremes: Extremes<N>,
    /// Number of evaluations left.
    left: Cell<u32>,
}

impl<S: Events<N>, const N: usize, const M: usize, K: Copy + PartialEq> Search<'_, S, N, M, K> {
    fn probe(&self, part: f64, guard_values: S::GuardValues) -> Probe<S::GuardValues> {
        let guard_residual = self.system.guard_residual(&guard_values, self.tolerance);
        Probe { part, guard_values, guard_residual }
    }

    fn at(&self, part: f64) -> Probe<S::GuardValues> {
        self.left.set(self.left.get().saturating_sub(1));
        // Coordinates and rates are of one polynomial, the one that is bounded.
        let (q, v) = (self.step.start.q + self.motion.at(part), (1.0 / self.step.length) * self.motion.rate_at(part));
        self.probe(part, self.system.guard_values(&q, &v))
    }

    /// Part of the step at which the first guard is crossed between two places; the first place is within all guards.
    fn first(&self, from: &Probe<S::GuardValues>, to: &Probe<S::GuardValues>) -> Option<f64> {
        if to.guard_residual > CROSSING_RESIDUAL {
            // A crossing lies in between; the stretch before it is searched for earlier ones.
            let at = self.crossing_between(from, to);
            let before = if at.guard_residual <= CROSSING_RESIDUAL { self.first(from, &at) } else { None };
            return before.or(Some(at.part));
        }
        let stretch = to.part - from.part;
        if stretch <= SHORTEST_STRETCH || self.left.get() == 0 {
            return None;
        }
        let duration = stretch * self.step.length;
        let stays = self.system.stays_within([&from.guard_values, &to.guard_values], duration, &self.extremes, self.tolerance);
        if stays && !self.system.sticks_in_motion(&from.guard_values) {
            return None;
        }
        let middle = self.at(0.5 * (from.part + to.part));
        if stays && middle.guard_residual <= CROSSING_RESIDUAL && stretch <= LONGEST_PARABOLA {
            let probes =
                [from, &middle, to].map(|probe| [probe.part, self.system.breakaway_residual(&probe.guard_values, self.tolerance)]);
            if maximum_is_below(probes) {
                return None;
            }
            if stretch <= ONE_MAXIMUM {
                return self.refine_maximum(from, probes);
            }
        }
        self.first(from, &middle).or_else(|| self.first(&middle, to))
    }

    /// First crossing on a stretch where the reaction of sticking friction has one maximum at most, by successive parabolas.
    #[cold]
    fn refine_maximum(&self, from: &Probe<S::GuardValues>, [mut left, mut top, mut right]: [[f64; 2]; 3]) -> Option<f64> {
        for _ in 0..MAXIMUM_ROUNDS {
            let slope = |[x, y]: [f64; 2], [z, w]: [f64; 2]| (w - y) / (z - x);
            let (rise, curvature) = (slope(left, top), slope(left, top) - slope(top, right));
            let part = 0.5 * (left[0] + top[0]) + 0.5 * rise / curvature * (right[0] - left[0]);
            let is_seen = (part - top[0]).abs() <= MAXIMUM_ACCURACY * (right[0] - left[0]);
            if curvature <= 0.0 || is_seen || !(left[0] < part && part < right[0]) {
                return None;
            }
            let probe = self.at(part);
            if probe.guard_residual > CROSSING_RESIDUAL {
                return self.first(from, &probe);
            }
            let maximum = [part, self.system.breakaway_residual(&probe.guard_values, self.tolerance)];
            [left, top, right] = match (part < top[0], maximum[1] > top[1]) {
                (true, true) => [left, maximum, top],
                (true, false) => [maximum, top, right],
                (false, true) => [top, maximum, right],
                (false, false) => [left, top, maximum],
            };
        }
        None
    }

    /// Crossing of a guard between a place within and a place past it, by false position (Anderson and Björck, *BIT* 13, 1973).
    fn crossing_between(&self, from: &Probe<S::GuardValues>, to: &Probe<S::GuardValues>) -> Probe<S::GuardValues> {
        let [mut before, mut after] = [from.part, to.part];
        // Only sign and size near the guard matter.
        let (mut low, mut high) = ((from.guard_residual - TARGET_RESIDUAL).max(-1e12), to.guard_residual - TARGET_RESIDUAL);
        let mut last_was_positive = None;
        if low < 0.0 {
            for _ in 0..ROUNDS {
                let part = after - high * (after - before) / (high - low);
                let probe = self.at(part);
                let here = probe.guard_residual - TARGET_RESIDUAL;
                if here.abs() <= 0.5 * WINDOW_HALF_WIDTH {
                    return probe;
                }
                if after - before <= f64::EPSILON {
                    break;
                }
                // The residual at an end that stays twice in a row is reduced.
                let is_past = here > 0.0;
                let (value, opposite) = if is_past { (high, &mut low) } else { (low, &mut high) };
                if last_was_positive == Some(is_past) {
                    let less = 1.0 - here / value;
                    // If another guard was dominant at one end, the residuals give no slope; the factor is at least 0.1.
                    *opposite *= if less > 0.0 { less.max(0.1) } else { 0.5 };
                }
                last_was_positive = Some(is_past);
                if is_past {
                    (after, high) = (part, here);
                } else {
                    (before, low) = (part, here);
                }
            }
        }
        self.at(before)
    }
}

/// Whether the reaction of sticking friction stays below its breakaway bound between three equidistant places, by their parabola
/// with a margin.
fn maximum_is_below([[_, from], [_, middle], [_, to]]: [[f64; 2]; 3]) -> bool {
    /// Margin in second differences; the parabola itself rises above its chords by 1/8.
    const PARABOLA_MARGIN: f64 = 0.5;
    from.max(to).max(middle) + PARABOLA_MARGIN * (from - 2.0 * middle + to).abs() <= CROSSING_RESIDUAL
}
