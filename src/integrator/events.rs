//! Hybrid systems: guards, modes and transitions of forces with discontinuities (stops, contact, stick-slip friction).
//!
//! Within a mode every force is one smooth formula, which also extends slightly beyond its guards. A step uses the formulas of one mode, so
//! all stages see smooth forces. When the motion crosses a guard, the step ends, and the next step begins in the next mode. The method
//! keeps its order, and no contact between stages is missed.

use std::borrow::Cow;
use std::fmt::Debug;

use borsh::{BorshDeserialize, BorshSerialize};

use super::locator::Path;
use crate::vector::Vector;

/// Conversion between errors of rates and of angles, 1/s: in error norms and guards a rate counts as its displacement in 0.1 s.
pub const ERROR_RATE: f64 = 10.0;

/// Bounds on the first four derivatives of the coordinates over a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extremes<const N: usize> {
    /// Bounds on |q̇|, m/s and rad/s.
    pub rates: Vector<N>,
    /// Bounds on |q̈|, m/s² and rad/s².
    pub accelerations: Vector<N>,
    /// Bounds on the third derivative of q, m/s³ and rad/s³.
    pub jerks: Vector<N>,
    /// Bounds on the fourth derivative of q, m/s⁴ and rad/s⁴.
    pub snaps: Vector<N>,
}

/// Distances of a state past its guards, in event tolerances; negative within the mode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residuals {
    /// Distance past the guard that is exceeded most.
    pub largest: f64,
    /// Distance of sticking friction's reaction past its breakaway bound while the system moves; −∞ if nothing sticks. The reaction is
    /// known only at evaluated states, without a bound in between.
    pub breakaway: f64,
}

/// Guard values of a system at a state, in the system's mode. By default there is no guard.
pub trait Guards {
    /// Bounds on the derivatives of the coordinates on which guards depend, over a path.
    type PathBounds;

    /// Distances of the state past the guards, in units of the event tolerance for `tolerance`.
    fn residuals(&self, _tolerance: f64) -> Residuals {
        Residuals { largest: f64::NEG_INFINITY, breakaway: f64::NEG_INFINITY }
    }

    /// Elastic energy still stored in separated springs, J. It is dissipated as they relax, in addition to the integral of the power.
    fn separation_energy(&self) -> f64 {
        0.0
    }

    /// Estimated time until the mode ends, s, if its formulas are valid only over a short path.
    fn dwell_time(&self) -> f64 {
        f64::INFINITY
    }

    /// Whether a motion within these bounds certainly passes no guard in the next `duration` seconds, except breakaway guards.
    fn are_out_of_reach(&self, _duration: f64, _bounds: &Self::PathBounds, _tolerance: f64) -> bool {
        true
    }

    /// Whether a motion within these bounds certainly passes no guard by more than the event tolerance before another state, `duration`
    /// seconds later, except breakaway guards.
    fn stay_until(&self, _to: &Self, _duration: f64, _bounds: &Self::PathBounds, _tolerance: f64) -> bool {
        true
    }
}

/// No guards.
impl Guards for () {
    type PathBounds = ();
}

/// A hybrid system. By default it has one mode and no events.
pub trait Events<const N: usize>: Clone {
    /// Mode: the smooth formula in use for every force.
    type Mode: Copy + Debug + PartialEq + BorshSerialize + BorshDeserialize;
    /// Guard values at a state.
    type GuardValues: Guards;

    /// Guard values at q and q̇.
    fn guard_values(&self, q: &Vector<N>, v: &Vector<N>) -> Self::GuardValues;

    /// Mode that follows from q and q̇ alone.
    fn mode_of(&self, q: &Vector<N>, v: &Vector<N>) -> Self::Mode;

    /// The mode, with the closure branch on which a motion begins.
    fn select_branch(&self, mode: Self::Mode, _q: &Vector<N>, _v: &Vector<N>) -> Self::Mode {
        mode
    }

    /// The system with its forces in a fixed mode.
    fn on(&self, _mode: Self::Mode) -> Cow<'_, Self> {
        Cow::Borrowed(self)
    }

    /// Mode after the transition at a state that has reached a guard.
    fn next_mode(&self, q: &Vector<N>, v: &Vector<N>, _tolerance: f64) -> Self::Mode {
        self.mode_of(q, v)
    }

    /// Whether a force law with phases is above its lowest phase in this mode, such as a stop that pushes.
    fn has_active_contact(&self) -> bool {
        false
    }

    /// Bounds on coordinate derivatives over a path.
    fn path_bounds(&self, path: &Path<N>) -> <Self::GuardValues as Guards>::PathBounds;
}

/// Energy that separated springs dissipate between guard values and a later state q, q̇, J.
pub(super) fn separation_loss<const N: usize, S: Events<N>>(system: &S, from: &S::GuardValues, [q, v]: [&Vector<N>; 2]) -> f64 {
    let before = from.separation_energy();
    let after = || system.guard_values(q, v).separation_energy();
    if before > 0.0 { (before - after()).max(0.0) } else { 0.0 }
}
