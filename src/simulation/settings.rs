//! Settings of the solver: the `solver.*` variables, and which of them a scene may have.

use crate::effects::{self, Law};
use crate::mechanism::SceneError;

/// Integration method.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Index-3 augmented Lagrangian with projections in dual form.
    #[default]
    I3alp,
    /// Index-3 augmented Lagrangian with the parameters and the approximate tangent of the paper.
    I3alpPrinted,
    /// Runge–Kutta of order 4 on the index-1 form with projection.
    Rk4,
    /// Runge–Kutta of order 8 in the link angles, error-controlled, with dense output.
    Dop853,
    /// Index-3 augmented Lagrangian by discrete derivatives: strictly fixed steps that keep energy and constraints.
    I3alpConserving,
    /// Error control alone: Dop853, a pair of lower order while inputs are held briefly, a Rosenbrock method while loads are stiff.
    Automatic,
}

/// The solver's settings: the `solver.*` variables of the same names.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// Integration method.
    pub method: Method,
    /// Macro step h, s; of [`Method::Dop853`] and [`Method::Automatic`] also the first step tried.
    pub step_size: f64,
    /// Whether macro steps are divided where the local error asks ([`Method::I3alp`] only).
    pub adaptive: bool,
    /// Local error allowed per sub-step, rad.
    pub error_tolerance: f64,
    /// Constraint violation allowed at h = 1 ms, relative to the machine's size.
    pub tolerance: f64,
    /// Largest number of Newton iterations per sub-step.
    pub max_iterations: u32,
    /// Largest number of iterations and evaluations per macro step; for [`Method::I3alpConserving`] including its fallback stages, 0: none.
    pub max_work: u32,
    /// Penalty α of the printed method, N/m.
    pub penalty: f64,
    /// Penalty scale κ of the default method, dimensionless.
    pub penalty_scale: f64,
    /// Whether steps are checked against what no right step breaks.
    pub checks: bool,
}

/// Name of the variable that selects stick-slip friction in an active effect, if any does.
pub(super) fn sticking_law(effects: &effects::Parameters) -> Option<&'static str> {
    let (friction, contact) = (&effects.friction, &effects.contact);
    let laws = [
        ("friction.law", friction.enabled && friction.law == Law::Stick),
        ("contact.law", contact.enabled && contact.law == Law::Stick),
    ];
    laws.into_iter().find_map(|(name, sticks)| sticks.then_some(name))
}

impl Settings {
    /// Whether the method follows its error, so that its steps may end at events.
    pub(super) fn follows_error(&self) -> bool {
        match self.method {
            Method::Dop853 | Method::Automatic => true,
            Method::I3alp => self.adaptive,
            Method::I3alpPrinted | Method::Rk4 | Method::I3alpConserving => false,
        }
    }

    /// Refuses stick-slip friction with a method whose steps cannot end at an event.
    pub(super) fn check_laws(&self, effects: &effects::Parameters) -> Result<(), SceneError> {
        let Some(name) = sticking_law(effects).filter(|_| !self.follows_error()) else { return Ok(()) };
        let steps = match self.method {
            Method::Dop853 | Method::Automatic => return Ok(()),
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
}
