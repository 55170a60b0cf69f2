//! Of which kinds steps are, and which comes next.
//!
//! By itself a run goes by DOP853, which nothing here beats where the road is free. Two things change that. Inputs that are held for no
//! longer than a step of order 5 reaches leave nothing for order 8 to gain. And where stability limits the step instead of the
//! error, a linearly implicit one goes on, until its own error asks for steps that an explicit one could make.

use borsh::{BorshDeserialize, BorshSerialize};

use super::stiffness::STABILITY_LIMIT;

/// A kind of step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum Scheme {
    /// Explicit, of order 8: DOP853.
    Dop853,
    /// Explicit, of order 5: Tsit5.
    Tsit5,
    /// Linearly implicit, of order 4: Rodas4.
    Rodas4,
    /// Linearly implicit, of order 5: Rodas5P.
    Rodas5p,
}

impl Scheme {
    /// Whether its steps are linearly implicit.
    pub(super) const fn is_implicit(self) -> bool {
        matches!(self, Self::Rodas4 | Self::Rodas5p)
    }
}

/// Which kinds are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Schemes {
    /// One, but explicit steps where an implicit one cannot begin.
    Only(Scheme),
    /// Whichever takes least.
    Automatic,
}

/// From this error tolerance on the implicit steps are of order 4: they take less, and ring less on kinks.
const LOOSE: f64 = 1e-5;

/// After each step of order 8 while inputs are held one of order 5 is taken to reach so much farther, so that it is tried again.
const RECONSIDERED: f64 = 1.05;

/// So many steps at the border are no accident, after as many changes back and forth as have been counted; doubled by each.
const AT_BORDER: u8 = 3;
/// The same for implicit steps in a row that explicit ones could have made: friction in saturation has no tangents, and by three steps that
/// find it there nothing ever comes to rest.
const WITHIN_BORDER: u8 = 3;
/// Most doublings.
const MOST_RETURNS: u8 = 5;
/// Bounds on the product of explicit steps with the fastest rate of the tangents, as it is found when implicit ones begin.
const BORDERS: [f64; 2] = [0.1, 12.0];
/// Their product where none has been seen: that of DOP853 for a damper.
const USUAL_BORDER: f64 = 6.4;
/// Where forces are steep, the tangents are asked after so many explicit steps: round-off, which stiff forces magnify, may keep those
/// away from the border. Doubled like the counts above.
const PROBED: u16 = 100;
/// Implicit steps are tried where the product of explicit ones with the fastest rate of the tangents is larger than this: round-off keeps it at
/// 0.8 or more, and 0.04 to 0.4 is usual where accuracy does.
const WORTH_A_TRY: f64 = 0.5;

/// What a run remembers to choose by.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct StiffnessSwitch {
    /// Whether steps are implicit.
    stiff: bool,
    /// Steps in a row, or nearly so, that speak against it.
    against: u8,
    /// Explicit steps since implicit ones, up to the next try.
    explicit: u16,
    /// How often implicit steps have been given up again.
    returns: u8,
    /// The explicit step at the border when implicit ones began, s, and then its product with the fastest rate of the tangents.
    border: f64,
    /// How long a step of order 5 would be, s.
    pub(super) fifth: f64,
}

/// An accepted step, as a [`StiffnessSwitch`] learns from it.
pub(super) struct AcceptedStep {
    pub(super) scheme: Scheme,
    /// Its length, s.
    pub(super) length: f64,
    /// Its product with the fastest rate.
    pub(super) product: f64,
    /// The step that its error would have allowed, s.
    pub(super) wanted: f64,
    /// What limited it otherwise, s.
    pub(super) limit: f64,
    /// Whether the forces are steep.
    pub(super) stiff_forces: bool,
}

impl Schemes {
    /// The implicit kind for a tolerance.
    fn stiff(error_tolerance: f64) -> Scheme {
        if error_tolerance >= LOOSE { Scheme::Rodas4 } else { Scheme::Rodas5p }
    }

    /// Whether a step may be of a kind.
    pub(super) fn allow(self, scheme: Scheme, error_tolerance: f64) -> bool {
        match self {
            Self::Only(only) => scheme == only || scheme == Scheme::Dop853,
            Self::Automatic => matches!(scheme, Scheme::Dop853 | Scheme::Tsit5) || scheme == Self::stiff(error_tolerance),
        }
    }

    /// The next step's, which nothing but the error limits to less than so many seconds.
    #[inline]
    pub(super) fn next(self, stiffness_switch: &StiffnessSwitch, error_tolerance: f64, limit: f64) -> Scheme {
        match self {
            Self::Only(scheme) => scheme,
            Self::Automatic if stiffness_switch.stiff => Self::stiff(error_tolerance),
            Self::Automatic if limit <= stiffness_switch.fifth && limit.is_finite() => Scheme::Tsit5,
            Self::Automatic => Scheme::Dop853,
        }
    }
}

impl StiffnessSwitch {
    /// Before anything is known.
    pub(super) const NEW: Self = Self { stiff: false, against: 0, explicit: 0, returns: 0, border: 0.0, fifth: f64::INFINITY };

    /// Before the first step: implicit ones begin at once where tangents have so fast a rate, 1/s, that an explicit step of the length that
    /// is wanted could not be one.
    pub(super) fn begin(&mut self, wanted: f64, rate: f64) {
        if wanted * rate > BORDERS[1] {
            (self.stiff, self.border) = (true, USUAL_BORDER);
        }
    }

    /// Whether so many explicit steps have been made that the tangents are to be asked.
    pub(super) fn is_probing(&self) -> bool {
        self.explicit >= PROBED << self.returns
    }

    /// What they say: the step that is wanted, s, and their fastest rate, 1/s. Where it is far from the border there is nothing to gain.
    pub(super) fn probe(&mut self, wanted: f64, rate: f64) {
        self.explicit = 0;
        if wanted.is_finite() && wanted * rate > WORTH_A_TRY {
            (self.stiff, self.against, self.border) = (true, 0, (wanted * rate).min(BORDERS[1]));
        }
    }

    /// What an accepted step says about the next ones.
    pub(super) fn learn(&mut self, seen: &AcceptedStep) {
        match seen.scheme {
            Scheme::Dop853 | Scheme::Tsit5 => self.learn_from_explicit(seen),
            Scheme::Rodas4 | Scheme::Rodas5p => self.learn_from_implicit(seen),
        }
        if seen.scheme == Scheme::Dop853 && seen.limit.is_finite() {
            self.fifth *= RECONSIDERED;
        }
    }

    fn learn_from_explicit(&mut self, seen: &AcceptedStep) {
        // The product is an estimate: between steps at the border it is below now and then.
        self.against = if seen.product > STABILITY_LIMIT { self.against + 1 } else { self.against.saturating_sub(1) };
        self.explicit += u16::from(seen.stiff_forces && seen.wanted < seen.limit && !self.is_probing());
        if self.against >= AT_BORDER << self.returns {
            (self.stiff, self.against, self.explicit, self.border) = (true, 0, 0, -seen.length);
        }
    }

    fn learn_from_implicit(&mut self, seen: &AcceptedStep) {
        let rate = seen.product / seen.length;
        if self.border < 0.0 {
            self.border = (-self.border * rate).clamp(BORDERS[0], BORDERS[1]);
        }
        let could_be_explicit = seen.wanted.min(seen.limit) * rate < self.border;
        self.against = if could_be_explicit { self.against + 1 } else { 0 };
        if self.against >= WITHIN_BORDER << self.returns {
            *self = Self { returns: (self.returns + 1).min(MOST_RETURNS), fifth: self.fifth, ..Self::NEW };
        }
    }

    /// Whether steps by some kinds can leave it behind.
    pub(super) fn is_possible(&self, schemes: Schemes) -> bool {
        if schemes != Schemes::Automatic {
            return *self == Self::NEW;
        }
        let most = if self.stiff { WITHIN_BORDER } else { AT_BORDER } << self.returns.min(MOST_RETURNS);
        let [least, largest] = BORDERS;
        let border = match self.stiff {
            true => self.border.is_finite() && (self.border < 0.0 || (least..=largest).contains(&self.border)),
            false => self.border == 0.0,
        };
        let explicit = self.explicit <= if self.stiff { 0 } else { PROBED << self.returns.min(MOST_RETURNS) };
        self.returns <= MOST_RETURNS && self.against < most && explicit && border && self.fifth > 0.0
    }
}
