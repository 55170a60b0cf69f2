//! What a method that follows its error asks of a system whose forces have kinks.
//!
//! Between its kinks a force is one smooth formula, which also holds a little beyond them. A step is made by the formulas of the sides on
//! which it begins, so that all its stages see a smooth force; where its motion crosses a border it ends, and the next step begins
//! behind it. No order is lost, and no touch between stages is missed.

use std::borrow::Borrow;
use std::fmt::Debug;

use borsh::{BorshDeserialize, BorshSerialize};

use crate::vector::Vector;

/// Magnitudes that are not exceeded on a way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extremes<const N: usize> {
    /// Of q̇.
    pub rates: Vector<N>,
    /// Of q̈.
    pub accelerations: Vector<N>,
    /// Of the first two derivatives of q̈, where they are known.
    pub higher: Option<[Vector<N>; 2]>,
}

/// A system that knows its kinks. By default it has none.
pub trait Events<const N: usize>: Sized {
    /// On which side of each kink its forces are.
    type Mode: Copy + Debug + PartialEq + BorshSerialize + BorshDeserialize;
    /// What a state is to its kinks.
    type GuardValues;

    /// Whether it has any.
    fn has_events(&self) -> bool {
        false
    }

    /// Whether its sides are ever others than at the start.
    fn has_modes(&self) -> bool {
        self.has_events()
    }

    /// Whether any of its kinks is where something begins to touch.
    fn may_make_contact(&self) -> bool {
        false
    }

    /// The least change of a rate of a coordinate, 1/s times its unit, that turns a force round: more than a method may overlook.
    fn regularization_velocity(&self) -> f64 {
        f64::INFINITY
    }

    /// Whether forces bend sharply without a kink.
    fn has_sharp_nonlinearity(&self) -> bool {
        false
    }

    /// What a state is to its kinks.
    fn guard_values(&self, q: &Vector<N>, v: &Vector<N>) -> Self::GuardValues;

    /// The sides of a state by itself.
    fn mode_of(&self, q: &Vector<N>, v: &Vector<N>) -> Self::Mode;

    /// The same sides where a motion begins to be on one of several branches.
    #[inline(always)]
    fn select_branch(&self, mode: Self::Mode, _q: &Vector<N>, _v: &Vector<N>) -> Self::Mode {
        mode
    }

    /// The same system with forces that stay on some sides.
    fn on(&self, _sides: Self::Mode) -> impl Borrow<Self> {
        self
    }

    /// How far a state is beyond the sides that hold, in units of what a motion may overlook at a tolerance of its coordinates; negative
    /// within them.
    fn guard_residual(&self, _at: &Self::GuardValues, _tolerance: f64) -> f64 {
        f64::NEG_INFINITY
    }

    /// The sides behind the border that a state is at.
    fn next_mode(&self, q: &Vector<N>, v: &Vector<N>, _tolerance: f64) -> Self::Mode {
        self.mode_of(q, v)
    }

    /// Whether any of its kinks is a grip of dry friction: a side that only a method can remember.
    fn has_stick_slip(&self) -> bool {
        false
    }

    /// Whether anything that touches pushes on these sides.
    fn has_active_contact(&self) -> bool {
        false
    }

    /// Energy that forces which act no more still show, J: what it loses on the way is dissipated, beside what their power says.
    fn separation_energy(&self, _at: &Self::GuardValues) -> f64 {
        0.0
    }

    /// About how long a motion goes on by formulas that hold on a short way only, s.
    fn dwell_time(&self, _at: &Self::GuardValues) -> f64 {
        f64::INFINITY
    }

    /// Whether the whole system is held: nothing moves while the forces stay.
    fn is_at_rest(&self) -> bool {
        false
    }

    /// Whether its grips are those of the sides that hold: nothing has begun to touch, or ceased.
    fn knows_stick_slip(&self, _at: &Self::GuardValues) -> bool {
        true
    }

    /// Whether what slips turns and turns back on the way from one state to another, both given by q, q̇ and q̈, some seconds apart. Asked
    /// only of grips.
    fn reverses_between(&self, _ends: [[&Vector<N>; 3]; 2], _duration: f64, _tolerance: f64) -> bool {
        false
    }

    /// Whether a grip holds while something moves: what it has to hold is known where it is asked for, and not bounded in between.
    fn sticks_in_motion(&self, _at: &Self::GuardValues) -> bool {
        false
    }

    /// How close what grips hold comes to what they can hold, in units of what may be overlooked; negative below.
    fn breakaway_residual(&self, _at: &Self::GuardValues, _tolerance: f64) -> f64 {
        f64::NEG_INFINITY
    }

    /// Whether a motion from one state to another, within these bounds on its way of some seconds, certainly crosses no border by more than
    /// it may overlook, but for what grips hold.
    fn stays_within(&self, _ends: [&Self::GuardValues; 2], _duration: f64, _extremes: &Extremes<N>, _tolerance: f64) -> bool {
        true
    }
}
