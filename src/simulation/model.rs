//! The constant part of a scene made ready, and what it is made from.

use arrayvec::ArrayVec;

use super::inertia::Inertia;
use crate::effects::{self, Active, Effect, ForceContext, Inputs, Law, Perturbation, TypicalInertia};
use crate::estimator;
use crate::integrator::dense::{Kind, Kinds};
use crate::integrator::{MacroStepMethod, dense, i3alp, i3alp_conserving, i3alp_printed, rk4};
use crate::linear::{LinearSolve, LinearSolver};
use crate::mechanism::{Assembly, Coordinates, Geometry, Mechanism, SceneError, Start};

/// How the equations of motion are integrated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Index-3 augmented Lagrangian with projections in dual form.
    #[default]
    I3alp,
    /// The same with the paper's parameters and approximate tangent.
    I3alpPrinted,
    /// Runge–Kutta of order 4 on the index-1 form with projection.
    Rk4,
    /// Runge–Kutta of order 8 in the link angles, error-controlled, with dense output.
    Dop853,
    /// Index-3 augmented Lagrangian by discrete derivatives: strictly fixed steps that keep energy and constraints.
    I3alpConserving,
    /// By the error tolerance alone: as [`Method::Dop853`], of lower order while inputs are held for short, implicit while loads are stiff.
    Automatic,
}

/// The solver's settings: the `solver.*` variables of the same names.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// Method.
    pub method: Method,
    /// Macro step h, s; of [`Method::Dop853`] and [`Method::Automatic`] also the first step tried.
    pub step_size: f64,
    /// Whether macro steps are divided where the local error asks ([`Method::I3alp`] only).
    pub adaptive: bool,
    /// Local error allowed per sub-step, rad.
    pub error_tolerance: f64,
    /// Constraint violation allowed, relative to the machine's size, at h = 1 ms.
    pub tolerance: f64,
    /// Most Newton iterations per sub-step.
    pub max_iterations: u32,
    /// Most iterations and evaluations of a macro step; of [`Method::I3alpConserving`] with those of its rescue, 0: no rescue.
    pub max_work: u32,
    /// α of the printed method, N/m.
    pub penalty: f64,
    /// κ of the default method.
    pub penalty_scale: f64,
}

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
    Outside(Assembly),
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
    pub has_kinks: bool,
    /// Whether any has dry friction that sticks.
    pub(super) sticks: bool,
    /// Local error allowed per sub-step, rad.
    pub(super) error_tolerance: f64,
    /// Whether the force of any changes steeply in places.
    pub is_steep: bool,
    /// The inertias by which the conserving method judges how stiff a force is.
    pub(super) typical_inertia: TypicalInertia,
    /// Whether an active effect reads the servo references.
    pub has_servo: bool,
    /// The linear solve that the scene needs.
    pub solver: LinearSolver,
    /// The mass matrix in the link angles.
    pub(super) inertia: Inertia,
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
        Ok(Self {
            typical_inertia: TypicalInertia::new(&geometry),
            conservative: effects.iter().all(Effect::conservative),
            has_kinks: effects.iter().any(Effect::has_kinks),
            sticks: effects.iter().any(Effect::sticks),
            error_tolerance: settings.error_tolerance,
            is_steep: effects.iter().any(Effect::is_steep),
            has_servo: effects.iter().any(|effect| matches!(effect, Effect::Servo(_))),
            effect_names: parameters.effects.enabled(),
            length_scale: geometry.length_scale(),
            weight: parameters.effects.weight(&mechanism)?,
            solver: LinearSolver::new(LinearSolve::choose(&geometry, &effects), &mechanism, regularization),
            inertia: Inertia::new(&mechanism),
            mechanism,
            effects,
            regularization,
            regularization_by_angles,
            max_iterations: settings.max_iterations,
            stepper: settings.stepper(&geometry, regularization, regularization_by_angles),
        })
    }

    /// The same for a run whose angles and rates come from outside: `solver.method` is not used.
    pub fn outside(parameters: &Parameters) -> Result<Self, SceneError> {
        if let Some(name) = sticking_law(&parameters.effects) {
            return Err(SceneError(format!(
                "{name} = stick is not allowed in model exchange, whose master does not know what holds: it must be smooth, or the unit \
                 instantiated for co-simulation."
            )));
        }
        Ok(Self { stepper: Stepper::Outside(parameters.start.assembly), ..Self::new(parameters)? })
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
            Stepper::MacroStep(_) | Stepper::Conserving(_) | Stepper::Outside(_) => unreachable!("a run is made for its method"),
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
                Stepper::Outside(_) => Self::outside(tuned)?,
                _ => Self::new(tuned)?,
            };
            return Ok(true);
        }
        let effects = parameters.active(&self.mechanism)?;
        let weight = parameters.weight(&self.mechanism)?;
        let changed = weight != self.weight || effects != self.effects;
        self.weight = weight;
        self.conservative = effects.iter().all(Effect::conservative);
        self.has_kinks = effects.iter().any(Effect::has_kinks);
        self.sticks = effects.iter().any(Effect::sticks);
        self.solver.choose(LinearSolve::choose(&self.mechanism.geometry, &effects));
        self.effects = effects;
        Ok(changed)
    }

    /// Potential energy of the active effects, J; 0 of their constant force at the left motor axis.
    pub fn potential(&self, at: &ForceContext) -> f64 {
        self.effects.iter().map(|effect| effect.potential(at)).sum::<f64>() - at.q.dot(&self.weight)
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
        "payload.mass = {wanted:?} kg is not allowed during this run: the linear solve chosen at its start takes {side} {taken:.6} kg, with \
         which the links' inertias are no further apart."
    ))
}

/// Halvings of an interval of masses: to six digits, from a million times as much.
const BISECTIONS: usize = 40;

/// The part of it that the balance may be off in a step of i3-ALP, whose work is known at its ends only: a kink leaves several such steps.
const KNOWN_AT_ENDS: f64 = 0.2;

/// The rate, 1/s, at which the machine's motion has the energy whose part the work of forces with kinks may be off: that of the error norm.
const RATE: f64 = 10.0;

/// e of the explicit method in the link angles, in multiples of 1 over the mean mass: no more than round-off makes of a singular
/// Φ_q M⁻¹ Φ_qᵀ. At 1e-14 passes close to a vertex were falsified.
const RANK_LOSS: f64 = 1e-20;
/// The same with coaxial motors, where rank is lost along any line and no gate helps: what is on none of the branches that `Parallels` knows
/// must pass softly.
const COAXIAL: f64 = 1e-10;

/// e of the conserving step in multiples of 1 over the mean mass. It weighs increments only: smaller, Newton's method finds fewer roots
/// next to vertices; larger, it takes more iterations.
const CONSERVING: f64 = 1e-7;

/// The variable of a law of friction that sticks, of an effect that is on.
pub(super) fn sticking_law(effects: &effects::Parameters) -> Option<&'static str> {
    let (friction, contact) = (&effects.friction, &effects.contact);
    let laws = [
        ("friction.law", friction.enabled && friction.law == Law::Stick),
        ("contact.law", contact.enabled && contact.law == Law::Stick),
    ];
    laws.into_iter().find_map(|(name, sticks)| sticks.then_some(name))
}

impl Settings {
    fn stepper(&self, geometry: &Geometry, regularization: f64, regularization_by_angles: f64) -> Stepper {
        let &Self { tolerance, max_iterations, .. } = self;
        let energy_scale = geometry.mean_mass() * (geometry.length_scale() * RATE).powi(2);
        Stepper::MacroStep(match self.method {
            Method::I3alp => MacroStepMethod::I3alp(i3alp::Settings {
                adaptive: self.adaptive,
                error_tolerance: self.error_tolerance,
                energy_scale: KNOWN_AT_ENDS * energy_scale,
                energy_at_start: 0.0,
                tolerance,
                max_iterations,
                max_work: self.max_work,
                regularization,
            }),
            Method::I3alpPrinted => {
                MacroStepMethod::I3alpPrinted(i3alp_printed::Settings { penalty: self.penalty, max_iterations })
            }
            Method::Rk4 => MacroStepMethod::Rk4(rk4::Settings { projection: true, regularization, tolerance, max_iterations }),
            Method::I3alpConserving => {
                return Stepper::Conserving(i3alp_conserving::Settings {
                    max_iterations,
                    max_work: self.max_work,
                    regularization: CONSERVING * regularization * self.penalty_scale,
                    equilibrium: regularization,
                });
            }
            Method::Dop853 | Method::Automatic => {
                let kinds = if self.method == Method::Automatic { Kinds::Automatic } else { Kinds::Only(Kind::Eighth) };
                return Stepper::Dense(dense::Settings {
                    kinds,
                    error_tolerance: self.error_tolerance,
                    energy_scale,
                    first_step: self.step_size,
                    max_iterations,
                    max_work: self.max_work,
                    regularization: regularization_by_angles,
                });
            }
        })
    }

    /// Friction that sticks needs steps that end where something stops or lets go.
    fn check_laws(&self, effects: &effects::Parameters) -> Result<(), SceneError> {
        let Some(name) = sticking_law(effects) else { return Ok(()) };
        let steps = match self.method {
            Method::Dop853 | Method::Automatic => return Ok(()),
            Method::I3alp if self.adaptive => return Ok(()),
            Method::I3alp => "solver.method = i3alp and solver.adaptive = false",
            Method::I3alpPrinted => "solver.method = i3alpPrinted",
            Method::Rk4 => "solver.method = rk4",
            Method::I3alpConserving => "solver.method = i3alpConserving",
        };
        Err(SceneError(format!(
            "{name} = stick is not allowed with {steps}, whose steps cannot end where something stops or lets go: it must be smooth, or \
             solver.method i3alp with solver.adaptive = true, dop853 or automatic."
        )))
    }

    fn check(&self) -> Result<(), SceneError> {
        for (name, value, unit) in [
            ("stepSize", self.step_size, "s"),
            ("errorTolerance", self.error_tolerance, "rad"),
            ("tolerance", self.tolerance, "(relative)"),
            ("penalty", self.penalty, "N/m"),
            ("penaltyScale", self.penalty_scale, "(relative)"),
        ] {
            crate::mechanism::positive(format_args!("solver.{name}"), value, unit)?;
        }
        if self.max_iterations == 0 {
            return Err(SceneError("solver.maxIterations = 0 is not allowed: it must be 1 or more.".into()));
        }
        Ok(())
    }
}
