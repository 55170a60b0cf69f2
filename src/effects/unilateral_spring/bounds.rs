//! Upper bounds on the guard values of a unilateral spring between two states of a trajectory, so that no crossing between them is missed.
//!
//! Given values and slopes at both ends and bounds on higher derivatives, a function lies below two parabolas, below the parabola over its
//! chord, and within a remainder of the cubic Hermite polynomial.

use super::{Phase, PhaseGuard, UnilateralSpring};

impl UnilateralSpring {
    /// Upper bound on the guard value that ends a phase, m or rad, between two states `duration` seconds apart, each given by penetration
    /// and rate, from bounds on the first two derivatives of the penetration.
    #[inline(never)]
    pub(in crate::effects) fn residual_bound_by_derivatives(
        &self,
        phase: Phase,
        ends: [[f64; 2]; 2],
        duration: f64,
        [slope, curvature]: [f64; 2],
    ) -> f64 {
        let deciding = self.phase_guards_at(phase, ends).map(|[from, to]| {
            let [by_depth, by_rate] = from.by;
            if by_rate == 0.0 {
                let [u, w] = ends.map(|[_, rate]| by_depth * rate);
                parabola_bound([from.guard_residual, u], [to.guard_residual, w], duration, curvature)
            } else {
                // The value lies below both straight lines of the steepest slope.
                let steepest = by_depth.abs() * slope + by_rate.abs() * curvature;
                f64::max(from.guard_residual, to.guard_residual)
                    .max(0.5 * (from.guard_residual + to.guard_residual + steepest * duration))
            }
        });
        Self::deciding(phase, deciding, |guard_residual| *guard_residual).unwrap_or(f64::NEG_INFINITY)
    }

    /// Upper bound on the guard value that ends a phase, m or rad, from bounds on the derivatives of order 2, 3 and 4 of the penetration:
    /// the smaller of the bounds by the parabola over the chord and by the cubic Hermite polynomial. The remainders of the cubic are
    /// 1/384 (penetration) and √3/216 (rate) of the fourth derivative times the fourth and the third power of the duration.
    #[inline(never)]
    pub(in crate::effects) fn residual_bound_by_cubic(
        &self,
        phase: Phase,
        ends: [[f64; 2]; 2],
        duration: f64,
        [largest_curvature, third, fourth]: [f64; 3],
    ) -> f64 {
        /// Remainder constants of cubic Hermite interpolation, for the value and for the slope: 1/384 and √3/216.
        const OFF: [f64; 2] = [1.0 / 384.0, 0.008_018_753_738_744_79];
        let [[x, u], [y, w]] = ends;
        let mean = 3.0 * (y - x) / duration;
        let [curvature, end_curvature] = [mean - 2.0 * u - w, u + 2.0 * w - mean].map(|rise| 2.0 * rise / duration);
        let deciding = self.phase_guards_at(phase, ends).map(|[from, to]| {
            let [by_depth, by_rate] = from.by;
            let slopes = [by_depth * u + by_rate * curvature, by_depth * w + by_rate * end_curvature];
            let off = (OFF[0] * by_depth.abs() * duration + OFF[1] * by_rate.abs()) * fourth * duration * duration * duration;
            let cubic = off - cubic_minimum([-from.guard_residual, -to.guard_residual], slopes.map(|slope| -slope * duration));
            let curvature_term = (by_depth.abs() * largest_curvature + by_rate.abs() * third) * duration * duration;
            cubic.min(chord_bound([from.guard_residual, to.guard_residual], curvature_term))
        });
        Self::deciding(phase, deciding, |guard_residual| *guard_residual).unwrap_or(f64::NEG_INFINITY)
    }

    /// Each guard of a phase at both ends.
    fn phase_guards_at(&self, phase: Phase, ends: [[f64; 2]; 2]) -> impl Iterator<Item = [PhaseGuard; 2]> {
        let [from, to] = ends.map(|[depth, rate]| self.phase_guards(phase, depth, rate));
        from.into_iter().flatten().zip(to.into_iter().flatten()).map(|(from, to)| [from, to])
    }
}

/// Upper bound on a function between the ends of an interval, from values and slopes at the ends and the bound `curvature` on its second
/// derivative: the largest value below both parabolas.
#[inline(never)]
pub(in crate::effects) fn parabola_bound([x, u]: [f64; 2], [y, w]: [f64; 2], duration: f64, curvature: f64) -> f64 {
    let at = |start: f64, slope: f64, time: f64| start + time * (slope + curvature / 2.0 * time);
    // The parabolas differ by a linear function of time, which rises but for round-off; `meet` is its root.
    let rising = u - w + curvature * duration;
    let meet = if rising > 0.0 {
        ((y - x - w * duration + curvature / 2.0 * duration * duration) / rising).clamp(0.0, duration)
    } else {
        0.0
    };
    x.max(y).max(at(x, u, meet).max(at(y, -w, duration - meet)))
}

/// Upper bound on a function between the end values x and y, where `curvature_term` bounds its second derivative times the square of the interval:
/// the largest value of the parabola over the chord.
fn chord_bound([x, y]: [f64; 2], curvature_term: f64) -> f64 {
    let rise = y - x;
    if curvature_term <= 2.0 * rise.abs() {
        return x.max(y);
    }
    let part = 0.5 + rise / curvature_term;
    x + part * (rise + 0.5 * curvature_term * (1.0 - part))
}

/// Minimum of the cubic Hermite polynomial on the interval from 0 to 1 with these values and slopes at the ends.
#[inline(never)]
pub fn cubic_minimum([x, y]: [f64; 2], [u, w]: [f64; 2]) -> f64 {
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

    const SPRING: UnilateralSpring = UnilateralSpring { stiffness: 50.0, damping: 0.02, width: 1e-3 };

    /// A dense sampling of motions with known derivatives exceeds no bound, and most bounds by the cubic are tight: sums of oscillations of
    /// random frequencies, many of which pass a guard and return between two ends that do not show the crossing.
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
            // Every other motion passes the first guard by 5 µm at its maximum.
            let places = (0..=500).map(|i| f64::from(i) / 500.0 * duration);
            let top = places.clone().map(|time| sum(0, time)).fold(f64::NEG_INFINITY, f64::max);
            let middle = if case % 2 == 0 { uniform(-1e-3, 2e-3) } else { 5e-6 - top };
            let spring = UnilateralSpring { damping: if case % 3 == 0 { 0.0 } else { uniform(0.0, 0.5) }, ..SPRING };
            let at = |time: f64| [middle + sum(0, time), sum(1, time)];
            let most = |order: i32| swings.iter().map(|[size, rate, _]| size.abs() * rate.powi(order)).sum::<f64>();
            let [slope, curvature, third, fourth] = [1, 2, 3, 4].map(most);
            for phase in [Phase::Free, Phase::Ramp, Phase::Full] {
                let ends = [at(0.0), at(duration)];
                let guard_residual = |[depth, rate]: [f64; 2]| {
                    let phase_guards =
                        spring.phase_guards(phase, depth, rate).into_iter().flatten().map(|phase_guard| phase_guard.guard_residual);
                    UnilateralSpring::deciding(phase, phase_guards, |guard_residual| *guard_residual).expect("a border")
                };
                let sampled = places.clone().map(|time| guard_residual(at(time))).fold(f64::NEG_INFINITY, f64::max);
                let by_derivatives = spring.residual_bound_by_derivatives(phase, ends, duration, [slope, curvature]);
                let by_cubic = spring.residual_bound_by_cubic(phase, ends, duration, [curvature, third, fourth]);
                // Round-off of sums of some millimetres.
                assert!(
                    sampled <= by_derivatives + 1e-15 && sampled <= by_cubic + 1e-15,
                    "{case} {phase:?}: {sampled:e} {by_derivatives:e} {by_cubic:e}"
                );
                let quarters = [0.0, 0.25, 0.5, 0.75, 1.0].map(|part| guard_residual(at(part * duration)));
                hidden += u32::from(sampled > 1e-6 && quarters.into_iter().all(|guard_residual| guard_residual < 0.0));
                looseness.push((by_cubic - sampled) / 1e-3);
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
