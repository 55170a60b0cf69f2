//! Dry friction as a set-valued law: friction places, their stick-slip states, and the choice of state where sliding rates vanish.
//!
//! A friction place is a direction in which bodies slide on each other: the rotation of a joint, or the tip along the plane. A slipping
//! place has a friction force against its sliding rate w; a sticking place has the force that keeps w = 0, up to the bound b. The method
//! stores the states ([`StickSlips`]); `simulation/stick_slip.rs` determines them from coordinates and rates.
//!
//! At vanishing sliding rates the accelerations follow from Gauss's principle with friction: they minimise
//! ½ (q̈ − q̈₀)ᵀ M (q̈ − q̈₀) + Σ b |ẇ|, with q̈₀ the accelerations without friction at these places (Moreau, 1988; Glocker, *Set-Valued
//! Force Laws*, 2001). The minimiser is unique. The mechanism has two degrees of freedom, so that at most two independent places stick,
//! and then nothing moves.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};

use super::wrench::{JOINTS, Wrench};
use crate::mechanism::ClosureBranch;

/// Number of friction places: the joints, and the tip on the plane.
pub const FRICTION_PLACES: usize = JOINTS + 1;

/// Index of the tip among the friction places.
pub(super) const TIP_FRICTION: usize = JOINTS;

/// Law of dry friction: the `….law` variables.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Law {
    /// Regularised: a smooth function of the sliding rate, which creeps under load.
    #[default]
    Smooth,
    /// Set-valued: sticks up to its bound.
    Stick,
}

/// Direction of slip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum SlipDirection {
    /// Positive sliding rate.
    Forward,
    /// Negative sliding rate.
    Backward,
}

impl SlipDirection {
    /// Direction of a sliding rate by its sign; forward at 0.
    pub fn of(x: f64) -> Self {
        if x < 0.0 { Self::Backward } else { Self::Forward }
    }

    /// Sign of the direction, ±1.
    pub fn sign(self) -> f64 {
        match self {
            Self::Forward => 1.0,
            Self::Backward => -1.0,
        }
    }
}

/// Stick-slip state of a friction place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum StickSlip {
    /// Inactive: no friction, the smooth law, or no contact.
    Inactive,
    /// Slips in a direction.
    Slips(SlipDirection),
    /// Sticks. Where several places hold the same motion, the direction is that of this place's share relative to the first.
    Sticks(SlipDirection),
    /// Still: the closure branch keeps the joint from turning, so that friction there has no effect.
    Still,
}

/// Stick-slip states of all friction places.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub struct StickSlips {
    places: [StickSlip; FRICTION_PLACES],
    /// Whether friction keeps the whole mechanism at rest.
    at_rest: bool,
}

impl StickSlips {
    /// No friction place is active.
    pub const OPEN: Self = Self { places: [StickSlip::Inactive; FRICTION_PLACES], at_rest: false };

    /// State of one friction place.
    pub fn at(&self, place: usize) -> StickSlip {
        self.places[place]
    }

    /// Sets the state of one friction place.
    pub fn set(&mut self, place: usize, joint: StickSlip) {
        self.places[place] = joint;
    }

    /// Whether friction keeps the whole mechanism at rest.
    #[inline]
    pub fn at_rest(&self) -> bool {
        self.at_rest
    }

    /// The states with the joints still that a closure branch keeps from turning.
    pub fn on_branch(mut self, closure_branch: ClosureBranch) -> Self {
        closure_branch.still_joints().iter().for_each(|joint| self.set(*joint, StickSlip::Still));
        self
    }

    /// Whether the closure branch keeps a friction place from moving.
    pub fn is_still(&self, place: usize) -> bool {
        self.places[place] == StickSlip::Still
    }

    /// The states with every place inactive but the still ones.
    pub fn opened(&self) -> Self {
        let mut stick_slip = Self::OPEN;
        (0..FRICTION_PLACES).filter(|place| self.is_still(*place)).for_each(|place| stick_slip.set(place, StickSlip::Still));
        stick_slip
    }

    /// The mechanism at rest with these places sticking.
    pub fn resting(self, places: impl Iterator<Item = usize>) -> Self {
        let mut stick_slip = Self { at_rest: true, ..self.opened() };
        places.for_each(|place| stick_slip.set(place, StickSlip::Sticks(SlipDirection::Forward)));
        stick_slip
    }

    /// Whether any friction place sticks.
    #[inline]
    pub fn any_sticks(&self) -> bool {
        self.places.iter().any(|joint| matches!(joint, StickSlip::Sticks(_)))
    }

    /// Sign of the sliding direction of a place with a rate, rad/s or m/s: that of the stored slip, 0 while sticking, and without a stored
    /// state that of the rate.
    pub(super) fn direction(&self, place: usize, rate: f64) -> f64 {
        match self.places[place] {
            StickSlip::Slips(slip_direction) => slip_direction.sign(),
            StickSlip::Sticks(_) | StickSlip::Still => 0.0,
            StickSlip::Inactive if rate == 0.0 => 0.0,
            StickSlip::Inactive => SlipDirection::of(rate).sign(),
        }
    }
}

/// Friction element at a state, as a constraint on the sliding rate that friction may hold at 0.
#[derive(Clone, Copy, Debug)]
pub struct FrictionConstraint {
    /// Index of the element in [`StickSlips`].
    pub place: usize,
    /// Wrench of a friction torque of 1 N·m, or of a friction force of 1 N; its power is the sliding rate.
    pub wrench: Wrench,
    /// Sliding rate, rad/s or m/s.
    pub rate: f64,
    /// Largest friction torque or force while sticking, N·m or N.
    pub bound: f64,
}

/// Constraints of all friction elements that are active at a state.
pub type FrictionConstraints = ArrayVec<FrictionConstraint, FRICTION_PLACES>;

/// Complementarity problem of the friction places whose sliding rate is 0: ẇ = G T + c with |T| ≤ b, T = −b sign ẇ where ẇ ≠ 0.
#[derive(Clone, Debug, Default)]
pub struct FrictionProblem {
    /// Indices of the places in [`StickSlips`].
    pub places: ArrayVec<usize, FRICTION_PLACES>,
    /// Matrix G: sliding accelerations per unit of friction torque or force at each place.
    pub mobility: [[f64; FRICTION_PLACES]; FRICTION_PLACES],
    /// Vector c: sliding accelerations without friction at these places, rad/s² or m/s².
    pub change: [f64; FRICTION_PLACES],
    /// Bounds b, N·m or N, all positive.
    pub bounds: [f64; FRICTION_PLACES],
}

/// Relative tolerance of the inequalities, as a part of the bounds: far above round-off, far below any physical load.
const TOLERANCE: f64 = 1e-9;

/// Ridge (Tikhonov) parameter of the torques at rest, relative to the trace: makes torques unique that equilibrium leaves open.
const RIDGE: f64 = 1e-12;

/// A candidate solution of a [`FrictionProblem`]: the stick-slip state of each of its places.
type Candidate = [StickSlip; FRICTION_PLACES];

impl FrictionProblem {
    fn len(&self) -> usize {
        self.places.len()
    }

    /// Largest acceleration that friction at place `i` alone can cause, rad/s² or m/s².
    fn scale(&self, i: usize) -> f64 {
        self.mobility[i][i] * self.bounds[i]
    }

    /// Whether friction can keep all places at rest, and that stops the whole mechanism.
    #[cold]
    #[inline(never)]
    pub fn can_rest(&self) -> bool {
        let n = self.len();
        let all = (0..n).any(|i| (0..i).any(|j| !self.are_parallel(i, j)));
        all && (self.least_squares_torques().is_some()
            || self.least_violating(2..=2).is_some_and(|(violation, _)| violation <= TOLERANCE))
    }

    /// Whether all places constrain the same motion.
    pub fn is_single_motion(&self) -> bool {
        (1..self.len()).all(|i| self.are_parallel(0, i))
    }

    /// Whether two places constrain the same motion: their rows are parallel.
    fn are_parallel(&self, i: usize, j: usize) -> bool {
        let g = &self.mobility;
        g[i][j] * g[i][j] >= (1.0 - TOLERANCE) * g[i][i] * g[j][j]
    }

    /// Torques or forces, N·m or N, by which all places stick: those of least sum of squares relative to the bounds, or, where these
    /// exceed the bounds, those with all but two places at their bounds.
    #[cold]
    #[inline(never)]
    pub fn resting_torques(&self) -> [f64; FRICTION_PLACES] {
        self.least_squares_torques().unwrap_or_else(|| {
            self.least_violating(2..=2).map_or([0.0; FRICTION_PLACES], |(_, candidate)| self.torques(&candidate))
        })
    }

    /// Torques of least squares: (D G D + ε tr) x = −D c, T = D x with D the bounds, by Cholesky's method; `None` where a bound is exceeded
    /// or an acceleration remains.
    #[cold]
    #[inline(never)]
    fn least_squares_torques(&self) -> Option<[f64; FRICTION_PLACES]> {
        let n = self.len();
        let trace: f64 = (0..n).map(|i| self.bounds[i] * self.scale(i)).sum();
        if trace <= 0.0 {
            return None;
        }
        // Cholesky, row by row.
        let mut lower = [[0.0; FRICTION_PLACES]; FRICTION_PLACES];
        let mut x = [0.0; FRICTION_PLACES];
        for i in 0..n {
            for j in 0..=i {
                let entry = self.bounds[i] * self.mobility[i][j] * self.bounds[j] + if i == j { RIDGE * trace } else { 0.0 };
                let rest = entry - (0..j).map(|k| lower[i][k] * lower[j][k]).sum::<f64>();
                if i == j && rest <= 0.0 {
                    return None;
                }
                lower[i][j] = if i == j { rest.sqrt() } else { rest / lower[j][j] };
            }
            let known: f64 = (0..i).map(|k| lower[i][k] * x[k]).sum();
            x[i] = (-self.bounds[i] * self.change[i] - known) / lower[i][i];
        }
        for i in (0..n).rev() {
            let known: f64 = (i + 1..n).map(|k| lower[k][i] * x[k]).sum();
            x[i] = (x[i] - known) / lower[i][i];
        }
        let mut torques = [0.0; FRICTION_PLACES];
        for i in 0..n {
            torques[i] = self.bounds[i] * x[i];
        }
        // If no torques keep all places at rest, those of least squares leave accelerations.
        let left = self.accelerations(&torques);
        let holds = (0..n).all(|i| x[i].abs() <= 1.0 && left[i].abs() <= 1e3 * TOLERANCE * self.scale(i));
        holds.then_some(torques)
    }

    /// Sliding accelerations ẇ = G T + c, rad/s² or m/s².
    #[cold]
    #[inline(never)]
    fn accelerations(&self, torques: &[f64; FRICTION_PLACES]) -> [f64; FRICTION_PLACES] {
        std::array::from_fn(|i| self.change[i] + (0..self.len()).map(|k| self.mobility[i][k] * torques[k]).sum::<f64>())
    }

    /// Torques or forces of a candidate, N·m or N: the bounds at slipping places, the solution of ẇ = 0 at up to two sticking places.
    #[cold]
    #[inline(never)]
    fn torques(&self, candidate: &Candidate) -> [f64; FRICTION_PLACES] {
        let mut torques: [f64; FRICTION_PLACES] = std::array::from_fn(|i| match candidate[i] {
            StickSlip::Slips(slip_direction) => -slip_direction.sign() * self.bounds[i],
            StickSlip::Sticks(_) | StickSlip::Inactive | StickSlip::Still => 0.0,
        });
        let left = self.accelerations(&torques);
        let mut held = (0..self.len()).filter(|i| matches!(candidate[*i], StickSlip::Sticks(_)));
        match (held.next(), held.next()) {
            (Some(i), None) => torques[i] = quotient(-left[i], self.mobility[i][i]),
            (Some(i), Some(j)) => {
                let [[a, b], [c, d]] = [[i, i], [j, j]].map(|[row, _]| [self.mobility[row][i], self.mobility[row][j]]);
                let determinant = a * d - b * c;
                torques[i] = quotient(b * left[j] - d * left[i], determinant);
                torques[j] = quotient(c * left[i] - a * left[j], determinant);
            }
            _ => {}
        }
        torques
    }

    /// The candidate of least violation, as a part of the bounds, among those whose number of sticking places is in a range.
    #[cold]
    #[inline(never)]
    fn least_violating(&self, holds: std::ops::RangeInclusive<usize>) -> Option<(f64, Candidate)> {
        let n = self.len();
        let mut least_violating: Option<(f64, Candidate)> = None;
        for mut code in 0..3_usize.pow(n as u32) {
            let mut candidate = [StickSlip::Inactive; FRICTION_PLACES];
            for joint in &mut candidate[..n] {
                *joint = [
                    StickSlip::Sticks(SlipDirection::Forward),
                    StickSlip::Slips(SlipDirection::Forward),
                    StickSlip::Slips(SlipDirection::Backward),
                ][code % 3];
                code /= 3;
            }
            let sticking: ArrayVec<usize, FRICTION_PLACES> =
                (0..n).filter(|i| matches!(candidate[*i], StickSlip::Sticks(_))).collect();
            // Two places that constrain the same motion leave the other motion free.
            if !holds.contains(&sticking.len()) || matches!(sticking[..], [i, j] if self.are_parallel(i, j)) {
                continue;
            }
            let torques = self.torques(&candidate);
            let left = self.accelerations(&torques);
            let violation = (0..n).fold(0.0, |most: f64, i| {
                most.max(match candidate[i] {
                    StickSlip::Sticks(_) => torques[i].abs() / self.bounds[i] - 1.0,
                    StickSlip::Slips(slip_direction) => quotient(-slip_direction.sign() * left[i], self.scale(i)),
                    StickSlip::Inactive | StickSlip::Still => 0.0,
                })
            });
            if least_violating.is_none_or(|(least, _)| violation < least) {
                least_violating = Some((violation, candidate));
            }
        }
        least_violating
    }

    /// Sets the states where the mechanism moves or begins to: at most one place sticks, and with it those that constrain the same motion.
    #[cold]
    #[inline(never)]
    pub fn resolve_motion(&self, stick_slip: &mut StickSlips) {
        let Some((_, mut candidate)) = self.least_violating(0..=1) else { return };
        let left = self.accelerations(&self.torques(&candidate));
        if let Some(sticking_place) = candidate.iter().position(|joint| matches!(joint, StickSlip::Sticks(_))) {
            // The round-off of strong places accelerates a weak one.
            let greatest = |i: usize| (0..self.len()).map(|k| (self.mobility[i][k] * self.bounds[k]).abs()).sum::<f64>();
            let with =
                |i: usize| i == sticking_place || self.are_parallel(sticking_place, i) && left[i].abs() <= TOLERANCE * greatest(i);
            // Directions are relative to the first of these places, which need not be `sticking_place`.
            let first = (0..sticking_place).find(|i| with(*i)).unwrap_or(sticking_place);
            for i in (first..self.len()).filter(|i| with(*i)) {
                candidate[i] = StickSlip::Sticks(SlipDirection::of(self.mobility[first][i]));
            }
        }
        for (place, joint) in self.places.iter().zip(candidate) {
            stick_slip.set(*place, joint);
        }
    }
}

/// The quotient x/y; where y is (nearly) 0, a value so large that it violates any bound.
fn quotient(x: f64, y: f64) -> f64 {
    /// Largest magnitude of the quotient: above any bound, and its square is still finite.
    const LARGEST_QUOTIENT: f64 = 1e100;
    if x == 0.0 {
        0.0
    } else if x.abs() < LARGEST_QUOTIENT * y.abs() {
        x / y
    } else {
        LARGEST_QUOTIENT * x.signum()
    }
}
