//! A benchmark, and the results of a run.

use std::time::Instant;

use fivebar::integrator::dense::{DenseStep, Horizon};
use fivebar::integrator::{Events, Implicit, Passage, State, StepError, dense, i3alp, rk4};
use fivebar::vector::Vector;

/// A benchmark: a system, its start, its duration and the published result.
pub struct Problem<S, const N: usize, const M: usize> {
    /// The system.
    pub system: S,
    /// Coordinates at the start.
    pub q: Vector<N>,
    /// Velocities at the start.
    pub v: Vector<N>,
    /// Time of the published values, s.
    pub duration: f64,
    /// e of the methods' saddle-point systems, 1/kg; by default 1e-12 divided by the mean mass.
    pub regularization: f64,
    /// Error of the final coordinates against the published values; each benchmark states the unit.
    pub error: fn(&Vector<N>) -> f64,
    /// Conserved energy, J: kinetic and potential energy, including constant torques.
    pub energy: fn(&S, &Vector<N>, &Vector<N>) -> f64,
}

/// A method with its settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// The default method.
    I3alp(i3alp::Settings),
    /// Runge-Kutta with projection.
    Rk4(rk4::Settings),
    /// The error-controlled explicit method.
    Dop853(dense::Settings),
}

/// Results of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// Distance from the published values; see [`Problem::error`].
    pub error: f64,
    /// Largest change of the energy at the end of any macro step, J.
    pub energy_drift: f64,
    /// Largest violation of a constraint at the end of any macro step, m.
    pub violation: f64,
    /// Accepted sub-steps.
    pub substeps: u64,
    /// Rejected sub-steps.
    pub rejected: u64,
    /// Newton iterations.
    pub iterations: u64,
    /// Wall time, s.
    pub seconds: f64,
}

/// Newton's bound on the constraint violation, relative to the size; the five-bar's default.
const TOLERANCE: f64 = 5e-13;
/// The five-bar's default.
const MAX_ITERATIONS: u32 = 10;
/// The five-bar's default.
const MAX_WORK: u32 = 400_000;
/// First trial step of DOP853, s; step control soon lengthens it.
const FIRST_STEP: f64 = 1e-5;

impl<S: Implicit<N, M> + Passage<N> + Events<N>, const N: usize, const M: usize> Problem<S, N, M> {
    /// i3-ALP with fixed steps.
    pub fn fixed(&self) -> Method {
        Method::I3alp(i3alp::Settings { adaptive: false, ..self.i3alp(f64::INFINITY) })
    }

    /// i3-ALP with sub-steps of this local error, in the unit of [`fivebar::integrator::System::error_norm`].
    pub fn adaptive(&self, error_tolerance: f64) -> Method {
        Method::I3alp(self.i3alp(error_tolerance))
    }

    fn i3alp(&self, error_tolerance: f64) -> i3alp::Settings {
        i3alp::Settings {
            adaptive: true,
            error_tolerance,
            tolerance: TOLERANCE,
            max_iterations: MAX_ITERATIONS,
            max_work: MAX_WORK,
            energy_scale: 1.0,
            energy_at_start: 0.0,
            regularization: self.regularization,
        }
    }

    /// Runge-Kutta with projection after each step.
    pub fn rk4(&self) -> Method {
        Method::Rk4(rk4::Settings { regularization: self.regularization, tolerance: TOLERANCE, max_iterations: MAX_ITERATIONS })
    }

    /// DOP853 with this local error, in the units of the coordinates.
    pub fn dop853(&self, error_tolerance: f64) -> Method {
        Method::Dop853(dense::Settings {
            schemes: dense::Schemes::Only(dense::Scheme::Dop853),
            error_tolerance,
            energy_scale: 1.0,
            first_step: FIRST_STEP,
            max_iterations: MAX_ITERATIONS,
            max_work: MAX_WORK,
            regularization: self.regularization,
        })
    }

    /// Runs to the published time in macro steps of h seconds.
    pub fn run(&self, method: Method, h: f64) -> Result<Outcome, StepError> {
        self.watch(method, h, |_, _| {})
    }

    /// Runs to the published time; calls `look` with time and state after each macro step.
    pub fn watch(&self, method: Method, h: f64, mut look: impl FnMut(f64, &State<N, M>)) -> Result<Outcome, StepError> {
        let system = &self.system;
        let start = Instant::now();
        let mut state = State::start(system, self.q, self.v, self.regularization);
        let energy = (self.energy)(system, &self.q, &self.v);
        let (mut energy_drift, mut violation) = (0.0f64, 0.0f64);
        let mut mode = system.mode_of(&self.q, &self.v);
        let mut running = match method {
            Method::Dop853(settings) => Some(DenseStep::start(system, self.q, self.v, &settings)),
            _ => None,
        };
        for step in 1..=(self.duration / h).round() as u64 {
            match method {
                Method::I3alp(settings) => {
                    i3alp::MacroStep::of(h).advance(system, &settings, &mut state, &mut mode)?;
                }
                Method::Rk4(settings) => rk4::advance(system, &settings, &mut state, h)?,
                Method::Dop853(settings) => {
                    running.as_mut().map_or(Ok(()), |running| advance(system, &settings, running, &mut state, h))?
                }
            }
            energy_drift = energy_drift.max(((self.energy)(system, &state.q, &state.v) - energy).abs());
            let phi = system.phi(&state.q, &system.pose(&state.q));
            violation = phi.iter().fold(violation, |largest, phi| largest.max(phi.abs()));
            look(step as f64 * h, &state);
        }
        Ok(Outcome {
            error: (self.error)(&state.q),
            energy_drift,
            violation,
            substeps: state.counters.substeps,
            rejected: state.counters.rejected,
            iterations: state.counters.iterations,
            seconds: start.elapsed().as_secs_f64(),
        })
    }
}

/// A macro step of h seconds by DOP853. Its own steps may run past the end, so the state there is interpolated.
fn advance<const N: usize, const M: usize, S: Implicit<N, M> + Passage<N> + Events<N>>(
    system: &S,
    settings: &dense::Settings,
    running: &mut DenseStep<N, M, S::Mode>,
    state: &mut State<N, M>,
    h: f64,
) -> Result<(), StepError> {
    running.advance(system, settings, h, Horizon { output: h, limit: f64::INFINITY }, None)?;
    let sample = running.sample(system, settings);
    running.record(&sample, state);
    (state.q, state.v) = (sample.q, sample.v);
    Ok(())
}
