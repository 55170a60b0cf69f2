//! Unilateral spring and damper: the reaction of a stop or a contact plane.
//!
//! ```text
//! N = max(0, s(d) (k d + c ḋ))      d the penetration, s = 6u⁵ − 15u⁴ + 10u³, u = min(d/width, 1)
//! ```
//!
//! The reaction never pulls. The ramp s (the "smootherstep" of Perlin, Improving Noise, 2002, and STEP5 of multibody packages) makes N
//! twice differentiable at d = 0; where max(0, ·) becomes 0, on fast separation, N has a kink. The potential is that of the spring
//! part, U = ∫ s k d dd; the rest of the power, (N − s k d) ḋ ≥ 0, is dissipated.
//! Phases are free, ramp and full; their guards are d = 0, d = width and k d + c ḋ = 0 (`bounds.rs` bounds them over a step).

mod bounds;

use borsh::{BorshDeserialize, BorshSerialize};

pub use bounds::cubic_minimum;
pub(super) use bounds::parabola_bound;

/// A unilateral spring and damper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UnilateralSpring {
    /// Stiffness k, N/m or N·m/rad.
    pub(super) stiffness: f64,
    /// Damping c, N·s/m or N·m·s/rad.
    pub(super) damping: f64,
    /// Penetration over which the ramp rises, m or rad.
    pub(super) width: f64,
}

/// Phase of a unilateral spring. In each phase N is one smooth formula, which extends smoothly past the guards of the phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub(super) enum Phase {
    /// No reaction, N = 0: no contact, or a separation so fast that the damper would have to pull.
    Free,
    /// Reaction on the ramp, 0 < d < width.
    Ramp,
    /// Reaction past the ramp, d ≥ width.
    Full,
}

/// A guard of a phase.
#[derive(Clone, Copy, Debug)]
pub(super) struct PhaseGuard {
    /// Guard value, m or rad: positive past the guard, negative where the phase holds.
    pub(super) guard_residual: f64,
    /// Derivatives of the guard value by penetration, 1, and by its rate, s.
    by: [f64; 2],
    /// The phase past the guard.
    pub(super) next_phase: Phase,
}

/// Time by which a rate counts as a displacement in the separation guard, s: the same as in the error norm of the error-controlled methods.
const RATE_TIME: f64 = 0.1;

impl PhaseGuard {
    /// A copy of the guard with its value in another unit.
    pub(super) fn in_units_of(self, unit: f64) -> Self {
        Self { guard_residual: self.guard_residual / unit, ..self }
    }
}

impl Phase {
    /// Whether the spring pushes.
    pub(super) fn pushes(self) -> bool {
        matches!(self, Self::Ramp | Self::Full)
    }
}

impl UnilateralSpring {
    /// The phase of a state: penetration, m or rad, and its rate, m/s or rad/s.
    pub(super) fn phase(&self, depth: f64, rate: f64) -> Phase {
        match (depth > 0.0 && self.push(depth, rate) > 0.0, depth < self.width) {
            (false, _) => Phase::Free,
            (true, true) => Phase::Ramp,
            (true, false) => Phase::Full,
        }
    }

    /// Guards of a phase: the phase ends where any of them is passed, or, for a free spring, where all of them are.
    pub(super) fn phase_guards(&self, phase: Phase, depth: f64, rate: f64) -> [Option<PhaseGuard>; 3] {
        let deeper = |than: f64, next_phase| Some(PhaseGuard { guard_residual: depth - than, by: [1.0, 0.0], next_phase });
        let shallower = |than: f64, next_phase| Some(PhaseGuard { guard_residual: than - depth, by: [-1.0, 0.0], next_phase });
        let push = |sign: f64, next_phase| {
            let by = [self.stiffness, self.damping].map(|by| sign * by / self.push_scale());
            // Without damping every contact pushes.
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

    /// The element that decides on the end of a phase: the largest guard value, or the smallest for a free spring.
    pub(super) fn deciding<T>(
        phase: Phase,
        phase_guards: impl Iterator<Item = T>,
        guard_residual: impl Fn(&T) -> f64,
    ) -> Option<T> {
        let all = phase == Phase::Free;
        phase_guards.reduce(|one, other| if (guard_residual(&other) >= guard_residual(&one)) != all { other } else { one })
    }

    /// Time to the end of a ramp at the present rate, s; infinite off the ramp. A step of that length does not evaluate the polynomial of
    /// the ramp far past its ends.
    pub(super) fn dwell_time(&self, phase: Phase, depth: f64, rate: f64) -> f64 {
        /// Least remaining part of the ramp, relative to its width: keeps the time from vanishing at the end of the ramp.
        const LEAST: f64 = 0.1;
        let ahead = match phase {
            Phase::Ramp if rate > 0.0 => self.width - depth,
            Phase::Ramp => depth,
            Phase::Free | Phase::Full => return f64::INFINITY,
        };
        if rate == 0.0 { f64::INFINITY } else { ahead.max(LEAST * self.width) / rate.abs() }
    }

    /// Event indicators of a spring, m or rad: penetration, penetration less the ramp's width, and the scaled push.
    pub(super) fn indicators(&self, depth: f64, rate: f64) -> [f64; 3] {
        [depth, depth - self.width, self.push_as_distance(depth, rate)]
    }

    /// Unramped push k d + c ḋ as a distance, m or rad.
    fn push_as_distance(&self, depth: f64, rate: f64) -> f64 {
        self.push(depth, rate) / self.push_scale()
    }

    /// Divisor that turns the unramped push into a distance, N/m or N·m/rad.
    fn push_scale(&self) -> f64 {
        (self.stiffness + self.damping / RATE_TIME).max(f64::MIN_POSITIVE)
    }

    /// Unramped push k d + c ḋ, N or N·m.
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

    /// Phase whose formula gives the elastic energy: it follows from the penetration alone, since a spring that has separated at a positive
    /// penetration still stores energy.
    fn strain_phase(&self, phase: Phase, depth: f64) -> Phase {
        match phase {
            Phase::Free if depth >= self.width => Phase::Full,
            Phase::Free if depth > 0.0 => Phase::Ramp,
            phase => phase,
        }
    }

    /// Reaction N, N or N·m.
    pub(super) fn force(&self, phase: Phase, depth: f64, rate: f64) -> f64 {
        if phase.pushes() { self.ramp(phase, depth)[0] * self.push(depth, rate) } else { 0.0 }
    }

    /// Derivatives ∂N/∂d, N/m or N·m/rad, and ∂N/∂ḋ, N·s/m or N·m·s/rad.
    pub(super) fn slopes(&self, phase: Phase, depth: f64, rate: f64) -> [f64; 2] {
        if !phase.pushes() {
            return [0.0; 2];
        }
        let [ramp, slope] = self.ramp(phase, depth);
        [slope * self.push(depth, rate) + ramp * self.stiffness, ramp * self.damping]
    }

    /// Potential U, J.
    pub(super) fn potential(&self, phase: Phase, depth: f64) -> f64 {
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

    /// Dissipated power, W; of a separated spring the loss of its elastic energy.
    pub(super) fn dissipation(&self, phase: Phase, depth: f64, rate: f64) -> f64 {
        (self.force(phase, depth, rate) - self.ramp(phase, depth)[0] * self.stiffness * depth) * rate
    }
}

/// Mean reaction of a unilateral spring and damper over a step.
pub(super) struct MeanReaction {
    /// Mean of N, N or N·m: times the increment of the penetration, it equals the gain of potential plus the dissipation, J.
    pub(super) force: f64,
    /// Derivative of the mean by the penetration at the step's end, N/m or N·m/rad.
    pub(super) slope: f64,
    /// Energy dissipated, J.
    pub(super) dissipated: f64,
}

impl UnilateralSpring {
    /// Mean reaction over a step of h seconds from a penetration `depth` with the increment `change`, m or rad. The damper takes the mean
    /// rate and the mean of the ramp.
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

    /// Mean of s k d over a step, (U(d₁) − U(d₀))/(d₁ − d₀) without cancellation, N or N·m, and its derivative by d₁, N/m or N·m/rad.
    /// Between the ends of the ramp both are polynomials that Gauss's rule with four points integrates exactly.
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
                // Round-off of the energies, and of the penetration over a long displacement.
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
        // The strain energy of a separated spring is dissipated while the penetration decreases.
        assert_eq!(SPRING.dissipation(Phase::Free, 0.1, -2.0), 2.0 * SPRING.stiffness * 0.1);
    }
}
