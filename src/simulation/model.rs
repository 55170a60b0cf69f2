//! The constant part of a scene made ready, and what it is made from.

use arrayvec::ArrayVec;

use super::angles::Falling;
use super::inertia::Inertia;
use super::settings::{Settings, sticking_law};
use crate::effects::{self, Active, Effect, ForceContext, Inputs, Perturbation, TypicalInertia};
use crate::estimator;
use crate::integrator::{MacroStepMethod, dense, i3alp_conserving};
use crate::linear::{LinearSolve, LinearSolver};
use crate::mechanism::{Assembly, Coordinates, Geometry, Mechanism, SceneError, Start};

/// Everything that defines a scene, before it is made ready.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// The mechanism.
    pub geometry: Geometry,
    /// Where it starts.
    pub start: Start,
    /// How it is integrated.
    pub settings: Settings,
    /// What acts on it.
    pub effects: effects::Parameters,
    /// How it follows measurements.
    pub estimator: estimator::Parameters,
}

/// The integrator with the settings it reads.
#[derive(Clone, Copy, Debug)]
pub enum Stepper {
    /// Steps end with the macro step.
    MacroStep(MacroStepMethod),
    /// Error control in the link angles: steps run past it.
    Dense(dense::Settings),
    /// Strictly fixed steps that conserve.
    Conserving(i3alp_conserving::Settings),
    /// None: the proximal angles and rates come from outside, the others follow in this assembly.
    ModelExchange(Assembly),
}

/// The constant part of a scene made ready.
#[derive(Clone, Debug)]
pub struct Model {
    /// The mechanism by legs.
    pub mechanism: Mechanism,
    /// Constant generalised force of the active effects, N and N·m.
    pub weight: Coordinates,
    /// The active effects whose forces depend on the motion, and no others; those with masses are in the mechanism.
    pub effects: Active,
    /// Names of all active effects.
    pub effect_names: ArrayVec<&'static str, { effects::NAMES.len() }>,
    /// Whether all forces have a potential.
    pub conservative: bool,
    /// Whether any has kinks that a method may follow.
    pub has_events: bool,
    /// The least change of a joint's rate that turns a force round, rad/s.
    pub(super) regularization_velocity: f64,
    /// Whether any has one-sided springs.
    pub(super) may_make_contact: bool,
    /// Whether any has dry friction that sticks.
    pub(super) sticks: bool,
    /// Local error allowed per sub-step, rad.
    pub(super) error_tolerance: f64,
    /// Whether the force of any changes steeply in places.
    pub has_stiff_forces: bool,
    /// Whether any bends sharply without a kink, and none has dry friction that sticks.
    pub(super) has_sharp_nonlinearity: bool,
    /// The inertias by which the conserving method judges how stiff a force is.
    pub(super) typical_inertia: TypicalInertia,
    /// Whether an active effect reads the servo references.
    pub has_servo: bool,
    /// The linear solve that the scene needs.
    pub solver: LinearSolver,
    /// The mass matrix in the link angles.
    pub(super) inertia: Inertia,
    /// How its weight acts in them.
    pub(super) falling: Falling,
    /// What round-off in Φ is proportional to, m.
    pub length_scale: f64,
    /// e of the saddle-point systems outside the printed method, 1/kg.
    pub regularization: f64,
    /// The same in the link angles.
    pub(super) regularization_by_angles: f64,
    /// Most Newton iterations.
    pub(super) max_iterations: u32,
    /// The integrator.
    pub stepper: Stepper,
}

impl Model {
    /// Checks the parameters and fixes everything that stays constant.
    #[cold]
    pub fn new(parameters: &Parameters) -> Result<Self, SceneError> {
        let settings = &parameters.settings;
        settings.check()?;
        parameters.geometry.check()?;
        let geometry = parameters.effects.with_added_masses(&parameters.geometry)?;
        let mechanism = Mechanism::new(&geometry)?;
        let effects = parameters.effects.active(&mechanism)?;
        settings.check_laws(&parameters.effects)?;
        // e = 1/(αβ) with α = κ m̄/β.
        let regularization = 1.0 / (settings.penalty_scale * geometry.mean_mass());
        let regularization_by_angles = if geometry.base_distance == 0.0 { COAXIAL } else { RANK_LOSS } / geometry.mean_mass();
        let (inertia, weight) = (Inertia::new(&mechanism), parameters.effects.weight(&mechanism)?);
        Ok(Self {
            typical_inertia: TypicalInertia::new(&geometry),
            conservative: effects.iter().all(Effect::conservative),
            has_events: effects.iter().any(Effect::has_events),
            regularization_velocity: regularization_velocity(&effects),
            may_make_contact: effects.iter().any(Effect::may_make_contact),
            sticks: effects.iter().any(Effect::sticks),
            error_tolerance: settings.error_tolerance,
            has_stiff_forces: effects.iter().any(Effect::has_stiff_forces),
            has_sharp_nonlinearity: has_sharp_nonlinearity(&effects),
            has_servo: effects.iter().any(|effect| matches!(effect, Effect::Servo(_))),
            effect_names: parameters.effects.enabled(),
            length_scale: geometry.length_scale(),
            falling: Falling::new(&mechanism, &inertia, &weight, regularization_by_angles),
            weight,
            solver: LinearSolver::new(LinearSolve::choose(&geometry, &effects), &mechanism, regularization),
            inertia,
            mechanism,
            effects,
            regularization,
            regularization_by_angles,
            max_iterations: settings.max_iterations,
            stepper: settings.stepper(&geometry, regularization, regularization_by_angles),
        })
    }

    /// The same for a run whose angles and rates come from outside: `solver.method` is not used.
    pub fn for_model_exchange(parameters: &Parameters) -> Result<Self, SceneError> {
        if let Some(name) = sticking_law(&parameters.effects) {
            return Err(SceneError(format!(
                "{name} = stick is not allowed in model exchange, whose master does not know which joints stick: it must be smooth, or the \
                 unit instantiated for co-simulation."
            )));
        }
        Ok(Self { stepper: Stepper::ModelExchange(parameters.start.assembly), ..Self::new(parameters)? })
    }

    /// Whether no effect has a force that depends on the motion, and the solve is leg by leg.
    #[inline(always)]
    pub(super) fn is_bare(&self) -> bool {
        self.effects.is_empty() && self.solver.linear_solve() == LinearSolve::TwoLeg
    }

    /// Settings of the steps in the link angles.
    pub(super) fn dense_settings(&self) -> &dense::Settings {
        match &self.stepper {
            Stepper::Dense(settings) => settings,
            Stepper::MacroStep(_) | Stepper::Conserving(_) | Stepper::ModelExchange(_) => {
                unreachable!("a run is made for its method")
            }
        }
    }

    /// Gives the active effects new parameters; the list of effects stays. Whether that changed anything; on refusal nothing has.
    pub fn tune(&mut self, in_force: &effects::Parameters, tuned: &Parameters) -> Result<bool, SceneError> {
        let parameters = &tuned.effects;
        let geometry = parameters.with_added_masses(&tuned.geometry)?;
        if geometry != self.mechanism.geometry {
            let is_dense = self.solver.linear_solve() == LinearSolve::Dense;
            if !is_dense && LinearSolve::choose(&geometry, &[]) == LinearSolve::Dense {
                return Err(too_far_apart(in_force, tuned));
            }
            *self = match self.stepper {
                Stepper::ModelExchange(_) => Self::for_model_exchange(tuned)?,
                _ => Self::new(tuned)?,
            };
            return Ok(true);
        }
        let effects = parameters.active(&self.mechanism)?;
        let weight = parameters.weight(&self.mechanism)?;
        let changed = weight != self.weight || effects != self.effects;
        self.weight = weight;
        self.falling = Falling::new(&self.mechanism, &self.inertia, &weight, self.regularization_by_angles);
        self.conservative = effects.iter().all(Effect::conservative);
        self.has_events = effects.iter().any(Effect::has_events);
        self.regularization_velocity = regularization_velocity(&effects);
        self.has_sharp_nonlinearity = has_sharp_nonlinearity(&effects);
        self.may_make_contact = effects.iter().any(Effect::may_make_contact);
        self.sticks = effects.iter().any(Effect::sticks);
        self.solver.choose(LinearSolve::choose(&self.mechanism.geometry, &effects));
        self.effects = effects;
        Ok(changed)
    }

    /// Potential energy of the active effects, J; 0 of their constant force at the left motor axis.
    pub fn potential(&self, at: &ForceContext) -> f64 {
        self.effects.iter().map(|effect| effect.potential(at)).sum::<f64>() - at.q.dot(&self.weight)
    }

    /// The generalised forces of the effects whose work is put in.
    pub(super) fn drive_forces(&self, at: &ForceContext) -> Coordinates {
        let mut forces = Coordinates::ZERO;
        self.effects
            .iter()
            .filter(|effect| matches!(effect, Effect::Servo(_)))
            .for_each(|effect| effect.add_forces(at, &mut forces));
        forces
    }

    /// How it changes, J.
    pub fn potential_change(&self, at: &ForceContext, change: &Perturbation) -> f64 {
        self.effects.iter().map(|effect| effect.potential_change(at, change)).sum::<f64>() - change.q.dot(&self.weight)
    }

    /// Whether two inputs are the same as far as they act: without servos their references do not.
    #[inline(always)]
    pub fn same_active_inputs(&self, a: &Inputs, b: &Inputs) -> bool {
        a.same_loads(b) && (!self.has_servo || a.same_references(b))
    }
}

/// The refusal of a payload with which inertias are further apart than the linear solve of a run takes, with how far it may go.
#[cold]
fn too_far_apart(in_force: &effects::Parameters, tuned: &Parameters) -> SceneError {
    let wanted = tuned.effects.payload.mass;
    let (mut taken, mut refused) = (in_force.payload.mass, wanted);
    let mut probe = tuned.effects.clone();
    for _ in 0..BISECTIONS {
        probe.payload.mass = taken + (refused - taken) / 2.0;
        let geometry = probe.with_added_masses(&tuned.geometry);
        let takes = geometry.is_ok_and(|geometry| LinearSolve::choose(&geometry, &[]) != LinearSolve::Dense);
        *(if takes { &mut taken } else { &mut refused }) = probe.payload.mass;
    }
    let side = if wanted > taken { "at most" } else { "at least" };
    SceneError(format!(
        "payload.mass = {wanted:?} kg is not allowed during this run: it must be {side} {taken:.6} kg, the limit of the linear solver \
         chosen at its start for the ratio of the links' inertias."
    ))
}

/// Halvings of an interval of masses: to six digits, from a million times as much.
const BISECTIONS: usize = 40;

/// e of the explicit method in the link angles, in multiples of 1 over the mean mass: no more than round-off makes of a singular
/// Φ_q M⁻¹ Φ_qᵀ. A larger one, say 1e-14, falsifies passes close to a vertex.
const RANK_LOSS: f64 = 1e-20;
/// The same with coaxial motors, where rank is lost along any line and no gate helps: what is on none of the branches that `ClosureBranch` knows
/// must pass softly.
const COAXIAL: f64 = 1e-10;

/// The least change of a joint's rate by which a force of any effect turns round, rad/s.
fn regularization_velocity(effects: &Active) -> f64 {
    effects.iter().map(Effect::regularization_velocity).fold(f64::INFINITY, f64::min)
}

/// Whether any effect bends sharply, and none has dry friction that sticks.
fn has_sharp_nonlinearity(effects: &Active) -> bool {
    effects.iter().any(Effect::has_sharp_nonlinearity) && !effects.iter().any(Effect::sticks)
}
