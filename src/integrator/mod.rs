//! i3-ALP and its companions, generic over the [`System`] they integrate.

use std::fmt;

/// Why a step could not be done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Failure {
    /// Placeholder of the skeleton.
    NotConverged,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("did not converge")
    }
}

/// What the integrator has done since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Macro steps.
    pub steps: u64,
    /// Accepted sub-steps.
    pub substeps: u64,
    /// Newton iterations, those of rejected sub-steps included.
    pub iterations: u64,
    /// Rejected sub-steps.
    pub rejected: u64,
}
