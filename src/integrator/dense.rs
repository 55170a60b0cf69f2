//! Error-controlled steps that pass communication points, with dense output, on the index-1 form of a [`System`]; projection onto the
//! constraints after every accepted step.
//!
//! A step is of a [`Scheme`]: explicit of order 8 (`dop853.rs`) or 5 (`tsit5.rs`), or linearly implicit (`rosenbrock.rs`) where loads are stiff.
//!
//! Steps are as long as the local error allows, wherever communication points are. The step under way may go past one: there the state
//! is that of the step's interpolant, projected. The step, which has been made with the inputs held, is thrown away if they
//! change at that point, and redone up to it ([`DenseStep::truncate_and_redo`]). So the state of a run is the step under way: both its
//! ends, the interpolant's coefficients and the time into it.
//!
//! Where a force has a kink, a step ends there (`events.rs`).

mod consistency;
mod dop853;
mod events;
mod hermite;
mod interpolant;
mod plan;
mod rosenbrock;
mod sample;
mod scheme;
mod search;
mod step;
mod step_end;
mod stiffness;
mod trial;
mod truncation;
mod tsit5;

use std::borrow::Borrow;

use borsh::{BorshDeserialize, BorshSerialize};

use super::controller::LEAST_LOG_ERROR;
use super::{Counters, Events, Passage, State, StepError, System, Work};
use crate::vector::Vector;
pub use sample::Sample;
use scheme::StiffnessSwitch;
pub use scheme::{Scheme, Schemes};
use stiffness::Stiffness;
use trial::StageDerivative;

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Which kinds of step are made.
    pub schemes: Schemes,
    /// Local error allowed per step: of each coordinate this, of its rate this times (10/s + |q̇|); root of the mean square.
    pub error_tolerance: f64,
    /// The work of forces with kinks may be off by the error tolerance times this, J, per step.
    pub energy_scale: f64,
    /// The first step tried, s.
    pub first_step: f64,
    /// Most Newton iterations of a projection.
    pub max_iterations: u32,
    /// More evaluations and iterations than this in one macro step end it with a status: a call never hangs.
    pub max_work: u32,
    /// e of the saddle-point systems, 1/kg (in the units of Φ_q M⁻¹ Φ_qᵀ): so small that it is seen only where that loses rank.
    pub regularization: f64,
}

/// Evaluations of the equations that a step takes, accepted or not.
const EVALUATIONS: u64 = 12;

/// Sums of macro steps are rounded by this part of a step, or less.
const ROUNDED: f64 = 64.0 * f64::EPSILON;

/// How far ahead steps may go, s from the beginning of a macro step.
#[derive(Clone, Copy, Debug)]
pub struct Horizon {
    /// When the next state is asked for; infinite where none is while a step is under way. A step that goes past it is interpolated.
    pub output: f64,
    /// No step goes past this.
    pub limit: f64,
}

impl Horizon {
    /// Seen from some seconds later.
    fn after(self, elapsed: f64) -> Self {
        Self { output: self.output - elapsed, limit: self.limit - elapsed }
    }
}

/// A run: the step that is under way.
#[derive(Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct DenseStep<const N: usize, const M: usize, K> {
    /// The last accepted state that time has passed: the beginning of the step.
    start: State<N, M>,
    /// Its end; of a step of order 5 without q̈, λ and power, which are found where they are asked for.
    end: State<N, M>,
    /// s.
    length: f64,
    /// The step that was made, of which this is the part before a border, s; 0 where it is all of it.
    cut_from: f64,
    /// Time into the step, s, never beyond its end.
    elapsed: f64,
    /// What kind of step it is.
    scheme: Scheme,
    /// The higher coefficients of the interpolant; 0 where it was not needed.
    dense: [StageDerivative<N>; 4],
    /// Whether the step is a straight motion close to a vertex, where nothing may be projected.
    is_linear: bool,
    /// On which sides of their kinks the forces are in the step, and from its end on.
    mode: K,
    next_mode_at_end: K,
    memory: Memory,
    /// The memory at its beginning, for when the step is redone.
    before: Memory,
}

impl<const N: usize, const M: usize, K: Copy> Clone for DenseStep<N, M, K> {
    /// In one piece: the derived one would go field by field.
    fn clone(&self) -> Self {
        *self
    }
}

/// What is remembered from step to step.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Memory {
    /// ln of the error of the last accepted step in units of the tolerance.
    log_error: f64,
    /// The step wanted where something that touches pushes, if nothing does, and the other way round, s; infinite where none is known.
    substep_in_other_mode: f64,
    stiffness: Stiffness,
    stiffness_switch: StiffnessSwitch,
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Begins with q and q̇, which meet the constraints.
    pub fn start<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        system: &S,
        q: Vector<N>,
        v: Vector<N>,
        settings: &Settings,
    ) -> Self {
        let mode = system.mode_of(&q, &v);
        let state = State::start(system.on(mode).borrow(), q, v, settings.regularization);
        let memory = Memory {
            log_error: LEAST_LOG_ERROR,
            substep_in_other_mode: f64::INFINITY,
            stiffness: Stiffness::default(),
            stiffness_switch: StiffnessSwitch::NEW,
        };
        Self {
            start: state,
            end: state,
            length: 0.0,
            cut_from: 0.0,
            elapsed: 0.0,
            scheme: Scheme::Dop853,
            dense: [StageDerivative::NONE; 4],
            is_linear: false,
            mode,
            next_mode_at_end: mode,
            memory,
            before: memory,
        }
    }

    /// Macro steps of h seconds within the step under way, up to so many: how many it has room for.
    #[inline]
    pub fn advance_within(&mut self, h: f64, most: u64) -> u64 {
        let (length, rounded) = (self.length, ROUNDED * self.length);
        // A macro step that begins before this ends before the step does.
        let last = length - rounded - h;
        let (mut elapsed, mut left) = (self.elapsed, most);
        while left > 0 && elapsed < last {
            elapsed += h;
            left -= 1;
        }
        // One that ends with the step but for round-off ends with it. At its very end even the shortest goes past it.
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

    /// One macro step of h seconds, from the end of the step under way with the pose there, where it is at hand. On failure the run is
    /// undefined: the caller keeps a copy.
    pub fn advance<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        h: f64,
        horizon: Horizon,
        pose: Option<&S::Pose>,
    ) -> Result<(), StepError> {
        if self.advance_within(h, 1) == 1 { Ok(()) } else { self.advance_past(system, settings, h, horizon, pose) }
    }

    /// The same where the step under way has no room for it, as [`advance_within`](Self::advance_within) has said.
    #[inline(always)]
    pub fn advance_past<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
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

    /// Evaluations and iterations since the start.
    #[inline]
    fn work(&self) -> u64 {
        let Counters { substeps, rejected, iterations, .. } = self.end.counters;
        EVALUATIONS * (substeps + rejected) + iterations
    }

    /// Refuses to go on where too much has been done in one macro step, after so much in those before.
    #[inline]
    fn check_work(&self, settings: &Settings, done: u64) -> Result<(), StepError> {
        if self.work() - done <= u64::from(settings.max_work) {
            return Ok(());
        }
        Err(StepError::TooMuchWork { most: settings.max_work, substep: self.length, error: self.end.error_estimate })
    }

    /// Ends the step at the present time, because what was held from here on will change: the step is redone, up to here and no
    /// further. `system` is that of the step; [`restart`](Self::restart) follows. On failure the run is undefined.
    pub fn truncate_and_redo<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
    ) -> Result<(), StepError> {
        if self.finish() {
            return Ok(());
        }
        let mut rest = self.elapsed;
        let dissipated = self.dissipated(system, settings);
        self.memory = self.before;
        self.next_mode_at_end = self.mode;
        self.retract();
        self.end.counters.rejected += 1;
        let done = self.work();
        while rest > 0.0 {
            self.check_work(settings, done)?;
            self.step(system, settings, Horizon { output: f64::INFINITY, limit: rest }, None)?;
            rest -= self.length;
        }
        // What has been shown is not taken back: of two values below the truth the larger one is nearer to it.
        self.end.work.dissipated = self.end.work.dissipated.max(dissipated);
        (self.length, self.elapsed) = (0.0, 0.0);
        Ok(())
    }

    /// Whether the present time is the end of the step, which is over then: it need not be redone.
    #[inline]
    pub fn finish(&mut self) -> bool {
        let is_over = self.elapsed == self.length;
        if is_over {
            (self.length, self.elapsed) = (0.0, 0.0);
        }
        is_over
    }

    /// Takes the end of the step back to its beginning: what has been spent on it stays.
    fn retract(&mut self) {
        let Counters { rejected, iterations, .. } = self.end.counters;
        self.end = self.start;
        self.dense = [StageDerivative::NONE; 4];
        (self.length, self.cut_from) = (0.0, 0.0);
        self.end.counters.rejected = rejected;
        self.end.counters.iterations = iterations;
    }

    /// The rates have changed at once, after [`truncate_and_redo`](Self::truncate_and_redo); [`restart`](Self::restart) follows.
    pub fn jump(&mut self, v: &Vector<N>) {
        self.end.v = *v;
    }

    /// The forces have changed at once, after [`truncate_and_redo`](Self::truncate_and_redo), which did some work. From the pose there.
    pub fn restart<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        pose: &S::Pose,
        work: Work,
    ) {
        let mode = system.mode_of(&self.end.q, &self.end.v);
        self.end.restart(system.on(mode).borrow(), pose, settings.regularization);
        self.end.work += work;
        self.start = self.end;
        (self.mode, self.next_mode_at_end) = (mode, mode);
    }

    /// Goes on from another state, which puts in some energy, J: the step under way is thrown away. Systems before and after.
    pub fn resume_from<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        [before, after]: [&S; 2],
        settings: &Settings,
        [q, v]: [Vector<N>; 2],
        external_work: f64,
    ) {
        let work = self.sample(before, settings).work;
        if self.elapsed < self.length {
            self.memory = self.before;
            self.retract();
            self.end.counters.rejected += 1;
        }
        (self.end.q, self.end.v, self.end.on_ray) = (q, v, false);
        let pose = after.pose(&q);
        self.end.configuration_signs = after.configuration_signs(&pose);
        self.end.work = work;
        self.dense = [StageDerivative::NONE; 4];
        self.is_linear = false;
        (self.length, self.elapsed) = (0.0, 0.0);
        self.restart(after, settings, &pose, Work { input: external_work, dissipated: 0.0 });
    }

    /// Moves the origin of the coordinates: by `shift`, which the system does not notice (whole turns of angles).
    pub fn shift(&mut self, shift: &Vector<N>) {
        self.start.q += *shift;
        self.end.q += *shift;
    }

    /// Coordinates at the end of the step.
    pub fn end(&self) -> &Vector<N> {
        &self.end.q
    }

    /// The sides that hold at the present time.
    pub fn mode(&self) -> K {
        if self.elapsed == self.length { self.next_mode_at_end } else { self.mode }
    }

    /// Macro steps since the start.
    pub fn steps(&self) -> u64 {
        self.start.counters.steps
    }

    /// Whether steps have been limited by stability instead of accuracy: an implicit method would do better.
    pub fn is_stiff(&self) -> bool {
        self.memory.stiffness.found
    }
}
