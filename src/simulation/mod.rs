//! A scene made ready: constant model, active effects and state; advances by internal steps.

use std::fmt;

pub use crate::effects::Inputs;
use crate::integrator::{Counters, Failure};
pub use crate::mechanism::{Assembly, Geometry, Link, Refusal, Start};

/// How the equations of motion are integrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Index-3 augmented Lagrangian with projections, dual form, sub-steps.
    I3alp,
    /// The same with the paper's parameters and approximate tangent.
    I3alpPrinted,
    /// Runge-Kutta of order 4 on the index-1 form with projection.
    Rk4,
}

/// The solver's settings; see the `solver.*` variables.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Method.
    pub method: Method,
    /// Macro step h, s.
    pub step_size: f64,
    /// Whether macro steps are divided where the local error asks.
    pub adaptive: bool,
    /// Local error per sub-step, rad.
    pub error_tolerance: f64,
    /// Newton tolerance relative to the machine's size, at h = 1 ms.
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
    /// Geometry of the mechanism.
    pub geometry: Geometry,
    /// Start.
    pub start: Start,
    /// Solver.
    pub settings: Settings,
    /// Effects.
    pub effects: crate::effects::Parameters,
}

/// The constant part of a scene made ready.
#[derive(Debug)]
pub struct Model {}

/// Everything that changes during a run.
#[derive(Clone, Debug, PartialEq)]
pub struct State {}

/// A failed call of [`Simulation::advance`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepFailure {
    /// How far the call came before it gave up, s after its beginning.
    pub elapsed: f64,
    /// Why it gave up.
    pub cause: Failure,
}

impl fmt::Display for StepFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.cause)
    }
}

/// A scene made ready.
#[derive(Debug)]
pub struct Simulation {
    /// The constant part.
    pub model: Model,
    /// Everything that changes.
    pub state: State,
}

impl Simulation {
    /// Validates the parameters, closes the loop, fixes the list of effects and the linear solve.
    pub fn new(_parameters: &Parameters, _inputs: &Inputs) -> Result<Self, Refusal> {
        todo!()
    }

    /// `steps` macro steps of `h` seconds with `inputs` held. On failure the state is as before the call. Allocates nothing.
    pub fn advance(&mut self, _inputs: &Inputs, _h: f64, _steps: u64) -> Result<(), StepFailure> {
        todo!()
    }

    /// The present state with the accelerations and multipliers that belong to `inputs` (observers answer for these).
    pub fn state_for(&self, _inputs: &Inputs) -> State {
        todo!()
    }

    /// What the integrator has done since the start.
    pub fn counters(&self) -> Counters {
        todo!()
    }

    /// Local error of the last accepted sub-step over the link angles, rad.
    pub fn error_estimate(&self) -> f64 {
        todo!()
    }

    /// Names of the active effects, e.g. `["gravity"]`.
    pub fn active_effects(&self) -> Vec<&'static str> {
        todo!()
    }
}
