//! Branches of a reducible closure. With coaxial motors and links of pairwise equal lengths, the configuration space is a union of branches
//! that intersect where all links are in line.
//!
//! The four links are vectors; the loop is closed when their sum is zero. Suppose two of them have length a and two have length b. Then the
//! vectors of each pair are either opposite, or mirror images in an axis that both pairs share, with equal and opposite components along
//! it. Opposite pairs are parallel or antiparallel links. If a = b, a mirrored posture is an opposite posture of another pairing, so there
//! are three branches with opposite pairs. If a ≠ b, there is one branch of each kind.
//!
//! At an intersection the closure of the tip loses rank, and the force that keeps a motion on its branch is unbounded. A single branch is
//! regular. With opposite pairs it satisfies two linear equations in the angles. With mirrored pairs it satisfies one linear equation, for
//! the common axis, and the closure of the tip along this axis. A motion on a branch therefore uses these equations instead.

use std::f64::consts::{PI, TAU};

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};

use super::legs::{Legs, Legs2};
use super::model::Geometry;

/// A branch of the closure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum ClosureBranch {
    /// A parallelogram: each proximal link is parallel to the distal link of the other leg.
    Parallelogram,
    /// Coincident legs: the proximal links are parallel, and so are the distal links.
    Coincident,
    /// Folded legs: each distal link lies back along its proximal link, and the tip is on the motor axes.
    Folded,
    /// A crossed parallelogram: each proximal link is as long as the distal link of the other leg, but not parallel to it.
    CrossedParallelogram,
    /// A kite with equal legs: they are mirror images in the line from the motors to the tip.
    Kite,
    /// A kite with two equal links in each leg; its axis is the line through both elbows.
    ElbowKite,
}

/// Proximal and distal values of both legs: angles, rad, rates, rad/s, or weights.
pub(crate) type Pairs = [Legs; 2];

/// Deviation from each branch of a mechanism: of a posture, rad, or of rates, rad/s.
type Deviations = ArrayVec<(ClosureBranch, f64), { ClosureBranch::ALL.len() }>;

/// Largest deviation from its branch of a motion on the branch: of the posture, rad, or of the rates, relative to the fastest rate. It is
/// above the drift of a coarse step and below any visible motion.
const LARGEST_DEVIATION: f64 = 1e-6;
/// Smallest deviation of a posture from all other branches, rad, at which the posture decides. Nearer to an intersection, a closed loop
/// does not distinguish the branches: its round-off is divided by the distance.
const LEAST_SEPARATION: f64 = 1e-6;
/// Smallest deviation of the rates from all other branches, rad/s, at which the rates decide.
const LEAST_RATE: f64 = 1e-4;
/// Smallest ratio of the deviation from any other branch to the deviation from the chosen branch.
const TIMES: f64 = 100.0;

/// Largest difference from a machine with branches, relative to the longest link, for which [`ClosureBranch::turn_in_line`] is given. Other
/// machines turn so far from the posture with all links in line that the error of a step shows the turn.
const LARGEST_DIFFERENCE: f64 = 1e-2;
/// Largest error tolerance relative to [`ClosureBranch::turn_in_line`]: a larger error would hide the turn.
pub const TOLERANCE_OF_TURN: f64 = 0.1;

impl ClosureBranch {
    const ALL: [Self; 6] =
        [Self::Parallelogram, Self::Coincident, Self::Folded, Self::CrossedParallelogram, Self::Kite, Self::ElbowKite];

    /// Returns the branch of a motion. The posture decides if it can, otherwise the rates. `None` if the motors are not coaxial, the
    /// lengths are not equal in pairs, or the motion is at an intersection and the rates do not decide either.
    pub fn of(geometry: &Geometry, q: Pairs, v: Pairs) -> Option<Self> {
        let largest = |of: [f64; 2]| of[0].abs().max(of[1].abs());
        let branches = Self::ALL.into_iter().filter(|branch| branch.is_of(geometry));
        let by_posture: Deviations = branches.map(|branch| (branch, largest(branch.apart(q)))).collect();
        Self::nearest(&by_posture, LARGEST_DEVIATION, LEAST_SEPARATION).or_else(|| {
            let [proximal, distal] = v.map(Legs::to_array);
            let fastest = proximal.into_iter().chain(distal).fold(1.0, |most: f64, rate| most.max(rate.abs()));
            let near = by_posture.iter().filter(|(_, deviation)| *deviation <= LARGEST_DEVIATION);
            let by_rates: Deviations = near.map(|(branch, _)| (*branch, largest(branch.rates(v)))).collect();
            Self::nearest(&by_rates, LARGEST_DEVIATION * fastest, LEAST_RATE)
        })
    }

    /// Returns the branch with the smallest deviation if it is at most `largest` and all other deviations exceed `least` and `TIMES` the
    /// smallest.
    fn nearest(deviations: &Deviations, largest: f64, least: f64) -> Option<Self> {
        let &(nearest, deviation) = deviations.iter().min_by(|(_, one), (_, other)| one.total_cmp(other))?;
        let separate = |(branch, other): &(Self, f64)| *branch == nearest || *other > least.max(TIMES * deviation);
        (deviation <= largest && deviations.iter().all(separate)).then_some(nearest)
    }

    /// Whether, for some branch, the lengths in each pair differ by at most `length`, m, and the base distance is at most `base`, m.
    pub fn any_is_nearly_of(geometry: &Geometry, [length, base]: [f64; 2]) -> bool {
        let are_near = |[x, y]: [f64; 2]| (x - y).abs() <= length;
        geometry.base_distance <= base && Self::ALL.into_iter().any(|branch| branch.pairs(geometry).into_iter().all(are_near))
    }

    /// Distance, rad, from the posture with all links in line within which a motion turns from one branch to another, if the machine nearly
    /// has branches: the square root of its difference from a machine with branches, relative to the longest link. `None` for machines with
    /// branches and for those that differ much.
    pub fn turn_in_line(geometry: &Geometry) -> Option<f64> {
        if Self::ALL.into_iter().any(|branch| branch.is_of(geometry)) {
            return None;
        }
        let longest = geometry.lengths().into_iter().fold(0.0, f64::max);
        let largest =
            |branch: Self| branch.pairs(geometry).into_iter().map(|[x, y]| (x - y).abs()).fold(geometry.base_distance, f64::max);
        let difference = Self::ALL.into_iter().map(largest).fold(f64::INFINITY, f64::min) / longest;
        (difference <= LARGEST_DIFFERENCE).then(|| difference.max(f64::EPSILON).sqrt())
    }

    /// Lengths of the links of both pairs, m.
    fn pairs(self, geometry: &Geometry) -> [[f64; 2]; 2] {
        let [left, distal_left, distal_right, right] = geometry.lengths();
        match self {
            Self::Parallelogram | Self::CrossedParallelogram => [[left, distal_right], [right, distal_left]],
            Self::Coincident | Self::Kite => [[left, right], [distal_left, distal_right]],
            Self::Folded | Self::ElbowKite => [[left, distal_left], [right, distal_right]],
        }
    }

    /// Whether a mechanism has the branch, within the round-off of its lengths.
    pub fn is_of(self, geometry: &Geometry) -> bool {
        let pairs = self.pairs(geometry);
        let [[one, _], [other, _]] = pairs;
        let are_equal = |[x, y]: [f64; 2]| (x - y).abs() <= 4.0 * f64::EPSILON * x;
        geometry.base_distance == 0.0 && pairs.into_iter().all(are_equal) && !(self.is_mirrored() && are_equal([one, other]))
    }

    /// Whether the two links of each pair are mirror images in an axis.
    fn is_mirrored(self) -> bool {
        matches!(self, Self::CrossedParallelogram | Self::Kite | Self::ElbowKite)
    }

    /// Indices of the joints that do not turn on the branch, counted from the left base joint to the right base joint.
    pub fn still_joints(self) -> &'static [usize] {
        match self {
            Self::Parallelogram | Self::CrossedParallelogram | Self::Kite | Self::ElbowKite => &[],
            Self::Coincident => &[2],
            Self::Folded => &[1, 3],
        }
    }

    /// Deviations from the linear equations of the branch, rad: angle between the links of each opposite pair, or twice the angle between
    /// the axes of mirrored pairs.
    pub fn apart(self, q: Pairs) -> [f64; 2] {
        let straight = if self == Self::Folded { PI } else { 0.0 };
        self.rates(q).map(|angle| {
            let off = angle - straight;
            off - (off / TAU).round() * TAU
        })
    }

    /// Rates of the deviations [`ClosureBranch::apart`], rad/s.
    pub fn rates(self, [proximal, distal]: Pairs) -> [f64; 2] {
        let ([pl, pr], [dl, dr]) = (proximal.to_array(), distal.to_array());
        match self {
            Self::Parallelogram => [pl - dr, dl - pr],
            Self::Coincident => [pl - pr, dl - dr],
            Self::Folded => [dl - pl, dr - pr],
            Self::CrossedParallelogram => [(pl + dr) - (dl + pr), 0.0],
            Self::Kite => [(pl + pr) - (dl + dr), 0.0],
            Self::ElbowKite => [(pl + dl) - (pr + dr), 0.0],
        }
    }

    /// Terms of Φ_q on the branch.
    pub fn terms(self) -> &'static ClosureTerms {
        match self {
            Self::Parallelogram => &PARALLELOGRAM,
            Self::Coincident => &COINCIDENT,
            Self::Folded => &FOLDED,
            Self::CrossedParallelogram => &CROSSED_PARALLELOGRAM,
            Self::Kite => &KITE,
            Self::ElbowKite => &ELBOW_KITE,
        }
    }
}

/// Factor that scales the angle equations of branches to lengths, m/rad: about the length of a link. It affects only round-off.
pub const BRANCH_ARM: f64 = 0.25;

/// Rows of Φ_q for the tip's closure or for a branch, as a weighted sum: code without conditionals keeps the factorisation in registers.
#[derive(Debug)]
pub struct ClosureTerms {
    /// Weight of the tip's closure: 0 on a branch with opposite pairs, otherwise 1.
    pub open: Legs,
    /// Derivatives of a branch's linear equations with respect to the proximal and the distal angles, m/rad; 0 without a branch.
    pub constant: [Legs2; 2],
    /// Weights for each mirrored pair, on a branch with mirrored pairs. There the tip's closure counts only along the axis: the weighted
    /// sum of the proximal and distal directions of either pair is normal to the axis.
    pub mirrored: Option<[Pairs; 2]>,
}

impl ClosureTerms {
    /// Terms of the tip's closure, without a branch.
    pub const OPEN: &'static Self = &Self { open: Legs::new([1.0; 2]), constant: [NOTHING; 2], mirrored: None };
}

const NOTHING: Legs2 = Legs2 { x: Legs::new([0.0; 2]), y: Legs::new([0.0; 2]) };

/// Derivatives of the first (x) and the second (y) branch equation, left and right, in multiples of [`BRANCH_ARM`].
const fn arms(x: [f64; 2], y: [f64; 2]) -> Legs2 {
    Legs2 { x: Legs::new([x[0] * BRANCH_ARM, x[1] * BRANCH_ARM]), y: Legs::new([y[0] * BRANCH_ARM, y[1] * BRANCH_ARM]) }
}

static PARALLELOGRAM: ClosureTerms = opposite(arms([1.0, 0.0], [0.0, -1.0]), arms([0.0, -1.0], [1.0, 0.0]));
static COINCIDENT: ClosureTerms = opposite(arms([1.0, -1.0], [0.0, 0.0]), arms([0.0, 0.0], [1.0, -1.0]));
static FOLDED: ClosureTerms = opposite(arms([-1.0, 0.0], [0.0, -1.0]), arms([1.0, 0.0], [0.0, 1.0]));

const fn opposite(proximal: Legs2, distal: Legs2) -> ClosureTerms {
    ClosureTerms { open: Legs::new([0.0; 2]), constant: [proximal, distal], mirrored: None }
}

static CROSSED_PARALLELOGRAM: ClosureTerms =
    mirrored([1.0, -1.0], [-1.0, 1.0], [[[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [1.0, 0.0]]]);
static KITE: ClosureTerms = mirrored([1.0, 1.0], [-1.0, -1.0], [[[1.0, 1.0], [0.0, 0.0]], [[0.0, 0.0], [1.0, 1.0]]]);
static ELBOW_KITE: ClosureTerms = mirrored([1.0, -1.0], [1.0, -1.0], [[[1.0, 0.0], [-1.0, 0.0]], [[0.0, 1.0], [0.0, -1.0]]]);

const fn mirrored(proximal: [f64; 2], distal: [f64; 2], [[ap, ad], [bp, bd]]: [[[f64; 2]; 2]; 2]) -> ClosureTerms {
    let pairs = [[Legs::new(ap), Legs::new(ad)], [Legs::new(bp), Legs::new(bd)]];
    let constant = [arms(proximal, [0.0; 2]), arms(distal, [0.0; 2])];
    ClosureTerms { open: Legs::new([1.0; 2]), constant, mirrored: Some(pairs) }
}
