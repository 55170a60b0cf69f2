//! Parameters of a scene, and the constant [`Model`] made from them: mechanism, active effects, linear solver, settings of the method.

use arrayvec::ArrayVec;

use super::bindings::check_bounds;
use super::settings::Settings;
use crate::dynamics::angles::{Inertia, Weight};
use crate::effects::{self, Active, Effect, Inputs, Motion, MotionChange, PowerFlow, Properties, TypicalInertia, Wrench};
use crate::estimator;
use crate::hybrid::Kinks;
use crate::integrator::Features;
use crate::linear::{LinearSolve, LinearSolver};
use crate::mechanism::{ClosureBranch, Coordinates, Geometry, Mechanism, SceneError, Start, TOLERANCE_OF_TURN};

/// Parameters that define a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Geometry and masses of the mechanism.
    pub geometry: Geometry,
    /// Initial angles and rates.
    pub start: Start,
    /// Settings of the solver.
    pub settings: Settings,
    /// Parameters of the effects.
    pub effects: effects::Parameters,
    /// Parameters of the estimator.
    pub estimator: estimator::Parameters,
}

/// Constant part of a simulation.
#[derive(Clone, Debug)]
pub struct Model {
    /// Mechanism, stored by legs.
    pub mechanism: Mechanism,
    /// Constant generalised force of the active effects, N and N·m.
    pub weight: Coordinates,
    /// Active effects with forces that depend on the motion; constant forces are in `weight`, added masses in `mechanism`.
    pub effects: Active,
    /// Names of all active effects.
    pub effect_names: ArrayVec<&'static str, { effects::NAMES.len() }>,
    /// Whether all forces have a potential.
    pub conservative: bool,
    /// Features of the active effects. Events are among them only if the method ends its steps at events.
    pub(super) features: Features,
    /// Whether the force of any effect has kinks.
    pub(super) has_kinks: bool,
    /// Typical inertias, to judge the stiffness of a force in the conserving method.
    pub(super) typical_inertia: TypicalInertia,
    /// Whether an active effect reads the servo references.
    pub has_servo: bool,
    /// Time from a new servo reference to its effect, s; 0 without servos.
    pub command_delay: f64,
    /// Linear solver that the scene needs.
    pub solver: LinearSolver,
    /// Constant part of the mass matrix in the link angles.
    pub(super) inertia: Inertia,
    /// Constant force of the active effects in the link angles.
    pub(super) weight_torques: Weight,
    /// Length scale of round-off in Φ, m.
    pub length_scale: f64,
    /// e of the saddle-point systems outside the printed method, 1/kg.
    pub regularization: f64,
    /// e of the saddle-point systems in the link angles, 1/kg.
    pub(super) regularization_by_angles: f64,
    /// Distance, rad, within which a motion turns beside the posture with all links in line, if the machine nearly has branches.
    pub(super) turn_in_line: Option<f64>,
    /// Settings of the solver.
    pub settings: Settings,
}

impl Model {
    /// Checks the parameters and computes everything that stays constant. Refuses values that are outside their bounds or do not fit
    /// together.
    pub fn new(parameters: &Parameters) -> Result<Self, SceneError> {
        check_bounds(parameters)?;
        Self::within_bounds(parameters)
    }

    /// The model on the heap. Not inlined: the stack has no room for a second model.
    #[inline(never)]
    pub(super) fn boxed(parameters: &Parameters) -> Result<Box<Self>, SceneError> {
        Self::new(parameters).map(Box::new)
    }

    /// Model of parameters within their bounds, given or learned; refuses values that do not fit together.
    pub(super) fn within_bounds(parameters: &Parameters) -> Result<Self, SceneError> {
        let settings = &parameters.settings;
        let geometry = parameters.effects.with_added_masses(&parameters.geometry);
        let mechanism = Mechanism::new(&geometry);
        let effects = parameters.effects.active(&mechanism)?;
        settings.check_laws(&parameters.effects)?;
        // e = 1/(αβ) with α = κ m̄/β.
        let regularization = 1.0 / (settings.penalty_scale * geometry.mean_mass());
        let regularization_by_angles =
            if geometry.turns_in_line() { IN_LINE_REGULARIZATION } else { ANGLE_REGULARIZATION } / geometry.mean_mass();
        let turn_in_line = ClosureBranch::turn_in_line(&geometry);
        let mut settings = settings.clone();
        if let Some(turn) = turn_in_line {
            settings.error_tolerance = settings.error_tolerance.min(TOLERANCE_OF_TURN * turn);
        }
        let (inertia, weight) = (Inertia::new(&mechanism), parameters.effects.weight(&mechanism));
        let mut model = Self {
            typical_inertia: TypicalInertia::new(&geometry),
            conservative: true,
            features: Features::SMOOTH,
            has_kinks: false,
            has_servo: false,
            command_delay: parameters.effects.servo.command_delay(),
            effect_names: parameters.effects.enabled(),
            length_scale: geometry.length_scale(),
            weight_torques: Weight::new(&mechanism, &weight),
            weight,
            solver: LinearSolver::new(LinearSolve::choose(&geometry), &mechanism, regularization),
            inertia,
            mechanism,
            effects,
            regularization,
            regularization_by_angles,
            turn_in_line,
            settings,
        };
        model.note_properties();
        Ok(model)
    }

    /// Changes the geometry, including added masses, only in the equations of motion in the link angles.
    pub(super) fn lengthen(&mut self, geometry: &Geometry) {
        self.mechanism = Mechanism::new(geometry);
        self.turn_in_line = ClosureBranch::turn_in_line(geometry);
        (self.inertia, self.weight_torques) = (Inertia::new(&self.mechanism), Weight::new(&self.mechanism, &self.weight));
    }

    /// Stores the properties of the active effects that methods read in every step.
    fn note_properties(&mut self) {
        let properties = || self.effects.iter().map(|effect| effect.properties());
        let any = |property: fn(&Properties) -> bool| properties().any(|of| property(&of));
        let may_stick = any(|of| of.may_stick);
        self.conservative = properties().all(|of| of.conservative);
        self.has_kinks = self.effects.iter().any(Effect::has_kinks);
        self.has_servo = self.effects.iter().any(|effect| matches!(effect, Effect::Servo(_)));
        self.features = Features {
            work: !self.conservative,
            stiff: any(|of| of.stiff),
            events: self.settings.follows_error() && (self.has_kinks || may_stick),
            may_stick,
            sharp: !may_stick && any(|of| of.sharp),
            special_constraints: false,
            checks: self.settings.checks,
            regularization_velocity: properties().map(|of| of.regularization_velocity).fold(f64::INFINITY, f64::min),
        };
    }

    /// Whether no effect has a force that depends on the motion and the solve is leg by leg.
    pub(super) fn is_bare(&self) -> bool {
        self.effects.is_empty() && self.solver.linear_solve() == LinearSolve::Structured
    }

    /// Changes parameters of the active effects, within their bounds; the same effects remain active. Returns whether anything has changed.
    /// A refusal changes nothing. Not inlined, so that its temporary models have left the stack when the run adapts to the change.
    #[inline(never)]
    pub(super) fn tune(&mut self, in_force: &effects::Parameters, tuned: &Parameters) -> Result<bool, SceneError> {
        let parameters = &tuned.effects;
        let geometry = parameters.with_added_masses(&tuned.geometry);
        if geometry != self.mechanism.geometry {
            let is_dense = self.solver.linear_solve() == LinearSolve::Dense;
            if !is_dense && LinearSolve::choose(&geometry) == LinearSolve::Dense {
                return Err(inertia_ratio_refusal(in_force, tuned));
            }
            *self = Self::within_bounds(tuned)?;
            return Ok(true);
        }
        let effects = parameters.active(&self.mechanism)?;
        let weight = parameters.weight(&self.mechanism);
        let changed = weight != self.weight || effects != self.effects;
        (self.weight, self.weight_torques) = (weight, Weight::new(&self.mechanism, &weight));
        self.effects = effects;
        self.note_properties();
        Ok(changed)
    }

    /// Potential energy of the active effects at coordinates and their motion, J; for the constant force it is 0 at the left motor axis.
    pub fn potential(&self, q: &Coordinates, at: &Motion) -> f64 {
        self.effects.iter().map(|effect| effect.potential(at)).sum::<f64>() - q.dot(&self.weight)
    }

    /// Kinks of the active effects at a motion.
    pub fn kinks(&self, at: &Motion) -> Kinks<'_> {
        let mut kinks = Kinks::new();
        for effect in &self.effects {
            effect.add_kinks(at, &mut kinks);
        }
        kinks
    }

    /// Wrench of the effects that supply work, which counts as input.
    pub(super) fn drives(&self, at: &Motion) -> Wrench {
        let mut wrench = Wrench::default();
        for drive in self.effects.iter().filter(|effect| effect.properties().power_flow == PowerFlow::Supplied) {
            drive.act(at, &mut wrench);
        }
        wrench
    }

    /// Change of the potential energy of the active effects, J, for a change of the coordinates and the corresponding change of the motion.
    pub fn potential_change(&self, q_change: &Coordinates, at: &Motion, change: &MotionChange) -> f64 {
        // Computed with the change as a velocity: dU/dt = input − dissipation − power of the wrench.
        let mut moving = Motion { velocity: change.position, ..*at };
        moving.joints.rates = change.angles;
        let stored = self.effects.iter().map(|effect| {
            let mut wrench = Wrench::default();
            let [input, dissipated] = effect.act(&moving, &mut wrench);
            input - dissipated - wrench.power(&change.angles, change.position)
        });
        stored.sum::<f64>() - q_change.dot(&self.weight)
    }

    /// Whether two inputs have the same effect; servo references count only with servos.
    pub fn same_active_inputs(&self, a: &Inputs, b: &Inputs) -> bool {
        a.same_loads(b) && (!self.has_servo || a.same_references(b))
    }
}

/// Refusal of a payload that makes the inertia ratio too large for the linear solve of this run; names the mass that is still allowed.
fn inertia_ratio_refusal(in_force: &effects::Parameters, tuned: &Parameters) -> SceneError {
    let wanted = tuned.effects.payload.mass;
    let (mut taken, mut refused) = (in_force.payload.mass, wanted);
    let mut probe = tuned.effects.clone();
    for _ in 0..BISECTIONS {
        probe.payload.mass = taken + (refused - taken) / 2.0;
        let geometry = probe.with_added_masses(&tuned.geometry);
        let takes = LinearSolve::choose(&geometry) != LinearSolve::Dense;
        *(if takes { &mut taken } else { &mut refused }) = probe.payload.mass;
    }
    let side = if wanted > taken { "at most" } else { "at least" };
    SceneError(format!(
        "payload.mass = {wanted:?} kg is not allowed during this run: it must be {side} {taken:.6} kg, the limit of the linear solver \
         chosen at the start of the run for the ratio of the links' inertias."
    ))
}

/// Bisections of the mass interval: 40 give six digits over a range of a million to one.
const BISECTIONS: usize = 40;

/// e of the error-controlled methods in the link angles, relative to 1 over the mean mass: at most the round-off of a singular
/// Φ_q M⁻¹ Φ_qᵀ, because even 1e-14 falsifies passages close to a vertex.
const ANGLE_REGULARIZATION: f64 = 1e-20;
/// e in the link angles if all links in line turn about coaxial motors, relative to 1 over the mean mass. It is larger, because rank is
/// lost along whole lines of configurations, and a motion on none of the known closure branches needs bounded joint forces there. If the
/// links only come close to a line, this e would carry a motion from one side to the other.
const IN_LINE_REGULARIZATION: f64 = 1e-10;
