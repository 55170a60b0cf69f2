//! Unilateral spring and damper: the reaction of a stop or a contact plane.
//!
//! ```text
//! N = max(0, s(d) (k d + c ḋ))      d the penetration, s = 6u⁵ − 15u⁴ + 10u³, u = min(d/width, 1)
//! ```
//!
//! The reaction never pulls. The ramp s (the "smootherstep" of Perlin, Improving Noise, 2002, and STEP5 of multibody packages) makes N
//! twice differentiable at d = 0. On fast separation, when max(0, ·) becomes 0, N has a kink. The spring part has the potential
//! U = ∫ s k d dd; the remaining power, (N − s k d) ḋ ≥ 0, is dissipated. The phases are free, ramp and full; their borders are d = 0,
//! d = width and k d + c ḋ = 0.

use super::kink::{Border, INDICATORS_PER_KINK, Kink, Levels, Piecewise};
use super::mode::Mode;
use super::mode::Phase::{self, Below as Free, Beyond as Full, Within as Ramp};
use crate::integrator::ERROR_RATE;

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

impl Piecewise for UnilateralSpring {
    fn phase(&self, depth: f64, rate: f64) -> Phase {
        match (depth > 0.0 && self.push(depth, rate) > 0.0, depth < self.width) {
            (false, _) => Free,
            (true, true) => Ramp,
            (true, false) => Full,
        }
    }

    /// Besides the levels of the ramp there are borders of the push: a pushing spring separates when its push becomes negative, and a free
    /// spring pushes only if its push is positive. Without damping the push as a distance equals the penetration.
    fn border(&self, phase: Phase, index: usize, depth: f64) -> Option<Border> {
        let pushing = || if depth < self.width { Ramp } else { Full };
        match (phase, index) {
            (Free, 0) => Some(Border::above(0.0, pushing())),
            (Free, 1) => Some(self.push_border(1.0, pushing())),
            (Ramp, 2) | (Full, 1) => Some(self.push_border(-1.0, Free)),
            _ => Levels { lower: 0.0, upper: self.width }.border(phase, index, depth),
        }
    }

    fn ends_past_all_borders(&self, phase: Phase) -> bool {
        phase == Free
    }

    fn width(&self) -> f64 {
        self.width
    }

    /// Penetration, penetration minus the ramp's width, and the push as a distance.
    fn indicators(&self, depth: f64, rate: f64) -> [f64; INDICATORS_PER_KINK] {
        [depth, depth - self.width, self.push_as_distance(depth, rate)]
    }

    /// Time to the end of the ramp at the current rate. It bounds the step so that the ramp's polynomial is not evaluated far outside the
    /// ramp.
    fn dwell_time(&self, phase: Phase, depth: f64, rate: f64) -> f64 {
        /// Smallest remaining part of the ramp, relative to its width: keeps the time positive at the end of the ramp.
        const LEAST: f64 = 0.1;
        let ahead = match phase {
            Ramp if rate > 0.0 => self.width - depth,
            Ramp => depth,
            Free | Full => return f64::INFINITY,
        };
        if rate == 0.0 { f64::INFINITY } else { ahead.max(LEAST * self.width) / rate.abs() }
    }

    /// A spring that separated at a positive penetration dissipates its energy as it relaxes.
    fn separation_energy(&self, phase: Phase, depth: f64) -> f64 {
        if depth > 0.0 && phase == Free { self.potential(Free, depth) } else { 0.0 }
    }
}

impl UnilateralSpring {
    /// Border at which the push without ramp, k d + c ḋ, rises through 0 (`sign` 1) or falls through 0 (`sign` −1). Its value is scaled to
    /// a distance.
    fn push_border(&self, sign: f64, next: Phase) -> Border {
        Border { offset: 0.0, by_x: sign * self.stiffness, by_rate: sign * self.damping, scale: self.push_scale(), next }
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
            Free => [0.0, 0.0],
            Full => [1.0, 0.0],
            Ramp => {
                let u = depth / self.width;
                [u * u * u * (u * (6.0 * u - 15.0) + 10.0), 30.0 * u * u * (1.0 - u) * (1.0 - u) / self.width]
            }
        }
    }

    /// Phase whose formula gives the elastic energy. It follows only from the penetration, because a spring that separated at a positive
    /// penetration still stores energy.
    fn strain_phase(&self, phase: Phase, depth: f64) -> Phase {
        match phase {
            Free if depth >= self.width => Full,
            Free if depth > 0.0 => Ramp,
            phase => phase,
        }
    }

    /// Reaction N, N or N·m.
    pub fn force(&self, phase: Phase, depth: f64, rate: f64) -> f64 {
        if pushes(phase) { self.ramp(phase, depth)[0] * self.push(depth, rate) } else { 0.0 }
    }

    /// Derivatives ∂N/∂d, N/m or N·m/rad, and ∂N/∂ḋ, N·s/m or N·m·s/rad.
    pub fn slopes(&self, phase: Phase, depth: f64, rate: f64) -> [f64; 2] {
        if !pushes(phase) {
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
            Free => 0.0,
            Full => k * (width * width * RAMP + (depth * depth - width * width) / 2.0),
            Ramp => {
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

/// Whether a spring pushes in a phase.
fn pushes(phase: Phase) -> bool {
    phase != Free
}

impl Kink<'_, UnilateralSpring> {
    /// Whether the spring pushes.
    pub fn pushes(&self, mode: &Mode) -> bool {
        pushes(self.phase(mode))
    }

    /// Whether the spring neither pushes nor dissipates.
    pub fn is_idle(&self, mode: &Mode) -> bool {
        mode.kinks[self.place].map_or(self.x <= 0.0, |phase| !pushes(phase))
    }

    /// Normal force or torque N of the spring, N or N·m.
    pub fn force(&self, mode: &Mode) -> f64 {
        self.law.force(self.phase(mode), self.x, self.rate)
    }

    /// Derivatives ∂N/∂d, N/m or N·m/rad, and ∂N/∂ḋ, N·s/m or N·m·s/rad.
    pub fn slopes(&self, mode: &Mode) -> [f64; 2] {
        self.law.slopes(self.phase(mode), self.x, self.rate)
    }

    /// Potential U of the spring, J.
    pub fn potential(&self, mode: &Mode) -> f64 {
        self.law.potential(self.phase(mode), self.x)
    }

    /// Dissipated power, W. Force laws skip a spring with the stored phase free; its loss is the
    /// [`Piecewise::separation_energy`].
    pub fn dissipation(&self, mode: &Mode) -> f64 {
        self.law.dissipation(self.phase(mode), self.x, self.rate)
    }
}

#[cfg(test)]
mod tests {
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
        assert_eq!(SPRING.phase(0.1, -1e4), Free);
        assert_eq!(SPRING.force(Free, 0.1, -1e4), 0.0);
        // A separated spring dissipates its strain energy while the penetration decreases.
        assert_eq!(SPRING.dissipation(Free, 0.1, -2.0), 2.0 * SPRING.stiffness * 0.1);
    }
}
