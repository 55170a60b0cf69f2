//! Of which kinds steps are, and which comes next.

use borsh::{BorshDeserialize, BorshSerialize};

/// A kind of step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum Kind {
    /// Explicit, of order 8: DOP853.
    Eighth,
    /// Linearly implicit, of order 4: Rodas4.
    StiffFourth,
    /// Linearly implicit, of order 5: Rodas5P.
    StiffFifth,
}

/// Which kinds are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kinds {
    /// One.
    Only(Kind),
}

impl Kinds {
    /// With which a run begins.
    pub(super) fn first(self) -> Kind {
        match self {
            Self::Only(kind) => kind,
        }
    }

    /// Whether a kind is among them.
    pub(super) fn hold(self, kind: Kind) -> bool {
        match self {
            Self::Only(only) => kind == only,
        }
    }
}
