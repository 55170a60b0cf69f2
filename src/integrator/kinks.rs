//! What a method that follows its error asks of a system whose forces have kinks.
//!
//! Between its kinks a force is one smooth formula, which also holds a little beyond them. A step is made by the formulas of the sides on
//! which it begins, so that all its stages see a smooth force; where its motion crosses a border it ends, and the next step begins
//! behind it. No order is lost, and no touch between stages is missed.

use std::borrow::Borrow;
use std::fmt::Debug;

use borsh::{BorshDeserialize, BorshSerialize};

use crate::vector::Vector;

/// A system that knows its kinks.
pub trait Kinked<const N: usize>: Sized {
    /// On which side of each kink its forces are.
    type Sides: Copy + Debug + PartialEq + BorshSerialize + BorshDeserialize;

    /// Whether it has any.
    fn has_kinks(&self) -> bool {
        false
    }

    /// The sides of a state by itself.
    fn sides_of(&self, q: &Vector<N>, v: &Vector<N>) -> Self::Sides;

    /// The same system with forces that stay on some sides.
    fn on(&self, _sides: Self::Sides) -> impl Borrow<Self> {
        self
    }

    /// How far a state is beyond the sides that hold, in units of what a motion may overlook at a tolerance of its coordinates; negative
    /// within them.
    fn beyond(&self, _q: &Vector<N>, _v: &Vector<N>, _tolerance: f64) -> f64 {
        f64::NEG_INFINITY
    }

    /// The sides behind the border that a state is at.
    fn behind(&self, q: &Vector<N>, v: &Vector<N>, _tolerance: f64) -> Self::Sides {
        self.sides_of(q, v)
    }

    /// Whether a motion certainly crosses no border between two states by more than it may overlook. Borders of what touches are judged
    /// at the two states only: the forces there keep steps short.
    fn stays_within(&self, _stretch: &Stretch<'_, N>, _tolerance: f64) -> bool {
        true
    }

    /// Whether borders are near that are judged at states only.
    fn touches(&self, _q: &Vector<N>, _v: &Vector<N>) -> bool {
        false
    }
}

/// A stretch of a motion.
#[derive(Clone, Copy, Debug)]
pub struct Stretch<'a, const N: usize> {
    /// q and q̇ at both its ends.
    pub ends: [&'a [Vector<N>; 2]; 2],
    /// s.
    pub duration: f64,
    /// The greatest magnitudes of q̇ and q̈ on the way.
    pub extremes: &'a [Vector<N>; 2],
}
