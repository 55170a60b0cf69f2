//! The constant part of a scene made ready, and what it is made from.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};

use super::two_leg::Elimination;
use crate::effects::{self, Active, Change, Effect, Inputs, Situation};
use crate::integrator::{dop853, i3alp, i3alp_printed, rk4};
use crate::mechanism::{Coordinates, Geometry, Mechanism, Refusal, Start};

/// How the equations of motion are integrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Index-3 augmented Lagrangian with projections in dual form.
    I3alp,
    /// The same with the paper's parameters and approximate tangent.
    I3alpPrinted,
    /// Runge–Kutta of order 4 on the index-1 form with projection.
    Rk4,
    /// Runge–Kutta of order 8 in the link angles, error-controlled, with dense output.
    Dop853,
}

/// The solver's settings: the `solver.*` variables of the same names.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Method.
    pub method: Method,
    /// Macro step h, s; of [`Method::Dop853`] also the first step tried.
    pub step_size: f64,
    /// Whether macro steps are divided where the local error asks ([`Method::I3alp`] only).
    pub adaptive: bool,
    /// Local error allowed per sub-step, rad.
    pub error_tolerance: f64,
    /// Constraint violation allowed, relative to the machine's size, at h = 1 ms.
    pub tolerance: f64,
    /// Most Newton iterations per sub-step.
    pub max_iterations: u32,
    /// α of the printed method, N/m.
    pub penalty: f64,
    /// κ of the default method.
    pub penalty_scale: f64,
}

/// Everything that defines a scene, before it is made ready.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// The mechanism.
    pub geometry: Geometry,
    /// Where it starts.
    pub start: Start,
    /// How it is integrated.
    pub settings: Settings,
    /// What acts on it.
    pub effects: effects::Parameters,
}

/// The integrator with the settings it reads.
#[derive(Clone, Copy, Debug)]
pub enum Stepper {
    /// The default.
    I3alp(i3alp::Settings),
    /// As printed in the paper.
    I3alpPrinted(i3alp_printed::Settings),
    /// Runge–Kutta.
    Rk4(rk4::Settings),
    /// Runge–Kutta with error control, in the link angles.
    Dop853(dop853::Settings),
}

/// The linear solves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum Solve {
    /// Leg by leg, without effects whose force depends on the motion. See [`two_leg`](super::two_leg).
    Bare,
    /// Leg by leg: no active effect couples links.
    TwoLegged,
    /// Active effects couple links. See [`coupled`](super::coupled).
    LinksCoupled,
    /// Anything: compliances are far apart. See [`dense`](super::dense).
    Dense,
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
    /// Whether an active effect reads the servo references.
    pub servo: bool,
    /// What the fast linear solve has computed beforehand.
    pub elimination: Elimination,
    /// What round-off in Φ is proportional to, m.
    pub size: f64,
    /// e of the saddle-point systems outside the printed method, 1/kg.
    pub softness: f64,
    /// The integrator.
    pub stepper: Stepper,
    /// The linear solve that the scene needs.
    pub solve: Solve,
}

impl Model {
    /// Checks the parameters and fixes everything that stays constant.
    pub fn new(parameters: &Parameters) -> Result<Self, Refusal> {
        let settings = &parameters.settings;
        settings.check()?;
        parameters.geometry.check()?;
        let geometry = parameters.effects.burdened(&parameters.geometry)?;
        let mechanism = Mechanism::new(&geometry)?;
        let effects = parameters.effects.active(&mechanism)?;
        // e = 1/(αβ) with α = κ m̄/β.
        let softness = 1.0 / (settings.penalty_scale * geometry.mean_mass());
        let Settings { tolerance, max_iterations, .. } = *settings;
        let stepper = match settings.method {
            Method::I3alp => Stepper::I3alp(i3alp::Settings {
                adaptive: settings.adaptive,
                error_tolerance: settings.error_tolerance,
                tolerance,
                max_iterations,
                softness,
            }),
            Method::I3alpPrinted => Stepper::I3alpPrinted(i3alp_printed::Settings { penalty: settings.penalty, max_iterations }),
            Method::Dop853 => Stepper::Dop853(dop853::Settings {
                error_tolerance: settings.error_tolerance,
                first_step: settings.step_size,
                max_iterations,
                softness: if geometry.base_distance == 0.0 { COAXIAL } else { RANK_LOSS } / geometry.mean_mass(),
            }),
            Method::Rk4 => Stepper::Rk4(rk4::Settings { projection: true, softness, tolerance, max_iterations }),
        };
        Ok(Self {
            solve: if compliance_spread(&geometry) > LARGEST_SPREAD {
                Solve::Dense
            } else if effects.iter().any(Effect::couples_links) {
                Solve::LinksCoupled
            } else if effects.is_empty() {
                Solve::Bare
            } else {
                Solve::TwoLegged
            },
            conservative: effects.iter().all(Effect::conservative),
            servo: effects.iter().any(|effect| matches!(effect, Effect::Servo(_))),
            effect_names: parameters.effects.enabled(),
            size: geometry.size(),
            weight: parameters.effects.weight(&mechanism)?,
            elimination: Elimination::new(&mechanism, softness),
            mechanism,
            effects,
            softness,
            stepper,
        })
    }

    /// Gives the active effects new parameters; the list of effects and the linear solve stay. Whether that changed anything; on
    /// refusal nothing has.
    pub fn tune(&mut self, parameters: &effects::Parameters) -> Result<bool, Refusal> {
        let effects = parameters.active(&self.mechanism)?;
        if let Some(effect) = effects.iter().find(|effect| effect.couples_links() && self.solve == Solve::TwoLegged) {
            return Err(Refusal(format!(
                "{0}.* at joints 2 to 4 is not allowed to become positive now: it was 0 at the end of initialisation, which fixed a linear \
                 solve without coupled links; start with a positive value there.",
                effect.name()
            )));
        }
        let weight = parameters.weight(&self.mechanism)?;
        let changed = weight != self.weight || effects != self.effects;
        self.weight = weight;
        self.conservative = effects.iter().all(Effect::conservative);
        self.effects = effects;
        Ok(changed)
    }

    /// Potential energy of the active effects, J; 0 of their constant force at the left motor axis.
    pub fn potential(&self, at: &Situation) -> f64 {
        let weight: f64 = at.q.iter().zip(&self.weight).map(|(x, weight)| x * weight).sum();
        self.effects.iter().map(|effect| effect.potential(at)).sum::<f64>() - weight
    }

    /// How it changes, J.
    pub fn potential_change(&self, at: &Situation, change: &Change) -> f64 {
        let weight: f64 = change.q.iter().zip(&self.weight).map(|(x, weight)| x * weight).sum();
        self.effects.iter().map(|effect| effect.potential_change(at, change)).sum::<f64>() - weight
    }

    /// Whether the scene hears no difference between two inputs.
    #[inline(always)]
    pub fn hears_the_same(&self, a: &Inputs, b: &Inputs) -> bool {
        a.same_loads(b) && (!self.servo || a.same_references(b))
    }

    /// The part of the inputs that the scene hears: without servos no references.
    pub fn heard(&self, inputs: &Inputs) -> Inputs {
        if self.servo { *inputs } else { inputs.without_references() }
    }
}

/// e of the explicit method in the link angles, in multiples of 1 over the mean mass: no more than round-off makes of a singular
/// Φ_q M⁻¹ Φ_qᵀ. At 1e-14 passes close to a vertex were falsified.
const RANK_LOSS: f64 = 1e-20;
/// The same with coaxial motors, where links of equal lengths lose rank in every direction and no gate helps: motions must pass softly.
const COAXIAL: f64 = 1e-10;

/// Beyond this spread of compliances the differences of the two-leg elimination lose too many digits: its error is the square of the
/// spread times ε. The paper's links have 3.
const LARGEST_SPREAD: f64 = 1e4;

/// Largest over smallest compliance of the links' ends, 1/m and arm²/I.
fn compliance_spread(geometry: &Geometry) -> f64 {
    let compliances = geometry.links.iter().flat_map(|link| {
        let arm = link.com.abs().max((link.length - link.com).abs());
        [1.0 / link.mass, (1.0 / link.mass).max(arm * arm / link.inertia)]
    });
    let (least, most) = compliances.fold((f64::INFINITY, 0.0_f64), |(least, most), x| (least.min(x), most.max(x)));
    most / least
}

impl Settings {
    fn check(&self) -> Result<(), Refusal> {
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
            return Err(Refusal("solver.maxIterations = 0 is not allowed: it must be 1 or more.".into()));
        }
        Ok(())
    }
}
