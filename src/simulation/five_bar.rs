//! The five-bar in its twelve coordinates, with active effects and constant inputs: implements [`System`], the interface of the
//! integrators.

use super::model::Model;
use crate::dynamics::{Conditions, TipArm};
use crate::effects::{Inputs, Motion, Slopes, Wrench};
use crate::hybrid::{Frictional, Mode};
use crate::integrator::{
    CONFIGURATION_SIGNS, Events, Features, Implicit, StepError, StickingConstraint, Stuck, System, TangentPoint, Work,
};
use crate::linear::{Definiteness, LinearSolve, MassFactor, TangentSystem};
use crate::mechanism::coordinates::{THETA, angles_by_leg, largest_angle};
use crate::mechanism::{COORDINATES, ClosureBranch, Coordinates, MULTIPLIERS, Multipliers, Pose};

/// A model with the inputs and whole turns that are constant during a step.
///
/// `BARE` selects the form without motion-dependent effects, solved leg by leg. It keeps the whole step in registers and saves 700 of 3,490
/// instructions of a fixed step (`cargo xtask bench`, table steps).
#[derive(Clone, Copy, Debug)]
pub struct FiveBar<'a, const BARE: bool = false> {
    pub(super) model: &'a Model,
    pub(super) inputs: &'a Inputs,
    pub(super) turns: &'a [i64; 4],
    follows_work: bool,
    pub(super) mode: Mode,
}

/// Point at which a tangent is evaluated.
type At<'a> = TangentPoint<'a, Pose, COORDINATES, MULTIPLIERS>;

impl<'a> FiveBar<'a> {
    /// System of `model` under `inputs`; `turns` are the whole turns of links 1 to 4 that q omits.
    pub fn new(model: &'a Model, inputs: &'a Inputs, turns: &'a [i64; 4]) -> Self {
        Self { model, inputs, turns, follows_work: inputs.load() || !model.conservative, mode: Mode::OF_STATE }
    }

    /// System with the stick-slip states that follow from `q` and `v`.
    pub(super) fn resolved(model: &'a Model, inputs: &'a Inputs, turns: &'a [i64; 4], [q, v]: [&Coordinates; 2]) -> Self {
        let system = Self::new(model, inputs, turns);
        system.on(Events::mode_of(&system, q, v))
    }
}

impl<'a, const BARE: bool> FiveBar<'a, BARE> {
    /// System in the other form. The bare form is only for a model that is solved leg by leg and has no effects that depend on the motion.
    pub fn in_form<const OTHER: bool>(&self) -> FiveBar<'a, OTHER> {
        let &Self { model, inputs, turns, follows_work, mode } = self;
        FiveBar { model, inputs, turns, follows_work, mode }
    }

    /// System with other whole turns.
    #[inline(always)]
    pub(super) fn with_turns<'b>(&self, turns: &'b [i64; 4]) -> FiveBar<'b, BARE>
    where
        'a: 'b,
    {
        FiveBar { turns, ..*self }
    }

    /// System in this mode.
    #[inline(always)]
    pub(super) fn on(&self, mode: Mode) -> Self {
        Self { mode, ..*self }
    }

    /// Inputs, turns and mode under which the force laws act.
    #[inline(always)]
    pub(super) fn conditions(&self) -> Conditions<'a> {
        Conditions { inputs: self.inputs, turns: self.turns, mode: self.mode }
    }

    /// Motion of joints and tip.
    #[inline(always)]
    pub(super) fn motion(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> Motion<'a> {
        self.conditions().motion([q, v], pose)
    }

    /// Potential energy of all conservative forces, including the constant loads, J.
    pub(super) fn potential_energy(&self, q: &Coordinates, pose: &Pose) -> f64 {
        let at = self.motion(q, pose, &Coordinates::ZERO);
        self.model.potential(q, &at) + self.inputs.potential([q[THETA[0]], q[THETA[3]]], at.position)
    }

    /// Power of the effects that have no potential, W, at a motion.
    pub(super) fn power_without_potential(&self, at: &Motion) -> f64 {
        // Springs are in the phase of the current state. A separated spring then has a potential, so its loss counts as power here.
        let mut at = *at;
        at.joints.mode = Mode::of_stick_slip(self.mode.stick_slip);
        let Work { input, dissipated } = self.effects_at(at).1;
        input - dissipated
    }

    /// Wrench of the effects, and its power. The motion is passed by value: behind a reference, the compiler would keep it in memory even
    /// in scenes without effects.
    #[inline(never)]
    fn effects_at(&self, at: Motion) -> (Wrench, Work) {
        let (mut wrench, mut power) = (Wrench::default(), Work::default());
        for effect in &self.model.effects {
            let [input, dissipated] = effect.act(&at, &mut wrench);
            power += Work { input, dissipated };
        }
        (wrench, power)
    }

    /// Wrench of loads and effects, and its power.
    #[inline(always)]
    pub(super) fn acting(&self, at: &Motion) -> (Wrench, Work) {
        let loads = self.inputs.wrench();
        let power = Work { input: loads.power(&at.joints.rates, at.velocity), dissipated: 0.0 };
        if BARE || self.model.effects.is_empty() {
            return (loads, power);
        }
        let (wrench, mut sum) = self.effects_at(*at);
        sum += power;
        (wrench.plus(1.0, &loads), sum)
    }

    /// Slopes of loads and effects.
    #[inline(never)]
    pub(super) fn slopes(&self, at: Motion) -> Slopes {
        let mut slopes = Slopes { force: self.inputs.tip_force, ..Slopes::default() };
        for effect in &self.model.effects {
            effect.add_slopes(&at, &mut slopes);
        }
        slopes
    }

    /// Slopes at coordinates and velocities, with the arms of the tip.
    #[inline(always)]
    fn slopes_at(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> (Slopes, TipArm) {
        let slopes =
            if BARE { Slopes { force: self.inputs.tip_force, ..Slopes::default() } } else { self.slopes(self.motion(q, pose, v)) };
        (slopes, TipArm::of_pose(pose, v))
    }

    /// (M + h/2 C + h²/4 K) x with K = −∂Q/∂q and C = −∂Q/∂q̇: the weight of the paper's projections.
    pub fn effective_mass_times(&self, at: &At<'_>, x: &Coordinates) -> Coordinates {
        let &TangentPoint { q, pose, v, h, .. } = at;
        let (slopes, arm) = self.slopes_at(q, pose, v);
        self.model.solver.effective_mass_times(&slopes, &arm, h, x)
    }

    #[inline(always)]
    fn solve_tangent_as(
        &self,
        definite: Definiteness,
        at: &At<'_>,
        regularization: f64,
        b: &Coordinates,
        c: &Multipliers,
    ) -> Result<(Coordinates, Multipliers), StepError> {
        let &TangentPoint { q, pose, v, lambda, h } = at;
        let (slopes, arm) = self.slopes_at(q, pose, v);
        let of = TangentSystem { slopes, arm, pose, lambda, h, regularization, definite };
        if BARE { self.model.solver.solve_tangent_by_legs(&of, b, c) } else { self.model.solver.solve_tangent(&of, b, c) }
    }
}

/// Work of an iteration with the dense solve (22 × 22, with its search for a descent direction), in iterations of the fastest solve.
const DENSE_WORK: u64 = 16;

impl<'a, const BARE: bool> System<COORDINATES, MULTIPLIERS> for FiveBar<'a, BARE> {
    type Pose = Pose;
    type Mass = MassFactor<'a, BARE>;

    fn pose(&self, q: &Coordinates) -> Pose {
        self.model.mechanism.pose(q)
    }

    fn phi(&self, q: &Coordinates, pose: &Pose) -> Multipliers {
        self.model.mechanism.phi(q, pose)
    }

    fn phi_q_times(&self, pose: &Pose, v: &Coordinates) -> Multipliers {
        pose.phi_q_times(v)
    }

    fn phi_q_dot_times(&self, pose: &Pose, v: &Coordinates) -> Multipliers {
        pose.phi_q_dot_times(v)
    }

    fn mass_times(&self, _pose: &Pose, x: &Coordinates) -> Coordinates {
        self.model.mechanism.mass_times(x)
    }

    fn energy(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> f64 {
        if BARE {
            return self.model.mechanism.energy([q, v], &self.model.weight);
        }
        self.mass_times(pose, v).dot(v) / 2.0 + self.model.potential(q, &self.motion(q, pose, v))
    }

    fn factor_mass(&self, pose: &Pose, regularization: f64) -> MassFactor<'a, BARE> {
        self.model.solver.factor_mass(pose, regularization)
    }

    fn features(&self) -> Features {
        let Features { checks, .. } = self.model.features;
        Features { work: self.follows_work, checks, ..if BARE { Features::SMOOTH } else { self.model.features } }
    }

    fn configuration_signs(&self, pose: &Pose) -> u8 {
        pose.configuration_signs()
    }

    fn determinants(&self, pose: &Pose) -> [f64; CONFIGURATION_SIGNS] {
        pose.sines()
    }

    fn branch(&self, q: &Coordinates, v: &Coordinates) -> Option<u8> {
        let geometry = &self.model.mechanism.geometry;
        if geometry.base_distance != 0.0 {
            return None;
        }
        ClosureBranch::of(geometry, angles_by_leg(q), angles_by_leg(v)).map(|branch| branch as u8)
    }

    fn stuck(&self) -> Stuck {
        match &self.mode.stick_slip {
            _ if BARE || !self.model.features.may_stick => Stuck::Nothing,
            stick_slip if stick_slip.at_rest() => Stuck::Wholly,
            stick_slip if stick_slip.any_sticks() => Stuck::Partly,
            _ => Stuck::Nothing,
        }
    }

    fn sticking_constraint(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> StickingConstraint<COORDINATES> {
        self.sticking(q, pose, v)
    }

    #[inline(always)]
    fn forces(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> (Coordinates, Work) {
        let (wrench, power) = self.acting(&self.motion(q, pose, v));
        let mut forces = self.model.weight;
        wrench.add_to(TipArm::of_pose(pose, v).row, &mut forces);
        (forces, if self.follows_work { power } else { Work::default() })
    }

    fn error_norm(&self, x: &Coordinates) -> f64 {
        largest_angle(x)
    }

    fn length_scale(&self) -> f64 {
        self.model.length_scale
    }
}

impl<'a, const BARE: bool> Implicit<COORDINATES, MULTIPLIERS> for FiveBar<'a, BARE> {
    type General = FiveBar<'a>;

    fn general(&self) -> FiveBar<'a> {
        self.in_form()
    }

    fn phi_q_transposed_times(&self, pose: &Pose, lambda: &Multipliers) -> Coordinates {
        pose.phi_q_transposed_times(lambda)
    }

    #[inline(always)]
    fn solve_tangent(
        &self,
        at: &At<'_>,
        regularization: f64,
        b: &Coordinates,
        c: &Multipliers,
    ) -> Result<(Coordinates, Multipliers), StepError> {
        self.solve_tangent_as(Definiteness::Required, at, regularization, b, c)
    }

    fn solve_descent(
        &self,
        at: &At<'_>,
        regularization: f64,
        b: &Coordinates,
        c: &Multipliers,
    ) -> Option<(Coordinates, Multipliers)> {
        self.solve_tangent_as(Definiteness::Enforced, at, regularization, b, c).ok()
    }

    fn potential(&self, q: &Coordinates, pose: &Pose) -> Option<f64> {
        self.model.conservative.then(|| self.potential_energy(q, pose))
    }

    fn drive_forces(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> Option<Coordinates> {
        self.model.has_servo.then(|| self.model.drives(&self.motion(q, pose, v)).in_coordinates(pose))
    }

    /// An iteration of the dense solve, with 22 rows, counts as several.
    fn iteration_work(&self) -> u64 {
        if !BARE && self.model.solver.linear_solve() == LinearSolve::Dense { DENSE_WORK } else { 1 }
    }
}
