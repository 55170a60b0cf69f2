//! The five-bar as a hybrid system ([`Events`], [`Frictional`]) in the link angles and in the twelve coordinates: guards, modes,
//! transitions, and the friction places with their constraint rows.

use std::borrow::Cow;

use super::angles::{ANGLES, AngleSystem, Angles, CLOSURES, LINK_INDICES, angles, angles_of, legs};
use super::five_bar::FiveBar;
use crate::effects::{FrictionElement, FrictionElements, Motion, Wrench};
use crate::hybrid::{
    Extremes, FRICTION_PLACES, FrictionConstraint, FrictionConstraints, FrictionGuards, FrictionPlace, Frictional, GuardValues,
    Mode, StickSlip, StickSlips, stick_velocity,
};
use crate::integrator::{Events, Implicit, Inconsistency, Path, Posed, System};
use crate::mechanism::coordinates::{THETA, angles_by_leg};
use crate::mechanism::{COORDINATES, ClosureBranch, Coordinates, MULTIPLIERS, Pose};
use crate::vector::Vector;

impl<'a, const BARE: bool> FiveBar<'a, BARE> {
    /// Guard values at a motion, with the given guards of friction.
    fn guards(&self, at: &Motion, friction_guards: FrictionGuards) -> GuardValues<'a> {
        GuardValues::new(self.mode, self.model.kinks(at), friction_guards)
    }

    /// Friction places that are active at a motion, with their wrenches.
    fn friction_elements(&self, at: &Motion) -> FrictionElements {
        let mut elements = FrictionElements::new();
        for effect in &self.model.effects {
            effect.add_friction(at, &mut elements);
        }
        elements
    }

    /// Friction places that are active at a motion.
    fn friction_places(&self, at: &Motion) -> impl Iterator<Item = FrictionPlace> {
        self.friction_elements(at).into_iter().map(|element| element.at)
    }

    /// Friction places that are active at a motion, as constraints.
    fn friction<const N: usize>(
        &self,
        at: &Motion,
        wanted: impl Fn(StickSlip) -> bool,
        constraint: impl Fn(&Wrench) -> (Vector<N>, f64),
    ) -> FrictionConstraints<N> {
        let carried = |FrictionElement { at, wrench }| {
            let (row, drift) = constraint(&wrench);
            FrictionConstraint { at, row, drift }
        };
        let elements = self.friction_elements(at).into_iter();
        elements.filter(|element| wanted(self.mode.stick_slip.at(element.at.place))).map(carried).collect()
    }

    /// Closure branch of a state with coaxial motors.
    fn closure_branch(&self, [q, v]: [[crate::mechanism::legs::Legs; 2]; 2]) -> Option<ClosureBranch> {
        ClosureBranch::of(&self.model.mechanism.geometry, q, v)
    }
}

impl Frictional<ANGLES, CLOSURES> for AngleSystem<'_> {
    fn stick_slip(&self) -> &StickSlips {
        &self.five_bar().mode.stick_slip
    }

    fn with_stick_slip(&self, stick_slip: StickSlips) -> Self {
        self.in_mode(self.five_bar().mode.with_stick_slip(stick_slip))
    }

    fn friction_constraints(
        &self,
        Posed { q, pose, v }: Posed<'_, Pose, ANGLES>,
        wanted: impl Fn(StickSlip) -> bool,
    ) -> FrictionConstraints<ANGLES> {
        self.five_bar().friction(&self.motion(pose, q, v), wanted, |wrench| {
            (angles(wrench.torques_in_angles(pose)), wrench.drift_in_angles(pose, legs(v)))
        })
    }

    #[expect(clippy::misnamed_getters, reason = "the twelve coordinates have another regularisation")]
    fn regularization(&self) -> f64 {
        self.model().regularization_by_angles
    }

    fn stick_velocity(&self) -> f64 {
        stick_velocity(self.model().settings.error_tolerance)
    }
}

impl<const BARE: bool> Frictional<COORDINATES, MULTIPLIERS> for FiveBar<'_, BARE> {
    fn stick_slip(&self) -> &StickSlips {
        &self.mode.stick_slip
    }

    fn with_stick_slip(&self, stick_slip: StickSlips) -> Self {
        self.on(self.mode.with_stick_slip(stick_slip))
    }

    fn friction_constraints(
        &self,
        Posed { q, pose, v }: Posed<'_, Pose, COORDINATES>,
        wanted: impl Fn(StickSlip) -> bool,
    ) -> FrictionConstraints<COORDINATES> {
        self.friction(&self.motion(q, pose, v), wanted, |wrench| {
            (wrench.in_coordinates(pose), wrench.drift_in_coordinates(pose, v))
        })
    }

    fn regularization(&self) -> f64 {
        self.model.regularization
    }

    fn stick_velocity(&self) -> f64 {
        stick_velocity(self.model.settings.error_tolerance)
    }

    fn holding_at_rest(&self, at: Posed<'_, Pose, COORDINATES>) -> [f64; FRICTION_PLACES] {
        match self.by_branch(self.mode, [at.q, at.v]) {
            Some(by_branch) => by_branch.torques_at_rest(&angles_of(at.q), &angles_of(at.v)),
            None => self.torques_at_rest(at.q, at.v),
        }
    }
}

impl<'a> Events<ANGLES> for AngleSystem<'a> {
    type Mode = Mode;
    type GuardValues = GuardValues<'a>;

    fn guard_values(&self, q: &Angles, v: &Angles) -> GuardValues<'a> {
        let pose = self.pose(q);
        let motion = self.motion(&pose, q, v);
        let friction_guards = self.friction_guards(self.five_bar().friction_places(&motion), Posed { q, pose: &pose, v });
        self.five_bar().guards(&motion, friction_guards)
    }

    fn mode_of(&self, q: &Angles, v: &Angles) -> Mode {
        let mut mode = self.select_branch(Mode::OF_STATE, q, v);
        if self.features().events {
            mode = self.five_bar().guards(&self.motion(&self.pose(q), q, v), FrictionGuards::new()).with_present_phases(mode);
        }
        if self.features().may_stick { mode.with_stick_slip(self.in_mode(mode).resolved(q, v)) } else { mode }
    }

    fn select_branch(&self, mode: Mode, q: &Angles, v: &Angles) -> Mode {
        if self.model().mechanism.geometry.base_distance != 0.0 || mode.closure_branch.is_some() {
            return mode;
        }
        let closure_branch = self.five_bar().closure_branch([legs(q), legs(v)]);
        match closure_branch {
            Some(closure_branch) if self.features().may_stick => mode.with_stick_slip(mode.stick_slip.on_branch(closure_branch)),
            _ => mode,
        }
        .with_closure_branch(closure_branch)
    }

    /// The system itself if modes do not matter, which saves a copy per step.
    fn on(&self, mode: Mode) -> Cow<'_, Self> {
        let has_modes = self.features().events || self.model().mechanism.geometry.base_distance == 0.0;
        if has_modes { Cow::Owned(self.in_mode(mode)) } else { Cow::Borrowed(self) }
    }

    fn next_mode(&self, q: &Angles, v: &Angles, tolerance: f64) -> Mode {
        let mode = self.guard_values(q, v).next_mode(tolerance);
        if self.features().may_stick { mode.with_stick_slip(self.in_mode(mode).resolved(q, v)) } else { mode }
    }

    fn has_active_contact(&self) -> bool {
        self.five_bar().mode.has_active_contact()
    }

    fn path_bounds(&self, path: &Path<ANGLES>) -> Extremes {
        path.extremes(LINK_INDICES)
    }
}

impl<'a, const BARE: bool> Events<COORDINATES> for FiveBar<'a, BARE> {
    type Mode = Mode;
    type GuardValues = GuardValues<'a>;

    fn guard_values(&self, q: &Coordinates, v: &Coordinates) -> GuardValues<'a> {
        let pose = self.pose(q);
        let motion = self.motion(q, &pose, v);
        let friction_guards = self.friction_guards(self.friction_places(&motion), Posed { q, pose: &pose, v });
        self.guards(&motion, friction_guards)
    }

    fn mode_of(&self, q: &Coordinates, v: &Coordinates) -> Mode {
        if !self.features().events {
            return Mode::OF_STATE;
        }
        let mode = self.guards(&self.motion(q, &self.pose(q), v), FrictionGuards::new()).with_present_phases(Mode::OF_STATE);
        self.with_resolved_friction(mode, q, v)
    }

    fn on(&self, mode: Mode) -> Cow<'_, Self> {
        Cow::Owned(FiveBar::on(self, mode))
    }

    fn next_mode(&self, q: &Coordinates, v: &Coordinates, tolerance: f64) -> Mode {
        self.with_resolved_friction(self.guard_values(q, v).next_mode(tolerance), q, v)
    }

    fn path_bounds(&self, path: &Path<COORDINATES>) -> Extremes {
        path.extremes(THETA)
    }
}

impl<const BARE: bool> FiveBar<'_, BARE> {
    /// The mode with stick-slip states determined from coordinates and velocities. A mode in the twelve coordinates stores no closure
    /// branch, so the branch and the joints that it locks are determined again.
    fn with_resolved_friction(&self, mode: Mode, q: &Coordinates, v: &Coordinates) -> Mode {
        if !self.features().may_stick {
            return mode;
        }
        mode.with_stick_slip(match self.by_branch(mode.with_stick_slip(StickSlips::OPEN), [q, v]) {
            Some(by_branch) => by_branch.resolved(&angles_of(q), &angles_of(v)),
            None => FiveBar::on(self, mode.with_stick_slip(StickSlips::OPEN)).resolved(q, v),
        })
    }

    /// The machine in its link angles, on the closure branch of a motion, in a mode; `None` if the motion is on no branch. Near a posture with
    /// all links in line, only the equations of the branch determine the directions in which the machine can move; in the twelve
    /// coordinates the regularisation would allow more, and friction would hold any load.
    fn by_branch(&self, mode: Mode, [q, v]: [&Coordinates; 2]) -> Option<AngleSystem<'_>> {
        let closure_branch = self.closure_branch([q, v].map(angles_by_leg))?;
        let stick_slip = mode.stick_slip.on_branch(closure_branch);
        let mode = mode.with_stick_slip(stick_slip).with_closure_branch(Some(closure_branch));
        Some(AngleSystem::new(self.general()).in_mode(mode))
    }

    /// Refuses stick-slip states that coordinates and velocities do not allow. `just_stopped` allows the residual rates of a stop.
    pub(super) fn check_stick_slip(&self, [q, v]: [&Coordinates; 2], just_stopped: bool) -> Result<(), Inconsistency> {
        let possible = if !self.features().may_stick {
            self.mode.stick_slip == StickSlips::OPEN
        } else if let Some(by_branch) = self.by_branch(self.mode, [q, v]) {
            by_branch.are_possible(&angles_of(q), &angles_of(v), just_stopped)
        } else {
            self.are_possible(q, v, just_stopped)
        };
        if possible { Ok(()) } else { Err("its stick-slip states do not fit its rates and loads") }
    }
}
