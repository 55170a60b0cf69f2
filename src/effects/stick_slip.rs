//! Dry friction as a set-valued law: where it may hold, what it does there, and how that follows from the forces.
//!
//! A grip is a direction in which parts slide on each other: one of the joints, or the tip along the plane. While it slips, friction is
//! a force against the motion; while it holds, it is whatever keeps its rate 0, up to its bound. Which of them hold ([`StickSlips`]) is for
//! the method to remember; how a system finds it out from coordinates and rates is in `simulation/stick_slip.rs`.
//!
//! Where rates vanish, the accelerations are those of Gauss's principle with friction: of all that the bounds allow the least
//! ½ (q̈ − q̈₀)ᵀ M (q̈ − q̈₀) + Σ b |ẇ|, with q̈₀ those without friction there (Moreau, 1988; Glocker, *Set-Valued Force Laws*, 2001).
//! They are unique. The mechanism has two degrees of freedom, so that no more than two independent grips hold, and then nothing moves.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};

use super::force_context::JOINTS;
use crate::mechanism::LINKS;
use crate::vector::Vector;

/// Number of grips: the joints, and the tip on the plane.
pub const FRICTION_PLACES: usize = JOINTS + 1;

/// Place of the tip among them.
pub(super) const TIP_FRICTION: usize = JOINTS;

/// What dry friction does at rest: the `….law` variables.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Law {
    /// A smooth function of the rate, which creeps under load.
    #[default]
    Smooth,
    /// Set-valued: it holds up to its bound.
    Stick,
}

/// Which way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum SlipDirection {
    /// With the rate positive.
    Forward,
    /// With it negative.
    Backward,
}

impl SlipDirection {
    /// That of a number.
    pub fn of(x: f64) -> Self {
        if x < 0.0 { Self::Backward } else { Self::Forward }
    }

    /// ±1.
    pub fn sign(self) -> f64 {
        match self {
            Self::Forward => 1.0,
            Self::Backward => -1.0,
        }
    }
}

/// What a grip does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub enum StickSlip {
    /// There is none: no friction, a smooth law, or nothing touches.
    Inactive,
    /// It slips.
    Slips(SlipDirection),
    /// It holds. Where several hold the same motion, their shares act this way relative to the first.
    Sticks(SlipDirection),
}

/// What all grips do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub struct StickSlips {
    places: [StickSlip; FRICTION_PLACES],
    /// Whether they hold the whole mechanism.
    at_rest: bool,
}

impl StickSlips {
    /// There are none.
    pub const OPEN: Self = Self { places: [StickSlip::Inactive; FRICTION_PLACES], at_rest: false };

    /// What one does.
    pub fn at(&self, place: usize) -> StickSlip {
        self.places[place]
    }

    /// Changes what one does.
    pub fn set(&mut self, place: usize, joint: StickSlip) {
        self.places[place] = joint;
    }

    /// Whether nothing moves.
    #[inline]
    pub fn at_rest(&self) -> bool {
        self.at_rest
    }

    /// All of these hold, and the mechanism with them.
    pub fn resting(places: impl Iterator<Item = usize>) -> Self {
        let mut stick_slip = Self { at_rest: true, ..Self::OPEN };
        places.for_each(|place| stick_slip.set(place, StickSlip::Sticks(SlipDirection::Forward)));
        stick_slip
    }

    /// Whether any holds.
    #[inline]
    pub fn any_sticks(&self) -> bool {
        self.places.iter().any(|joint| matches!(joint, StickSlip::Sticks(_)))
    }

    /// The sign of friction's direction in a grip that moves at a rate: of what slips that of its way, of what holds 0; by itself that
    /// of the rate.
    pub(super) fn direction(&self, place: usize, rate: f64) -> f64 {
        match self.places[place] {
            StickSlip::Slips(slip_direction) => slip_direction.sign(),
            StickSlip::Sticks(_) => 0.0,
            StickSlip::Inactive if rate == 0.0 => 0.0,
            StickSlip::Inactive => SlipDirection::of(rate).sign(),
        }
    }
}

/// A grip as it is now, in N coordinates.
#[derive(Clone, Copy, Debug)]
pub struct FrictionConstraint<const N: usize> {
    /// Its place in [`StickSlips`].
    pub place: usize,
    /// Its rate is row·q̇; a torque or force T in it acts with T·row.
    pub row: Vector<N>,
    /// Its acceleration is row·q̈ + drift.
    pub drift: f64,
    /// Rate, rad/s or m/s.
    pub rate: f64,
    /// What it holds at most, N·m or N.
    pub bound: f64,
    /// By how much its rate changes with that of each link at most.
    pub arms: [f64; LINKS],
}

/// All grips that there are.
pub type FrictionConstraints<const N: usize> = ArrayVec<FrictionConstraint<N>, FRICTION_PLACES>;

/// What grips have to hold: those whose rate is 0, as the equations of motion see them.
#[derive(Clone, Debug, Default)]
pub struct FrictionProblem {
    /// Their places.
    pub places: ArrayVec<usize, FRICTION_PLACES>,
    /// Their accelerations per unit of torque in each.
    pub mobility: [[f64; FRICTION_PLACES]; FRICTION_PLACES],
    /// Their accelerations without any of these torques.
    pub change: [f64; FRICTION_PLACES],
    /// Their bounds, all positive.
    pub bounds: [f64; FRICTION_PLACES],
}

/// Inequalities are judged to this part of the bounds.
const TOLERANCE: f64 = 1e-9;

/// What is held counts in the torques at rest, which it does not determine alone, by this part.
const RIDGE: f64 = 1e-12;

/// What each of the grips of a [`FrictionProblem`] may do.
type Candidate = [StickSlip; FRICTION_PLACES];

impl FrictionProblem {
    fn len(&self) -> usize {
        self.places.len()
    }

    /// The greatest acceleration that friction in a grip alone may make.
    fn scale(&self, i: usize) -> f64 {
        self.mobility[i][i] * self.bounds[i]
    }

    /// Whether friction can hold all of them, and that leaves no motion.
    #[cold]
    #[inline(never)]
    pub fn can_rest(&self) -> bool {
        let n = self.len();
        let all = (0..n).any(|i| (0..i).any(|j| !self.are_parallel(i, j)));
        all && (self.least_squares_torques().is_some()
            || self.least_violating(2..=2).is_some_and(|(violation, _)| violation <= TOLERANCE))
    }

    /// Whether all of them hold the same motion.
    pub fn is_single_motion(&self) -> bool {
        (1..self.len()).all(|i| self.are_parallel(0, i))
    }

    /// Whether two of them hold the same motion.
    fn are_parallel(&self, i: usize, j: usize) -> bool {
        let g = &self.mobility;
        g[i][j] * g[i][j] >= (1.0 - TOLERANCE) * g[i][i] * g[j][j]
    }

    /// The torques by which all hold: of those possible the ones that use the smallest parts of their bounds, or where these are not within
    /// them, those by which all but two give all they can.
    #[cold]
    #[inline(never)]
    pub fn resting_torques(&self) -> [f64; FRICTION_PLACES] {
        self.least_squares_torques().unwrap_or_else(|| {
            self.least_violating(2..=2).map_or([0.0; FRICTION_PLACES], |(_, candidate)| self.torques(&candidate))
        })
    }

    /// (D G D + ε tr) x = −D c, T = D x with D the bounds, by Cholesky's method.
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
        // Where no torques hold all of them, those of least squares leave accelerations.
        let left = self.accelerations(&torques);
        let holds = (0..n).all(|i| x[i].abs() <= 1.0 && left[i].abs() <= 1e3 * TOLERANCE * self.scale(i));
        holds.then_some(torques)
    }

    #[cold]
    #[inline(never)]
    fn accelerations(&self, torques: &[f64; FRICTION_PLACES]) -> [f64; FRICTION_PLACES] {
        std::array::from_fn(|i| self.change[i] + (0..self.len()).map(|k| self.mobility[i][k] * torques[k]).sum::<f64>())
    }

    /// The torques of a pattern: slipping grips give their bounds, and no more than two hold.
    #[cold]
    #[inline(never)]
    fn torques(&self, candidate: &Candidate) -> [f64; FRICTION_PLACES] {
        let mut torques: [f64; FRICTION_PLACES] = std::array::from_fn(|i| match candidate[i] {
            StickSlip::Slips(slip_direction) => -slip_direction.sign() * self.bounds[i],
            StickSlip::Sticks(_) | StickSlip::Inactive => 0.0,
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

    /// The pattern that violates the law least, of those in which so many hold; by how much, as a part of the bounds.
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
            // Two that hold the same motion leave the other.
            if !holds.contains(&sticking.len()) || matches!(sticking[..], [i, j] if self.are_parallel(i, j)) {
                continue;
            }
            let torques = self.torques(&candidate);
            let left = self.accelerations(&torques);
            let violation = (0..n).fold(0.0, |most: f64, i| {
                most.max(match candidate[i] {
                    StickSlip::Sticks(_) => torques[i].abs() / self.bounds[i] - 1.0,
                    StickSlip::Slips(slip_direction) => quotient(-slip_direction.sign() * left[i], self.scale(i)),
                    StickSlip::Inactive => 0.0,
                })
            });
            if least_violating.is_none_or(|(least, _)| violation < least) {
                least_violating = Some((violation, candidate));
            }
        }
        least_violating
    }

    /// What they do where something moves, or will: no more than one of them holds by itself, and with it those that hold the same motion.
    #[cold]
    #[inline(never)]
    pub fn resolve_motion(&self, stick_slip: &mut StickSlips) {
        let Some((_, mut candidate)) = self.least_violating(0..=1) else { return };
        let left = self.accelerations(&self.torques(&candidate));
        if let Some(sticking_place) = candidate.iter().position(|joint| matches!(joint, StickSlip::Sticks(_))) {
            // A weak grip among strong ones is accelerated by what these leave of round-off.
            let greatest = |i: usize| (0..self.len()).map(|k| (self.mobility[i][k] * self.bounds[k]).abs()).sum::<f64>();
            let with =
                |i: usize| i == sticking_place || self.are_parallel(sticking_place, i) && left[i].abs() <= TOLERANCE * greatest(i);
            // Ways are relative to the first of them, which need not be the one that holds by itself.
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

/// x/y, and what violates any bound where y is no number to divide by.
fn quotient(x: f64, y: f64) -> f64 {
    /// As good as infinite.
    const LARGEST_QUOTIENT: f64 = 1e100;
    if x == 0.0 {
        0.0
    } else if x.abs() < LARGEST_QUOTIENT * y.abs() {
        x / y
    } else {
        LARGEST_QUOTIENT * x.signum()
    }
}
