//! Event interface ([`Events`]) of the five-bar, in the link angles and in the twelve coordinates: guards, modes and transitions.

use std::borrow::Borrow;

use super::angles::{ANGLES, AngleSystem, Angles, DISTAL, LINK_INDICES, PROXIMAL};
use super::five_bar::FiveBar;
use super::stick_slip::{friction_guards, resolved, reverses_between};
use crate::effects::{self, FrictionGuards, GuardValues, Mode, StickSlips, stick_velocity};
use crate::integrator::{Events, Extremes, System};
use crate::mechanism::coordinates::{D_THETA, P_THETA, THETA, legs_of};
use crate::mechanism::{COORDINATES, ClosureBranch, Coordinates, LINKS, Pose};
use crate::vector::Vector;

/// A system in a mode: borrowed where modes do not matter, which saves a copy per step.
enum InMode<'b, S> {
    Same(&'b S),
    Others(S),
}

impl<S> Borrow<S> for InMode<'_, S> {
    #[inline(always)]
    fn borrow(&self) -> &S {
        match self {
            Self::Same(system) => system,
            Self::Others(system) => system,
        }
    }
}

impl<'a> Events<ANGLES> for AngleSystem<'a> {
    type Mode = Mode;
    type GuardValues = GuardValues<'a>;

    #[inline]
    fn has_events(&self) -> bool {
        self.model().has_events
    }

    #[inline]
    fn has_modes(&self) -> bool {
        self.has_events() || self.model().mechanism.geometry.base_distance == 0.0
    }

    #[inline]
    fn regularization_velocity(&self) -> f64 {
        self.model().regularization_velocity
    }

    #[inline]
    fn has_sharp_nonlinearity(&self) -> bool {
        self.model().has_sharp_nonlinearity
    }

    fn guard_values(&self, q: &Angles, v: &Angles) -> GuardValues<'a> {
        let pose = self.pose(q);
        let (x, rates) = self.coordinates(&pose, q, v);
        let friction_guards = self.five_bar().friction_guards(&x, &pose, &rates);
        GuardValues::new(&self.model().effects, &self.motion(&pose, q, v), friction_guards)
    }

    #[inline]
    fn mode_of(&self, q: &Angles, v: &Angles) -> Mode {
        if !self.has_events() {
            return self.select_branch(Mode::OF_STATE, q, v);
        }
        let pose = self.pose(q);
        let springs = GuardValues::new(&self.model().effects, &self.motion(&pose, q, v), FrictionGuards::new()).mode();
        self.with_resolved_stick_slip(self.select_branch(springs, q, v), q, v)
    }

    #[inline(always)]
    fn select_branch(&self, mode: Mode, q: &Angles, v: &Angles) -> Mode {
        if self.model().mechanism.geometry.base_distance != 0.0 || mode.closure_branch.is_some() {
            return mode;
        }
        let pairs = |x: &Angles| [legs_of(x, PROXIMAL), legs_of(x, DISTAL)];
        let closure_branch = ClosureBranch::of(&self.model().mechanism.geometry, pairs(q), pairs(v));
        match closure_branch {
            Some(closure_branch) if self.model().sticks => mode.with_stick_slip(mode.stick_slip.on_branch(closure_branch)),
            _ => mode,
        }
        .with_closure_branch(closure_branch)
    }

    #[inline]
    fn on(&self, mode: Mode) -> impl Borrow<Self> {
        if self.has_modes() { InMode::Others(self.in_mode(mode)) } else { InMode::Same(self) }
    }

    fn guard_residual(&self, at: &GuardValues<'a>, tolerance: f64) -> f64 {
        at.guard_residual(&self.five_bar().mode(), tolerance)
    }

    fn next_mode(&self, q: &Angles, v: &Angles, tolerance: f64) -> Mode {
        let mode = self.guard_values(q, v).next_mode(self.five_bar().mode(), tolerance);
        self.with_resolved_stick_slip(mode, q, v)
    }

    fn has_stick_slip(&self) -> bool {
        self.model().sticks
    }

    fn has_active_contact(&self) -> bool {
        self.five_bar().mode().has_active_contact()
    }

    fn separation_energy(&self, at: &GuardValues<'a>) -> f64 {
        at.separation_energy(&self.five_bar().mode())
    }

    fn dwell_time(&self, at: &GuardValues<'a>) -> f64 {
        at.dwell_time(&self.five_bar().mode())
    }

    fn is_at_rest(&self) -> bool {
        self.five_bar().mode.stick_slip.at_rest()
    }

    fn sticks_in_motion(&self, at: &GuardValues<'a>) -> bool {
        at.any_sticks_while_moving(&self.five_bar().mode())
    }

    fn breakaway_residual(&self, at: &GuardValues<'a>, tolerance: f64) -> f64 {
        at.breakaway_residual(&self.five_bar().mode(), tolerance)
    }

    fn stays_within(&self, ends: [&GuardValues<'a>; 2], duration: f64, extremes: &Extremes<ANGLES>, tolerance: f64) -> bool {
        GuardValues::stay_in_phase(ends, &self.five_bar().mode(), duration, &of_links(extremes, LINK_INDICES), tolerance)
    }
}

/// Bounds of the link rates and accelerations out of bounds of all coordinates.
fn of_links<const N: usize>(Extremes { rates, accelerations, higher }: &Extremes<N>, links: [usize; LINKS]) -> effects::Extremes {
    let of = |x: &Vector<N>| links.map(|i| x[i]);
    effects::Extremes {
        rates: of(rates),
        accelerations: of(accelerations),
        higher: higher.as_ref().map(|[jerks, snaps]| [of(jerks), of(snaps)]),
    }
}

impl AngleSystem<'_> {
    /// Mode with the stick-slip states that follow from the state.
    fn with_resolved_stick_slip(&self, mode: Mode, q: &Angles, v: &Angles) -> Mode {
        if !self.model().sticks {
            return mode;
        }
        let (x, rates) = self.coordinates(&self.pose(q), q, v);
        mode.with_stick_slip(resolved(&self.five_bar().on(mode), &x, &rates))
    }
}

impl<const BARE: bool> FiveBar<'_, BARE> {
    /// Friction guards, none without stick-slip friction.
    fn friction_guards(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> FrictionGuards {
        if self.model.sticks { friction_guards(&self.general(), q, pose, v) } else { FrictionGuards::new() }
    }
}

impl<'a, const BARE: bool> Events<COORDINATES> for FiveBar<'a, BARE> {
    type Mode = Mode;
    type GuardValues = GuardValues<'a>;

    #[inline(always)]
    fn has_events(&self) -> bool {
        !BARE && self.model.has_events
    }

    #[inline(always)]
    fn may_make_contact(&self) -> bool {
        !BARE && self.model.may_make_contact
    }

    fn guard_values(&self, q: &Coordinates, v: &Coordinates) -> GuardValues<'a> {
        let pose = self.pose(q);
        let friction_guards = self.friction_guards(q, &pose, v);
        GuardValues::new(&self.model.effects, &self.motion(q, &pose, v), friction_guards)
    }

    /// Initial mode: phases of unilateral springs follow from the state; stick-slip states are resolved from it.
    #[inline]
    fn mode_of(&self, q: &Coordinates, v: &Coordinates) -> Mode {
        if BARE || !self.model.sticks {
            return Mode::OF_STATE;
        }
        let pairs = |x: &Coordinates| [legs_of(x, P_THETA), legs_of(x, D_THETA)];
        let closure_branch = ClosureBranch::of(&self.model.mechanism.geometry, pairs(q), pairs(v));
        let still = closure_branch.map_or(StickSlips::OPEN, |closure_branch| StickSlips::OPEN.on_branch(closure_branch));
        Mode::of_stick_slip(resolved(&self.general().on(Mode::of_stick_slip(still)), q, v))
    }

    #[inline(always)]
    fn on(&self, mode: Mode) -> impl Borrow<Self> {
        FiveBar::on(self, mode)
    }

    #[inline(always)]
    fn has_stick_slip(&self) -> bool {
        !BARE && self.model.sticks
    }

    #[inline(always)]
    fn is_at_rest(&self) -> bool {
        !BARE && self.mode.stick_slip.at_rest()
    }

    fn knows_stick_slip(&self, at: &GuardValues<'a>) -> bool {
        at.are_known(&self.mode.stick_slip)
    }

    fn guard_residual(&self, at: &GuardValues<'a>, tolerance: f64) -> f64 {
        at.guard_residual(&self.mode(), tolerance)
    }

    fn reverses_between(&self, ends: [[&Coordinates; 3]; 2], duration: f64, tolerance: f64) -> bool {
        reverses_between(&self.general(), ends, duration, stick_velocity(tolerance))
    }

    /// Springs alone: reversals of slipping contacts are found by [`Events::reverses_between`], which knows the accelerations.
    fn stays_within(&self, ends: [&GuardValues<'a>; 2], duration: f64, extremes: &Extremes<COORDINATES>, tolerance: f64) -> bool {
        GuardValues::endpoints_bound_penetration(ends, duration, &of_links(extremes, THETA), tolerance)
    }
}
