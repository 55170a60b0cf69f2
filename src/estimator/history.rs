//! History of the encoder angles for delayed samples (fixed-lag measurement update).
//!
//! A sample of time t − d measures the error e(t − d) = Φ⁻¹ e(t), so its row is H Φ⁻¹; the process noise in between is neglected. Each time
//! update propagates the rows; each measurement update corrects the angles.
//!
//! Where loads damp the motion strongly, errors decay within d, and the present error is noise that came in between: Φ⁻¹ would multiply it
//! without bound. Rows that grow beyond those of a free motion are propagated at constant rates instead.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::{Matrix2, SVector};

use super::error_state::{Error, FORCE, MOVING, RATE, Transition, turn_errors};
use super::stored;
use super::tangent::{Frame, LinkState, MEASURED, wrapped};
use super::tuning::{LARGEST_INVERSE, LARGEST_ROW, LEAST_TURN};
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
    /// Whether the row was propagated at constant rates, because the exact one grew too large.
    is_approximate: bool,
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
        let axis = |i: usize| Axis {
            angle: motion.theta[MEASURED[i]],
            rate: motion.omega[MEASURED[i]],
            row: frame.row(i),
            is_approximate: false,
        };
        Self { age: 0.0, axes: [axis(0), axis(1)] }
    }
}

/// Expected angle of a delayed sample.
pub(super) struct Expected {
    /// Angle, rad.
    pub(super) angle: f64,
    /// Derivative of the angle with respect to the present error.
    pub(super) row: Error,
    /// Whether the derivative is that of a motion at constant rates, because the exact one is too large.
    pub(super) is_approximate: bool,
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
        let Some(turn_back) = transition.fixed_view::<2, 2>(FORCE, FORCE).into_owned().try_inverse() else { return self.clear() };
        let back = transition.try_inverse().filter(|back| back.iter().all(|x| x.abs() < LARGEST_INVERSE));
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
                let row = axis.row.fixed_rows::<MOVING>(0).into_owned();
                let fits = |moved: &SVector<f64, MOVING>| {
                    let largest = |first| moved.fixed_rows::<2>(first).norm();
                    largest(0) <= LARGEST_ROW && largest(RATE) <= LARGEST_ROW * past.age
                };
                if let Some(moved) = back.map(|back| back.tr_mul(&row)).filter(fits) {
                    axis.row.fixed_rows_mut::<MOVING>(0).copy_from(&moved);
                } else {
                    // At constant rates the past angle is the present one minus the rate times the age.
                    let by_angles = row.fixed_rows::<2>(0) * h;
                    axis.row.fixed_rows_mut::<2>(RATE).zip_apply(&by_angles, |by_rate, by_angle| *by_rate -= by_angle);
                    turn_errors(&turn_back.transpose(), &mut axis.row);
                    axis.is_approximate = true;
                }
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

    /// Angle of an encoder `age` seconds ago; `None` if the sample is older than the run or the last change of hypothesis.
    pub(super) fn at(&self, motion: &LinkState, frame: &Frame, encoder: usize, age: f64) -> Option<Expected> {
        if age == 0.0 {
            return Some(Expected { angle: motion.theta[MEASURED[encoder]], row: frame.row(encoder), is_approximate: false });
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
        Some(Expected {
            angle: begin.angle + part * whole + bent,
            row: begin.row * other + end.row * part,
            is_approximate: begin.is_approximate || end.is_approximate,
        })
    }

    /// Whether stored entries are possible: finite, in order of time.
    pub(super) fn is_sound(&self) -> bool {
        let is_finite = |axis: &Axis| [axis.angle, axis.rate].iter().chain(&axis.row).all(|x| x.is_finite());
        self.past.iter().all(|past| past.age.is_finite() && past.age > 0.0 && past.axes.iter().all(is_finite))
            && self.past.windows(2).all(|pair| pair[0].age > pair[1].age)
    }
}
