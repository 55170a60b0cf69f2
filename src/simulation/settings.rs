//! Settings of the solver: the `solver.*` variables, and the friction laws that each method allows.

use super::methods::Steps;
use crate::effects::{self, Law};
use crate::mechanism::SceneError;
pub use crate::variables::Method;

/// Value before the start value of the XML is written.
impl Default for Method {
    fn default() -> Self {
        Self::I3alp
    }
}

/// Settings of the solver: the `solver.*` variables of the same names.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// Integration method.
    pub method: Method,
    /// Macro step h, s; of methods with dense output also the first step tried.
    pub step_size: f64,
    /// Whether macro steps are divided as the local error requires ([`Steps::Adaptive`] only).
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
    /// Whether steps are checked for violations that no correct step has.
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
        match self.method.properties().steps {
            Steps::Fixed => false,
            Steps::Adaptive => self.adaptive,
            Steps::Dense => true,
        }
    }

    /// Refuses stick-slip friction with a method that cannot end its steps at events.
    pub(super) fn check_laws(&self, effects: &effects::Parameters) -> Result<(), SceneError> {
        let Some(name) = sticking_law(effects).filter(|_| !self.follows_error()) else { return Ok(()) };
        let fixed = if self.method.uses_adaptive() { " and solver.adaptive = false" } else { "" };
        let others: Vec<String> = Method::LIST
            .iter()
            .filter_map(|method| match method.properties().steps {
                Steps::Fixed => None,
                Steps::Adaptive => Some(format!("{} with solver.adaptive = true", method.name())),
                Steps::Dense => Some(method.name().to_owned()),
            })
            .collect();
        Err(SceneError(format!(
            "{name} = stick is not allowed with solver.method = {}{fixed}, whose steps cannot end at stick-slip transitions: it must be \
             smooth, or solver.method must be one of {}.",
            self.method.name(),
            others.join(", ")
        )))
    }
}
