//! Unilateral spring and damper: the reaction of a stop or a contact plane.
//!
//! ```text
//! N = max(0, s(d) (k d + c ḋ))      d the penetration, s = 6u⁵ − 15u⁴ + 10u³, u = min(d/width, 1)
//! ```
//!
//! The reaction never pulls. The ramp s (the "smootherstep" of Perlin, Improving Noise, 2002, and STEP5 of multibody packages) makes N
//! twice differentiable at d = 0. On fast separation, when max(0, ·) becomes 0, N has a kink. The spring part has the potential
//! U = ∫ s k d dd; the remaining power, (N − s k d) ḋ ≥ 0, is dissipated. The phases are free, ramp and full; their guards are d = 0,
//! d = width and k d + c ḋ = 0.
//!
//! Upper bounds on the guard values between two states ensure that no crossing is missed. With values and slopes at both ends and bounds on
//! higher derivatives, a function lies below two straight lines, below the parabola over its chord, and within a remainder of the cubic
//! Hermite polynomial.

use super::mode::{Mode, Phase};
use super::{Extremes, derivative_bound};
use crate::integrator::ERROR_RATE;
use crate::mechanism::LINKS;

/// A unilateral spring and damper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnilateralSpring {
    /// Stiffness k, N/m or N·m/rad.
    pub stiffness: f64,
    /// Damping c, N·s/m or N·m·s/rad.
    pub damping: f64,
    /// Penetration over which the ramp rises, m or rad.
    pub width: f64,
}

/// A guard of a phase: a function of penetration and its rate, m or rad. It is negative in the phase and positive past the guard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PhaseGuard {
    /// Penetration: positive when the spring is touched.
    Touch,
    /// Negative penetration: positive when the ramp is left outwards.
    Release,
    /// Penetration minus the ramp's width: positive beyond the ramp.
    FullDepth,
    /// Width minus penetration: positive when the motion returns to the ramp.
    BackOnRamp,
    /// Push without ramp, as a distance.
    Push,
    /// Negative push without ramp, as a distance: positive when the spring separates.
    Pull,
}

impl Phase {
    /// Whether the spring pushes.
    pub fn pushes(self) -> bool {
        matches!(self, Self::Ramp | Self::Full)
    }

    /// The first guard of a phase and its other guards. The phase ends when any of them is passed; a free spring's phase ends when all are
    /// passed. Without damping the push as a distance is the penetration.
    fn guards(self) -> (PhaseGuard, &'static [PhaseGuard]) {
        match self {
            Self::Free => (PhaseGuard::Touch, &[PhaseGuard::Push]),
            Self::Ramp => (PhaseGuard::FullDepth, &[PhaseGuard::Release, PhaseGuard::Pull]),
            Self::Full => (PhaseGuard::BackOnRamp, &[PhaseGuard::Pull]),
        }
    }

    /// Whether a phase persists, given which of its guards are provably not passed.
    fn holds(self, is_kept: impl Fn(PhaseGuard) -> bool) -> bool {
        let (first, others) = self.guards();
        let mut others = others.iter().copied();
        if self == Self::Free { is_kept(first) || others.any(is_kept) } else { is_kept(first) && others.all(is_kept) }
    }
}

impl UnilateralSpring {
    /// Phase at a state: penetration, m or rad, and its rate, m/s or rad/s.
    pub fn phase(&self, depth: f64, rate: f64) -> Phase {
        match (depth > 0.0 && self.push(depth, rate) > 0.0, depth < self.width) {
            (false, _) => Phase::Free,
            (true, true) => Phase::Ramp,
            (true, false) => Phase::Full,
        }
    }

    /// Value of a guard, m or rad.
    fn guard_residual(&self, guard: PhaseGuard, [depth, rate]: [f64; 2]) -> f64 {
        match guard {
            PhaseGuard::Touch => depth,
            PhaseGuard::Release => -depth,
            PhaseGuard::FullDepth => depth - self.width,
            PhaseGuard::BackOnRamp => self.width - depth,
            PhaseGuard::Push => self.push_as_distance(depth, rate),
            PhaseGuard::Pull => -self.push_as_distance(depth, rate),
        }
    }

    /// Derivatives of a guard value with respect to penetration, 1, and to its rate, s.
    fn guard_slopes(&self, guard: PhaseGuard) -> [f64; 2] {
        match guard {
            PhaseGuard::Touch | PhaseGuard::FullDepth => [1.0, 0.0],
            PhaseGuard::Release | PhaseGuard::BackOnRamp => [-1.0, 0.0],
            PhaseGuard::Push => [self.stiffness, self.damping].map(|by| by / self.push_scale()),
            PhaseGuard::Pull => [self.stiffness, self.damping].map(|by| -by / self.push_scale()),
        }
    }

    /// The phase beyond a guard, at a penetration.
    pub(super) fn phase_past(&self, guard: PhaseGuard, depth: f64) -> Phase {
        match guard {
            PhaseGuard::Touch | PhaseGuard::Push if depth < self.width => Phase::Ramp,
            PhaseGuard::BackOnRamp => Phase::Ramp,
            PhaseGuard::Touch | PhaseGuard::Push | PhaseGuard::FullDepth => Phase::Full,
            PhaseGuard::Release | PhaseGuard::Pull => Phase::Free,
        }
    }

    /// The guard that decides when a phase ends, and its value: the largest value, or the smallest for a free spring.
    fn deciding(phase: Phase, value: impl Fn(PhaseGuard) -> f64) -> (PhaseGuard, f64) {
        let all = phase == Phase::Free;
        let (first, others) = phase.guards();
        others.iter().fold((first, value(first)), |one, guard| {
            let other = value(*guard);
            if (other >= one.1) != all { (*guard, other) } else { one }
        })
    }

    /// Time to the end of the ramp at the current rate, s; infinite off the ramp. A step of at most this length does not evaluate the
    /// ramp's polynomial far beyond its ends.
    pub(super) fn dwell_time(&self, phase: Phase, depth: f64, rate: f64) -> f64 {
        /// Smallest remaining part of the ramp, relative to its width: keeps the time positive at the end of the ramp.
        const LEAST: f64 = 0.1;
        let ahead = match phase {
            Phase::Ramp if rate > 0.0 => self.width - depth,
            Phase::Ramp => depth,
            Phase::Free | Phase::Full => return f64::INFINITY,
        };
        if rate == 0.0 { f64::INFINITY } else { ahead.max(LEAST * self.width) / rate.abs() }
    }

    /// Event indicators of a spring, m or rad: penetration, penetration minus the ramp's width, and the push as a distance.
    pub fn indicators(&self, depth: f64, rate: f64) -> [f64; 3] {
        [depth, depth - self.width, self.push_as_distance(depth, rate)]
    }

    /// Push without ramp, k d + c ḋ, as a distance, m or rad.
    fn push_as_distance(&self, depth: f64, rate: f64) -> f64 {
        self.push(depth, rate) / self.push_scale()
    }

    /// Divisor that converts the push without ramp to a distance, N/m or N·m/rad.
    fn push_scale(&self) -> f64 {
        (self.stiffness + self.damping * ERROR_RATE).max(f64::MIN_POSITIVE)
    }

    /// Push without ramp, k d + c ḋ, N or N·m.
    fn push(&self, depth: f64, rate: f64) -> f64 {
        self.stiffness * depth + self.damping * rate
    }

    /// Ramp s and its derivative ds/dd, 1/m or 1/rad.
    fn ramp(&self, phase: Phase, depth: f64) -> [f64; 2] {
        match self.strain_phase(phase, depth) {
            Phase::Free => [0.0, 0.0],
            Phase::Full => [1.0, 0.0],
            Phase::Ramp => {
                let u = depth / self.width;
                [u * u * u * (u * (6.0 * u - 15.0) + 10.0), 30.0 * u * u * (1.0 - u) * (1.0 - u) / self.width]
            }
        }
    }

    /// Phase whose formula gives the elastic energy. It follows only from the penetration, because a spring that separated at a positive
    /// penetration still stores energy.
    fn strain_phase(&self, phase: Phase, depth: f64) -> Phase {
        match phase {
            Phase::Free if depth >= self.width => Phase::Full,
            Phase::Free if depth > 0.0 => Phase::Ramp,
            phase => phase,
        }
    }

    /// Reaction N, N or N·m.
    pub fn force(&self, phase: Phase, depth: f64, rate: f64) -> f64 {
        if phase.pushes() { self.ramp(phase, depth)[0] * self.push(depth, rate) } else { 0.0 }
    }

    /// Derivatives ∂N/∂d, N/m or N·m/rad, and ∂N/∂ḋ, N·s/m or N·m·s/rad.
    pub fn slopes(&self, phase: Phase, depth: f64, rate: f64) -> [f64; 2] {
        if !phase.pushes() {
            return [0.0; 2];
        }
        let [ramp, slope] = self.ramp(phase, depth);
        [slope * self.push(depth, rate) + ramp * self.stiffness, ramp * self.damping]
    }

    /// Potential U, J.
    pub fn potential(&self, phase: Phase, depth: f64) -> f64 {
        /// Integral ∫ s u du over the ramp: 6/7 − 15/6 + 10/5.
        const RAMP: f64 = 5.0 / 14.0;
        let Self { stiffness: k, width, .. } = *self;
        match self.strain_phase(phase, depth) {
            Phase::Free => 0.0,
            Phase::Full => k * (width * width * RAMP + (depth * depth - width * width) / 2.0),
            Phase::Ramp => {
                let u = depth / width;
                k * width * width * (u * u * u * u * u) * (u * (6.0 / 7.0 * u - 2.5) + 2.0)
            }
        }
    }

    /// Dissipated power, W. A separated spring dissipates its elastic energy.
    pub fn dissipation(&self, phase: Phase, depth: f64, rate: f64) -> f64 {
        (self.force(phase, depth, rate) - self.ramp(phase, depth)[0] * self.stiffness * depth) * rate
    }
}

/// Mean reaction of a unilateral spring and damper over a step.
pub struct MeanReaction {
    /// Mean of N, N or N·m. Its product with the increment of penetration is the gain of potential plus the dissipation, J.
    pub force: f64,
    /// Derivative of the mean with respect to the penetration at the step's end, N/m or N·m/rad.
    pub slope: f64,
    /// Energy dissipated, J.
    pub dissipated: f64,
}

impl UnilateralSpring {
    /// Mean reaction over a step of h seconds that starts at penetration `depth` and adds `change`, m or rad. The damper uses the mean rate
    /// and the mean ramp.
    pub fn mean_reaction(&self, depth: f64, change: f64, h: f64) -> MeanReaction {
        let end = depth + change;
        if depth <= 0.0 && end <= 0.0 {
            return MeanReaction { force: 0.0, slope: 0.0, dissipated: 0.0 };
        }
        let [elastic, stiffness] = self.mean_elastic(depth, change);
        let ramp = |depth: f64| self.ramp(self.phase(depth, 0.0), depth);
        let ([from, _], [to, slope]) = (ramp(depth), ramp(end));
        let damping = self.damping / h;
        let drag = 0.5 * (from + to) * damping * change;
        if elastic + drag <= 0.0 {
            return MeanReaction { force: 0.0, slope: 0.0, dissipated: -elastic * change };
        }
        let slope = stiffness + 0.5 * damping * (from + to + slope * change);
        MeanReaction { force: elastic + drag, slope, dissipated: drag * change }
    }

    /// Mean of s k d over a step, N or N·m: (U(d₁) − U(d₀))/(d₁ − d₀) without cancellation. Also its derivative with respect to d₁, N/m or
    /// N·m/rad. Between the ends of the ramp both are polynomials, which Gauss's rule with four points integrates exactly.
    fn mean_elastic(&self, depth: f64, change: f64) -> [f64; 2] {
        /// Abscissas and weights of Gauss's rule with four points on the interval from −1 to 1.
        const GAUSS: [[f64; 2]; 4] = [
            [-0.861_136_311_594_052_6, 0.347_854_845_137_453_85],
            [-0.339_981_043_584_856_26, 0.652_145_154_862_546_2],
            [0.339_981_043_584_856_26, 0.652_145_154_862_546_2],
            [0.861_136_311_594_052_6, 0.347_854_845_137_453_85],
        ];
        let cut = |level: f64| if change == 0.0 { 0.0 } else { ((level - depth) / change).clamp(0.0, 1.0) };
        let (a, b) = (cut(0.0), cut(self.width));
        let (mut mean, mut slope) = (0.0, 0.0);
        for [from, to] in [[0.0, a.min(b)], [a.min(b), a.max(b)], [a.max(b), 1.0]] {
            let half = 0.5 * (to - from);
            for [place, weight] in GAUSS {
                let part = from + half * (1.0 + place);
                let x = depth + part * change;
                if half > 0.0 && x > 0.0 {
                    let [ramp, rise] = self.ramp(self.phase(x, 0.0), x);
                    mean += half * weight * ramp * self.stiffness * x;
                    slope += half * weight * part * self.stiffness * (ramp + rise * x);
                }
            }
        }
        [mean, slope]
    }
}

/// A unilateral spring at a state, with the quantities that its guards need.
#[derive(Clone, Copy)]
pub struct UnilateralGuard<'a> {
    /// Index in [`Mode`].
    pub place: usize,
    /// The spring.
    pub spring: &'a UnilateralSpring,
    /// Penetration, m or rad.
    pub depth: f64,
    /// Rate of penetration, m/s or rad/s.
    pub rate: f64,
    /// Largest |∂d/∂θ| of the penetration with respect to the angle of each link, m/rad or 1.
    pub arms: &'a [f64; LINKS],
}

impl UnilateralGuard<'_> {
    /// Whether the spring neither pushes nor dissipates.
    pub fn is_idle(&self, mode: &Mode) -> bool {
        mode.springs[self.place].map_or(self.depth <= 0.0, |phase| !phase.pushes())
    }

    /// Normal force or torque N of the spring, N or N·m.
    pub fn force(&self, mode: &Mode) -> f64 {
        self.spring.force(self.phase(mode), self.depth, self.rate)
    }

    /// Derivatives ∂N/∂d, N/m or N·m/rad, and ∂N/∂ḋ, N·s/m or N·m·s/rad.
    pub fn slopes(&self, mode: &Mode) -> [f64; 2] {
        self.spring.slopes(self.phase(mode), self.depth, self.rate)
    }

    /// Potential U of the spring, J.
    pub fn potential(&self, mode: &Mode) -> f64 {
        self.spring.potential(self.phase(mode), self.depth)
    }

    /// Dissipated power, W. Force laws skip a spring with the stored phase free; its loss is the
    /// [`separation_energy`](crate::integrator::Guards::separation_energy).
    pub fn dissipation(&self, mode: &Mode) -> f64 {
        self.spring.dissipation(self.phase(mode), self.depth, self.rate)
    }

    /// Phase stored in the mode, otherwise the phase of the current state.
    pub fn phase(&self, mode: &Mode) -> Phase {
        mode.springs[self.place].unwrap_or_else(|| self.spring.phase(self.depth, self.rate))
    }

    /// Largest change of penetration if all links turn by one radian, m/rad or 1.
    fn scale(&self) -> f64 {
        self.arms.iter().sum()
    }

    /// Event tolerance of the penetration, m or rad, for an angular tolerance, rad. It is the smaller of the trajectory's error and a
    /// fraction of the ramp's width, but no less than round-off.
    fn event_tolerance(&self, tolerance: f64) -> f64 {
        /// Largest event tolerance as a fraction of the ramp's width: 1 % of a ramp does not affect the force visibly.
        const RAMP_PART: f64 = 0.01;
        /// Round-off of an angle, rad: a few hundred units in the last place of 1 rad.
        const ANGLE_ROUND_OFF: f64 = 1e-13;
        let scale = self.scale();
        (tolerance * scale).min(RAMP_PART * self.spring.width).max(ANGLE_ROUND_OFF * scale)
    }

    /// Whether the phase provably persists for `duration` seconds from this state, whatever the end state is. Each guard must be farther
    /// away than the penetration can change in that time plus the error of the motion, which follows from the angular tolerance, rad.
    pub(super) fn is_out_of_reach(&self, mode: &Mode, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let bound = |order: usize| derivative_bound(self.arms, order, extremes);
        self.phase(mode).holds(|guard| {
            let guard_residual = self.spring.guard_residual(guard, [self.depth, self.rate]);
            guard_residual + self.spring.steepest(guard, bound) * duration <= -tolerance * self.scale()
        })
    }

    /// Whether the phase provably persists between this state and another state `duration` seconds later, within the event tolerance.
    pub(super) fn stays(&self, to: &Self, mode: &Mode, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let event_tolerance = self.event_tolerance(tolerance);
        let ends = [self, to].map(|guard| [guard.depth, guard.rate]);
        let bound = |order: usize| derivative_bound(self.arms, order, extremes);
        // The cheaper bound decides in most cases, because the spring is usually far from its guards.
        self.phase(mode).holds(|guard| {
            self.spring.bound_by_slope(guard, ends, duration, bound) <= event_tolerance
                || self.spring.bound_by_cubic(guard, ends, duration, bound) <= event_tolerance
        })
    }

    /// The guard that decides when the current phase ends, and its value in units of the event tolerance.
    pub(super) fn deciding(&self, mode: &Mode, tolerance: f64) -> (PhaseGuard, f64) {
        let guard_residual = |guard| self.spring.guard_residual(guard, [self.depth, self.rate]);
        let (guard, guard_residual) = UnilateralSpring::deciding(self.phase(mode), guard_residual);
        (guard, guard_residual / self.event_tolerance(tolerance))
    }
}

impl UnilateralSpring {
    /// Bound on the derivative of a guard value, m/s or rad/s, from bounds on the first two derivatives of the penetration.
    fn steepest(&self, guard: PhaseGuard, bound: impl Fn(usize) -> f64) -> f64 {
        let [by_depth, by_rate] = self.guard_slopes(guard);
        by_depth.abs() * bound(1) + if by_rate == 0.0 { 0.0 } else { by_rate.abs() * bound(2) }
    }

    /// Upper bound on a guard value, m or rad, between two states `duration` seconds apart, each given by penetration and rate. The value
    /// lies below two straight lines with the steepest slope, one through each end.
    fn bound_by_slope(&self, guard: PhaseGuard, ends: [[f64; 2]; 2], duration: f64, bound: impl Fn(usize) -> f64) -> f64 {
        let [from, to] = ends.map(|end| self.guard_residual(guard, end));
        from.max(to).max(0.5 * (from + to + self.steepest(guard, bound) * duration))
    }

    /// Upper bound on a guard value, m or rad, from bounds on the second, third and fourth derivative of the penetration: the smaller of
    /// the bounds from the parabola over the chord and from the cubic Hermite polynomial. The remainder of the cubic is 1/384 (penetration)
    /// and √3/216 (rate) of the fourth derivative, times the fourth and the third power of the duration.
    fn bound_by_cubic(&self, guard: PhaseGuard, ends: [[f64; 2]; 2], duration: f64, bound: impl Fn(usize) -> f64) -> f64 {
        /// Remainder constants of cubic Hermite interpolation, for the value and for the slope: 1/384 and √3/216.
        const OFF: [f64; 2] = [1.0 / 384.0, 0.008_018_753_738_744_79];
        let [[x, u], [y, w]] = ends;
        let mean = 3.0 * (y - x) / duration;
        let [curvature, end_curvature] = [mean - 2.0 * u - w, u + 2.0 * w - mean].map(|rise| 2.0 * rise / duration);
        let [from, to] = ends.map(|end| self.guard_residual(guard, end));
        let [by_depth, by_rate] = self.guard_slopes(guard);
        let slopes = [by_depth * u + by_rate * curvature, by_depth * w + by_rate * end_curvature];
        let off = (OFF[0] * by_depth.abs() * duration + OFF[1] * by_rate.abs()) * bound(4) * duration * duration * duration;
        let cubic = off - cubic_minimum([-from, -to], slopes.map(|slope| -slope * duration));
        let curvature_term = (by_depth.abs() * bound(2) + by_rate.abs() * bound(3)) * duration * duration;
        cubic.min(chord_bound([from, to], curvature_term))
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

    const SPRING: UnilateralSpring = UnilateralSpring { stiffness: 50.0, damping: 0.02, width: 1e-3 };

    /// Central differences have an error of (step/width)² of the value and a round-off of ε·value/step.
    #[test]
    fn slopes_and_potential_are_derivatives() {
        let step = 1e-8;
        for depth in [1e-5, 3e-4, 7e-4, 9.9e-4, 1.5e-3, 0.1] {
            for rate in [-0.5, 0.0, 2.0] {
                let phase = SPRING.phase(depth, rate);
                let [by_depth, by_rate] = SPRING.slopes(phase, depth, rate);
                let difference = |at: &dyn Fn(f64) -> f64| (at(step) - at(-step)) / (2.0 * step);
                let numeric =
                    [difference(&|x| SPRING.force(phase, depth + x, rate)), difference(&|x| SPRING.force(phase, depth, rate + x))];
                assert!((by_depth - numeric[0]).abs() < 1e-5 * (1.0 + by_depth.abs()), "{depth} {rate}: {by_depth} {numeric:?}");
                assert!((by_rate - numeric[1]).abs() < 1e-6, "{depth} {rate}: {by_rate} {numeric:?}");
            }
            let spring = UnilateralSpring { damping: 0.0, ..SPRING };
            let phase = spring.phase(depth, 0.0);
            let numeric = (spring.potential(phase, depth + step) - spring.potential(phase, depth - step)) / (2.0 * step);
            assert!((spring.force(phase, depth, 0.0) - numeric).abs() < 1e-6 * (1.0 + numeric), "{depth}: {numeric}");
        }
    }

    /// The mean force times the displacement is the change of the potential, within its round-off; its slope is a derivative.
    #[test]
    fn the_mean_force_follows_from_the_potential() {
        let spring = UnilateralSpring { damping: 0.0, ..SPRING };
        for depth in [-1.0, -1e-4, 1e-5, 3e-4, 9.9e-4, 1.5e-3, 0.1] {
            for end in [-1e-3, 2e-5, 4e-4, 1.1e-3, 0.05, 0.2] {
                let push = spring.mean_reaction(depth, end - depth, 1e-3);
                let potential = |depth: f64| spring.potential(spring.phase(depth, 0.0), depth);
                let gained = potential(end) - potential(depth);
                let scale = potential(end).max(potential(depth));
                // Round-off of the energies, and of the penetration over a long displacement.
                let force = |depth: f64| spring.force(spring.phase(depth, 0.0), depth, 0.0);
                let round_off = 1e-14 * scale + 1e-15 * (depth.abs() + end.abs()) * force(depth).max(force(end));
                assert!((push.force * (end - depth) - gained).abs() <= round_off, "{depth} {end}");
                assert_eq!(push.dissipated, 0.0);
                let step = 1e-7;
                let [more, less] = [step, -step].map(|x| SPRING.mean_reaction(depth, end - depth + x, 1e-3).force);
                let slope = SPRING.mean_reaction(depth, end - depth, 1e-3).slope;
                // Second differences on a ramp of 1 mrad: (step/width)² of the largest slope, about 100 N·m/rad.
                assert!(((more - less) / (2.0 * step) - slope).abs() <= 1e-4 * (1.0 + slope.abs()), "{depth} {end}: {slope}");
            }
        }
        for (depth, change) in [(0.1, -0.2), (-0.1, 0.2), (2e-3, 1e-3), (5e-4, -1e-5)] {
            let push = SPRING.mean_reaction(depth, change, 1e-4);
            assert!(push.force >= 0.0 && push.dissipated >= 0.0, "{depth} {change}");
        }
    }

    #[test]
    fn it_never_pulls_and_never_gives_energy() {
        for depth in [-1.0, 0.0, 1e-4, 1e-3, 0.2] {
            for rate in [-1e4, -1.0, 0.0, 1.0, 1e4] {
                let phase = SPRING.phase(depth, rate);
                assert!(SPRING.force(phase, depth, rate) >= 0.0 && SPRING.dissipation(phase, depth, rate) >= 0.0, "{depth} {rate}");
            }
        }
        assert_eq!(SPRING.phase(0.1, -1e4), Phase::Free);
        assert_eq!(SPRING.force(Phase::Free, 0.1, -1e4), 0.0);
        // A separated spring dissipates its strain energy while the penetration decreases.
        assert_eq!(SPRING.dissipation(Phase::Free, 0.1, -2.0), 2.0 * SPRING.stiffness * 0.1);
    }

    /// Dense samples of motions with known derivatives stay below all bounds, and most cubic bounds are tight. The motions are sums of
    /// oscillations with random frequencies; many pass a guard and return between two ends that do not show the crossing.
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
            let bound = |order: usize| swings.iter().map(|[size, rate, _]| size.abs() * rate.powi(order as i32)).sum::<f64>();
            for phase in [Phase::Free, Phase::Ramp, Phase::Full] {
                let ends = [at(0.0), at(duration)];
                let deciding = |value: &dyn Fn(PhaseGuard) -> f64| UnilateralSpring::deciding(phase, value).1;
                let guard_residual = |end: [f64; 2]| deciding(&|guard| spring.guard_residual(guard, end));
                let sampled = places.clone().map(|time| guard_residual(at(time))).fold(f64::NEG_INFINITY, f64::max);
                let by_slope = deciding(&|guard| spring.bound_by_slope(guard, ends, duration, bound));
                let by_cubic = deciding(&|guard| spring.bound_by_cubic(guard, ends, duration, bound));
                let by_start = deciding(&|guard| spring.guard_residual(guard, ends[0]) + spring.steepest(guard, bound) * duration);
                // Round-off of sums of a few millimetres.
                assert!(
                    [by_slope, by_cubic, by_start].iter().all(|bound| sampled <= bound + 1e-15),
                    "{case} {phase:?}: {sampled:e} {by_slope:e} {by_cubic:e} {by_start:e}"
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
