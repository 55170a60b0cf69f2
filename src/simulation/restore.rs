//! Consistency checks of a stored run with the model and parameters that it is restored under.

use super::angles::AngleSystem;
use super::five_bar::FiveBar;
use super::model::{Model, Stepper};
use super::passage::VERTEX_REGULARIZATION;
use super::run::{IntegratorState, Run};
use super::stick_slip;
use super::{Method, Parameters, Settings};
use crate::effects::{Mode, StickSlips};
use crate::integrator::{Bounds, Implicit, Inconsistency, System};
use crate::mechanism::{Coordinates, SceneError};

/// Tolerance of the constraints, relative to the machine's size, unless the solver's tolerance allows more.
const POSITION_TOLERANCE: f64 = 1e-10;
/// Tolerance of the constraints for the printed method, relative: its Newton iteration stops at 1e-8.
const PRINTED_POSITION_TOLERANCE: f64 = 1e-7;
/// Tolerances of the constraint rates, relative to their largest term: of all methods but one, also next to a vertex; and of the printed
/// method, whose finite penalty leaves a sixth of them in short steps.
const RATE_TOLERANCES: [f64; 2] = [1e-5, 0.5];
impl Run {
    /// Refuses a run that is inconsistent with this model.
    pub(super) fn check(&self, model: &Model, parameters: &Parameters) -> Result<(), SceneError> {
        let Self { turns, inputs, energy_at_start, integrator } = self;
        if !inputs.are_finite() || !energy_at_start.is_finite() {
            return Err(SceneError("an input or an energy is not finite".into()));
        }
        let system = FiveBar::<false>::new(model, inputs, turns);
        match (&model.stepper, integrator) {
            (Stepper::MacroStep(_), IntegratorState::MacroStepped(core, stick_slip)) => {
                let system = system.on(Mode::of_stick_slip(*stick_slip));
                check_stick_slip(model, &system, [&core.q, &core.v], false)
                    .and_then(|()| core.check(&system, &bounds(model, &parameters.settings)))
            }
            (Stepper::Conserving(_), IntegratorState::Conserving(run)) => run.check(&system, &bounds(model, &parameters.settings)),
            (Stepper::Dense(settings), IntegratorState::DenseOutput(run)) => {
                let e = settings.regularization;
                let bounds = Bounds { regularizations: [e, e], ..bounds(model, &parameters.settings) };
                run.check(&AngleSystem::new(system), settings, &bounds)
            }
            (Stepper::ModelExchange(_), IntegratorState::ModelExchange(run)) => {
                run.check(model, inputs, &bounds(model, &parameters.settings))
            }
            _ => Err("it belongs to another solver.method than the one that is set in it"),
        }
        .map_err(|what| SceneError(what.into()))
    }
}

/// Refuses stick-slip states that are impossible in a state.
pub(super) fn check_stick_slip(
    model: &Model,
    system: &FiveBar<'_>,
    [q, v]: [&Coordinates; 2],
    just_stopped: bool,
) -> Result<(), Inconsistency> {
    let possible = if model.sticks {
        stick_slip::are_possible(system, q, v, just_stopped)
    } else {
        system.mode.stick_slip == StickSlips::OPEN
    };
    if possible { Ok(()) } else { Err("friction does not hold or slip as it says") }
}

impl Run {
    /// Sums of absolute residuals: of the equations of motion, N and N·m, including the predicted acceleration at the end of a macro step
    /// of h seconds, and of the constraint rates, m/s. Both are 0 for a run whose step under way is checked by repetition.
    pub(super) fn errors(&self, model: &Model, h: f64) -> [f64; 2] {
        let system = FiveBar::<false>::new(model, &self.inputs, &self.turns);
        let (core, remembered) = match &self.integrator {
            IntegratorState::MacroStepped(core, _) => (*core, 0.0),
            // Accelerations follow from equilibrium here: they reveal whether the stored inputs are those that the run has held.
            IntegratorState::Conserving(run) => {
                let core = run.state(&system, model.regularization);
                (core, run.remembered() + core.a.iter().map(|x| x.abs()).sum::<f64>())
            }
            IntegratorState::DenseOutput(_) | IntegratorState::ModelExchange(_) => return [0.0; 2],
        };
        let pose = system.pose(&core.q);
        let left = system.mass_times(&pose, &(core.a + h * core.jerk)) + system.phi_q_transposed_times(&pose, &core.lambda);
        let forces = left - system.forces(&core.q, &pose, &core.v);
        [forces.iter().map(|x| x.abs()).sum::<f64>() + remembered, system.phi_q_times(&pose, &core.v).iter().map(|x| x.abs()).sum()]
    }
}

/// Tolerances to which the method keeps constraints and equilibrium.
fn bounds(model: &Model, settings: &Settings) -> Bounds {
    let e = model.regularization;
    let regularizations = [e, VERTEX_REGULARIZATION * e];
    let allowed = 4.0 * settings.tolerance;
    match settings.method {
        Method::I3alpPrinted => {
            Bounds { position: PRINTED_POSITION_TOLERANCE, velocity: RATE_TOLERANCES[1], in_balance: false, regularizations }
        }
        Method::I3alp | Method::Rk4 | Method::Dop853 | Method::I3alpConserving | Method::Automatic => Bounds {
            position: POSITION_TOLERANCE.max(allowed),
            velocity: RATE_TOLERANCES[0].max(allowed),
            in_balance: true,
            regularizations,
        },
    }
}
