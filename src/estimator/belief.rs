//! Belief about a motion: the unknown force and the bank of errors, on the tangent space at the motion.

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::Matrix2;

use super::bank::Bank;
use super::constants::{CAUSE_MODEL, LARGEST_RATE};
use super::error_state::{ERRORS, Error, FORCE, Matrix, READINGS, isolate_force};
use super::flow::unit_forces;
use super::stored;
use super::tangent::{Frame, LinkState, Linkage, Links, Pair};

/// Unknown force, and errors about it and about a motion that stands elsewhere.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Belief {
    /// Unknown force as motor torques, N·m, and a tip force, N: the smallest inputs with its effect.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    pub force: Links,
    /// Bank of errors about the motion and the force.
    pub bank: Bank,
}

impl Belief {
    /// No unknown force, with these variances of angles, rad², rates, rad²/s², and force, (N·m)².
    pub(super) fn new(variances: [f64; 3]) -> Self {
        Self { force: Links::zeros(), bank: Bank::new(variances) }
    }

    /// Unknown force on the tangent basis, N·m.
    pub fn tangent_force(&self, at: &Frame) -> Pair {
        on_basis(at, &self.force)
    }

    /// Injects the mean error into a motion and the force. Returns the error, the map between the tangent bases and the new frame; `None`,
    /// with nothing changed, where the loop cannot be closed.
    pub(super) fn inject_error(
        &mut self,
        linkage: &Linkage,
        from: &Frame,
        motion: &mut LinkState,
    ) -> Option<(Error, Matrix2<f64>, Frame)> {
        let mut error = self.bank.mean();
        // Persistent errors of encoders stay where they are.
        error.fixed_rows_mut::<2>(READINGS).fill(0.0);
        let [a, b, c, d, ..]: [f64; ERRORS] = error.into();
        let (corrected, to) = linkage.closed(from.displaced(motion, [a, b, c, d]))?;
        if corrected.fastest() >= LARGEST_RATE {
            return None;
        }
        *motion = corrected;
        self.force = unit_forces(linkage, from) * (self.tangent_force(from) + error.fixed_rows::<2>(FORCE));
        let turn = from.basis_map_to(&to);
        self.bank.subtract_mean(&error);
        self.bank.change_basis(&turn);
        Some((error, turn, to))
    }

    /// Mean and covariance of the errors with another force, by its change on the tangent basis, N·m, which is as certain as that of a quiet
    /// model and uncorrelated with the motion.
    pub(super) fn with_force(&self, change: &Pair) -> (Error, Matrix) {
        let (mut error, mut covariance) = self.bank.moments();
        let certain = self.bank.members[CAUSE_MODEL].covariance.fixed_view::<2, 2>(FORCE, FORCE).into_owned();
        error.fixed_rows_mut::<2>(FORCE).copy_from(change);
        isolate_force(&mut covariance, &certain);
        (error, covariance)
    }

    /// Whether a stored belief about a motion is possible: closed loop, finite force, sound bank.
    pub(super) fn is_sound(&self, linkage: &Linkage, motion: &LinkState) -> bool {
        linkage.is_closed(motion) && self.force.iter().all(|x| x.is_finite()) && self.bank.is_sound()
    }
}

/// Generalised force of inputs on the tangent basis, N·m.
pub(super) fn on_basis(at: &Frame, force: &Links) -> Pair {
    at.basis.tr_mul(&(at.by_inputs() * force))
}
