//! Event location on the dense output of a step, independent of the method. Interval bounds prove that a stretch crosses no guard;
//! otherwise the stretch is halved. False position refines crossings. Reactions of sticking friction have no such bounds, so their maxima
//! are located. Events are data here: the system supplies guard values, their residuals and their bounds.

use std::cell::Cell;

use super::dense_output::Interpolant;
use super::{Events, Extremes, Guards, Residuals};
use crate::vector::Vector;

/// Guard residual at which a step should end, in event tolerances. It is past the guard, so that the next mode begins well inside its own
/// guards.
const TARGET_RESIDUAL: f64 = 0.5;
/// Half-width of the accepted window around [`TARGET_RESIDUAL`], in event tolerances.
const WINDOW_HALF_WIDTH: f64 = 0.4;
/// Guard residual above which an event has occurred, in event tolerances. It is less than 1, so that bounds on the residual fit between.
pub const CROSSING_RESIDUAL: f64 = 0.95;
/// Number of trials to end a step at a guard before the step is halved instead.
const MOST_TRIES: u32 = 8;
/// Shortest step that ends at a guard, s. If a guard is crossed earlier, the mode changes immediately.
pub(super) const SHORTEST: f64 = 1e-15;
/// Shortest step that is halved, s: nothing moves in shorter steps.
const SHORTEST_HALVED: f64 = 1e-12;
/// Time over which the motion is linearised to differentiate the guard residual, relative to the step.
const LINEARIZED_PART: f64 = 1e-6;
/// Largest correction of a step's end towards a guard, relative to the step.
const LARGEST_CORRECTION: f64 = 0.1;
/// Length of a stretch, relative to the step, on which the reaction is assumed to have at most one maximum.
const ONE_MAXIMUM: f64 = 1.0 / 16.0;
/// Largest number of parabolas per maximum.
const MAXIMUM_ROUNDS: u32 = 6;
/// Accuracy of a maximum's place, relative to the bracket; the error of its value is of second order.
const MAXIMUM_ACCURACY: f64 = 1e-3;
/// Shortest stretch, relative to the step: on shorter ones the ends differ only by round-off.
const SHORTEST_STRETCH: f64 = 1e-6;
/// Largest number of rounds of false position.
const ROUNDS: u32 = 60;
/// Largest number of evaluations per step. A step that needs more is too long for its interpolant and is halved.
const MOST_EVALUATIONS: u32 = 200;

/// Decision about a step with an admissible error.
pub(super) enum EventCheck {
    /// No event occurs in the step.
    Clear,
    /// The step ends at an event.
    AtEnd,
    /// The step has to be tried again over this many seconds: up to the first event, or half as long if the event was not found.
    Before(f64),
}

/// Checks a step of `length` seconds for events, after `tries` trials to end it at a guard. `from` is its beginning, `end` holds q, q̇ and
/// q̈ at its end, and `path` is its dense output. `truncate` may end the step at a time inside it, s, so that it need not be redone.
///
/// Let r(t) be the largest guard residual on `path`, in event tolerances. If r(0) ≤ [`CROSSING_RESIDUAL`], then after
/// - `Clear`: r ≤ [`CROSSING_RESIDUAL`] on [0, `length`];
/// - `AtEnd`: the same holds up to the end of the step, where r is within [`WINDOW_HALF_WIDTH`] of [`TARGET_RESIDUAL`]. The end is at
///   `length`, or where `truncate` has put it;
/// - `Before(when)`: nothing is promised about this step; it has to be tried again over `when` seconds. `when` exceeds `length`, by less than
///   [`LARGEST_CORRECTION`] of it, if a trial for a guard ended just before it, and is less than [`SHORTEST`] if a guard is crossed at the
///   beginning.
///
/// Bounds on derivatives prove this between the places that are evaluated, with three exceptions. Stretches shorter than
/// [`SHORTEST_STRETCH`] of the step are judged by their ends, maxima of sticking friction's reaction by parabolas, and a step shorter than
/// [`SHORTEST_HALVED`] is `Clear` or `AtEnd` even if the search found no end for it.
pub(super) fn check<const N: usize, S: Events<N>>(
    (system, tolerance): (&S, f64),
    from: &Probe<S::GuardValues>,
    (end, length): ([&Vector<N>; 3], f64),
    tries: u32,
    path: &Path<N>,
    truncate: impl FnOnce(f64) -> bool,
) -> EventCheck {
    let bounds = system.path_bounds(path);
    if tries == 0 && !from.sticks() && from.guard_values.are_out_of_reach(length, &bounds, tolerance) {
        return EventCheck::Clear;
    }
    let mut seen = EventCheck::Clear;
    if (1..MOST_TRIES).contains(&tries) {
        match EventWindow::of(system, tolerance, end, length) {
            // Another guard may be crossed earlier.
            EventWindow::Within => seen = EventCheck::AtEnd,
            // The interpolant was not accurate enough, so the end of the step gives the correction.
            EventWindow::Outside(Some(later)) => return EventCheck::Before(length + later),
            EventWindow::Outside(None) => {}
        }
    }
    let search = Search { path, system, tolerance, bounds, left: Cell::new(MOST_EVALUATIONS) };
    let crossing = search.first(from, &Probe::new(system, (1.0, [end[0], end[1]]), tolerance), false);
    let is_exhausted = search.left.get() == 0;
    match crossing.map(|part| length * part) {
        None if !is_exhausted => seen,
        Some(when) if !is_exhausted && when >= SHORTEST && truncate(when) => EventCheck::AtEnd,
        Some(when) if !is_exhausted && tries < MOST_TRIES => EventCheck::Before(when),
        _ if length > SHORTEST_HALVED => EventCheck::Before(0.5 * length),
        _ => seen,
    }
}

/// Trials of one step that should end at a guard.
pub(super) struct EventTrials {
    /// Number of such trials.
    pub(super) count: u32,
    /// Length of the next trial, s, if it should end at a guard.
    pub(super) end: Option<f64>,
    /// Length of the trial with the dense output that showed the event, s; infinite before.
    shown_by: f64,
}

impl EventTrials {
    /// No trial has shown an event.
    pub(super) const NONE: Self = Self { count: 0, end: None, shown_by: f64::INFINITY };

    /// Notes that a trial of `tried` seconds showed an event `when` seconds after the beginning of the step.
    pub(super) fn repeat(&mut self, tried: f64, when: f64) {
        self.count += 1;
        let crossed_at_once = when < SHORTEST;
        self.shown_by = if crossed_at_once { f64::INFINITY } else { tried };
        self.end = (!crossed_at_once).then_some(when);
    }

    /// Longest next step, s, after a step of `length` seconds. It is short if a longer trial showed a false event, or an event early in the
    /// trial, so that a few steps resolve an oscillation about a guard.
    pub(super) fn longest_next(&self, event: &EventCheck, length: f64) -> f64 {
        self.longest_after(event, (length, self.shown_by))
    }

    /// Longest next step, s, as in [`Self::longest_next`], after a step of `tried` seconds was truncated to `length`.
    pub(super) fn longest_after(&self, event: &EventCheck, (length, tried): (f64, f64)) -> f64 {
        /// Largest next step, relative to the longer trial.
        const AFTER_FALSE_EVENT: f64 = 0.3;
        /// Fraction of the longer trial before which an event is early.
        const EARLY: f64 = 0.01;
        match event {
            EventCheck::AtEnd if length >= EARLY * tried => f64::INFINITY,
            _ => (AFTER_FALSE_EVENT * tried).max(SHORTEST),
        }
    }
}

/// Position of a step's end relative to a guard.
pub(super) enum EventWindow {
    /// The guard residual is within the accepted window.
    Within,
    /// The guard residual is outside the window. The value is the correction of the step length, s, if the linearised motion reaches the
    /// guard nearby.
    Outside(Option<f64>),
}

impl EventWindow {
    /// Position of the state q, q̇ and q̈ near the end of a step of `length` seconds.
    pub(super) fn of<const N: usize>(system: &impl Events<N>, tolerance: f64, [q, v, a]: [&Vector<N>; 3], length: f64) -> Self {
        let guard_residual_at =
            |later: f64| system.guard_values(&(*q + later * *v), &(*v + later * *a)).residuals(tolerance).largest;
        let guard_residual = guard_residual_at(0.0);
        if (guard_residual - TARGET_RESIDUAL).abs() <= WINDOW_HALF_WIDTH {
            return Self::Within;
        }
        let later = LINEARIZED_PART * length;
        let (gained, missing) = (guard_residual_at(later) - guard_residual, (guard_residual - TARGET_RESIDUAL) * later);
        Self::Outside((missing.abs() < LARGEST_CORRECTION * length * gained.abs()).then(|| -missing / gained))
    }
}

/// Motion over a step: a polynomial for the coordinates relative to the beginning; its derivative gives the rates.
pub struct Path<const N: usize> {
    /// Coordinates at the beginning, m and rad.
    pub(super) origin: Vector<N>,
    /// Increment of the coordinates, m and rad.
    pub(super) increment: Interpolant<N>,
    /// Length of the step, s.
    pub(super) length: f64,
    /// Longest stretch, relative to the step, on which the reaction of sticking friction is interpolated by a parabola.
    pub(super) longest_parabola: f64,
}

impl<const N: usize> Path<N> {
    /// Coordinates and rates at a fraction of the step.
    fn at(&self, part: f64) -> [Vector<N>; 2] {
        [self.origin + self.increment.at(part), (1.0 / self.length) * self.increment.rate_at(part)]
    }

    /// Bounds on the derivatives of some coordinates over the step.
    pub fn extremes<const K: usize>(&self, coordinates: [usize; K]) -> Extremes<K> {
        let mut per = 1.0;
        let [rates, accelerations, jerks, snaps] = self.increment.components(coordinates).derivative_bounds().map(|bounds| {
            per /= self.length;
            per * bounds
        });
        Extremes { rates, accelerations, jerks, snaps }
    }
}

/// Guard values evaluated at one place of the interpolant.
pub(super) struct Probe<T> {
    /// Place, as a fraction of the step.
    part: f64,
    /// Guard values at the place.
    pub(super) guard_values: T,
    residuals: Residuals,
}

impl<T: Guards> Probe<T> {
    /// Evaluates the guards at a place, given as a fraction of the step, with the state q and q̇.
    pub(super) fn new<const N: usize, S: Events<N, GuardValues = T>>(
        system: &S,
        (part, [q, v]): (f64, [&Vector<N>; 2]),
        tolerance: f64,
    ) -> Self {
        let guard_values = system.guard_values(q, v);
        let residuals = guard_values.residuals(tolerance);
        Self { part, guard_values, residuals }
    }

    /// Whether friction sticks while the system moves.
    fn sticks(&self) -> bool {
        self.residuals.breakaway != f64::NEG_INFINITY
    }

    /// Whether an event has occurred, so that the place is past a guard of the mode.
    pub(super) fn is_past_guard(&self) -> bool {
        self.residuals.largest > CROSSING_RESIDUAL
    }
}

/// Location of the first event on a path.
struct Search<'a, S: Events<N>, const N: usize> {
    path: &'a Path<N>,
    system: &'a S,
    /// Error tolerance of a coordinate, rad.
    tolerance: f64,
    /// Bounds on the derivatives over the whole step.
    bounds: <S::GuardValues as Guards>::PathBounds,
    /// Number of evaluations left.
    left: Cell<u32>,
}

impl<S: Events<N>, const N: usize> Search<'_, S, N> {
    fn at(&self, part: f64) -> Probe<S::GuardValues> {
        self.left.set(self.left.get().saturating_sub(1));
        let [q, v] = self.path.at(part);
        Probe::new(self.system, (part, [&q, &v]), self.tolerance)
    }

    /// Fraction of the step at which the first guard is crossed between two places; the first place is within all guards. If `stays`,
    /// bounds on a longer stretch have excluded all guards except those of sticking friction.
    fn first(&self, from: &Probe<S::GuardValues>, to: &Probe<S::GuardValues>, stays: bool) -> Option<f64> {
        if to.is_past_guard() {
            // A crossing lies between the two places; the stretch before it is searched for an earlier one.
            let at = self.crossing_between(from, to);
            let before = if at.is_past_guard() { None } else { self.first(from, &at, stays) };
            return before.or(Some(at.part));
        }
        let stretch = to.part - from.part;
        if stretch <= SHORTEST_STRETCH || self.left.get() == 0 {
            return None;
        }
        let duration = stretch * self.path.length;
        let stays = stays || from.guard_values.stay_until(&to.guard_values, duration, &self.bounds, self.tolerance);
        if stays && !from.sticks() {
            return None;
        }
        let middle = self.at(0.5 * (from.part + to.part));
        if stays && !middle.is_past_guard() && stretch <= self.path.longest_parabola {
            let probes = [from, &middle, to].map(|probe| [probe.part, probe.residuals.breakaway]);
            if maximum_is_below(probes) {
                return None;
            }
            if stretch <= ONE_MAXIMUM {
                return self.refine_maximum(from, probes);
            }
        }
        self.first(from, &middle, stays).or_else(|| self.first(&middle, to, stays))
    }

    /// First crossing on a stretch with at most one maximum of sticking friction's reaction, by successive parabolas. Not inlined, so that
    /// the recursion of [`Self::first`] needs less stack.
    #[inline(never)]
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
            if probe.is_past_guard() {
                return self.first(from, &probe, true);
            }
            let maximum = [part, probe.residuals.breakaway];
            [left, top, right] = match (part < top[0], maximum[1] > top[1]) {
                (true, true) => [left, maximum, top],
                (true, false) => [maximum, top, right],
                (false, true) => [top, maximum, right],
                (false, false) => [left, top, maximum],
            };
        }
        None
    }

    /// Crossing of a guard between a place within it and a place past it, by false position (Anderson and Björck, *BIT* 13, 1973).
    /// Not inlined, so that the recursion of [`Self::first`] needs less stack.
    #[inline(never)]
    fn crossing_between(&self, from: &Probe<S::GuardValues>, to: &Probe<S::GuardValues>) -> Probe<S::GuardValues> {
        let [mut before, mut after] = [from.part, to.part];
        // Only the sign, and the size near the guard, matter.
        let (mut low, mut high) = ((from.residuals.largest - TARGET_RESIDUAL).max(-1e12), to.residuals.largest - TARGET_RESIDUAL);
        let mut last_was_positive = None;
        if low < 0.0 {
            for _ in 0..ROUNDS {
                let part = after - high * (after - before) / (high - low);
                let probe = self.at(part);
                let here = probe.residuals.largest - TARGET_RESIDUAL;
                if here.abs() <= 0.5 * WINDOW_HALF_WIDTH {
                    return probe;
                }
                if after - before <= f64::EPSILON {
                    break;
                }
                // If the same end is kept twice in a row, its residual is reduced.
                let is_past = here > 0.0;
                let (value, opposite) = if is_past { (high, &mut low) } else { (low, &mut high) };
                if last_was_positive == Some(is_past) {
                    let less = 1.0 - here / value;
                    // If another guard was dominant at one end, the residuals give no slope. The factor is at least 0.1.
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

/// Whether the reaction of sticking friction stays below its breakaway bound between three equidistant places, judged by their parabola
/// with a margin.
fn maximum_is_below([[_, from], [_, middle], [_, to]]: [[f64; 2]; 3]) -> bool {
    /// Margin in second differences; the parabola itself rises above its chords by 1/8.
    const PARABOLA_MARGIN: f64 = 0.5;
    from.max(to).max(middle) + PARABOLA_MARGIN * (from - 2.0 * middle + to).abs() <= CROSSING_RESIDUAL
}
