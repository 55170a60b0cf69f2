//! Schemes of a step, and the automatic choice among them.
//!
//! DOP853 is used unless stiffness or short input holds favour another. Inputs held for no longer than a step of order 5 leave no
//! advantage to order 8: then Tsit5. Where stability limits the step instead of the error, a Rosenbrock method is used until its
//! own error asks for steps that an explicit method could make. `docs/automatic.md`.

use borsh::{BorshDeserialize, BorshSerialize};

use super::stiffness::STABILITY_LIMIT;

/// Scheme of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum Scheme {
    /// DOP853: explicit, of order 8.
    Dop853,
    /// Tsit5: explicit, of order 5.
    Tsit5,
    /// Rodas4: linearly implicit, of order 4.
    Rodas4,
    /// Rodas5P: linearly implicit, of order 5.
    Rodas5p,
}

impl Scheme {
    /// Whether the scheme is linearly implicit.
    pub(super) const fn is_implicit(self) -> bool {
        matches!(self, Self::Rodas4 | Self::Rodas5p)
    }
}

/// Schemes that a run may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Schemes {
    /// One scheme, with DOP853 where an implicit step cannot begin.
    Only(Scheme),
    /// Automatic choice of the cheapest scheme.
    Automatic,
}

/// Error tolerance, rad, from which on Rodas4 replaces Rodas5P: it is cheaper, and oscillates less at discontinuities.
const RODAS4_TOLERANCE: f64 = 1e-5;

/// Factor on the assumed length of a Tsit5 step after each DOP853 step under short input holds, so that Tsit5 is tried again.
const TSIT5_GROWTH: f64 = 1.05;

/// Number of explicit steps at the stability limit that switch to implicit ones; doubled by each return.
const STEPS_AT_LIMIT: u8 = 3;
/// Number of successive implicit steps that could have been explicit after which the switch goes back, doubled by each return.
/// Saturated friction has zero tangents, so fewer steps would switch back too early.
const STEPS_BELOW_LIMIT: u8 = 3;
/// Largest number of doublings.
const MOST_RETURNS: u8 = 5;
/// Admissible range of the stability limit: explicit step times fastest rate of the tangents, at the switch to implicit steps.
const STABILITY_LIMIT_RANGE: [f64; 2] = [0.1, 12.0];
/// Stability limit where none has been observed: that of DOP853 for a damper.
const USUAL_STABILITY_LIMIT: f64 = 6.4;
/// Number of explicit steps with stiff forces after which the tangents are evaluated, doubled by each return: round-off, amplified
/// by stiff forces, may keep steps short of the stability limit.
const PROBE_INTERVAL: u16 = 100;
/// Product of explicit step and fastest rate of the tangents above which implicit steps are tried: round-off keeps it at 0.8 or
/// more, accuracy at 0.04 to 0.4.
const LEAST_PROBED_PRODUCT: f64 = 0.5;

/// Switch between explicit and implicit schemes by detected stiffness, with its memory.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct StiffnessSwitch {
    /// Whether the steps are implicit.
    stiff: bool,
    /// Number of recent steps that speak for a change.
    contrary_steps: u8,
    /// Number of explicit steps since the last evaluation of tangents.
    explicit_steps: u16,
    /// Number of returns from implicit to explicit steps.
    returns: u8,
    /// Minus the explicit step, s, at the switch to implicit steps; from the first implicit step on its product with the fastest
    /// rate of the tangents.
    stability_limit: f64,
    /// Length of the next Tsit5 step, s.
    pub(super) tsit5_step: f64,
}

/// Accepted step, as data for a [`StiffnessSwitch`].
pub(super) struct AcceptedStep {
    pub(super) scheme: Scheme,
    /// Step length, s.
    pub(super) length: f64,
    /// Product of step length and fastest rate.
    pub(super) product: f64,
    /// Step length that the error allows next, s.
    pub(super) wanted: f64,
    /// Limit of the step length by other reasons, s.
    pub(super) limit: f64,
    /// Whether any force is stiff.
    pub(super) stiff_forces: bool,
}

impl Schemes {
    /// Implicit scheme for an error tolerance, rad.
    fn stiff(error_tolerance: f64) -> Scheme {
        if error_tolerance >= RODAS4_TOLERANCE { Scheme::Rodas4 } else { Scheme::Rodas5p }
    }

    /// Whether a step may belong to a scheme.
    pub(super) fn allow(self, scheme: Scheme, error_tolerance: f64) -> bool {
        match self {
            Self::Only(only) => scheme == only || scheme == Scheme::Dop853,
            Self::Automatic => matches!(scheme, Scheme::Dop853 | Scheme::Tsit5) || scheme == Self::stiff(error_tolerance),
        }
    }

    /// Scheme of the next step, which other reasons limit to `limit` seconds.
    #[inline]
    pub(super) fn next(self, stiffness_switch: &StiffnessSwitch, error_tolerance: f64, limit: f64) -> Scheme {
        match self {
            Self::Only(scheme) => scheme,
            Self::Automatic if stiffness_switch.stiff => Self::stiff(error_tolerance),
            Self::Automatic if limit <= stiffness_switch.tsit5_step && limit.is_finite() => Scheme::Tsit5,
            Self::Automatic => Scheme::Dop853,
        }
    }
}

impl StiffnessSwitch {
    /// Initial state, without observations.
    pub(super) const NEW: Self =
        Self { stiff: false, contrary_steps: 0, explicit_steps: 0, returns: 0, stability_limit: 0.0, tsit5_step: f64::INFINITY };

    /// Chooses the first scheme: implicit if an explicit step of `wanted` seconds would be unstable at the tangents' fastest rate,
    /// 1/s.
    pub(super) fn begin(&mut self, wanted: f64, rate: f64) {
        if wanted * rate > STABILITY_LIMIT_RANGE[1] {
            (self.stiff, self.stability_limit) = (true, USUAL_STABILITY_LIMIT);
        }
    }

    /// Whether enough explicit steps have been made for the tangents to be evaluated again.
    pub(super) fn is_probing(&self) -> bool {
        self.explicit_steps >= PROBE_INTERVAL << self.returns
    }

    /// Takes the tangents' fastest rate, 1/s, at a step of `wanted` seconds: implicit steps are tried unless the product is far
    /// from the stability limit.
    pub(super) fn probe(&mut self, wanted: f64, rate: f64) {
        self.explicit_steps = 0;
        if wanted.is_finite() && wanted * rate > LEAST_PROBED_PRODUCT {
            (self.stiff, self.contrary_steps, self.stability_limit) = (true, 0, (wanted * rate).min(STABILITY_LIMIT_RANGE[1]));
        }
    }

    /// Updates the switch from an accepted step.
    pub(super) fn learn(&mut self, seen: &AcceptedStep) {
        match seen.scheme {
            Scheme::Dop853 | Scheme::Tsit5 => self.learn_from_explicit(seen),
            Scheme::Rodas4 | Scheme::Rodas5p => self.learn_from_implicit(seen),
        }
        if seen.scheme == Scheme::Dop853 && seen.limit.is_finite() {
            self.tsit5_step *= TSIT5_GROWTH;
        }
    }

    fn learn_from_explicit(&mut self, seen: &AcceptedStep) {
        // The product is an estimate, which steps at the stability limit undercut now and then.
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
            *self = Self { returns: (self.returns + 1).min(MOST_RETURNS), tsit5_step: self.tsit5_step, ..Self::NEW };
        }
    }

    /// Whether runs with these schemes can leave the switch in this state.
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
            && self.tsit5_step > 0.0
    }
}
