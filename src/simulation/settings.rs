//! Settings of the solver: the `solver.*` variables, and the friction laws that each method allows.

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
    /// Error control: Dop853, a pair of lower order if inputs change often, a Rosenbrock method while loads are stiff.
    Automatic,
}

/// Settings of the solver: the `solver.*` variables of the same names.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// Integration method.
    pub method: Method,
    /// Macro step h, s; for [`Method::Dop853`] and [`Method::Automatic`] also the first step tried.
    pub step_size: f64,
    /// Whether macro steps are divided to meet the local error ([`Method::I3alp`] only).
    pub adaptive: bool,
    /// Local error allowed per sub-step, rad.
    pub error_tolerance: f64,
    /// Allowed constraint violation at h = 1 ms, relative to the machine's size.
    pub tolerance: f64,
    /// Largest number of Newton iterations per sub-step.
    pub max_iterations: u32,
    /// Largest number of iterations and evaluations per macro step; [`Method::I3alpConserving`] includes its fallback stages, and 0 allows
    /// none.
    pub max_work: u32,
    /// Penalty α of the printed method, N/m.
    pub penalty: f64,
    /// Penalty scale κ of the default method, dimensionless.
    pub penalty_scale: f64,
    /// Whether steps are checked for violations that no correct step shows.
    pub checks: bool,
}

/// Name of the variable that selects stick-slip friction in an active effect; `None` if none does.
pub(super) fn sticking_law(effects: &effects::Parameters) -> Option<&'static str> {
    let (friction, contact) = (&effects.friction, &effects.contact);
    let laws = [
        ("friction.law", friction.enabled && friction.law == Law::Stick),
        ("contact.law", contact.enabled && contact.law == Law::Stick),
    ];
    laws.into_iter().find_map(|(name, sticks)| sticks.then_some(name))
}

impl Settings {
    /// Whether the method controls its error, so that its steps may end at events.
    pub(super) fn follows_error(&self) -> bool {
        match self.method {
            Method::Dop853 | Method::Automatic => true,
            Method::I3alp => self.adaptive,
            Method::I3alpPrinted | Method::Rk4 | Method::I3alpConserving => false,
        }
    }

    /// Refuses stick-slip friction with a method that cannot end its steps at events.
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
