//! Stiffness detection for explicit methods (Hairer, Wanner II, section IV.2, the test of DOP853), and the step limit at rest.

use std::borrow::Borrow;

use borsh::{BorshDeserialize, BorshSerialize};

use super::rosenbrock::Linearization;
use super::{DenseStep, Settings};
use crate::integrator::{Events, System};

/// Accepted steps between two checks; a power of two avoids a division.
const INTERVAL: u64 = 1024;
/// Estimated product of step and fastest rate above which a step is at the stability limit. There it is 3.9 for a damper and 3.3 in
/// the mean for a damped spring (exact: 6.4 and 5.5); below 1.7 accuracy limits the step.
pub(super) const STABILITY_LIMIT: f64 = 2.5;
/// Number of checks at the stability limit, without [`NONSTIFF_STEPS`] others in a row between them, that detect stiffness.
const STIFF_STEPS: u8 = 15;
/// Number of successive checks away from the stability limit that reset the count.
const NONSTIFF_STEPS: u8 = 6;

/// Rate, in error tolerances per s, below which the system counts as at rest: less than the tolerance per ms.
const REST_RATE: f64 = 1e3;
/// Product of step and fastest rate at rest. It is below the stability limit, at which errors would stay small until accelerations
/// reach the admissible error of rates times the fastest rate.
const STABILITY_LIMIT_AT_REST: f64 = 5.0;

/// Observations of the stability limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct StiffnessDetector {
    at_limit: u8,
    away_from_limit: u8,
    /// Whether stability rather than accuracy has limited the steps.
    pub(super) detected: bool,
    /// Fastest rate of the tangents, 1/s, where sticking friction and springs hold the system at rest; motion does not show it
    /// there.
    pub(super) rate_at_rest: Option<f64>,
}

impl StiffnessDetector {
    /// Whether a check is due after `substeps` accepted steps.
    #[inline]
    pub(super) fn is_due(&self, substeps: u64) -> bool {
        !self.detected && (self.at_limit > 0 || substeps.is_multiple_of(INTERVAL))
    }

    /// Takes the product of step and fastest rate of one step.
    #[cold]
    pub(super) fn check(&mut self, step_times_rate: f64) {
        if step_times_rate > STABILITY_LIMIT {
            self.away_from_limit = 0;
            self.at_limit += 1;
            self.detected = self.at_limit == STIFF_STEPS;
        } else if self.at_limit > 0 {
            self.away_from_limit += 1;
            if self.away_from_limit == NONSTIFF_STEPS {
                (self.at_limit, self.away_from_limit) = (0, 0);
            }
        }
    }

    /// Whether the counts can result from checks.
    pub(super) fn is_consistent(&self) -> bool {
        self.rate_at_rest.is_none_or(|rate| (0.0..f64::INFINITY).contains(&rate))
            && self.at_limit <= STIFF_STEPS
            && self.away_from_limit < NONSTIFF_STEPS
            && self.detected == (self.at_limit == STIFF_STEPS)
    }
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Longest step, s, in which oscillations of springs decay while friction holds everything else.
    #[cold]
    pub(super) fn longest_at_rest<S: System<N, M> + Events<N, Mode = K>>(&mut self, system: &S, settings: &Settings) -> f64 {
        let on = system.on(self.mode);
        let rate = &mut self.memory.stiffness.rate_at_rest;
        // Nothing oscillates where everything sticks.
        if on.borrow().is_at_rest() || system.error_norm(&self.start.v) > REST_RATE * settings.error_tolerance {
            *rate = None;
            return f64::INFINITY;
        }
        let by_tangents = || {
            let linearization = Linearization::about(on.borrow(), settings, (&self.start, &system.pose(&self.start.q)));
            linearization.map(|linearization| linearization.fastest_rate).filter(|rate| rate.is_finite()).unwrap_or_default()
        };
        STABILITY_LIMIT_AT_REST / *rate.get_or_insert_with(by_tangents)
    }
}
