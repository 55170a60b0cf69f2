//! Coaxial motors with links of equal lengths: the closure falls apart into branches on which pairs of links stay parallel, and which
//! meet where all links are in line.
//!
//! There the closure of the tip loses rank, and the force that keeps a motion on its branch grows beyond all bounds. On a branch by itself
//! nothing is singular: it is two linear equations in the angles, of constant derivatives. So a motion that is on one stays on it.

use std::f64::consts::{PI, TAU};

use borsh::{BorshDeserialize, BorshSerialize};

use super::legs::{Legs, Legs2};
use super::model::Geometry;

/// A branch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum ClosureBranch {
    /// A parallelogram: each proximal link beside the distal one of the other leg.
    Parallelogram,
    /// The legs on each other: the proximal links, and the distal ones.
    Coincident,
    /// Both legs folded: each distal link back along its proximal one, the tip on the motors.
    Folded,
}

/// Angles of both proximal and both distal links, rad, or their rates.
type Pairs = [Legs; 2];

/// This near a branch, rad or rad/s, a motion is on it...
const LARGEST_DEVIATION: f64 = 1e-6;
/// ... unless another one is not farther than this.
const LEAST_SEPARATION: f64 = 1e-4;

impl ClosureBranch {
    const ALL: [Self; 3] = [Self::Parallelogram, Self::Coincident, Self::Folded];

    /// The branch that a motion is on; none where the motors are not coaxial or the lengths not equal, or where branches meet.
    #[cold]
    pub fn of(geometry: &Geometry, q: Pairs, v: Pairs) -> Option<Self> {
        let mut on = None;
        for branch in Self::ALL.into_iter().filter(|branch| branch.is_of(geometry)) {
            let off = branch.apart(q).into_iter().chain(branch.rates(v)).fold(0.0, |most: f64, x| most.max(x.abs()));
            if off <= LARGEST_DEVIATION && on.is_none() {
                on = Some(branch);
            } else if off <= LEAST_SEPARATION {
                return None;
            }
        }
        on
    }

    /// Whether a machine has it.
    pub fn is_of(self, geometry: &Geometry) -> bool {
        let [left, distal_left, distal_right, right] = geometry.links.map(|link| link.length);
        let pairs = match self {
            Self::Parallelogram => [[left, distal_right], [right, distal_left]],
            Self::Coincident => [[left, right], [distal_left, distal_right]],
            Self::Folded => [[left, distal_left], [right, distal_right]],
        };
        geometry.base_distance == 0.0 && pairs.iter().all(|[x, y]| x == y)
    }

    /// How far its pairs are from being parallel, rad.
    pub fn apart(self, q: Pairs) -> [f64; 2] {
        let straight = if self == Self::Folded { PI } else { 0.0 };
        self.rates(q).map(|angle| {
            let off = angle - straight;
            off - (off / TAU).round() * TAU
        })
    }

    /// How fast they turn against each other, rad/s.
    pub fn rates(self, [proximal, distal]: Pairs) -> [f64; 2] {
        let ([pl, pr], [dl, dr]) = (proximal.to_array(), distal.to_array());
        match self {
            Self::Parallelogram => [pl - dr, dl - pr],
            Self::Coincident => [pl - pr, dl - dr],
            Self::Folded => [dl - pl, dr - pr],
        }
    }

    /// Φ_q of the branch.
    pub fn terms(self) -> &'static ClosureTerms {
        match self {
            Self::Parallelogram => &PARALLELOGRAM,
            Self::Coincident => &COINCIDENT,
            Self::Folded => &FOLDED,
        }
    }
}

/// What turns the angles of branches into lengths, m: about that of a link, it matters to round-off alone.
pub const BRANCH_ARM: f64 = 0.25;

/// Φ_q of a branch, or of none, as a sum: without a branch in the code, which would have all of a factor in memory.
#[derive(Debug)]
pub struct ClosureTerms {
    /// How much of the closure of the tip holds: 1, or 0 on a branch.
    pub open: Legs,
    /// The derivatives of both equations by the proximal and by the distal angles, m; 0 without a branch.
    pub constant: [Legs2; 2],
}

impl ClosureTerms {
    /// On no branch.
    pub const OPEN: &'static Self = &Self { open: Legs::new([1.0; 2]), constant: [NOTHING; 2] };
}

const NOTHING: Legs2 = Legs2 { x: Legs::new([0.0; 2]), y: Legs::new([0.0; 2]) };

/// Parts of the arm: of the first and the second equation, left and right.
const fn arms(x: [f64; 2], y: [f64; 2]) -> Legs2 {
    Legs2 { x: Legs::new([x[0] * BRANCH_ARM, x[1] * BRANCH_ARM]), y: Legs::new([y[0] * BRANCH_ARM, y[1] * BRANCH_ARM]) }
}

static PARALLELOGRAM: ClosureTerms = branch(arms([1.0, 0.0], [0.0, -1.0]), arms([0.0, -1.0], [1.0, 0.0]));
static COINCIDENT: ClosureTerms = branch(arms([1.0, -1.0], [0.0, 0.0]), arms([0.0, 0.0], [1.0, -1.0]));
static FOLDED: ClosureTerms = branch(arms([-1.0, 0.0], [0.0, -1.0]), arms([1.0, 0.0], [0.0, 1.0]));

const fn branch(proximal: Legs2, distal: Legs2) -> ClosureTerms {
    ClosureTerms { open: Legs::new([0.0; 2]), constant: [proximal, distal] }
}
