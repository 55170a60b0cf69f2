//! Whether the scene is too stiff for an explicit method (Hairer, Wanner II, section IV.2, the test of DOP853).

use std::borrow::Borrow;

use borsh::{BorshDeserialize, BorshSerialize};

use super::rosenbrock::Shared;
use super::{DenseStep, Settings};
use crate::integrator::{Events, System};

/// Accepted steps between two checks: a power of two, which counts are told by without a division.
const INTERVAL: u64 = 1024;
/// A step whose product with the fastest rate is larger than this is at the border of stability: there the estimated product is 3.9 for
/// a damper and in the mean 3.3 for a damped spring (the true ones are 6.4 and 5.5), and below 1.7 where accuracy limits the step.
pub(super) const STABILITY_LIMIT: f64 = 2.5;
/// So many steps there in all, without [`NONSTIFF_STEPS`] others in a row between them, are no accident.
const STIFF_STEPS: u8 = 15;
/// So many steps away from the border begin the count anew.
const NONSTIFF_STEPS: u8 = 6;

/// Where nothing moves by more than the tolerance in a ms, what friction holds comes to rest on its springs:
const STILL: f64 = 1e3;
/// there a step times the fastest rate is at most this, within the border of stability, at which errors say nothing until accelerations are as
/// large as rates may be off.
const STABILITY_LIMIT_AT_REST: f64 = 5.0;

/// What has been seen of the border of stability.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Stiffness {
    at_border: u8,
    away: u8,
    /// Whether steps have been limited by stability and not by accuracy.
    pub(super) found: bool,
    /// By tangents, where what friction holds has come to rest: the fastest rate, 1/s. Nothing that moves tells it there.
    pub(super) held: Option<f64>,
}

impl Stiffness {
    /// Whether a check is due after this many accepted steps.
    #[inline]
    pub(super) fn is_due(&self, substeps: u64) -> bool {
        !self.found && (self.at_border > 0 || substeps.is_multiple_of(INTERVAL))
    }

    /// A check by the product of a step with the fastest rate.
    #[cold]
    pub(super) fn check(&mut self, step_times_rate: f64) {
        if step_times_rate > STABILITY_LIMIT {
            self.away = 0;
            self.at_border += 1;
            self.found = self.at_border == STIFF_STEPS;
        } else if self.at_border > 0 {
            self.away += 1;
            if self.away == NONSTIFF_STEPS {
                (self.at_border, self.away) = (0, 0);
            }
        }
    }

    /// Whether the counts are such as checks leave behind.
    pub(super) fn is_consistent(&self) -> bool {
        self.held.is_none_or(|rate| (0.0..f64::INFINITY).contains(&rate))
            && self.at_border <= STIFF_STEPS
            && self.away < NONSTIFF_STEPS
            && self.found == (self.at_border == STIFF_STEPS)
    }
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// The longest step in which what springs do fades where friction lets nothing else move, s.
    #[cold]
    pub(super) fn longest_at_rest<S: System<N, M> + Events<N, Mode = K>>(&mut self, system: &S, settings: &Settings) -> f64 {
        let on = system.on(self.mode);
        let rate = &mut self.memory.stiffness.held;
        // Where nothing can move nothing has to fade.
        if on.borrow().is_at_rest() || system.error_norm(&self.start.v) > STILL * settings.error_tolerance {
            *rate = None;
            return f64::INFINITY;
        }
        let by_tangents = || {
            let shared = Shared::about(on.borrow(), settings, (&self.start, &system.pose(&self.start.q)));
            shared.map(|shared| shared.fastest).filter(|rate| rate.is_finite()).unwrap_or_default()
        };
        STABILITY_LIMIT_AT_REST / *rate.get_or_insert_with(by_tangents)
    }
}
