//! Kinks of forces: where a formula changes, and on which side of each a motion is.
//!
//! A method that follows its error ends a step where its motion crosses a border, and begins the next behind it: within a step every
//! force is one smooth formula, and an order stays what it is. Which sides hold is for the method to remember ([`Mode`]); by
//! [`Mode::OF_STATE`], as all other methods have it, every formula is the one of the present state.
//!
//! Kinks are those of the one-sided springs of stops and contact, and the grips of dry friction that sticks (`stick_slip.rs`). Smooth friction
//! and servos have none.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};

use super::stick_slip::{FRICTION_PLACES, StickSlip, StickSlips};
use super::unilateral_spring::{Phase, PhaseBorder, UnilateralSpring, deepest};
use super::{Active, ForceContext};
use crate::mechanism::{ClosureBranch, LINKS};

/// One-sided springs: that of the contact, and two for each motor's stops.
pub(super) const SPRINGS: usize = 5;

/// Numbers that change sign where a motion passes a kink.
pub const INDICATORS: usize = 3 * SPRINGS;

/// Place of the contact among them.
pub(super) const CONTACT: usize = 0;

/// Places of the lower and the upper stop of the motors.
pub(super) const STOPS: [[usize; 2]; 2] = [[1, 2], [3, 4]];

/// On which side of their kinks forces are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub struct Mode {
    springs: [Option<Phase>; SPRINGS],
    /// What dry friction does.
    pub stick_slip: StickSlips,
    /// The branch of the closure, where it has several that meet.
    pub closure_branch: Option<ClosureBranch>,
}

impl Mode {
    /// Wherever the state is.
    pub const OF_STATE: Self = Self { springs: [None; SPRINGS], stick_slip: StickSlips::OPEN, closure_branch: None };

    /// Whether any spring pushes.
    pub fn has_active_contact(&self) -> bool {
        self.springs.iter().flatten().any(|phase| phase.pushes())
    }

    /// The same with other grips.
    pub fn with_stick_slip(self, stick_slip: StickSlips) -> Self {
        Self { stick_slip, ..self }
    }

    /// The same on another branch of the closure.
    pub fn with_closure_branch(self, closure_branch: Option<ClosureBranch>) -> Self {
        Self { closure_branch, ..self }
    }

    /// With these grips, and springs wherever the state is.
    pub fn of_stick_slip(stick_slip: StickSlips) -> Self {
        Self::OF_STATE.with_stick_slip(stick_slip)
    }
}

/// What the links do not exceed on a way.
#[derive(Clone, Copy, Debug)]
pub struct Extremes {
    /// Magnitudes of their rates, rad/s.
    pub rates: [f64; LINKS],
    /// Of their accelerations, rad/s².
    pub accelerations: [f64; LINKS],
    /// Of the first two derivatives of these, rad/s³ and rad/s⁴, where they are known.
    pub higher: Option<[[f64; LINKS]; 2]>,
}

/// A one-sided spring as it is now.
#[derive(Clone, Copy)]
pub(super) struct UnilateralGuard<'a> {
    /// Its place in [`Mode`].
    pub(super) place: usize,
    pub(super) spring: &'a UnilateralSpring,
    /// Penetration, m or rad.
    pub(super) depth: f64,
    /// Its rate.
    pub(super) rate: f64,
    /// By how much the penetration changes with the angle of each link at most, m or rad.
    pub(super) arms: &'a [f64; LINKS],
}

impl UnilateralGuard<'_> {
    /// Whether it neither pushes nor loses anything now.
    pub(super) fn is_idle(&self, at: &ForceContext) -> bool {
        at.mode.springs[self.place].map_or(self.depth <= 0.0, |phase| !phase.pushes())
    }

    /// N, N or N·m.
    pub(super) fn force(&self, at: &ForceContext) -> f64 {
        self.spring.force(self.phase(&at.mode), self.depth, self.rate)
    }

    /// ∂N/∂d and ∂N/∂ḋ.
    pub(super) fn slopes(&self, at: &ForceContext) -> [f64; 2] {
        self.spring.slopes(self.phase(&at.mode), self.depth, self.rate)
    }

    /// U, J.
    pub(super) fn potential(&self, at: &ForceContext) -> f64 {
        self.spring.potential(self.phase(&at.mode), self.depth)
    }

    /// Power lost, W; not what a spring that is known to have let go loses ([`GuardValues::separation_energy`]).
    pub(super) fn dissipation(&self, at: &ForceContext) -> f64 {
        self.spring.dissipation(self.phase(&at.mode), self.depth, self.rate)
    }

    /// The phase that holds.
    pub(super) fn phase(&self, mode: &Mode) -> Phase {
        mode.springs[self.place].unwrap_or_else(|| self.spring.phase(self.depth, self.rate))
    }

    /// What a motion may overlook at an angular tolerance, rad: its own error, or a part of the ramp, but no less than round-off.
    fn unit(&self, tolerance: f64) -> f64 {
        /// Part of a ramp that may be overlooked.
        const PART: f64 = 0.01;
        /// Round-off of an angle, rad.
        const ROUND_OFF: f64 = 1e-13;
        let scale: f64 = self.arms.iter().sum();
        (tolerance * scale).min(PART * self.spring.width).max(ROUND_OFF * scale)
    }

    /// The first two derivatives of the penetration at most.
    #[inline(never)]
    fn derivatives(&self, Extremes { rates, accelerations, .. }: &Extremes) -> [f64; 2] {
        let sum = |change: &dyn Fn(usize) -> f64| (0..LINKS).map(|link| self.arms[link] * change(link)).sum();
        [sum(&|link| rates[link]), sum(&|link| accelerations[link] + rates[link] * rates[link])]
    }

    /// The derivatives of order 2, 3 and 4.
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

    /// The greatest penetration that there can be on the way to another place, some seconds later, m or rad.
    fn deepest_over_step(&self, to: &Self, duration: f64, extremes: &Extremes) -> f64 {
        let [_, bend] = self.derivatives(extremes);
        deepest([self.depth, self.rate], [to.depth, to.rate], duration, bend)
    }

    /// Whether its phase certainly holds on the way to another place, some seconds later, but for what may be overlooked.
    fn stays(&self, to: &Self, mode: &Mode, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let (phase, unit) = (self.phase(mode), self.unit(tolerance));
        let ends = [self, to].map(|guard| [guard.depth, guard.rate]);
        // Most are far away, which takes little to see.
        let by_derivatives = || self.spring.farthest_by_derivatives(phase, ends, duration, self.derivatives(extremes)) <= unit;
        let by_cubic = |higher| self.spring.farthest_by_cubic(phase, ends, duration, self.higher(extremes, higher)) <= unit;
        by_derivatives() || extremes.higher.as_ref().is_some_and(by_cubic)
    }

    /// The border of the phase that holds that it is farthest beyond, in units of what may be overlooked.
    fn farthest(&self, mode: &Mode, tolerance: f64) -> Option<PhaseBorder> {
        let phase = self.phase(mode);
        let borders = self.spring.borders(phase, self.depth, self.rate).into_iter().flatten();
        let farthest = UnilateralSpring::farthest(phase, borders, |border| border.guard_residual);
        farthest.map(|border| border.per(self.unit(tolerance)))
    }
}

/// A grip as it is now, and how far it is from doing something else.
#[derive(Clone, Copy, Debug)]
pub struct FrictionGuard {
    /// Its place in [`StickSlips`].
    pub place: usize,
    /// Rate, rad/s or m/s.
    pub rate: f64,
    /// What it holds, and what it can hold, N·m or N; 0 while it does not.
    pub load: [f64; 2],
    /// By how much its rate changes with that of each link at most.
    pub arms: [f64; LINKS],
}

/// All grips that there are.
pub type FrictionGuards = ArrayVec<FrictionGuard, FRICTION_PLACES>;

/// The rate at which a grip rests, as far as a motion may overlook it at an angular tolerance, rad/s or m/s.
pub fn stick_velocity(tolerance: f64) -> f64 {
    /// A rate counts as the way that it makes in a tenth of a second: as in the error norm of the explicit method.
    const PER_ANGLE: f64 = 10.0;
    (PER_ANGLE * tolerance).clamp(1e-11, 1e-6)
}

impl FrictionGuard {
    /// How far it is beyond what it does, in units of what may be overlooked.
    fn guard_residual(&self, stick_slip: &StickSlips, tolerance: f64) -> f64 {
        match stick_slip.at(self.place) {
            StickSlip::Open => f64::NEG_INFINITY,
            StickSlip::Slips(direction) => -direction.sign() * self.rate / stick_velocity(tolerance),
            StickSlip::Holds(_) => {
                let [load, bound] = self.load;
                (load.abs() - bound) / (1e-7 * bound.abs() + 1e-12)
            }
        }
    }

    /// Whether it certainly does not turn on the way from here to another place, some seconds later: by how fast its rate changes, or by how
    /// far that may be from the chord.
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
        let bend = along(&|link| jerks[link] + rates[link] * (3.0 * accelerations[link] + rates[link] * rates[link]));
        from.min(to) - bend * duration * duration / 8.0 >= -stick_velocity(tolerance)
    }
}

/// The kinks of a scene as they are now.
pub struct GuardValues<'a> {
    springs: ArrayVec<UnilateralGuard<'a>, SPRINGS>,
    friction_guards: FrictionGuards,
}

impl<'a> GuardValues<'a> {
    /// Those of a state, with its grips.
    pub fn new(effects: &'a Active, at: &ForceContext, friction_guards: FrictionGuards) -> Self {
        Self { springs: effects.iter().flat_map(|effect| effect.guard_values(at)).collect(), friction_guards }
    }

    /// Whether the grips that there are are those that are remembered.
    pub fn are_known(&self, stick_slip: &StickSlips) -> bool {
        let there = |place: usize| self.friction_guards.iter().any(|friction_guard| friction_guard.place == place);
        (0..FRICTION_PLACES).all(|place| there(place) == (stick_slip.at(place) != StickSlip::Open))
    }

    /// The sides of the state by itself, without grips.
    pub fn mode(&self) -> Mode {
        let mut mode = Mode::OF_STATE;
        for guard in &self.springs {
            mode.springs[guard.place] = Some(guard.spring.phase(guard.depth, guard.rate));
        }
        mode
    }

    /// Numbers that change sign where a motion passes a kink; 1 of springs that are absent.
    pub fn indicators(&self) -> [f64; INDICATORS] {
        let mut indicators = [1.0; INDICATORS];
        for guard in &self.springs {
            indicators[3 * guard.place..][..3].copy_from_slice(&guard.spring.indicators(guard.depth, guard.rate));
        }
        indicators
    }

    /// Whether any grip holds while something moves.
    pub fn any_sticks_in_motion(&self, mode: &Mode) -> bool {
        !mode.stick_slip.at_rest() && self.held(mode).next().is_some()
    }

    /// What grips hold over what they can hold, in units of what may be overlooked: the most of all.
    pub fn holding_margin(&self, mode: &Mode, tolerance: f64) -> f64 {
        self.held(mode)
            .map(|friction_guard| friction_guard.guard_residual(&mode.stick_slip, tolerance))
            .fold(f64::NEG_INFINITY, f64::max)
    }

    /// The grips that hold.
    fn held(&self, mode: &Mode) -> impl Iterator<Item = &FrictionGuard> {
        self.friction_guards.iter().filter(|friction_guard| matches!(mode.stick_slip.at(friction_guard.place), StickSlip::Holds(_)))
    }

    /// How far the state is beyond the border that it is farthest beyond, in units of what may be overlooked at an angular tolerance, rad;
    /// negative on the near side of all.
    pub fn guard_residual(&self, mode: &Mode, tolerance: f64) -> f64 {
        let borders = self.springs.iter().filter_map(|guard| guard.farthest(mode, tolerance)).map(|border| border.guard_residual);
        let friction_guards =
            self.friction_guards.iter().map(|friction_guard| friction_guard.guard_residual(&mode.stick_slip, tolerance));
        borders.chain(friction_guards).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The potential of springs that have let go, J: what it loses is dissipated.
    #[inline(never)]
    pub fn separation_energy(&self, mode: &Mode) -> f64 {
        let free = self.springs.iter().filter(|guard| guard.depth > 0.0 && guard.phase(mode) == Phase::Free);
        free.map(|guard| guard.spring.potential(Phase::Free, guard.depth)).sum()
    }

    /// About how long the motion stays on the ramps on which it is, s.
    pub fn dwell_time(&self, mode: &Mode) -> f64 {
        let lasting = self.springs.iter().map(|guard| guard.spring.dwell_time(guard.phase(mode), guard.depth, guard.rate));
        lasting.fold(f64::INFINITY, f64::min)
    }

    /// The sides behind the borders of springs that the state is beyond, and behind the nearest one.
    pub fn next_mode(&self, mode: Mode, tolerance: f64) -> Mode {
        let nearest = self.guard_residual(&mode, tolerance).min(0.0);
        let mut next_mode = mode;
        for guard in &self.springs {
            if let Some(border) = guard.farthest(&mode, tolerance).filter(|border| border.guard_residual >= nearest) {
                next_mode.springs[guard.place] = Some(border.next_phase);
            }
        }
        next_mode
    }

    /// Whether springs stay in their phases, and what slips does not turn, on the way from one place to another some seconds later, but for
    /// what may be overlooked. What grips hold is not bounded.
    pub fn stay_in_phase(ends: [&Self; 2], mode: &Mode, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let [from, to] = ends;
        let mut friction_guards = from.friction_guards.iter().zip(&to.friction_guards);
        let mut springs = from.springs.iter().zip(&to.springs);
        friction_guards.all(|(from, to)| from.stays(to, &mode.stick_slip, duration, extremes, tolerance))
            && springs.all(|(from, to)| from.stays(to, mode, duration, extremes, tolerance))
    }

    /// Whether the ends of such a motion show how deep springs are touched on its way, for one who sees nothing else: by no more than half
    /// as much again, or than may be overlooked. Where both ends touch the way between is taken as the cubic through them.
    pub fn endpoints_bound_penetration(ends: [&Self; 2], duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        const DEEPER: f64 = 1.5;
        let [from, to] = ends;
        from.springs.iter().zip(&to.springs).all(|(from, to)| {
            let seen = from.depth.max(to.depth);
            let most = if from.depth > 0.0 && to.depth > 0.0 {
                (from.depth + to.depth) / 2.0 + duration * (from.rate - to.rate) / 8.0
            } else {
                from.deepest_over_step(to, duration, extremes)
            };
            most <= f64::max(DEEPER * seen, from.unit(tolerance))
        })
    }
}
