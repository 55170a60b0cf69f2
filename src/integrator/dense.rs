//! Error-controlled steps with dense output on the index-1 form of a [`super::System`], projected onto the constraints after every
//! accepted step.
//!
//! A step belongs to a [`Scheme`]: explicit (`explicit.rs`) of order 8 or 5, or linearly implicit (`rosenbrock.rs`) for stiff loads. Steps
//! are as long as the local error allows and may pass communication points; the state there is the projected interpolant. Inputs are
//! constant during a step. If they change at a communication point inside it, the step is discarded and redone up to this point
//! ([`DenseStep::truncate_and_redo`]). The state of a run is therefore its current step: both ends, the coefficients of the interpolant and
//! the time elapsed in it. Events of the forces end a step (`locator.rs`).
//!
//! `docs/explicit.md` and `docs/automatic.md` derive the methods.

mod consistency;
mod explicit;
mod inside;
mod rosenbrock;
mod scheme;
mod step;
mod stiff_metric;
mod trial;

use borsh::{BorshDeserialize, BorshSerialize};

use super::controller::LEAST_LOG_ERROR;
use super::{Counters, Mechanics, State, StepError, Work};
use crate::vector::Vector;
pub use inside::Sample;
pub use scheme::{Scheme, Schemes};
use scheme::{StiffnessDetector, StiffnessSwitch};
use trial::StageDerivative;

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Settings {
    /// Schemes in use.
    pub schemes: Schemes,
    /// Admissible local error per step, as root mean square: this value for a coordinate, rad, and (10/s + |q̇|) times it for a rate.
    pub error_tolerance: f64,
    /// Energy scale, J. Its product with the error tolerance bounds the error of a step's work; used with events.
    pub energy_scale: f64,
    /// Length of the first step tried, s.
    pub first_step: f64,
    /// Largest number of Newton iterations of a projection.
    pub max_iterations: u32,
    /// Largest number of evaluations and iterations in one macro step, so that every call ends.
    pub max_work: u32,
    /// Regularisation e of the saddle-point systems, 1/kg (the unit of Φ_q M⁻¹ Φ_qᵀ). It has a visible effect only if this matrix loses
    /// rank.
    pub regularization: f64,
}

/// Evaluations of the equations of motion counted per step, accepted or not.
const EVALUATIONS: u64 = 12;

/// Round-off of a sum of macro steps, relative to the current step.
const MACRO_STEP_ROUND_OFF: f64 = 64.0 * f64::EPSILON;

/// Round-off of a sum of thousands of macro steps, relative to the current step.
const SUM_ROUND_OFF: f64 = 64.0 * MACRO_STEP_ROUND_OFF;

/// Limits of the next steps, s from the beginning of a macro step.
#[derive(Clone, Copy, Debug)]
pub struct Horizon {
    /// Time of the next output, s; infinite if no output is read before the end of the step. A step that passes it is interpolated.
    pub output: f64,
    /// Latest end of a step, s.
    pub limit: f64,
}

impl Horizon {
    /// The horizon `elapsed` seconds later.
    fn after(self, elapsed: f64) -> Self {
        Self { output: self.output - elapsed, limit: self.limit - elapsed }
    }
}

/// State of a run: its current step.
#[derive(Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct DenseStep<const N: usize, const M: usize, K> {
    /// State at the beginning of the step: the last accepted state that time has passed.
    start: State<N, M>,
    /// State at the end of the step. If the scheme does not evaluate forces there, q̈, λ and power are missing until they are needed.
    end: State<N, M>,
    /// Length of the step, s.
    length: f64,
    /// If this step is a part of an original step before an event: length of the original step, s; otherwise 0.
    truncated_from: f64,
    /// Time elapsed in the step, s, between 0 and its length.
    elapsed: f64,
    /// Scheme of the step.
    scheme: Scheme,
    /// Higher coefficients of the polynomials; 0 if no interpolant was needed.
    dense: [StageDerivative<N>; 4],
    /// Whether the step is a straight motion through a vertex; then nothing is projected.
    is_linear: bool,
    /// Mode of the forces within the step.
    mode: K,
    /// Mode of the forces after the end of the step.
    next_mode_at_end: K,
    memory: Memory,
    /// Memory at the beginning of the step, to redo it.
    before: Memory,
}

impl<const N: usize, const M: usize, K: Copy> Clone for DenseStep<N, M, K> {
    /// Copies the whole value at once; a derived implementation would copy field by field.
    fn clone(&self) -> Self {
        *self
    }
}

/// Memory of step-size control and scheme selection.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Memory {
    /// Natural logarithm of the error of the last accepted step, in units of the tolerance.
    log_error: f64,
    /// Step length for the other contact mode (with or without a pushing contact), s; infinite if unknown.
    substep_in_other_mode: f64,
    stiffness: StiffnessDetector,
    stiffness_switch: StiffnessSwitch,
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Starts a run at q and q̇, which must satisfy the constraints.
    pub fn start<S: Mechanics<N, M, Mode = K>>(system: &S, q: Vector<N>, v: Vector<N>, settings: &Settings) -> Self {
        let mode = system.mode_of(&q, &v);
        let state = State::start(&*system.on(mode), q, v, settings.regularization);
        let memory = Memory {
            log_error: LEAST_LOG_ERROR,
            substep_in_other_mode: f64::INFINITY,
            stiffness: StiffnessDetector::default(),
            stiffness_switch: StiffnessSwitch::NEW,
        };
        Self {
            start: state,
            end: state,
            length: 0.0,
            truncated_from: 0.0,
            elapsed: 0.0,
            scheme: Scheme::GENERAL,
            dense: [StageDerivative::NONE; 4],
            is_linear: false,
            mode,
            next_mode_at_end: mode,
            memory,
            before: memory,
        }
    }

    /// The time left in the current step, s, if `h` differs from it only by the round-off of many macro steps; otherwise `h`.
    pub fn rounded_to_end(&self, h: f64) -> f64 {
        let left = self.length - self.elapsed;
        if (left - h).abs() <= SUM_ROUND_OFF * self.length { left } else { h }
    }

    /// Advances by at most `most` macro steps of `h` seconds within the current step. Returns their number.
    pub fn advance_within(&mut self, h: f64, most: u64) -> u64 {
        let (length, rounded) = (self.length, MACRO_STEP_ROUND_OFF * self.length);
        // A macro step that begins before this time ends before the current step does.
        let last = length - rounded - h;
        let (mut elapsed, mut left) = (self.elapsed, most);
        while left > 0 && elapsed < last {
            elapsed += h;
            left -= 1;
        }
        // A macro step that ends within round-off of the current step's end is set to end there. At the very end even the shortest macro
        // step exceeds the current step.
        if left > 0 && elapsed < length && h <= length - elapsed + rounded {
            elapsed = length;
            left -= 1;
        }
        let count = most - left;
        self.elapsed = elapsed;
        self.start.counters.steps += count;
        self.end.counters.steps += count;
        count
    }

    /// Advances by one macro step of `h` seconds. `pose` is the pose at the end of the current step, if known. Fails if a step becomes too
    /// short or fails its checks, or if the work exceeds its limit; the run is then undefined, so the caller keeps a copy.
    pub fn advance<S: Mechanics<N, M, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        h: f64,
        horizon: Horizon,
        pose: Option<&S::Pose>,
    ) -> Result<(), StepError> {
        if self.advance_within(h, 1) == 1 { Ok(()) } else { self.advance_past(system, settings, h, horizon, pose) }
    }

    /// Advances by a macro step that exceeds the current step; see [`advance_within`](Self::advance_within).
    pub fn advance_past<S: Mechanics<N, M, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        h: f64,
        mut horizon: Horizon,
        mut pose: Option<&S::Pose>,
    ) -> Result<(), StepError> {
        let mut rest = h;
        let done = self.work();
        loop {
            self.check_work(settings, done)?;
            let left = self.length - self.elapsed;
            rest -= left;
            horizon = horizon.after(left);
            self.step(system, settings, horizon, pose.take())?;
            if self.advance_within(rest, 1) == 1 {
                return Ok(());
            }
        }
    }

    /// Number of evaluations and iterations since the start.
    fn work(&self) -> u64 {
        let Counters { substeps, rejected, iterations, .. } = self.end.counters;
        EVALUATIONS * (substeps + rejected) + iterations
    }

    /// Refuses work above the limit, for a macro step that began at the count `done`.
    fn check_work(&self, settings: &Settings, done: u64) -> Result<(), StepError> {
        if self.work() - done <= u64::from(settings.max_work) {
            return Ok(());
        }
        Err(StepError::TooMuchWork { most: settings.max_work, substep: self.length, error: self.end.error_estimate })
    }

    /// Ends the current step at the present time because inputs or parameters change: redoes it up to this time. `system` is the system of
    /// the step; [`restart`](Self::restart) must follow. On failure the run is undefined.
    pub fn truncate_and_redo<S: Mechanics<N, M, Mode = K>>(&mut self, system: &S, settings: &Settings) -> Result<(), StepError> {
        let mut rest = self.elapsed;
        if rest == self.length {
            (self.length, self.elapsed) = (0.0, 0.0);
            return Ok(());
        }
        let sampled = self.sample(system, settings).work;
        self.memory = self.before;
        self.next_mode_at_end = self.mode;
        self.discard();
        let done = self.work();
        while rest > 0.0 {
            self.check_work(settings, done)?;
            self.step(system, settings, Horizon { output: f64::INFINITY, limit: rest }, None)?;
            rest -= self.length;
        }
        // Dissipation that the caller has read does not decrease: of two values below the exact one, the larger is closer.
        self.end.work.dissipated = self.end.work.dissipated.max(sampled.dissipated);
        (self.length, self.elapsed) = (0.0, 0.0);
        Ok(())
    }

    /// Discards the step and counts it as rejected.
    fn discard(&mut self) {
        self.reset_to_start();
        self.end.counters.rejected += 1;
    }

    /// Resets the end of the step to its beginning; work counters keep their values.
    fn reset_to_start(&mut self) {
        let Counters { rejected, iterations, .. } = self.end.counters;
        self.end = self.start;
        self.dense = [StageDerivative::NONE; 4];
        (self.length, self.truncated_from) = (0.0, 0.0);
        self.end.counters.rejected = rejected;
        self.end.counters.iterations = iterations;
    }

    /// Ends the current step at the present time because the motion is replaced: discards the step but keeps the work that the caller has
    /// read. `system` is the system of the step; [`replace`](Self::replace) and [`restart`](Self::restart) must follow.
    pub fn abandon<S: Mechanics<N, M, Mode = K>>(&mut self, system: &S, settings: &Settings) {
        let work = self.sample(system, settings).work;
        if self.elapsed < self.length {
            self.memory = self.before;
            self.discard();
        }
        (self.end.work, self.end.on_ray) = (work, false);
        (self.length, self.elapsed) = (0.0, 0.0);
    }

    /// Records that the machine is replaced, and the motion too if `motion` is given. The current step must have been ended;
    /// [`restart`](Self::restart) must follow.
    pub fn replace(&mut self, motion: Option<[Vector<N>; 2]>) {
        if let Some([q, v]) = motion {
            (self.end.q, self.end.v) = (q, v);
        }
        (self.end.energy, self.end.branch) = (None, None);
    }

    /// Restarts after a discontinuity that did the given work, J. The current step must have been ended. `pose` is the pose at the present
    /// state.
    pub fn restart<S: Mechanics<N, M, Mode = K>>(&mut self, system: &S, settings: &Settings, pose: &S::Pose, work: Work) {
        let mode = system.mode_of(&self.end.q, &self.end.v);
        self.end.configuration_signs = system.configuration_signs(pose);
        self.end.restart(&*system.on(mode), pose, settings.regularization);
        self.end.work += work;
        self.start = self.end;
        (self.mode, self.next_mode_at_end) = (mode, mode);
        (self.dense, self.is_linear, self.truncated_from) = ([StageDerivative::NONE; 4], false, 0.0);
    }

    /// Shifts the coordinates by whole turns, rad, which do not change the system.
    pub fn shift(&mut self, shift: &Vector<N>) {
        self.start.q += *shift;
        self.end.q += *shift;
    }

    /// Coordinates at the end of the step, m and rad.
    pub fn end(&self) -> &Vector<N> {
        &self.end.q
    }

    /// Mode at the present time.
    pub fn mode(&self) -> K {
        if self.elapsed == self.length { self.next_mode_at_end } else { self.mode }
    }

    /// Number of macro steps since the start.
    pub fn steps(&self) -> u64 {
        self.start.counters.steps
    }

    /// Whether stability rather than accuracy has limited the steps, so that an implicit method would be faster.
    pub fn is_stiff(&self) -> bool {
        self.memory.stiffness.detected
    }
}
