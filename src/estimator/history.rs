//! History of the encoder angles for delayed samples (fixed-lag measurement update).
//!
//! A sample of time t − d measures the error e(t − d) = Φ⁻¹ e(t): its row is H Φ⁻¹, without the process noise in between. Each time update
//! propagates the rows; each measurement update corrects the angles.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};

use super::bank::{Error, Matrix};
use super::linkage::{Frame, MEASURED, Pair};
use super::track::{Track, wrapped};
use super::transition::ERRORS;

/// Least |det| of a map between tangent bases that rows can be transformed by.
const LEAST_TURN: f64 = 1e-6;

/// Number of macro steps whose angles the history holds.
pub const REMEMBERED: usize = 64;

/// Estimated encoder angles at a past instant.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Past {
    /// Age, s.
    age: f64,
    /// Angles, rad.
    angles: [f64; 2],
    /// Rates, rad/s.
    rates: [f64; 2],
    /// Derivatives of the angles with respect to the present error.
    rows: [Error; 2],
}

impl Past {
    fn present(track: &Track, frame: &Frame) -> Self {
        let rows = MEASURED.map(|link| {
            let mut row = [0.0; ERRORS];
            (row[0], row[1]) = (frame.basis[0][link], frame.basis[1][link]);
            row
        });
        Self { age: 0.0, angles: MEASURED.map(|link| track.theta[link]), rates: MEASURED.map(|link| track.omega[link]), rows }
    }

    fn is_finite(&self) -> bool {
        let numbers = self.angles.iter().chain(&self.rates).chain(self.rows.iter().flatten());
        numbers.chain([&self.age]).all(|x| x.is_finite())
    }
}

/// Past macro steps, the latest last.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct History(ArrayVec<Past, REMEMBERED>);

impl History {
    /// Time update by h seconds and a transition matrix from `track`; entries older than `max_age`, s, are dropped.
    #[inline(never)]
    pub(super) fn step(&mut self, (track, frame): (&Track, &Frame), transition: &Matrix, h: f64, max_age: f64) {
        if max_age == 0.0 {
            return;
        }
        let Some(back) = inverse(transition) else {
            self.0.clear();
            return;
        };
        // One older entry stays for interpolation.
        while self.0.len() > 1 && self.0[1].age + h > max_age || self.0.is_full() {
            self.0.remove(0);
        }
        self.0.push(Past::present(track, frame));
        for past in &mut self.0 {
            past.age += h;
            past.rows = past.rows.map(|row| times(&row, &back));
        }
    }

    /// Measurement update: the estimate was corrected by `error`, and the basis changed.
    pub(super) fn correct(&mut self, error: &Error, [[a, b], [c, d]]: &[Pair; 2]) {
        let determinant = a * d - b * c;
        // After a correction of the order of 1 rad the tangent bases before and after have no common plane.
        if determinant.is_nan() || determinant.abs() < LEAST_TURN {
            self.0.clear();
        }
        for past in &mut self.0 {
            for i in 0..2 {
                past.angles[i] += past.rows[i].iter().zip(error).map(|(a, b)| a * b).sum::<f64>();
                let row = past.rows[i];
                for first in (0..ERRORS).step_by(2) {
                    let (x, y) = (row[first], row[first + 1]);
                    past.rows[i][first] = (x * d - y * c) / determinant;
                    past.rows[i][first + 1] = (y * a - x * b) / determinant;
                }
            }
        }
    }

    /// Drops all entries: another hypothesis has become the estimate.
    pub(super) fn clear(&mut self) {
        self.0.clear();
    }

    /// Angle of an encoder `age` seconds ago, rad, and its derivative with respect to the present error; `None` where the history is
    /// shorter.
    #[inline(never)]
    pub(super) fn at(&self, track: &Track, frame: &Frame, encoder: usize, age: f64) -> Option<(f64, Error)> {
        let present = Past::present(track, frame);
        let before = self.0.iter().rposition(|past| past.age >= age)?;
        let (past, next) = (&self.0[before], self.0.get(before + 1).unwrap_or(&present));
        let length = past.age - next.age;
        let part = (past.age - age) / length;
        // Cubic Hermite interpolation; whole turns between the ends are removed.
        let whole = wrapped(next.angles[encoder] - past.angles[encoder]);
        let [begin, end] = [past, next].map(|at| length * at.rates[encoder]);
        let (other, curve) = (1.0 - part, part * (1.0 - part));
        let angle = past.angles[encoder] + part * whole + curve * (other * (begin - whole) - part * (end - whole));
        let row = std::array::from_fn(|i| other * past.rows[encoder][i] + part * next.rows[encoder][i]);
        Some((angle, row))
    }

    /// Whether stored entries are possible: finite, the latest last.
    #[cold]
    pub(super) fn is_sound(&self) -> bool {
        self.0.iter().all(Past::is_finite)
            && self.0.windows(2).all(|pair| pair[0].age > pair[1].age)
            && self.0.iter().all(|past| past.age > 0.0)
    }
}

impl BorshSerialize for History {
    fn serialize<W: std::io::Write>(&self, writer: &mut W) -> std::io::Result<()> {
        self.0.as_slice().serialize(writer)
    }
}

impl BorshDeserialize for History {
    fn deserialize_reader<R: std::io::Read>(reader: &mut R) -> std::io::Result<Self> {
        let all = Vec::<Past>::deserialize_reader(reader)?;
        all.as_slice()
            .try_into()
            .map(Self)
            .map_err(|_| std::io::Error::other("the history of the estimator is longer than its capacity"))
    }
}

/// Product x F of a row and a matrix.
fn times(x: &Error, f: &Matrix) -> Error {
    std::array::from_fn(|k| (0..ERRORS).map(|i| x[i] * f[i][k]).sum())
}

/// Inverse of a matrix by Gauss–Jordan elimination with pivots; `None` where it is singular.
#[inline(never)]
fn inverse(f: &Matrix) -> Option<Matrix> {
    let mut left = *f;
    let mut right: Matrix = std::array::from_fn(|i| std::array::from_fn(|k| f64::from(u8::from(i == k))));
    for column in 0..ERRORS {
        let pivot =
            (column + 1..ERRORS).fold(column, |best, i| if left[i][column].abs() > left[best][column].abs() { i } else { best });
        left.swap(column, pivot);
        right.swap(column, pivot);
        let value = left[column][column];
        if value.is_nan() || value.abs() <= 1e-12 {
            return None;
        }
        for k in 0..ERRORS {
            left[column][k] /= value;
            right[column][k] /= value;
        }
        for i in (0..ERRORS).filter(|&i| i != column) {
            let factor = left[i][column];
            for k in 0..ERRORS {
                left[i][k] -= factor * left[column][k];
                right[i][k] -= factor * right[column][k];
            }
        }
    }
    Some(right)
}
