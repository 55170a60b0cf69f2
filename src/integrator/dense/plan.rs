//! Plan, trial and outcome of one step.

use super::Horizon;

/// Plan of the next step.
pub(super) struct Plan<'a, P> {
    /// Step length, s.
    pub(super) h: f64,
    /// Step length that the error control wants, s.
    pub(super) wanted: f64,
    /// Longest admissible step, s.
    pub(super) longest: f64,
    /// Whether a vertex is near, where the energy may have to be conserved.
    pub(super) near: bool,
    /// Whether events are located; not so when a step is made again for comparison.
    pub(super) locates_events: bool,
    /// Time of the next output and limit of the step while inputs are constant.
    pub(super) horizon: Horizon,
    /// Pose at the beginning of the step, if known.
    pub(super) pose: Option<&'a P>,
}

/// One trial of a step.
pub(super) struct Try {
    /// Step length, s.
    pub(super) h: f64,
    /// Length, s, and error of the last rejected trial.
    pub(super) rejected: Option<[f64; 2]>,
    /// Number of trials that were to end at a guard.
    pub(super) event_trials: u32,
    /// Length, s, of the trial whose interpolant has shown the event that this trial is to end at.
    pub(super) event_shown_by: f64,
}

impl Try {
    /// First trial of a step, of `h` seconds.
    pub(super) fn of(h: f64) -> Self {
        Self { h, rejected: None, event_trials: 0, event_shown_by: f64::INFINITY }
    }
}

/// Outcome of a trial.
pub(super) enum Outcome {
    /// The step is accepted.
    Accepted,
    /// The error, in tolerances, is too large or NaN.
    Rejected(f64),
    /// The step has to end at an event, this many seconds after its beginning.
    EventAt(f64),
}
