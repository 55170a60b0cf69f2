//! History of the encoder angles for delayed samples (fixed-lag measurement update).
//!
//! A sample of time t − d measures the error e(t − d) = Φ⁻¹ e(t), so its row is H Φ⁻¹; the process noise in between is neglected. Each time
//! update propagates the rows; each measurement update corrects the angles.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::Matrix2;

use super::error_state::{Error, MOVING, Transition, turn_errors};
use super::stored;
use super::tangent::{Frame, LinkState, MEASURED, wrapped};
use super::tuning::{LARGEST_INVERSE, LEAST_TURN};
use crate::copies::clone_by_fields;

/// Number of entries of the history. Entries are so far apart that they reach back to the largest age, however short the steps are.
pub const REMEMBERED: usize = 64;

/// Estimated angle of an encoder's axis at a past instant.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Axis {
    /// Angle, rad.
    angle: f64,
    /// Rate, rad/s.
    rate: f64,
    /// Derivative of the angle with respect to the present error.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    row: Error,
}

/// Both axes at a past instant.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Past {
    /// Age, s.
    age: f64,
    axes: [Axis; 2],
}

impl Past {
    fn present(motion: &LinkState, frame: &Frame) -> Self {
        let axis = |i: usize| Axis { angle: motion.theta[MEASURED[i]], rate: motion.omega[MEASURED[i]], row: frame.row(i) };
        Self { age: 0.0, axes: [axis(0), axis(1)] }
    }
}

/// Past instants, at beginnings of steps; the latest is last.
#[derive(Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct History {
    past: ArrayVec<Past, REMEMBERED>,
}

clone_by_fields!(History { past });

impl History {
    /// Time update by h seconds from a motion, with the transition matrix; drops entries older than `max_age`, s.
    pub(super) fn step(&mut self, (motion, frame): (&LinkState, &Frame), transition: &Transition, h: f64, max_age: f64) {
        if max_age == 0.0 {
            return;
        }
        let Some(back) = transition.try_inverse().filter(|back| back.iter().all(|x| x.abs() < LARGEST_INVERSE)) else {
            return self.clear();
        };
        // One older entry is kept for interpolation.
        while self.past.len() > 1 && self.past[1].age + h > max_age || self.past.is_full() {
            self.past.remove(0);
        }
        if self.past.last().is_none_or(|last| last.age >= max_age / (REMEMBERED - 2) as f64) {
            self.past.push(Past::present(motion, frame));
        }
        for past in &mut self.past {
            past.age += h;
            for axis in &mut past.axes {
                let row = back.tr_mul(&axis.row.fixed_rows::<MOVING>(0));
                axis.row.fixed_rows_mut::<MOVING>(0).copy_from(&row);
            }
        }
    }

    /// Measurement update, after `error` has corrected the estimate and `turn` has turned the tangent basis.
    pub(super) fn correct(&mut self, error: &Error, turn: &Matrix2<f64>) {
        if self.past.is_empty() {
            return;
        }
        // After a correction of about 1 rad, the map between the tangent bases may be singular.
        let Some(back) = turn.try_inverse().filter(|_| turn.determinant().abs() >= LEAST_TURN) else { return self.clear() };
        for axis in self.past.iter_mut().flat_map(|past| &mut past.axes) {
            axis.angle += axis.row.dot(error);
            turn_errors(&back.transpose(), &mut axis.row);
        }
    }

    /// Drops all entries: another hypothesis has become the estimate.
    pub(super) fn clear(&mut self) {
        self.past.clear();
    }

    /// Angle of an encoder `age` seconds ago, rad, and its derivative with respect to the present error; `None` if the sample is older than
    /// the run or the last change of hypothesis.
    pub(super) fn at(&self, motion: &LinkState, frame: &Frame, encoder: usize, age: f64) -> Option<(f64, Error)> {
        if age == 0.0 {
            return Some((motion.theta[MEASURED[encoder]], frame.row(encoder)));
        }
        let present = Past::present(motion, frame);
        let before = self.past.iter().rposition(|past| past.age >= age)?;
        let (past, next) = (&self.past[before], self.past.get(before + 1).unwrap_or(&present));
        let length = past.age - next.age;
        let part = (past.age - age) / length;
        // Cubic Hermite interpolation; whole turns between the ends are removed.
        let [begin, end] = [past, next].map(|at| at.axes[encoder]);
        let whole = wrapped(end.angle - begin.angle);
        let (other, curve) = (1.0 - part, part * (1.0 - part));
        let bent = curve * (other * (length * begin.rate - whole) - part * (length * end.rate - whole));
        Some((begin.angle + part * whole + bent, begin.row * other + end.row * part))
    }

    /// Whether stored entries are possible: finite, in order of time.
    pub(super) fn is_sound(&self) -> bool {
        let is_finite = |axis: &Axis| [axis.angle, axis.rate].iter().chain(&axis.row).all(|x| x.is_finite());
        self.past.iter().all(|past| past.age.is_finite() && past.age > 0.0 && past.axes.iter().all(is_finite))
            && self.past.windows(2).all(|pair| pair[0].age > pair[1].age)
    }
}
