//! Guards of force laws and the mode of a hybrid system.
//!
//! A guard is a function of the state whose zero separates two smooth branches of a force law. An error-controlled method ends its step
//! where the trajectory crosses a guard and begins the next step in the next mode: within a step every force is one smooth formula, so
//! the method keeps its order. The method stores the [`Mode`]; by [`Mode::OF_STATE`], as for all other methods, every formula is the one
//! of the present state. Guards belong to the unilateral springs of stops and contact (penetration, ramp, push) and to set-valued dry
//! friction (`stick_slip.rs`). Smooth friction and servos have none.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};

use super::Active;
use super::stick_slip::{FRICTION_PLACES, StickSlip, StickSlips};
use super::unilateral_spring::{Phase, PhaseGuard, UnilateralSpring, parabola_bound};
use super::wrench::Motion;
use crate::mechanism::{ClosureBranch, LINKS};

/// Number of unilateral springs: one of the contact, two stops on each motor axis.
pub(super) const SPRINGS: usize = 5;

/// Number of event indicators: three for each unilateral spring.
pub const INDICATORS: usize = 3 * SPRINGS;

/// Index of the contact among the unilateral springs.
pub(super) const CONTACT: usize = 0;

/// Indices of the lower and the upper stop of each motor among the unilateral springs.
pub(super) const STOPS: [[usize; 2]; 2] = [[1, 2], [3, 4]];

/// Mode of the hybrid system: phases of the springs, stick-slip states of friction, branch of the closure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub struct Mode {
    springs: [Option<Phase>; SPRINGS],
    /// Stick-slip state of every friction place.
    pub stick_slip: StickSlips,
    /// Branch of the closure; `None` away from the branches of a reducible closure (`closure_branch.rs`).
    pub closure_branch: Option<ClosureBranch>,
}

impl Mode {
    /// No stored mode: every force law takes the branch of the present state.
    pub const OF_STATE: Self = Self { springs: [None; SPRINGS], stick_slip: StickSlips::OPEN, closure_branch: None };

    /// Whether any spring pushes.
    pub fn has_active_contact(&self) -> bool {
        self.springs.iter().flatten().any(|phase| phase.pushes())
    }

    /// A copy of the mode with other stick-slip states.
    pub fn with_stick_slip(self, stick_slip: StickSlips) -> Self {
        Self { stick_slip, ..self }
    }

    /// A copy of the mode on another branch of the closure.
    pub fn with_closure_branch(self, closure_branch: Option<ClosureBranch>) -> Self {
        Self { closure_branch, ..self }
    }

    /// The mode with these stick-slip states, and springs in the phase of the present state.
    pub fn of_stick_slip(stick_slip: StickSlips) -> Self {
        Self::OF_STATE.with_stick_slip(stick_slip)
    }
}

/// Bounds on the derivatives of the link angles over a step.
#[derive(Clone, Copy, Debug)]
pub struct Extremes {
    /// Largest magnitudes of the rates, rad/s.
    pub rates: [f64; LINKS],
    /// Largest magnitudes of the accelerations, rad/s².
    pub accelerations: [f64; LINKS],
    /// Largest magnitudes of the third and the fourth derivative (jerk, snap), rad/s³ and rad/s⁴, where known.
    pub higher: Option<[[f64; LINKS]; 2]>,
}

/// A unilateral spring at a state, with the quantities of its guards.
#[derive(Clone, Copy)]
pub struct UnilateralGuard<'a> {
    /// Index in [`Mode`].
    pub(super) place: usize,
    pub(super) spring: &'a UnilateralSpring,
    /// Penetration, m or rad.
    pub(super) depth: f64,
    /// Rate of penetration, m/s or rad/s.
    pub(super) rate: f64,
    /// Lever arms: largest |∂d/∂θ| of the penetration by the angle of each link, m/rad or 1.
    pub(super) arms: &'a [f64; LINKS],
}

impl UnilateralGuard<'_> {
    /// Whether the spring neither pushes nor dissipates.
    pub(super) fn is_idle(&self, mode: &Mode) -> bool {
        mode.springs[self.place].map_or(self.depth <= 0.0, |phase| !phase.pushes())
    }

    /// Normal force or torque N of the spring, N or N·m.
    pub(super) fn force(&self, mode: &Mode) -> f64 {
        self.spring.force(self.phase(mode), self.depth, self.rate)
    }

    /// Derivatives ∂N/∂d, N/m or N·m/rad, and ∂N/∂ḋ, N·s/m or N·m·s/rad.
    pub(super) fn slopes(&self, mode: &Mode) -> [f64; 2] {
        self.spring.slopes(self.phase(mode), self.depth, self.rate)
    }

    /// Potential U of the spring, J.
    pub(super) fn potential(&self, mode: &Mode) -> f64 {
        self.spring.potential(self.phase(mode), self.depth)
    }

    /// Dissipated power, W; without the loss of a spring whose stored phase is separated ([`GuardValues::separation_energy`]).
    pub(super) fn dissipation(&self, mode: &Mode) -> f64 {
        self.spring.dissipation(self.phase(mode), self.depth, self.rate)
    }

    /// The phase by the mode, or else of the present state.
    pub(super) fn phase(&self, mode: &Mode) -> Phase {
        mode.springs[self.place].unwrap_or_else(|| self.spring.phase(self.depth, self.rate))
    }

    /// Event tolerance in penetration, m or rad, at an angular tolerance, rad: the error of the trajectory or a part of the ramp's width,
    /// the smaller, but no less than round-off.
    fn event_tolerance(&self, tolerance: f64) -> f64 {
        /// Largest event tolerance as a part of the ramp's width: 1 % of a ramp is below any effect on the force.
        const RAMP_PART: f64 = 0.01;
        /// Round-off of an angle, rad: some hundred units in the last place of 1 rad.
        const ANGLE_ROUND_OFF: f64 = 1e-13;
        let scale: f64 = self.arms.iter().sum();
        (tolerance * scale).min(RAMP_PART * self.spring.width).max(ANGLE_ROUND_OFF * scale)
    }

    /// Bounds on the first two derivatives of the penetration, m/s and m/s², or rad/s and rad/s².
    #[inline(never)]
    fn derivatives(&self, Extremes { rates, accelerations, .. }: &Extremes) -> [f64; 2] {
        let sum = |change: &dyn Fn(usize) -> f64| (0..LINKS).map(|link| self.arms[link] * change(link)).sum();
        [sum(&|link| rates[link]), sum(&|link| accelerations[link] + rates[link] * rates[link])]
    }

    /// Bounds on the derivatives of order 2, 3 and 4 of the penetration, m or rad over the power of s.
    #[inline(never)]
    fn higher(&self, extremes: &Extremes, [jerks, snaps]: &[[f64; LINKS]; 2]) -> [f64; 3] {
        let Extremes { rates, accelerations, .. } = extremes;
        let mut derivatives = [self.derivatives(extremes)[1], 0.0, 0.0];
        for (link, arm) in self.arms.iter().enumerate() {
            let (rate, acceleration) = (rates[link], accelerations[link]);
            let square = rate * rate;
            derivatives[1] += arm * (jerks[link] + rate * (3.0 * acceleration + square));
            derivatives[2] += arm
                * (snaps[link]
                    + 4.0 * rate * jerks[link]
                    + 3.0 * acceleration * acceleration
                    + square * (6.0 * acceleration + square));
        }
        derivatives
    }

    /// Upper bound on the penetration between this state and another state `duration` seconds later, m or rad.
    fn largest_penetration(&self, to: &Self, duration: f64, extremes: &Extremes) -> f64 {
        let [_, curvature] = self.derivatives(extremes);
        parabola_bound([self.depth, self.rate], [to.depth, to.rate], duration, curvature)
    }

    /// Whether the phase provably holds between this state and another state `duration` seconds later, to the event tolerance.
    fn stays(&self, to: &Self, mode: &Mode, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let (phase, event_tolerance) = (self.phase(mode), self.event_tolerance(tolerance));
        let ends = [self, to].map(|guard| [guard.depth, guard.rate]);
        // The cheaper bound decides most cases, in which the spring is far from its guards.
        let by_derivatives =
            || self.spring.residual_bound_by_derivatives(phase, ends, duration, self.derivatives(extremes)) <= event_tolerance;
        let by_cubic =
            |higher| self.spring.residual_bound_by_cubic(phase, ends, duration, self.higher(extremes, higher)) <= event_tolerance;
        by_derivatives() || extremes.higher.as_ref().is_some_and(by_cubic)
    }

    /// The guard of the current phase that decides on its end, with its residual in units of the event tolerance.
    fn deciding(&self, mode: &Mode, tolerance: f64) -> Option<PhaseGuard> {
        let phase = self.phase(mode);
        let phase_guards = self.spring.phase_guards(phase, self.depth, self.rate).into_iter().flatten();
        let deciding = UnilateralSpring::deciding(phase, phase_guards, |phase_guard| phase_guard.guard_residual);
        deciding.map(|phase_guard| phase_guard.in_units_of(self.event_tolerance(tolerance)))
    }
}

/// A friction place at a state, with its distance from the next transition between stick and slip.
#[derive(Clone, Copy, Debug)]
pub struct FrictionGuard {
    /// Index in [`StickSlips`].
    pub place: usize,
    /// Rate, rad/s or m/s.
    pub rate: f64,
    /// Friction torque or force while sticking, and its bound, N·m or N; 0 while slipping.
    pub load: [f64; 2],
    /// Lever arms: largest |∂w/∂θ̇| of the sliding rate by the rate of each link, 1 or m/rad.
    pub arms: [f64; LINKS],
}

/// Guards of all friction places that are active at a state.
pub type FrictionGuards = ArrayVec<FrictionGuard, FRICTION_PLACES>;

/// Sliding rate below which a friction place counts as at rest, rad/s or m/s, at an angular tolerance, rad.
pub fn stick_velocity(tolerance: f64) -> f64 {
    /// Rate per tolerated angle, 1/s: a rate counts as the displacement in 0.1 s, as in the error norm of the error-controlled methods.
    const PER_ANGLE: f64 = 10.0;
    (PER_ANGLE * tolerance).clamp(1e-11, 1e-6)
}

impl FrictionGuard {
    /// Guard value in units of the event tolerance, positive past the guard: reversed rate while slipping, load above its bound while
    /// sticking.
    fn guard_residual(&self, stick_slip: &StickSlips, tolerance: f64) -> f64 {
        match stick_slip.at(self.place) {
            StickSlip::Inactive | StickSlip::Still => f64::NEG_INFINITY,
            StickSlip::Slips(direction) => -direction.sign() * self.rate / stick_velocity(tolerance),
            StickSlip::Sticks(_) => {
                let [load, bound] = self.load;
                (load.abs() - bound) / (1e-7 * bound.abs() + 1e-12)
            }
        }
    }

    /// Whether the sliding rate provably keeps its sign between this state and another state `duration` seconds later: by the bound on the
    /// derivative of the rate, or on the distance of the rate from its chord.
    #[inline(never)]
    fn stays(
        &self,
        to: &Self,
        stick_slip: &StickSlips,
        duration: f64,
        Extremes { rates, accelerations, higher }: &Extremes,
        tolerance: f64,
    ) -> bool {
        let StickSlip::Slips(direction) = stick_slip.at(self.place) else { return true };
        let [from, to] = [self.rate, to.rate].map(|rate| direction.sign() * rate);
        let along = |of: &dyn Fn(usize) -> f64| (0..LINKS).map(|link| self.arms[link] * of(link)).sum::<f64>();
        let most = along(&|link| accelerations[link] + rates[link] * rates[link]);
        if from + to - most * duration >= -2.0 * stick_velocity(tolerance) {
            return true;
        }
        let Some([jerks, _]) = higher else { return false };
        let curvature = along(&|link| jerks[link] + rates[link] * (3.0 * accelerations[link] + rates[link] * rates[link]));
        from.min(to) - curvature * duration * duration / 8.0 >= -stick_velocity(tolerance)
    }
}

/// Guard values of a scene at a state.
pub struct GuardValues<'a> {
    springs: ArrayVec<UnilateralGuard<'a>, SPRINGS>,
    friction_guards: FrictionGuards,
}

impl<'a> GuardValues<'a> {
    /// Guard values of a state, given those of friction.
    pub fn new(effects: &'a Active, at: &Motion, friction_guards: FrictionGuards) -> Self {
        Self { springs: effects.iter().flat_map(|effect| effect.guard_values(at)).collect(), friction_guards }
    }

    /// Whether the active friction places are those of the stored stick-slip states.
    pub fn are_known(&self, stick_slip: &StickSlips) -> bool {
        let there = |place: usize| self.friction_guards.iter().any(|friction_guard| friction_guard.place == place);
        (0..FRICTION_PLACES).all(|place| there(place) == (stick_slip.at(place) != StickSlip::Inactive))
    }

    /// The mode of the present state, without friction.
    pub fn mode(&self) -> Mode {
        let mut mode = Mode::OF_STATE;
        for guard in &self.springs {
            mode.springs[guard.place] = Some(guard.spring.phase(guard.depth, guard.rate));
        }
        mode
    }

    /// Event indicators, m or rad, which change sign at a discontinuity of a force law; 1 for absent springs.
    pub fn indicators(&self) -> [f64; INDICATORS] {
        let mut indicators = [1.0; INDICATORS];
        for guard in &self.springs {
            indicators[3 * guard.place..][..3].copy_from_slice(&guard.spring.indicators(guard.depth, guard.rate));
        }
        indicators
    }

    /// Whether any friction place sticks while the mechanism moves.
    pub fn any_sticks_while_moving(&self, mode: &Mode) -> bool {
        !mode.stick_slip.at_rest() && self.sticking(mode).next().is_some()
    }

    /// Largest excess of a sticking load over its bound, in units of the event tolerance; −∞ where nothing sticks.
    pub fn breakaway_residual(&self, mode: &Mode, tolerance: f64) -> f64 {
        self.sticking(mode)
            .map(|friction_guard| friction_guard.guard_residual(&mode.stick_slip, tolerance))
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// The friction places that stick.
    fn sticking(&self, mode: &Mode) -> impl Iterator<Item = &FrictionGuard> {
        self.friction_guards
            .iter()
            .filter(|friction_guard| matches!(mode.stick_slip.at(friction_guard.place), StickSlip::Sticks(_)))
    }

    /// Largest guard value of a state in units of the event tolerance, at an angular tolerance, rad: positive past a guard, negative
    /// where the mode holds.
    pub fn guard_residual(&self, mode: &Mode, tolerance: f64) -> f64 {
        let phase_guards =
            self.springs.iter().filter_map(|guard| guard.deciding(mode, tolerance)).map(|phase_guard| phase_guard.guard_residual);
        let friction_guards =
            self.friction_guards.iter().map(|friction_guard| friction_guard.guard_residual(&mode.stick_slip, tolerance));
        phase_guards.chain(friction_guards).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Elastic energy still stored in springs that have separated, J; its decrease is dissipated.
    #[inline(never)]
    pub fn separation_energy(&self, mode: &Mode) -> f64 {
        let free = self.springs.iter().filter(|guard| guard.depth > 0.0 && guard.phase(mode) == Phase::Free);
        free.map(|guard| guard.spring.potential(Phase::Free, guard.depth)).sum()
    }

    /// Estimated time that springs on their ramps remain there, s.
    pub fn dwell_time(&self, mode: &Mode) -> f64 {
        let lasting = self.springs.iter().map(|guard| guard.spring.dwell_time(guard.phase(mode), guard.depth, guard.rate));
        lasting.fold(f64::INFINITY, f64::min)
    }

    /// The mode after the transitions of all springs whose guards the state has passed, or, where none is passed, of the nearest one.
    pub fn next_mode(&self, mode: Mode, tolerance: f64) -> Mode {
        let nearest = self.guard_residual(&mode, tolerance).min(0.0);
        let mut next_mode = mode;
        for guard in &self.springs {
            if let Some(phase_guard) = guard.deciding(&mode, tolerance).filter(|phase_guard| phase_guard.guard_residual >= nearest)
            {
                next_mode.springs[guard.place] = Some(phase_guard.next_phase);
            }
        }
        next_mode
    }

    /// Whether springs provably stay in their phases and slip keeps its direction between two states `duration` seconds apart, to the
    /// event tolerance at an angular tolerance, rad. Sticking loads have no such bound.
    pub fn stay_in_phase(ends: [&Self; 2], mode: &Mode, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let [from, to] = ends;
        let mut friction_guards = from.friction_guards.iter().zip(&to.friction_guards);
        let mut springs = from.springs.iter().zip(&to.springs);
        friction_guards.all(|(from, to)| from.stays(to, &mode.stick_slip, duration, extremes, tolerance))
            && springs.all(|(from, to)| from.stays(to, mode, duration, extremes, tolerance))
    }

    /// Whether the largest penetration over a step, for a method that evaluates its ends only, exceeds that of the ends by no more than
    /// half of it or by the event tolerance. Between two ends in contact the penetration is taken as the cubic Hermite polynomial.
    pub fn endpoints_bound_penetration(ends: [&Self; 2], duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        /// Largest allowed penetration over the penetration at the ends: the half more is within the accuracy of a step of this size.
        const LARGEST_EXCESS: f64 = 1.5;
        let [from, to] = ends;
        from.springs.iter().zip(&to.springs).all(|(from, to)| {
            let seen = from.depth.max(to.depth);
            let most = if from.depth > 0.0 && to.depth > 0.0 {
                (from.depth + to.depth) / 2.0 + duration * (from.rate - to.rate) / 8.0
            } else {
                from.largest_penetration(to, duration, extremes)
            };
            most <= f64::max(LARGEST_EXCESS * seen, from.event_tolerance(tolerance))
        })
    }
}
