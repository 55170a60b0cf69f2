//! The driver of error-controlled steps, common to all methods: a step begins, is tried until its error is admissible, ends at an event if
//! one occurs, and is accepted.
//!
//! | state of a step | what happens | leads to |
//! | --- | --- | --- |
//! | begin | the mode makes all transitions that are due; vertices are looked for; the step is planned | try, or the end: at rest, past a vertex |
//! | try | the method makes a trial; the locator looks for events on its dense output | accept, end at an event, a shorter trial |
//! | end at an event | the step is tried up to the event; if the event is at its beginning, the step begins again in the next mode | try, begin |
//! | accept | the method accepts the trial; its next step is as long as error and events allow | the end |
//!
//! Methods with dense output (`dense.rs`) also step past communication points, and redo such a step up to a communication point.

use super::checks::{Beginning, Imbalance};
use super::locator::{EventTrials, Probe};
use super::{Approach, Guards, Mechanics, PassageLimits, State, StepError, StepLimits, Stuck, Transit};

/// Trials of one step.
pub(super) struct Trials {
    /// Length of the current trial, s.
    pub(super) h: f64,
    /// Length, s, and error of the last trial that was rejected because of its error.
    pub(super) rejected: Option<[f64; 2]>,
    /// Trials that should end at a guard.
    pub(super) events: EventTrials,
    /// Longest trial that the errors of rejected trials allow, s.
    longest: f64,
}

/// Outcome of a trial.
pub(super) enum Outcome {
    /// The step is accepted.
    Accepted,
    /// The error, in tolerances, is too large, or NaN if there is no estimate.
    Rejected(f64),
    /// The step has to end at an event, this many seconds after its beginning.
    EventAt(f64),
}

/// Progress of a step, or of a macro step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// The step is finished: by a trial, at rest, or past a vertex.
    Done,
    /// A trial of this length, s, was rejected near a bifurcation of the constraints; the caller decides.
    Blocked(f64),
}

/// A method's part of a step, called by the driver.
pub(super) trait Method<const N: usize, const M: usize, S: Mechanics<N, M>> {
    /// State at the beginning of the step.
    fn start(&self) -> &State<N, M>;
    /// State at the end of the accepted step; a method may store only this state by then.
    fn end(&self) -> &State<N, M>;
    /// Mode at the beginning of the step.
    fn initial_mode(&self) -> S::Mode;
    /// Longest step, s.
    fn longest(&self) -> f64;
    /// Changes the mode and evaluates forces and accelerations again in it.
    fn enter(&mut self, system: &S, mode: S::Mode);
    /// Remains at rest over the longest step.
    fn rest(&mut self);
    /// Moves to the end of a transit.
    fn pass(&mut self, system: &S, transit: &Transit<N>) -> Result<(), StepError>;
    /// Returns the length of the first trial, s. `system` is in the mode of the step, which lasts about `lasting` seconds; `near` are
    /// limits if a vertex is near.
    fn plan(&mut self, system: &S, near: Option<&StepLimits>, lasting: f64) -> f64;
    /// Makes a trial with `system` in the mode of the step. Accepts it if its error is admissible and no event occurs earlier. `from` is
    /// the guard probe at the beginning, if there are guards.
    fn attempt(&mut self, system: &S, trials: &Trials, from: Option<&Probe<S::GuardValues>>) -> Result<Outcome, StepError>;
    /// Discards a trial.
    fn discard(&mut self);
    /// Returns the length of the next trial, s, after a trial that was rejected with an error.
    fn shorten(&mut self, trials: &Trials, error: f64) -> Result<f64, StepError>;
}

/// Limits for all steps of a run.
pub(super) struct Limits {
    /// Thresholds of vertices.
    pub(super) passage: PassageLimits,
    /// Error tolerance, rad.
    pub(super) tolerance: f64,
    /// Admissible imbalance of energy.
    pub(super) imbalance: Imbalance,
}

/// Makes the next step. Fails if the method fails or the step fails its checks; the state of the method is then undefined.
pub(super) fn step<const N: usize, const M: usize, S: Mechanics<N, M>>(
    method: &mut impl Method<N, M, S>,
    system: &S,
    limits: &Limits,
) -> Result<Progress, StepError> {
    /// Factor on the estimated time until a mode ends, so that the guard lies within the step.
    const DWELL_MARGIN: f64 = 1.2;
    let mut trials = Trials { h: f64::INFINITY, rejected: None, events: EventTrials::NONE, longest: f64::INFINITY };
    loop {
        let from = begin(method, system, limits.tolerance);
        let in_mode = system.on(method.initial_mode());
        if in_mode.stuck() == Stuck::Wholly {
            method.rest();
            return Ok(Progress::Done);
        }
        // A passage uses the forces of its own states, in every mode.
        let near = match system.approach(&limits.passage, &method.start().departure(method.longest())) {
            Approach::Clear => None,
            Approach::Limited(limits) => Some(limits),
            Approach::Passed(transit) => {
                method.pass(system, &transit)?;
                return Ok(Progress::Done);
            }
        };
        let lasting = from.as_ref().map_or(f64::INFINITY, |from| DWELL_MARGIN * from.guard_values.dwell_time());
        trials.h = method.plan(&*in_mode, near.as_ref(), lasting).min(trials.longest);
        let longest = near.map_or(f64::INFINITY, |limits| limits.longest);
        let beginning = method.start().checked().map(|from| Beginning::of(&*in_mode, &from));
        if let Some(end) = in_one_mode(method, &*in_mode, (from.as_ref(), longest), &mut trials)? {
            if let (Progress::Done, Some(beginning)) = (end, beginning)
                && let Some(to) = method.end().checked()
            {
                beginning.check(&*in_mode, limits.imbalance, &to, trials.h)?;
            }
            return Ok(end);
        }
        let State { q, v, .. } = method.start();
        let next = in_mode.next_mode(q, v, limits.tolerance);
        method.enter(system, next);
    }
}

/// Enters the mode in which a step begins, after all transitions due at its beginning. Returns the guard probe at the beginning, if there
/// are guards.
fn begin<const N: usize, const M: usize, S: Mechanics<N, M>>(
    method: &mut impl Method<N, M, S>,
    system: &S,
    tolerance: f64,
) -> Option<Probe<S::GuardValues>> {
    /// Largest number of transitions at the beginning of a step.
    const MOST_TRANSITIONS: u32 = 8;
    let State { q, v, .. } = method.start();
    let mut mode = system.select_branch(method.initial_mode(), q, v);
    let mut transitions = 0;
    loop {
        method.enter(system, mode);
        if !system.features().events {
            return None;
        }
        let (in_mode, State { q, v, .. }) = (system.on(mode), method.start());
        let from = Probe::new(&*in_mode, (0.0, [q, v]), tolerance);
        if !from.is_past_guard() || transitions == MOST_TRANSITIONS {
            return Some(from);
        }
        mode = in_mode.next_mode(q, v, tolerance);
        transitions += 1;
    }
}

/// Makes trials of a step, of at most `longest` seconds, with the system in one mode. Returns `None` if an event at the very beginning ends
/// the mode. `from` is the guard probe at the beginning.
fn in_one_mode<const N: usize, const M: usize, S: Mechanics<N, M>>(
    method: &mut impl Method<N, M, S>,
    system: &S,
    (from, longest): (Option<&Probe<S::GuardValues>>, f64),
    trials: &mut Trials,
) -> Result<Option<Progress>, StepError> {
    loop {
        match method.attempt(system, trials, from)? {
            Outcome::Accepted => return Ok(Some(Progress::Done)),
            Outcome::EventAt(when) => {
                method.discard();
                trials.events.repeat(trials.h, when.min(longest).min(method.longest()));
                match trials.events.end {
                    Some(end) => trials.h = end,
                    None => return Ok(None),
                }
            }
            Outcome::Rejected(error) => {
                let (h, State { q, v, .. }) = (trials.h, method.start());
                if system.is_near_bifurcation(q, v, h) {
                    return Ok(Some(Progress::Blocked(h)));
                }
                method.discard();
                let shorter = method.shorten(trials, error)?;
                *trials = Trials { h: shorter, rejected: Some([h, error]), events: EventTrials::NONE, longest: shorter };
            }
        }
    }
}
