//! The methods: their properties, the settings of the method of a scene, and one macro step by the methods whose steps end with macro
//! steps. Settings follow from those of the solver and from the scales of the machine.

use super::bifurcation;
use super::five_bar::FiveBar;
use super::model::Model;
use super::settings::Method;
use super::state::Core;
use crate::hybrid::Mode;
use crate::integrator::checks::count_breaches;
use crate::integrator::dense::{Scheme, Schemes};
use crate::integrator::{Bounds, Implicit, StepError, dense, i3alp, i3alp_conserving, i3alp_printed, rk4};

use borsh::{BorshDeserialize, BorshSerialize};

/// How a method treats its steps.
#[derive(Clone, Copy, Debug)]
pub struct Properties {
    /// Length of the steps.
    pub steps: Steps,
    /// Tolerances of the constraints that the method keeps, relative. `None` if it keeps them to `solver.tolerance`, or to round-off.
    pub(super) constraints: Option<Bounds>,
}

/// Length of a method's steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Steps {
    /// The macro step.
    Fixed,
    /// With `solver.adaptive`, as long as the error allows within the macro step; otherwise the macro step.
    Adaptive,
    /// As long as the error allows, past macro steps; the state at their ends is interpolated.
    Dense,
}

impl Method {
    /// Properties of the method.
    pub const fn properties(self) -> Properties {
        match self {
            Self::I3alp => Properties { steps: Steps::Adaptive, constraints: None },
            // Newton's method stops at 1e-8, and the finite penalty leaves constraint rates of a sixth of their largest term in short
            // steps.
            Self::I3alpPrinted => Properties { steps: Steps::Fixed, constraints: Some(Bounds { position: 1e-7, velocity: 0.5 }) },
            Self::Rk4 | Self::I3alpConserving => Properties { steps: Steps::Fixed, constraints: None },
            Self::Dop853 | Self::Automatic => Properties { steps: Steps::Dense, constraints: None },
        }
    }

    /// Whether `solver.adaptive` is used.
    pub(crate) fn uses_adaptive(self) -> bool {
        self.properties().steps == Steps::Adaptive
    }
}

/// Method whose steps end with the macro step, with its settings.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub enum MacroStepMethod {
    /// Index-3 augmented Lagrangian with projections in dual form, the default.
    I3alp(i3alp::Settings),
    /// Index-3 augmented Lagrangian with projections in the penalty form of the paper.
    I3alpPrinted(i3alp_printed::Settings),
    /// Classical Runge–Kutta of order 4 with projection.
    Rk4(rk4::Settings),
}

/// Energy tolerance of an i3-ALP step, relative to the tolerance of the error-controlled methods. It is smaller because an event divides a
/// macro step into several steps, and the work is known only at their ends.
const I3ALP_ENERGY_SHARE: f64 = 0.2;

/// Rate of the reference motion, 1/s, as in the error norm; its kinetic energy scales the energy tolerance of forces with events.
const REFERENCE_RATE: f64 = 10.0;

/// e of the conserving step relative to 1 over the mean mass. It only weights increments: with smaller values Newton's method finds fewer
/// roots next to vertices, with larger values it takes more iterations.
const CONSERVING_REGULARIZATION: f64 = 1e-7;

/// Kinetic energy of the reference motion, J.
fn energy_scale(model: &Model) -> f64 {
    model.mechanism.geometry.mean_mass() * (model.length_scale * REFERENCE_RATE).powi(2)
}

/// Settings of the method of a scene.
#[derive(Clone, Copy, Debug)]
pub enum MethodSettings {
    /// Steps end with the macro step.
    MacroStep(MacroStepMethod),
    /// Strictly fixed steps that conserve energy.
    Conserving(i3alp_conserving::Settings),
    /// Error control in the link angles: steps run past the macro step, and its end is interpolated.
    Dense(dense::Settings),
}

/// Settings of the method of a scene, for a run with this energy at its start, J.
pub fn method_settings(model: &Model, energy_at_start: f64) -> MethodSettings {
    let (settings, regularization) = (&model.settings, model.regularization);
    let max_iterations = settings.max_iterations;
    let dense = |schemes| {
        MethodSettings::Dense(dense::Settings {
            schemes,
            error_tolerance: settings.error_tolerance,
            energy_scale: energy_scale(model),
            first_step: settings.step_size,
            max_iterations,
            max_work: settings.max_work,
            regularization: model.regularization_by_angles,
        })
    };
    MethodSettings::MacroStep(match settings.method {
        Method::I3alp => MacroStepMethod::I3alp(i3alp::Settings {
            adaptive: settings.adaptive,
            error_tolerance: settings.error_tolerance,
            energy_scale: I3ALP_ENERGY_SHARE * energy_scale(model),
            energy_at_start,
            tolerance: settings.tolerance,
            max_iterations,
            max_work: settings.max_work,
            regularization,
        }),
        Method::I3alpPrinted => {
            MacroStepMethod::I3alpPrinted(i3alp_printed::Settings { penalty: settings.penalty, max_iterations })
        }
        Method::Rk4 => MacroStepMethod::Rk4(rk4::Settings { regularization, tolerance: settings.tolerance, max_iterations }),
        Method::I3alpConserving => {
            return MethodSettings::Conserving(i3alp_conserving::Settings {
                max_iterations,
                max_work: settings.max_work,
                regularization: CONSERVING_REGULARIZATION * regularization * settings.penalty_scale,
                equilibrium: regularization,
                energy_scale: energy_scale(model),
            });
        }
        Method::Dop853 => return dense(Schemes::Only(Scheme::Dop853)),
        Method::Automatic => return dense(Schemes::Automatic),
    })
}

impl MacroStepMethod {
    /// Advances the state from `mode` by one macro step of `h` seconds. A failure leaves both undefined, so the caller keeps a copy.
    pub fn advance<const BARE: bool>(
        &self,
        system: &FiveBar<'_, BARE>,
        core: &mut Core,
        mode: &mut Mode,
        h: f64,
    ) -> Result<(), StepError> {
        match self {
            Self::I3alp(settings) if settings.adaptive => {
                let mut step = i3alp::MacroStep::of(h);
                let mut progress = step.advance(system, settings, core, mode)?;
                while let i3alp::Progress::Blocked(h) = progress {
                    let transit = bifurcation::crossing(system.general(), core, h);
                    progress = step.cross(system, settings, core, mode, transit.as_ref())?;
                }
                Ok(())
            }
            Self::I3alp(_) | Self::I3alpPrinted(_) | Self::Rk4(_) => count_breaches(
                system,
                || energy_scale(system.model),
                core,
                h,
                |core| match self {
                    Self::I3alp(settings) => i3alp::MacroStep::of(h).advance(system, settings, core, mode).map(drop),
                    Self::I3alpPrinted(settings) => {
                        i3alp_printed::advance(system, |at, x| system.effective_mass_times(at, x), settings, core, h)
                    }
                    Self::Rk4(settings) => rk4::advance(system, settings, core, h),
                },
            ),
        }
    }
}
