//! The five-bar in its twelve coordinates, with active effects and held inputs: implements [`System`], the interface of the integrators.

use super::model::Model;
use crate::effects::{ForceContext, Inputs, Mode, Tangents};
use crate::integrator::{Events, Held, Implicit, StepError, System, TangentPoint, Work};
use crate::linear::{Definite, LinearSolve, MassFactor, TangentOf, TangentSource};
use crate::mechanism::coordinates::{D_THETA, P_THETA, largest_angle, legs_of};
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Multipliers, Pose};

/// A model with the inputs and whole turns that are constant during a step.
///
/// `BARE` selects the form without motion-dependent effects, solved leg by leg, which keeps the whole step in registers and saves 580 of
/// 2,970 instructions of a fixed step (`cargo xtask bench`, table steps).
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

impl<'a, const BARE: bool> FiveBar<'a, BARE> {
    /// System of `model` under `inputs`; `turns` holds the whole turns of links 1 to 4 that q leaves out.
    pub fn new(model: &'a Model, inputs: &'a Inputs, turns: &'a [i64; 4]) -> Self {
        Self { model, inputs, turns, follows_work: inputs.load() || !model.conservative, mode: Mode::OF_STATE }
    }

    /// System with the stick-slip states that follow from `q` and `v`.
    pub(super) fn resolved(model: &'a Model, inputs: &'a Inputs, turns: &'a [i64; 4], [q, v]: [&Coordinates; 2]) -> Self {
        let system = Self::new(model, inputs, turns);
        system.on(Events::mode_of(&system, q, v))
    }

    /// System with other whole turns.
    #[inline(always)]
    pub(super) fn with_turns<'b>(&self, turns: &'b [i64; 4]) -> FiveBar<'b, BARE>
    where
        'a: 'b,
    {
        FiveBar { turns, ..*self }
    }

    /// The form that is not specialised for the bare mechanism.
    pub(super) fn general(self) -> FiveBar<'a> {
        let Self { model, inputs, turns, follows_work, mode } = self;
        FiveBar { model, inputs, turns, follows_work, mode }
    }

    /// System in a given mode.
    #[inline(always)]
    pub(super) fn on(&self, mode: Mode) -> Self {
        Self { mode, ..*self }
    }

    /// Mode of the system.
    pub(super) fn mode(&self) -> Mode {
        self.mode
    }

    #[inline(always)]
    pub(super) fn context<'b>(&'b self, q: &'b Coordinates, pose: &'b Pose, v: &'b Coordinates) -> ForceContext<'b> {
        ForceContext { q, v, pose, inputs: self.inputs, turns: self.turns, mode: self.mode }
    }

    /// Potential energy of all conservative forces, held loads included, J.
    pub(super) fn potential_energy(&self, q: &Coordinates, pose: &Pose) -> f64 {
        let at = self.context(q, pose, &Coordinates::ZERO);
        self.model.potential(&at) + self.inputs.potential(&at)
    }

    /// Power of the non-conservative forces, W.
    pub(super) fn power_without_potential(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> f64 {
        // Evaluated in the mode of the state: the loss at a separating spring is power here, because its potential energy is counted.
        let at = ForceContext { mode: Mode::of_stick_slip(self.mode.stick_slip), ..self.context(q, pose, v) };
        self.model.effects.iter().map(|effect| effect.input_power(&at) - effect.dissipation(&at)).sum()
    }

    #[inline(always)]
    fn solve_tangent_as(
        &self,
        definite: Definite,
        at: &At<'_>,
        regularization: f64,
        right: (&Coordinates, &Multipliers),
    ) -> Result<(Coordinates, Multipliers), StepError> {
        let &TangentPoint { q, pose, v, lambda, h } = at;
        let forces = &ForceTangents::<BARE> { model: self.model, at: self.context(q, pose, v) };
        self.model.solver.solve_tangent::<BARE>(&TangentOf { forces, pose, lambda, h, regularization, definite }, right)
    }
}

impl<const BARE: bool> FiveBar<'_, BARE> {
    /// Forces of the effects, added to `forces`. The arguments are copies, made only if there are effects: data behind pointers must be in
    /// memory, and without effects they stay in registers (8 % of an evaluation by dop853).
    #[inline(never)]
    fn with_effects(&self, mut forces: Coordinates, q: Coordinates, pose: Pose, v: Coordinates) -> Coordinates {
        let at = self.context(&q, &pose, &v);
        for effect in &self.model.effects {
            effect.add_forces(&at, &mut forces);
        }
        forces
    }
}

impl<const BARE: bool> FiveBar<'_, BARE> {
    /// Forces of inputs and effects, N and N·m, with their power, W.
    #[inline(always)]
    pub(super) fn acting(&self, at: &ForceContext) -> (Coordinates, Work) {
        let mut forces = self.model.weight;
        self.inputs.add_forces(at, &mut forces);
        let power = self.act(at, &mut forces);
        (forces, power)
    }

    /// Adds the forces of the effects; returns the power of inputs and effects, W. Out of line, as `with_effects` is.
    #[inline(never)]
    fn act(&self, at: &ForceContext, forces: &mut Coordinates) -> Work {
        let mut power = Work { input: self.inputs.power(at), dissipated: 0.0 };
        for effect in &self.model.effects {
            let [input, dissipated] = effect.act(at, forces);
            power.input += input;
            power.dissipated += dissipated;
        }
        power
    }
}

impl<const BARE: bool> FiveBar<'_, BARE> {
    /// Adds the power of the effects to `power`, W.
    #[inline(never)]
    fn with_effect_power(&self, mut power: Work, at: &ForceContext) -> Work {
        for effect in &self.model.effects {
            power.input += effect.input_power(at);
            power.dissipated += effect.dissipation(at);
        }
        power
    }
}

/// Forces of a model at a state, as a source of tangents.
struct ForceTangents<'a, const BARE: bool> {
    model: &'a Model,
    at: ForceContext<'a>,
}

impl<const BARE: bool> TangentSource for ForceTangents<'_, BARE> {
    #[inline(always)]
    fn add_tangents(&self, tangents: &mut impl Tangents) {
        self.at.inputs.add_tangents(&self.at, tangents);
        if !BARE {
            for effect in &self.model.effects {
                effect.add_tangents(&self.at, tangents);
            }
        }
    }
}

/// Work of an iteration with the dense solve (22 × 22, with its search for a descent direction) in iterations of the fastest solve.
const DENSE_WORK: u64 = 16;

impl<'a, const BARE: bool> System<COORDINATES, MULTIPLIERS> for FiveBar<'a, BARE> {
    type Pose = Pose;
    type TrigBase = ();
    type Mass = MassFactor<'a, BARE>;

    fn pose(&self, q: &Coordinates) -> Pose {
        self.model.mechanism.pose(q)
    }

    #[inline(always)]
    fn pose_in_place(&self, q: &Coordinates) -> Pose {
        self.model.mechanism.pose_in_place([legs_of(q, P_THETA), legs_of(q, D_THETA)])
    }

    fn trig_base(&self, _: &Pose) {}

    #[inline(always)]
    fn phi(&self, q: &Coordinates, pose: &Pose) -> Multipliers {
        self.model.mechanism.phi(q, pose)
    }

    #[inline(always)]
    fn phi_q_times(&self, pose: &Pose, v: &Coordinates) -> Multipliers {
        pose.phi_q_times(v)
    }

    #[inline(always)]
    fn phi_q_dot_times(&self, pose: &Pose, v: &Coordinates) -> Multipliers {
        pose.phi_q_dot_times(v)
    }

    #[inline(always)]
    fn mass_times(&self, _pose: &Pose, x: &Coordinates) -> Coordinates {
        self.model.mechanism.mass_times(x)
    }

    #[inline(always)]
    fn forces(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> Coordinates {
        let at = self.context(q, pose, v);
        let mut forces = self.model.weight;
        self.inputs.add_forces(&at, &mut forces);
        if BARE || self.model.effects.is_empty() { forces } else { self.with_effects(forces, *q, *pose, *v) }
    }

    #[inline(never)]
    fn factor_mass(&self, pose: &Pose, regularization: f64) -> MassFactor<'a, BARE> {
        self.factor_mass_in_place(pose, regularization)
    }

    #[inline(always)]
    fn factor_mass_in_place(&self, pose: &Pose, regularization: f64) -> MassFactor<'a, BARE> {
        self.model.solver.factor_mass(pose, regularization)
    }

    #[inline(always)]
    fn has_stiff_forces(&self) -> bool {
        !BARE && self.model.has_stiff_forces
    }

    #[inline(always)]
    fn configuration_signs(&self, pose: &Pose) -> u8 {
        pose.configuration_signs()
    }

    fn uncertain_configuration_signs(&self, pose: &Pose) -> u8 {
        pose.uncertain_configuration_signs()
    }

    #[inline(always)]
    fn holds(&self) -> bool {
        !BARE && self.model.sticks && self.mode.stick_slip.any_sticks()
    }

    fn held(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> Held<COORDINATES> {
        super::stick_slip::held(&self.general(), q, pose, v)
    }

    fn with_friction_reaction(
        &self,
        q: Coordinates,
        v: Coordinates,
        free: (Coordinates, Multipliers),
    ) -> (Coordinates, Multipliers) {
        super::stick_slip::with_friction_reaction(&self.general(), [q, v], free, self.model.regularization)
    }

    fn project_sticking(&self, q: Coordinates, v: Coordinates) -> Coordinates {
        super::stick_slip::project_sticking(&self.general(), q, v)
    }

    #[inline(always)]
    fn follows_work(&self) -> bool {
        self.follows_work
    }

    #[inline]
    fn power(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> Work {
        let at = self.context(q, pose, v);
        let power = Work { input: self.inputs.power(&at), dissipated: 0.0 };
        if BARE || self.model.effects.is_empty() { power } else { self.with_effect_power(power, &at) }
    }

    #[inline(always)]
    fn forces_and_power(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> (Coordinates, Work) {
        if BARE || self.model.effects.is_empty() || !self.follows_work {
            let power = if self.follows_work { self.power(q, pose, v) } else { Work::default() };
            return (self.forces(q, pose, v), power);
        }
        let (q, pose, v) = (*q, *pose, *v);
        self.acting(&self.context(&q, &pose, &v))
    }

    #[cold]
    fn energy(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> f64 {
        self.mass_times(pose, v).dot(v) / 2.0 + self.model.potential(&self.context(q, pose, v))
    }

    #[inline(always)]
    fn error_norm(&self, x: &Coordinates) -> f64 {
        largest_angle(x)
    }

    #[inline(always)]
    fn length_scale(&self) -> f64 {
        self.model.length_scale
    }
}

impl<'a, const BARE: bool> Implicit<COORDINATES, MULTIPLIERS> for FiveBar<'a, BARE> {
    type General = FiveBar<'a>;

    fn general(&self) -> FiveBar<'a> {
        FiveBar::general(*self)
    }

    #[inline(always)]
    fn phi_q_transposed_times(&self, pose: &Pose, lambda: &Multipliers) -> Coordinates {
        pose.phi_q_transposed_times(lambda)
    }

    fn effective_mass_times(&self, at: &At<'_>, x: &Coordinates) -> Coordinates {
        let &TangentPoint { q, pose, v, h, .. } = at;
        self.model.solver.effective_mass_times(&ForceTangents::<BARE> { model: self.model, at: self.context(q, pose, v) }, h, x)
    }

    #[inline(always)]
    fn solve_tangent(
        &self,
        at: &At<'_>,
        regularization: f64,
        right: (&Coordinates, &Multipliers),
    ) -> Result<(Coordinates, Multipliers), StepError> {
        self.solve_tangent_as(Definite::Demanded, at, regularization, right)
    }

    fn solve_descent(
        &self,
        at: &At<'_>,
        regularization: f64,
        right: (&Coordinates, &Multipliers),
    ) -> Option<(Coordinates, Multipliers)> {
        self.solve_tangent_as(Definite::Enforced, at, regularization, right).ok()
    }

    fn potential(&self, q: &Coordinates, pose: &Pose) -> Option<f64> {
        self.model.conservative.then(|| self.potential_energy(q, pose))
    }

    #[cold]
    fn drives(&self, q: &Coordinates, v: &Coordinates) -> Option<Coordinates> {
        self.model.has_servo.then(|| self.model.drives(&self.context(q, &self.pose(q), v)))
    }

    /// An iteration of the dense solve counts as several: its matrix has 22 rows.
    #[inline(always)]
    fn iteration_work(&self) -> u64 {
        if !BARE && self.model.solver.linear_solve() == LinearSolve::Dense { DENSE_WORK } else { 1 }
    }
}
