//! What a step is to be, and what comes of trying it.

use super::Horizon;

/// What the next step is to be.
pub(super) struct Plan<'a, P> {
    /// Its length, s.
    pub(super) h: f64,
    /// What the error wants it to be.
    pub(super) wanted: f64,
    /// What it may be.
    pub(super) longest: f64,
    /// Whether a vertex is near, where energy may have to be kept.
    pub(super) near: bool,
    /// Whether borders are looked for: a step made once more ends where it did.
    pub(super) seeks_borders: bool,
    /// When an output is asked for, and what limits it while inputs are held.
    pub(super) horizon: Horizon,
    /// The pose at its beginning, where it is known.
    pub(super) pose: Option<&'a P>,
}

/// A try of it.
pub(super) struct Try {
    /// Its length, s.
    pub(super) h: f64,
    /// The last one that was rejected: length and error.
    pub(super) rejected: Option<[f64; 2]>,
    /// How many were to end at a border.
    pub(super) cuts: u32,
    /// The length of the one whose interpolant has shown it, s.
    pub(super) shown_by: f64,
}

impl Try {
    /// The first one.
    pub(super) fn of(h: f64) -> Self {
        Self { h, rejected: None, cuts: 0, shown_by: f64::INFINITY }
    }
}

/// What has come of it.
pub(super) enum Outcome {
    Accepted,
    /// Its error is too large, or NaN.
    Rejected(f64),
    /// It has to end at a border, so many seconds from its beginning.
    Crosses(f64),
}
