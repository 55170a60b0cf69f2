//! Consistency checks of a stored run against the model and parameters under which it is restored.

use super::angles::AngleSystem;
use super::commands::Delay;
use super::five_bar::FiveBar;
use super::model::Model;
use super::run::{Integrator, Run};
use super::{Parameters, Settings};
use crate::integrator::Bounds;
use crate::mechanism::SceneError;

/// Tolerance of the constraints, relative to the machine's size, unless the solver's tolerance allows more.
const POSITION_TOLERANCE: f64 = 1e-10;
/// Tolerance of the constraint rates, relative to their largest term, also next to a vertex, unless the solver's tolerance allows more.
const RATE_TOLERANCE: f64 = 1e-5;

impl Run {
    /// Refuses a run that is inconsistent with this model.
    pub(super) fn check(&self, model: &Model, parameters: &Parameters) -> Result<(), SceneError> {
        let Self { turns, inputs, energy_at_start, integrator, commands } = self;
        if !inputs.are_finite() || !energy_at_start.is_finite() {
            return Err(SceneError("an input or an energy is not finite".into()));
        }
        match (commands, Delay::of(model)) {
            (None, None) => {}
            (Some(commands), Some(delay)) => commands.check(delay).map_err(|what| SceneError(what.into()))?,
            (None, Some(_)) => return Err(SceneError("the commands that wait for servo.delay are missing".into())),
            (Some(_), None) => return Err(SceneError("commands wait, but no servo acts late".into())),
        }
        let system = FiveBar::new(model, inputs, turns);
        let bounds = bounds(&parameters.settings);
        match integrator {
            Integrator::MacroStepped(run) => {
                let system = system.on(run.mode);
                system.check_stick_slip([&run.core.q, &run.core.v], false).and_then(|()| run.core.check(&system, &bounds))
            }
            Integrator::Conserving(run) => run.state.check(&system, &bounds, model.regularization),
            Integrator::DenseOutput(run) => run.check(&AngleSystem::new(system), &bounds),
            Integrator::ModelExchange(run) => run.check(model, inputs, &bounds),
        }
        .map_err(|what| SceneError(what.into()))
    }
}

/// Tolerances within which the method satisfies the constraints.
fn bounds(settings: &Settings) -> Bounds {
    let allowed = 4.0 * settings.tolerance;
    let usual = Bounds { position: POSITION_TOLERANCE.max(allowed), velocity: RATE_TOLERANCE.max(allowed) };
    settings.method.properties().constraints.unwrap_or(usual)
}
