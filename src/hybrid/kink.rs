//! Kinks: where a force law changes its smooth formula, declared by the law as data.
//!
//! A [`Piecewise`] law has three phases of one quantity x, a length or an angle, each with one smooth formula. A phase ends at its
//! [`Border`]s, which are linear in x and its rate. The simplest law has borders at two [`Levels`] of x; a law with more of them declares
//! several kinks.
//!
//! Upper bounds on the border values between two states ensure that no crossing is missed. With values and slopes at both ends and bounds on
//! higher derivatives, a function lies below two straight lines, below the parabola over its chord, and within a remainder of the cubic
//! Hermite polynomial.

use super::mode::{Mode, Phase};
use super::{Extremes, derivative_bound};
use crate::mechanism::LINKS;

/// Border of a phase: the function (`offset` + `by_x` x + `by_rate` ẋ)/`scale`, m or rad. It is negative in the phase and positive past the
/// border.
#[derive(Clone, Copy, Debug)]
pub struct Border {
    /// Value at x = 0 and ẋ = 0, before the division.
    pub offset: f64,
    /// Derivative with respect to x, before the division.
    pub by_x: f64,
    /// Derivative with respect to ẋ, before the division.
    pub by_rate: f64,
    /// Divisor that converts the value to a length or an angle.
    pub scale: f64,
    /// Phase past the border.
    pub next: Phase,
}

impl Border {
    /// Border that x passes where it rises above a level.
    pub const fn above(level: f64, next: Phase) -> Self {
        Self { offset: -level, by_x: 1.0, by_rate: 0.0, scale: 1.0, next }
    }

    /// Border that x passes where it falls below a level.
    pub const fn below(level: f64, next: Phase) -> Self {
        Self { offset: level, by_x: -1.0, by_rate: 0.0, scale: 1.0, next }
    }

    /// Value at a state x, ẋ.
    fn residual(&self, [x, rate]: [f64; 2]) -> f64 {
        (self.offset + self.by_x * x + self.by_rate * rate) / self.scale
    }

    /// Derivatives of the value with respect to x, 1, and to ẋ, s.
    fn slopes(&self) -> [f64; 2] {
        [self.by_x, self.by_rate].map(|by| by / self.scale)
    }

    /// Bound on the derivative of the value, m/s or rad/s, from bounds on the first two derivatives of x.
    fn steepest(&self, bound: impl Fn(usize) -> f64) -> f64 {
        let [by_x, by_rate] = self.slopes();
        by_x.abs() * bound(1) + if by_rate == 0.0 { 0.0 } else { by_rate.abs() * bound(2) }
    }

    /// Upper bound on the value between two states `duration` seconds apart. The value lies below two straight lines with the steepest
    /// slope, one through each end.
    fn bound_by_slope(&self, ends: [[f64; 2]; 2], duration: f64, bound: impl Fn(usize) -> f64) -> f64 {
        let [from, to] = ends.map(|end| self.residual(end));
        from.max(to).max(0.5 * (from + to + self.steepest(bound) * duration))
    }

    /// Upper bound on the value between two states `duration` seconds apart, from bounds on the second, third and fourth derivative of x:
    /// the smaller of the bounds from the parabola over the chord and from the cubic Hermite polynomial. The remainder of the cubic is
    /// 1/384 (x) and √3/216 (ẋ) of the fourth derivative, times the fourth and the third power of the duration.
    fn bound_by_cubic(&self, ends: [[f64; 2]; 2], duration: f64, bound: impl Fn(usize) -> f64) -> f64 {
        /// Remainder constants of cubic Hermite interpolation, for the value and for the slope: 1/384 and √3/216.
        const OFF: [f64; 2] = [1.0 / 384.0, 0.008_018_753_738_744_79];
        let [[x, u], [y, w]] = ends;
        let mean = 3.0 * (y - x) / duration;
        let [curvature, end_curvature] = [mean - 2.0 * u - w, u + 2.0 * w - mean].map(|rise| 2.0 * rise / duration);
        let [from, to] = ends.map(|end| self.residual(end));
        let [by_x, by_rate] = self.slopes();
        let slopes = [by_x * u + by_rate * curvature, by_x * w + by_rate * end_curvature];
        let off = (OFF[0] * by_x.abs() * duration + OFF[1] * by_rate.abs()) * bound(4) * duration * duration * duration;
        let cubic = off - cubic_minimum([-from, -to], slopes.map(|slope| -slope * duration));
        let curvature_term = (by_x.abs() * bound(2) + by_rate.abs() * bound(3)) * duration * duration;
        cubic.min(chord_bound([from, to], curvature_term))
    }
}

/// A force law with phases of a quantity x. The provided methods are called through a table of functions once for a kink, not for each
/// border.
pub trait Piecewise {
    /// Phase at a state x, ẋ.
    fn phase(&self, x: f64, rate: f64) -> Phase;

    /// Border of a phase by its index from 0 on, at x; `None` after the last one. Only the phase past a border may depend on x.
    fn border(&self, phase: Phase, index: usize, x: f64) -> Option<Border>;

    /// Whether a phase ends only when all of its borders are passed, not when any of them is.
    fn ends_past_all_borders(&self, _phase: Phase) -> bool {
        false
    }

    /// Extent of the shortest phase in x, m or rad: the event tolerance is a small fraction of it.
    fn width(&self) -> f64;

    /// Event indicators, m or rad. They change sign where the phase may change; 1 for those not needed.
    fn indicators(&self, x: f64, rate: f64) -> [f64; INDICATORS_PER_KINK];

    /// Estimated time until the phase ends, s, if its formula is valid only over a short path.
    fn dwell_time(&self, _phase: Phase, _x: f64, _rate: f64) -> f64 {
        f64::INFINITY
    }

    /// Elastic energy that the law still stores although its force has vanished, J.
    fn separation_energy(&self, _phase: Phase, _x: f64) -> f64 {
        0.0
    }

    /// The border that decides when a phase ends: the phase past it, and its value.
    fn deciding(&self, phase: Phase, state: [f64; 2]) -> (Phase, f64) {
        let at = |border: Border| (border.next, border.residual(state));
        deciding(self, phase, state[0], at).unwrap_or((phase, f64::NEG_INFINITY))
    }

    /// Whether a phase provably persists for `duration` seconds from a state, whatever the end state is. Each border must be farther away
    /// than x can change in that time plus `margin`, the error of the motion.
    fn is_out_of_reach(&self, phase: Phase, state: [f64; 2], over: &Stretch<'_>, margin: f64) -> bool {
        holds(self, phase, state[0], |border| {
            border.residual(state) + border.steepest(|order| over.bound(order)) * over.duration <= -margin
        })
    }

    /// Whether a phase provably persists between two states at the ends of a stretch, within the event tolerance.
    fn stays(&self, phase: Phase, ends: [[f64; 2]; 2], over: &Stretch<'_>, event_tolerance: f64) -> bool {
        let bound = |order: usize| over.bound(order);
        // The cheaper bound decides in most cases, because a law is usually far from its borders.
        holds(self, phase, ends[0][0], |border| {
            border.bound_by_slope(ends, over.duration, bound) <= event_tolerance
                || border.bound_by_cubic(ends, over.duration, bound) <= event_tolerance
        })
    }
}

/// Number of event indicators of a kink.
pub const INDICATORS_PER_KINK: usize = 3;

/// Value and next phase at the border that decides when a phase ends: the border with the largest value, or with the smallest one if the
/// phase ends past all borders.
fn deciding<L: Piecewise + ?Sized>(law: &L, phase: Phase, x: f64, at: impl Fn(Border) -> (Phase, f64)) -> Option<(Phase, f64)> {
    let all = law.ends_past_all_borders(phase);
    borders(law, phase, x).map(at).reduce(|one, other| if (other.1 >= one.1) != all { other } else { one })
}

/// Whether a phase persists, given which of its borders are provably not passed.
fn holds<L: Piecewise + ?Sized>(law: &L, phase: Phase, x: f64, is_kept: impl Fn(Border) -> bool) -> bool {
    let mut borders = borders(law, phase, x);
    if law.ends_past_all_borders(phase) { borders.any(is_kept) } else { borders.all(is_kept) }
}

/// Borders of a phase at x.
fn borders<L: Piecewise + ?Sized>(law: &L, phase: Phase, x: f64) -> impl Iterator<Item = Border> {
    (0..).map_while(move |index| law.border(phase, index, x))
}

/// Two levels of x at which a law changes its formula: below `lower`, between the levels, and above `upper`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Levels {
    /// Lower level, m or rad.
    pub lower: f64,
    /// Upper level, m or rad; `f64::MAX` if there is only one.
    pub upper: f64,
}

impl Piecewise for Levels {
    fn phase(&self, x: f64, _rate: f64) -> Phase {
        match (x < self.lower, x < self.upper) {
            (true, _) => Phase::Below,
            (false, true) => Phase::Within,
            (false, false) => Phase::Beyond,
        }
    }

    fn border(&self, phase: Phase, index: usize, _x: f64) -> Option<Border> {
        match (phase, index) {
            (Phase::Below, 0) => Some(Border::above(self.lower, Phase::Within)),
            (Phase::Within, 0) => Some(Border::above(self.upper, Phase::Beyond)),
            (Phase::Within, 1) => Some(Border::below(self.lower, Phase::Below)),
            (Phase::Beyond, 0) => Some(Border::below(self.upper, Phase::Within)),
            _ => None,
        }
    }

    fn width(&self) -> f64 {
        self.upper - self.lower
    }

    fn indicators(&self, x: f64, _rate: f64) -> [f64; INDICATORS_PER_KINK] {
        [x - self.lower, x - self.upper, 1.0]
    }
}

/// A stretch of a path, with bounds on the derivatives of x over it.
pub struct Stretch<'a> {
    /// Largest |∂x/∂θ| with respect to the angle of each link, m/rad or 1.
    pub arms: &'a [f64; LINKS],
    /// Bounds on the derivatives of the link angles.
    pub extremes: &'a Extremes,
    /// Duration, s.
    pub duration: f64,
}

impl Stretch<'_> {
    /// Bound on the derivative of x of order 1 to 4.
    fn bound(&self, order: usize) -> f64 {
        derivative_bound(self.arms, order, self.extremes)
    }
}

/// A kink of a force law at a state.
pub struct Kink<'a, L: Piecewise + ?Sized = dyn Piecewise + 'a> {
    /// Index in [`Mode`].
    pub place: usize,
    /// The law.
    pub law: &'a L,
    /// Its quantity x, m or rad.
    pub x: f64,
    /// Rate of x, m/s or rad/s.
    pub rate: f64,
    /// Largest |∂x/∂θ| with respect to the angle of each link, m/rad or 1.
    pub arms: &'a [f64; LINKS],
}

impl<'a, L: Piecewise + 'a> Kink<'a, L> {
    /// The kink without the type of its law.
    pub fn erased(self) -> Kink<'a> {
        let Self { place, law, x, rate, arms } = self;
        Kink { place, law, x, rate, arms }
    }
}

impl<L: Piecewise + ?Sized> Kink<'_, L> {
    /// Phase stored in the mode, otherwise the phase of the current state.
    pub fn phase(&self, mode: &Mode) -> Phase {
        mode.kinks[self.place].unwrap_or_else(|| self.law.phase(self.x, self.rate))
    }

    /// Largest change of x if all links turn by one radian, m/rad or 1.
    fn scale(&self) -> f64 {
        self.arms.iter().sum()
    }

    /// Event tolerance of x, m or rad, for an angular tolerance, rad. It is the smaller of the trajectory's error and a fraction of the
    /// law's width, but no less than round-off.
    fn event_tolerance(&self, tolerance: f64) -> f64 {
        /// Largest event tolerance as a fraction of the width: 1 % of a ramp does not affect the force visibly.
        const PART_OF_WIDTH: f64 = 0.01;
        /// Round-off of an angle, rad: a few hundred units in the last place of 1 rad.
        const ANGLE_ROUND_OFF: f64 = 1e-13;
        let scale = self.scale();
        (tolerance * scale).min(PART_OF_WIDTH * self.law.width()).max(ANGLE_ROUND_OFF * scale)
    }

    /// Whether the phase provably persists for `duration` seconds from this state. `tolerance` is the error of the link angles, rad.
    pub(super) fn is_out_of_reach(&self, mode: &Mode, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let over = Stretch { arms: self.arms, extremes, duration };
        self.law.is_out_of_reach(self.phase(mode), [self.x, self.rate], &over, tolerance * self.scale())
    }

    /// Whether the phase provably persists between this state and another state `duration` seconds later, within the event tolerance.
    pub(super) fn stays(&self, to: &Self, mode: &Mode, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let (ends, over) = ([self, to].map(|kink| [kink.x, kink.rate]), Stretch { arms: self.arms, extremes, duration });
        self.law.stays(self.phase(mode), ends, &over, self.event_tolerance(tolerance))
    }

    /// The phase past the border that decides when the current phase ends, and the value of that border in units of the event tolerance.
    pub(super) fn deciding(&self, mode: &Mode, tolerance: f64) -> (Phase, f64) {
        let (next, residual) = self.law.deciding(self.phase(mode), [self.x, self.rate]);
        (next, residual / self.event_tolerance(tolerance))
    }
}

/// Upper bound on a function between its end values x and y: the largest value of the parabola over the chord. `curvature_term` bounds the
/// second derivative times the square of the interval.
fn chord_bound([x, y]: [f64; 2], curvature_term: f64) -> f64 {
    let rise = y - x;
    if curvature_term <= 2.0 * rise.abs() {
        return x.max(y);
    }
    let part = 0.5 + rise / curvature_term;
    x + part * (rise + 0.5 * curvature_term * (1.0 - part))
}

/// Minimum on the interval from 0 to 1 of the cubic Hermite polynomial with these end values and end slopes.
fn cubic_minimum([x, y]: [f64; 2], [u, w]: [f64; 2]) -> f64 {
    let rise = y - x;
    // The cubic is x + τ (u + τ (b + c τ)); its extrema satisfy 3c τ² + 2b τ + u = 0.
    let (b, c) = (3.0 * rise - 2.0 * u - w, u + w - 2.0 * rise);
    let root = (b * b - 3.0 * c * u).max(0.0).sqrt();
    let at = |place: f64, scale: f64| {
        let part = if scale == 0.0 { 0.0 } else { (place / scale).clamp(0.0, 1.0) };
        x + part * (u + part * (b + c * part))
    };
    // Both roots are computed without cancellation.
    let sum = -b - root.copysign(b);
    x.min(y).min(at(sum, 3.0 * c)).min(at(u, sum))
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::*;
    use crate::hybrid::UnilateralSpring;

    /// From any phase the borders that a state has passed lead to the phase of that state, and there no border is passed.
    #[test]
    fn borders_lead_to_the_phase_of_the_state() {
        let spring = UnilateralSpring { stiffness: 50.0, damping: 0.02, width: 1e-3 };
        for law in [&spring as &dyn Piecewise, &Levels { lower: 0.0, upper: 1e-3 }] {
            for x in [-1.0, -1e-5, 1e-5, 9e-4, 1.1e-3, 1.0] {
                for rate in [-1e3, -0.1, 0.0, 0.1, 1e3] {
                    let wanted = law.phase(x, rate);
                    for mut phase in [Phase::Below, Phase::Within, Phase::Beyond] {
                        loop {
                            let (next, residual) = law.deciding(phase, [x, rate]);
                            if residual <= 0.0 {
                                break;
                            }
                            assert_ne!(phase, wanted, "{x} {rate}: {residual}");
                            phase = next;
                        }
                        assert_eq!(phase, wanted, "{x} {rate}");
                    }
                }
            }
        }
    }

    /// Dense samples of motions with known derivatives stay below all bounds, and most cubic bounds are tight. The motions are sums of
    /// oscillations with random frequencies; many pass a border and return between two ends that do not reveal the crossing.
    #[test]
    fn no_border_is_passed_beyond_the_bounds() {
        let mut random = ChaCha8Rng::seed_from_u64(14);
        let mut uniform = |low: f64, high: f64| low + (high - low) * ((random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64);
        let (mut hidden, mut looseness) = (0, Vec::new());
        for case in 0..4000 {
            let duration = 1e-3 * 100_f64.powf(uniform(-1.0, 0.5));
            let swings = [0, 1, 2].map(|_| [1e-3 * uniform(-1.0, 1.0), uniform(0.1, 4.0) / duration, uniform(0.0, 6.3)]);
            let sum = |order: u32, time: f64| -> f64 {
                let angle = |rate: f64, start: f64| rate * time + start + f64::from(order) * std::f64::consts::FRAC_PI_2;
                swings.iter().map(|&[size, rate, start]| size * rate.powi(order as i32) * angle(rate, start).sin()).sum()
            };
            // Every other motion passes the first border by 5 µm at its maximum.
            let samples: Vec<[f64; 2]> =
                (0..=500).map(|i| f64::from(i) / 500.0 * duration).map(|time| [sum(0, time), sum(1, time)]).collect();
            let top = samples.iter().map(|[x, _]| *x).fold(f64::NEG_INFINITY, f64::max);
            let middle = if case % 2 == 0 { uniform(-1e-3, 2e-3) } else { 5e-6 - top };
            let spring =
                UnilateralSpring { damping: if case % 3 == 0 { 0.0 } else { uniform(0.0, 0.5) }, stiffness: 50.0, width: 1e-3 };
            let at = |time: f64| [middle + sum(0, time), sum(1, time)];
            let bound = |order: usize| swings.iter().map(|[size, rate, _]| size.abs() * rate.powi(order as i32)).sum::<f64>();
            for law in [&spring as &dyn Piecewise, &Levels { lower: 0.0, upper: 1e-3 }] {
                for phase in [Phase::Below, Phase::Within, Phase::Beyond] {
                    let ends = [at(0.0), at(duration)];
                    let deciding = |value: &dyn Fn(Border) -> f64| {
                        let at = |border| (phase, value(border));
                        super::deciding(law, phase, ends[0][0], at).expect("every phase has a border").1
                    };
                    let residual = |end: [f64; 2]| deciding(&|border| border.residual(end));
                    let sampled = samples.iter().map(|[x, rate]| residual([middle + x, *rate])).fold(f64::NEG_INFINITY, f64::max);
                    let by_slope = deciding(&|border| border.bound_by_slope(ends, duration, bound));
                    let by_cubic = deciding(&|border| border.bound_by_cubic(ends, duration, bound));
                    let by_start = deciding(&|border| border.residual(ends[0]) + border.steepest(bound) * duration);
                    // Round-off of sums of a few millimetres.
                    assert!(
                        [by_slope, by_cubic, by_start].iter().all(|bound| sampled <= bound + 1e-15),
                        "{case} {phase:?}: {sampled:e} {by_slope:e} {by_cubic:e} {by_start:e}"
                    );
                    let quarters = [0.0, 0.25, 0.5, 0.75, 1.0].map(|part| residual(at(part * duration)));
                    hidden += u32::from(sampled > 1e-6 && quarters.into_iter().all(|residual| residual < 0.0));
                    looseness.push((by_cubic - sampled) / 1e-3);
                }
            }
        }
        assert!(hidden > 200, "only {hidden} crossings are hidden from the quarters of the way");
        looseness.sort_by(f64::total_cmp);
        assert!(
            looseness[looseness.len() / 2] < 0.5,
            "half of the bounds are loose by {} of a swing",
            looseness[looseness.len() / 2]
        );
    }
}
