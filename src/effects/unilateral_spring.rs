//! A one-sided spring and damper: what a stop and a contact push with.
//!
//! ```text
//! N = max(0, s(d) (k d + c ḋ))      d the penetration, s = 6u⁵ − 15u⁴ + 10u³, u = min(d/width, 1)
//! ```
//!
//! It never pulls. The ramp s (the "smootherstep" of Perlin, Improving Noise, 2002, and STEP5 of multibody packages) makes N twice
//! differentiable at d = 0; where max(0, ·) begins to act, on fast separation, N has a kink. The potential is that of the spring
//! part, U = ∫ s k d dd; the rest of the power, (N − s k d) ḋ ≥ 0, is dissipated.

mod bounds;

use borsh::{BorshDeserialize, BorshSerialize};

pub use bounds::cubic_minimum;
pub(super) use bounds::parabola_bound;

/// A one-sided spring and damper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UnilateralSpring {
    /// Stiffness k, N/m or N·m/rad.
    pub(super) stiffness: f64,
    /// Damping c, N·s/m or N·m·s/rad.
    pub(super) damping: f64,
    /// Penetration over which the ramp rises, m or rad.
    pub(super) width: f64,
}

/// Between which of its kinks a spring is. In each phase N is one smooth formula, which goes on smoothly beyond the phase's borders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub(super) enum Phase {
    /// Not pushing: it does not touch, or separates so fast that it would have to pull. N = 0.
    Free,
    /// On the ramp, pushing.
    Ramp,
    /// Beyond the ramp, pushing.
    Full,
}

/// A border of a phase.
#[derive(Clone, Copy, Debug)]
pub(super) struct PhaseGuard {
    /// How far beyond it, m or rad; negative on the near side.
    pub(super) guard_residual: f64,
    /// How that changes with penetration and rate.
    by: [f64; 2],
    /// The phase behind it.
    pub(super) next_phase: Phase,
}

/// For the border at which a spring lets go, a rate counts as the distance that it makes in this time, s: as in the error norm of the
/// explicit method.
const RATE_TIME: f64 = 0.1;

impl PhaseGuard {
    /// The same in other units.
    pub(super) fn in_units_of(self, unit: f64) -> Self {
        Self { guard_residual: self.guard_residual / unit, ..self }
    }
}

impl Phase {
    pub(super) fn pushes(self) -> bool {
        matches!(self, Self::Ramp | Self::Full)
    }
}

impl UnilateralSpring {
    /// The phase of a penetration, m or rad, and its rate by themselves.
    pub(super) fn phase(&self, depth: f64, rate: f64) -> Phase {
        match (depth > 0.0 && self.push(depth, rate) > 0.0, depth < self.width) {
            (false, _) => Phase::Free,
            (true, true) => Phase::Ramp,
            (true, false) => Phase::Full,
        }
    }

    /// Where a motion leaves a phase: where it is beyond any of these borders, or, if the spring is free, beyond all of them.
    pub(super) fn phase_guards(&self, phase: Phase, depth: f64, rate: f64) -> [Option<PhaseGuard>; 3] {
        let deeper = |than: f64, next_phase| Some(PhaseGuard { guard_residual: depth - than, by: [1.0, 0.0], next_phase });
        let shallower = |than: f64, next_phase| Some(PhaseGuard { guard_residual: than - depth, by: [-1.0, 0.0], next_phase });
        let push = |sign: f64, next_phase| {
            let by = [self.stiffness, self.damping].map(|by| sign * by / self.push_scale());
            // Without damping what touches pushes.
            (self.damping > 0.0).then(|| PhaseGuard { guard_residual: sign * self.push_as_distance(depth, rate), by, next_phase })
        };
        match phase {
            Phase::Free => {
                let next_phase = if depth < self.width { Phase::Ramp } else { Phase::Full };
                [deeper(0.0, next_phase), push(1.0, next_phase), None]
            }
            Phase::Ramp => [deeper(self.width, Phase::Full), shallower(0.0, Phase::Free), push(-1.0, Phase::Free)],
            Phase::Full => [None, shallower(self.width, Phase::Ramp), push(-1.0, Phase::Free)],
        }
    }

    /// What is farthest beyond the borders of a phase, by what each of them says.
    pub(super) fn deciding<T>(
        phase: Phase,
        phase_guards: impl Iterator<Item = T>,
        guard_residual: impl Fn(&T) -> f64,
    ) -> Option<T> {
        let all = phase == Phase::Free;
        phase_guards.reduce(|one, other| if (guard_residual(&other) >= guard_residual(&one)) != all { other } else { one })
    }

    /// How long a motion at this rate takes to the end of a ramp, on it or towards it, s. The formulas of a ramp are polynomials, of which
    /// nothing is asked far beyond its ends.
    pub(super) fn dwell_time(&self, phase: Phase, depth: f64, rate: f64) -> f64 {
        /// Least part of a ramp that lies ahead.
        const LEAST: f64 = 0.1;
        let ahead = match phase {
            Phase::Ramp if rate > 0.0 => self.width - depth,
            Phase::Ramp => depth,
            Phase::Free | Phase::Full => return f64::INFINITY,
        };
        if rate == 0.0 { f64::INFINITY } else { ahead.max(LEAST * self.width) / rate.abs() }
    }

    /// What changes sign where a motion that touches passes a kink: penetration, that beyond the ramp, and the push, m or rad.
    pub(super) fn indicators(&self, depth: f64, rate: f64) -> [f64; 3] {
        [depth, depth - self.width, self.push_as_distance(depth, rate)]
    }

    /// (k d + c ḋ) as a distance, m or rad.
    fn push_as_distance(&self, depth: f64, rate: f64) -> f64 {
        self.push(depth, rate) / self.push_scale()
    }

    /// What makes a distance of a push, N/m or N·m/rad.
    fn push_scale(&self) -> f64 {
        (self.stiffness + self.damping / RATE_TIME).max(f64::MIN_POSITIVE)
    }

    /// k d + c ḋ.
    fn push(&self, depth: f64, rate: f64) -> f64 {
        self.stiffness * depth + self.damping * rate
    }

    /// s and ds/dd.
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

    /// By which formula a spring is strained: one that has let go still is, where it is.
    fn strain_phase(&self, phase: Phase, depth: f64) -> Phase {
        match phase {
            Phase::Free if depth >= self.width => Phase::Full,
            Phase::Free if depth > 0.0 => Phase::Ramp,
            phase => phase,
        }
    }

    /// N.
    pub(super) fn force(&self, phase: Phase, depth: f64, rate: f64) -> f64 {
        if phase.pushes() { self.ramp(phase, depth)[0] * self.push(depth, rate) } else { 0.0 }
    }

    /// ∂N/∂d and ∂N/∂ḋ.
    pub(super) fn slopes(&self, phase: Phase, depth: f64, rate: f64) -> [f64; 2] {
        if !phase.pushes() {
            return [0.0; 2];
        }
        let [ramp, slope] = self.ramp(phase, depth);
        [slope * self.push(depth, rate) + ramp * self.stiffness, ramp * self.damping]
    }

    /// U, J.
    pub(super) fn potential(&self, phase: Phase, depth: f64) -> f64 {
        /// ∫ s u du over the ramp: 6/7 − 15/6 + 10/5.
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

    /// Power lost, W; of a spring that has let go what it has left.
    pub(super) fn dissipation(&self, phase: Phase, depth: f64, rate: f64) -> f64 {
        (self.force(phase, depth, rate) - self.ramp(phase, depth)[0] * self.stiffness * depth) * rate
    }
}

/// What a one-sided spring and damper push with over a step.
pub(super) struct MeanReaction {
    /// Mean of N, so that N times the change of the penetration is what the potential gains and what is dissipated.
    pub(super) force: f64,
    /// How it changes with the penetration at the end.
    pub(super) slope: f64,
    /// Energy dissipated, J.
    pub(super) dissipated: f64,
}

impl UnilateralSpring {
    /// From a penetration, m or rad, that changes by so much in h seconds. The damper follows the mean rate and the mean of the ramp.
    pub(super) fn mean_reaction(&self, depth: f64, change: f64, h: f64) -> MeanReaction {
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

    /// The mean of s k d, which is (U(d₁) − U(d₀))/(d₁ − d₀) without its cancellation, and its derivative with respect to d₁. Between the
    /// ends of the ramp both are polynomials that Gauss's rule with four points integrates exactly.
    fn mean_elastic(&self, depth: f64, change: f64) -> [f64; 2] {
        /// Places and weights on the interval from −1 to 1.
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

#[cfg(test)]
mod tests {
    use super::*;

    const SPRING: UnilateralSpring = UnilateralSpring { stiffness: 50.0, damping: 0.02, width: 1e-3 };

    /// Central differences; their error here is (step/width)² of the value, their round-off ε·value/step.
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

    /// The mean force times the displacement is the change of the potential, to its round-off; its slope is a derivative.
    #[test]
    fn the_mean_force_is_that_of_the_potential() {
        let spring = UnilateralSpring { damping: 0.0, ..SPRING };
        for depth in [-1.0, -1e-4, 1e-5, 3e-4, 9.9e-4, 1.5e-3, 0.1] {
            for end in [-1e-3, 2e-5, 4e-4, 1.1e-3, 0.05, 0.2] {
                let push = spring.mean_reaction(depth, end - depth, 1e-3);
                let potential = |depth: f64| spring.potential(spring.phase(depth, 0.0), depth);
                let gained = potential(end) - potential(depth);
                let scale = potential(end).max(potential(depth));
                // Round-off of the energies, and of the penetration on a long way.
                let force = |depth: f64| spring.force(spring.phase(depth, 0.0), depth, 0.0);
                let round_off = 1e-14 * scale + 1e-15 * (depth.abs() + end.abs()) * force(depth).max(force(end));
                assert!((push.force * (end - depth) - gained).abs() <= round_off, "{depth} {end}");
                assert_eq!(push.dissipated, 0.0);
                let step = 1e-7;
                let [more, less] = [step, -step].map(|x| SPRING.mean_reaction(depth, end - depth + x, 1e-3).force);
                let slope = SPRING.mean_reaction(depth, end - depth, 1e-3).slope;
                // Second differences of a ramp of 1 mrad: (step/width)² of the largest slope, some 100 N·m/rad.
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
        // What it is strained by then is lost on the way back.
        assert_eq!(SPRING.dissipation(Phase::Free, 0.1, -2.0), 2.0 * SPRING.stiffness * 0.1);
    }
}
