//! How a scene is integrated: the `solver.*` variables, and what each method reads of them.

use super::model::Stepper;
use crate::effects::{self, Law};
use crate::integrator::dense::{Scheme, Schemes};
use crate::integrator::{MacroStepMethod, dense, i3alp, i3alp_conserving, i3alp_printed, rk4};
use crate::mechanism::{Geometry, SceneError};

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

/// The part of it that the balance may be off in a step of i3-ALP, whose work is known at its ends only: a kink leaves several such steps.
const KNOWN_AT_ENDS: f64 = 0.2;

/// The rate, 1/s, at which the machine's motion has the energy whose part the work of forces with kinks may be off: that of the error norm.
const RATE: f64 = 10.0;

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
    /// The integrator with what of them it reads.
    pub(super) fn stepper(&self, geometry: &Geometry, regularization: f64, regularization_by_angles: f64) -> Stepper {
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
                let schemes = if self.method == Method::Automatic { Schemes::Automatic } else { Schemes::Only(Scheme::Dop853) };
                return Stepper::Dense(dense::Settings {
                    schemes,
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
    pub(super) fn check_laws(&self, effects: &effects::Parameters) -> Result<(), SceneError> {
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
            "{name} = stick is not allowed with {steps}, whose steps cannot end at stick-slip transitions: it must be smooth, or \
             solver.method i3alp with solver.adaptive = true, dop853 or automatic."
        )))
    }

    /// Refuses what no method takes.
    pub(super) fn check(&self) -> Result<(), SceneError> {
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
