//! Schemes of a step, the automatic choice among them, and the detection of stiffness (Hairer, Wanner II, section IV.2, the test of
//! DOP853).
//!
//! DOP853 is used unless stiffness or frequent input changes favour another scheme. If inputs stay constant for no longer than a step of
//! order 5, order 8 has no advantage, and Tsit5 is used. If stability rather than the error limits the step, a Rosenbrock method is used
//! until its own error requires steps that an explicit method could make. See `docs/automatic.md`.

use borsh::{BorshDeserialize, BorshSerialize};

use super::rosenbrock::Linearization;
use super::{DenseStep, Settings};
use crate::integrator::System;
use crate::integrator::controller::StepSizeController;

/// The schemes, a row each.
macro_rules! schemes {
    ($($(#[$doc:meta])* $name:ident: $properties:expr,)*) => {
        /// Scheme of a step.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
        pub enum Scheme {
            $($(#[$doc])* $name,)*
        }

        impl Scheme {
            /// All schemes.
            pub const LIST: &[Self] = &[$(Self::$name),*];

            /// Properties of the scheme.
            #[inline(always)]
            pub(super) const fn properties(self) -> Properties {
                match self {
                    $(Self::$name => $properties,)*
                }
            }
        }
    };
}

schemes! {
    /// DOP853: explicit, of order 8. With memory and a growth limit of 3 it has a quarter of the rejections of the classical controller.
    Dop853: Properties {
        order: 8,
        is_implicit: false,
        evaluates_end: true,
        polynomials: Polynomials::OfEach,
        memory: 0.02,
        accepted: [0.3, 3.0],
        rejected: [0.3, 0.85],
        failed: 0.3,
    },
    /// Tsit5: explicit, of order 5. Inputs are expected to change at its ends.
    Tsit5: Properties {
        order: 5,
        is_implicit: false,
        evaluates_end: false,
        polynomials: Polynomials::OfCoordinates,
        memory: 0.04,
        accepted: [0.3, 5.0],
        rejected: [0.2, 0.85],
        failed: 0.3,
    },
    /// Rodas4: linearly implicit, of order 4, with the controller of its authors' code.
    Rodas4: Properties {
        order: 4,
        is_implicit: true,
        evaluates_end: true,
        polynomials: Polynomials::OfCoordinates,
        memory: 0.04,
        accepted: [0.2, 5.0],
        rejected: [0.1, 0.85],
        failed: 0.2,
    },
    /// Rodas5P: linearly implicit, of order 5, with the controller of its authors' code.
    Rodas5p: Properties {
        order: 5,
        is_implicit: true,
        evaluates_end: true,
        polynomials: Polynomials::OfCoordinates,
        memory: 0.04,
        accepted: [0.2, 5.0],
        rejected: [0.1, 0.85],
        failed: 0.2,
    },
}

/// How a scheme treats its steps.
pub(super) struct Properties {
    /// Order p: the local error falls with the power p + 1 of the step length.
    order: u8,
    /// Whether steps are linearly implicit: they need the tangents at their beginning.
    pub(super) is_implicit: bool,
    /// Whether a step evaluates forces at its projected end; the next step then starts with them. Otherwise q̈, λ and power at the end are
    /// evaluated only when needed, which saves an evaluation if inputs change there.
    pub(super) evaluates_end: bool,
    /// Polynomials of the dense output.
    pub(super) polynomials: Polynomials,
    /// Exponent of the error before the last one in the step-size controller.
    memory: f64,
    /// Bounds on the factor after an accepted step.
    accepted: [f64; 2],
    /// Bounds on the factor after a rejected step.
    rejected: [f64; 2],
    /// Factor after a step without an error estimate.
    failed: f64,
}

impl Properties {
    /// Step-size controller.
    #[inline(always)]
    pub(super) const fn controller(&self) -> StepSizeController {
        let &Self { order, memory, accepted, rejected, failed, .. } = self;
        StepSizeController { exponent: 1.0 / order as f64 - 0.75 * memory, memory, accepted, rejected, failed }
    }
}

/// Polynomials of a dense output.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Polynomials {
    /// One for the coordinates.
    OfCoordinates,
    /// One each for coordinates, rates and work, from the stages.
    OfEach,
}

impl Polynomials {
    /// Whether the rates are the derivative of the coordinates' polynomial. Otherwise the two may contradict each other.
    pub(super) const fn differentiate(self) -> bool {
        matches!(self, Self::OfCoordinates)
    }

    /// Whether there is a polynomial of the work. Otherwise its coefficient is computed from forces when the work is read.
    pub(super) const fn include_work(self) -> bool {
        matches!(self, Self::OfEach)
    }

    /// Whether the part of a step before an event can become the step. The defects that judge it compare the polynomials of rates and work
    /// with forces.
    pub(super) const fn can_be_truncated(self) -> bool {
        matches!(self, Self::OfEach)
    }
}

impl Scheme {
    /// Scheme that can make every step: explicit, with steps that can be truncated. It makes steps near vertices, where round-off dominates
    /// tangents, with friction that may stick, and instead of an implicit step that cannot begin.
    pub(super) const GENERAL: Self = Self::Dop853;
    /// Scheme of the automatic choice while inputs are held for no longer than its step. The memory stores the length of its next step
    /// separately.
    pub(super) const BRIEF: Self = Self::Tsit5;

    /// Order p: the local error falls with the power p + 1 of the step length.
    pub fn order(self) -> u8 {
        self.properties().order
    }
}

/// Schemes that a run may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum Schemes {
    /// One scheme, or `Scheme::GENERAL` for steps that it cannot make.
    Only(Scheme),
    /// Automatic choice of the cheapest scheme.
    Automatic,
}

/// Error tolerance, rad, above which Rodas4 replaces Rodas5P: it is cheaper, and oscillates less at discontinuities.
const RODAS4_TOLERANCE: f64 = 1e-5;

/// Growth of the assumed step of [`Scheme::BRIEF`] after each step of [`Scheme::GENERAL`] with frequent input changes, so that
/// [`Scheme::BRIEF`] is tried again.
const BRIEF_STEP_GROWTH: f64 = 1.05;

/// Number of explicit steps at the stability limit that switch to implicit steps; each return doubles it.
const STEPS_AT_LIMIT: u8 = 3;
/// Number of successive implicit steps that could have been explicit before the switch goes back; each return doubles this number.
/// Saturated friction has zero tangents, so fewer steps would switch back too early.
const STEPS_BELOW_LIMIT: u8 = 3;
/// Largest number of doublings.
const MOST_RETURNS: u8 = 5;
/// Admissible range of the stability limit: explicit step times fastest rate of the tangents when implicit steps begin.
const STABILITY_LIMIT_RANGE: [f64; 2] = [0.1, 12.0];
/// Stability limit if none has been observed: the limit of DOP853 for a damper.
const USUAL_STABILITY_LIMIT: f64 = 6.4;
/// Number of explicit steps with stiff forces before the tangents are evaluated; each return doubles this number. Round-off, amplified by
/// stiff forces, may keep steps below the stability limit.
const PROBE_INTERVAL: u16 = 100;
/// Product of explicit step and fastest rate of the tangents above which implicit steps are tried. Steps limited by round-off have 0.8 or
/// more, steps limited by accuracy 0.04 to 0.4.
const LEAST_PROBED_PRODUCT: f64 = 0.5;

/// Switch between explicit and implicit schemes by detected stiffness, with its memory.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct StiffnessSwitch {
    /// Whether the steps are implicit.
    stiff: bool,
    /// Number of recent steps that favour a change.
    contrary_steps: u8,
    /// Number of explicit steps since the last evaluation of tangents.
    explicit_steps: u16,
    /// Number of returns from implicit to explicit steps.
    returns: u8,
    /// Minus the length of the explicit step at the switch to implicit steps, s. After the first implicit step: the product of this length
    /// and the fastest rate of the tangents.
    stability_limit: f64,
    /// Length of the next step of [`Scheme::BRIEF`], s; infinite if none has been made.
    pub(super) brief_step: f64,
}

/// An accepted step, as input of a [`StiffnessSwitch`].
pub(super) struct AcceptedStep {
    pub(super) scheme: Scheme,
    /// Step length, s.
    pub(super) length: f64,
    /// Product of step length and fastest rate.
    pub(super) product: f64,
    /// Step length that the error allows for the next step, s.
    pub(super) wanted: f64,
    /// Limit of the step length for other reasons, s.
    pub(super) limit: f64,
    /// Whether any force is stiff.
    pub(super) stiff_forces: bool,
}

impl Schemes {
    /// Implicit scheme for an error tolerance, rad.
    fn stiff(error_tolerance: f64) -> Scheme {
        if error_tolerance >= RODAS4_TOLERANCE { Scheme::Rodas4 } else { Scheme::Rodas5p }
    }

    /// Whether a run with these schemes may use the given scheme for a step.
    pub(super) fn allow(self, scheme: Scheme, error_tolerance: f64) -> bool {
        match self {
            Self::Only(only) => scheme == only || scheme == Scheme::GENERAL,
            Self::Automatic => [Scheme::GENERAL, Scheme::BRIEF, Self::stiff(error_tolerance)].contains(&scheme),
        }
    }

    /// Scheme of the next step, which other reasons limit to `limit` seconds.
    pub(super) fn next(self, stiffness_switch: &StiffnessSwitch, error_tolerance: f64, limit: f64) -> Scheme {
        match self {
            Self::Only(scheme) => scheme,
            Self::Automatic if stiffness_switch.stiff => Self::stiff(error_tolerance),
            Self::Automatic if limit <= stiffness_switch.brief_step && limit.is_finite() => Scheme::BRIEF,
            Self::Automatic => Scheme::GENERAL,
        }
    }
}

impl StiffnessSwitch {
    /// Initial state, without observations.
    pub(super) const NEW: Self =
        Self { stiff: false, contrary_steps: 0, explicit_steps: 0, returns: 0, stability_limit: 0.0, brief_step: f64::INFINITY };

    /// Chooses the first scheme: implicit if an explicit step of `wanted` seconds would be unstable at the tangents' fastest rate, 1/s.
    pub(super) fn begin(&mut self, wanted: f64, rate: f64) {
        if wanted * rate > STABILITY_LIMIT_RANGE[1] {
            (self.stiff, self.stability_limit) = (true, USUAL_STABILITY_LIMIT);
        }
    }

    /// Whether it is time to evaluate the tangents again, after many explicit steps.
    pub(super) fn is_probing(&self) -> bool {
        self.explicit_steps >= PROBE_INTERVAL << self.returns
    }

    /// Records the tangents' fastest rate, 1/s, at a step of `wanted` seconds. Implicit steps are tried unless the product is far below the
    /// stability limit.
    pub(super) fn probe(&mut self, wanted: f64, rate: f64) {
        self.explicit_steps = 0;
        if wanted.is_finite() && wanted * rate > LEAST_PROBED_PRODUCT {
            (self.stiff, self.contrary_steps, self.stability_limit) = (true, 0, (wanted * rate).min(STABILITY_LIMIT_RANGE[1]));
        }
    }

    /// Updates the switch from an accepted step.
    pub(super) fn learn(&mut self, seen: &AcceptedStep) {
        if seen.scheme.properties().is_implicit {
            self.learn_from_implicit(seen);
        } else {
            self.learn_from_explicit(seen);
        }
        if seen.scheme == Scheme::GENERAL && seen.limit.is_finite() {
            self.brief_step *= BRIEF_STEP_GROWTH;
        }
    }

    fn learn_from_explicit(&mut self, seen: &AcceptedStep) {
        // The product is an estimate; steps at the stability limit are sometimes below it.
        self.contrary_steps =
            if seen.product > STABILITY_LIMIT { self.contrary_steps + 1 } else { self.contrary_steps.saturating_sub(1) };
        self.explicit_steps += u16::from(seen.stiff_forces && seen.wanted < seen.limit && !self.is_probing());
        if self.contrary_steps >= STEPS_AT_LIMIT << self.returns {
            (self.stiff, self.contrary_steps, self.explicit_steps, self.stability_limit) = (true, 0, 0, -seen.length);
        }
    }

    fn learn_from_implicit(&mut self, seen: &AcceptedStep) {
        let rate = seen.product / seen.length;
        if self.stability_limit < 0.0 {
            self.stability_limit = (-self.stability_limit * rate).clamp(STABILITY_LIMIT_RANGE[0], STABILITY_LIMIT_RANGE[1]);
        }
        let could_be_explicit = seen.wanted.min(seen.limit) * rate < self.stability_limit;
        self.contrary_steps = if could_be_explicit { self.contrary_steps + 1 } else { 0 };
        if self.contrary_steps >= STEPS_BELOW_LIMIT << self.returns {
            *self = Self { returns: (self.returns + 1).min(MOST_RETURNS), brief_step: self.brief_step, ..Self::NEW };
        }
    }

    /// Whether a run with these schemes can produce this state of the switch.
    pub(super) fn is_possible(&self, schemes: Schemes) -> bool {
        if schemes != Schemes::Automatic {
            return *self == Self::NEW;
        }
        let most = if self.stiff { STEPS_BELOW_LIMIT } else { STEPS_AT_LIMIT } << self.returns.min(MOST_RETURNS);
        let [least, largest] = STABILITY_LIMIT_RANGE;
        let limit_is_possible = match self.stiff {
            true => {
                self.stability_limit.is_finite()
                    && (self.stability_limit < 0.0 || (least..=largest).contains(&self.stability_limit))
            }
            false => self.stability_limit == 0.0,
        };
        let count_is_possible =
            self.explicit_steps <= if self.stiff { 0 } else { PROBE_INTERVAL << self.returns.min(MOST_RETURNS) };
        self.returns <= MOST_RETURNS
            && self.contrary_steps < most
            && count_is_possible
            && limit_is_possible
            && self.brief_step > 0.0
    }
}

/// Number of accepted steps between two checks; a power of two avoids a division.
const INTERVAL: u64 = 1024;
/// Estimated product of step and fastest rate above which a step is at the stability limit. At the limit the estimate is 3.9 for a damper
/// and 3.3 on average for a damped spring (exact: 6.4 and 5.5). Below 1.7 accuracy limits the step.
const STABILITY_LIMIT: f64 = 2.5;
/// Number of checks at the stability limit that detect stiffness, without [`NONSTIFF_STEPS`] others in a row between them.
const STIFF_STEPS: u8 = 15;
/// Number of successive checks away from the stability limit that reset the count.
const NONSTIFF_STEPS: u8 = 6;

/// Rate, in error tolerances per s, below which the system counts as at rest: a motion of less than the tolerance per ms.
const REST_RATE: f64 = 1e3;
/// Product of step and fastest rate at rest. It is below the stability limit. At the limit, errors would stay small until accelerations
/// reach the admissible error of rates times the fastest rate.
const STABILITY_LIMIT_AT_REST: f64 = 5.0;

/// Observations of the stability limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct StiffnessDetector {
    at_limit: u8,
    away_from_limit: u8,
    /// Whether stability rather than accuracy has limited the steps.
    pub(super) detected: bool,
    /// Fastest rate of the tangents, 1/s, if sticking friction and springs keep the system at rest, so that the motion does not reveal it.
    pub(super) rate_at_rest: Option<f64>,
}

impl StiffnessDetector {
    /// Whether a check is due after `substeps` accepted steps.
    pub(super) fn is_due(&self, substeps: u64) -> bool {
        !self.detected && (self.at_limit > 0 || substeps.is_multiple_of(INTERVAL))
    }

    /// Records the product of step and fastest rate of one step.
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

    /// Whether checks can produce these counts.
    pub(super) fn is_consistent(&self) -> bool {
        self.rate_at_rest.is_none_or(|rate| (0.0..f64::INFINITY).contains(&rate))
            && self.at_limit <= STIFF_STEPS
            && self.away_from_limit < NONSTIFF_STEPS
            && self.detected == (self.at_limit == STIFF_STEPS)
    }
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Longest stable step, s, while the system is at rest, as by sticking friction; infinite while it moves.
    pub(super) fn longest_at_rest<S: System<N, M>>(&mut self, system: &S, settings: &Settings, pose: &S::Pose) -> f64 {
        let rate = &mut self.memory.stiffness.rate_at_rest;
        if system.error_norm(&self.start.v) > REST_RATE * settings.error_tolerance {
            *rate = None;
            return f64::INFINITY;
        }
        let by_tangents = || {
            let linearization = Linearization::about(system, settings, (&self.start, pose));
            linearization.map(|linearization| linearization.fastest_rate).filter(|rate| rate.is_finite()).unwrap_or_default()
        };
        STABILITY_LIMIT_AT_REST / *rate.get_or_insert_with(by_tangents)
    }
}
