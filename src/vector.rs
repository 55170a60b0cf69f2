//! Vectors of coordinates and of multipliers, with the operators of linear algebra.
//!
//! Operators work on pairs of elements, starting with the first: a pair is the two legs, and stays in one register without shuffling. (The
//! compiler alone would pair the second element with the third.) In a stored state a vector is a sequence of little-endian doubles.

use std::io::{self, Read, Write};
use std::ops::{Add, AddAssign, Deref, DerefMut, Div, Mul, Neg, Sub};

use borsh::{BorshDeserialize, BorshSerialize};
use wide::f64x2;

/// 1.5·2^52. Adding it to a number of magnitude below 2^51 rounds the number to an integer, which appears in the low bits of the sum.
pub(crate) const ROUND: f64 = 6_755_399_441_055_744.0;

/// A vector with N elements.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(16))] // pairs of elements are read from memory by the instruction that uses them
pub struct Vector<const N: usize>([f64; N]);

impl<const N: usize> Vector<N> {
    /// All elements 0.
    pub const ZERO: Self = Self([0.0; N]);

    /// Creates a vector from a function of the index.
    pub fn from_fn(element: impl FnMut(usize) -> f64) -> Self {
        Self(std::array::from_fn(element))
    }

    /// Unit vector along axis `place`.
    pub fn unit(place: usize) -> Self {
        let mut unit = Self::ZERO;
        unit[place] = 1.0;
        unit
    }

    /// The scalar product.
    #[inline]
    pub fn dot(&self, other: &Self) -> f64 {
        self.iter().zip(other.iter()).map(|(x, y)| x * y).sum()
    }

    /// The Euclidean norm.
    pub fn norm(&self) -> f64 {
        self.dot(self).sqrt()
    }

    /// Largest magnitude of the elements, with one instruction per pair. NaN is ignored; the end of a step checks for NaN.
    #[inline]
    pub fn max_norm(&self) -> f64 {
        let larger = |largest: f64, value: f64| if value.abs() > largest { value.abs() } else { largest };
        let (pairs, single) = self.as_chunks::<2>();
        let [left, right] = pairs.iter().fold([0.0; 2], |[left, right], pair| [larger(left, pair[0]), larger(right, pair[1])]);
        single.iter().copied().fold(larger(left, right), larger)
    }

    /// Whether the sum of all elements is finite: false for NaN, for infinite elements, and for finite elements whose sum overflows.
    pub fn is_finite(&self) -> bool {
        self.sum().is_finite()
    }

    /// The sum of all elements.
    #[inline]
    pub fn sum(&self) -> f64 {
        let (pairs, single) = self.as_chunks::<2>();
        // The neutral element of addition is −0; the compiler removes it.
        let [left, right] = pairs.iter().fold([-0.0; 2], |[left, right], pair| [left + pair[0], right + pair[1]]);
        single.iter().fold(left + right, |sum, x| sum + x)
    }

    /// The pair of elements with pair index `place`; the last element of an odd length is paired with 0.
    #[inline(always)]
    pub fn pair(&self, place: usize) -> f64x2 {
        let (pairs, single) = self.as_chunks::<2>();
        if let Some(pair) = pairs.get(place) { f64x2::new(*pair) } else { f64x2::new([single[0], 0.0]) }
    }

    /// Sets the pair of elements with pair index `place`.
    #[inline(always)]
    pub fn set_pair(&mut self, place: usize, value: f64x2) {
        let (pairs, single) = self.as_chunks_mut::<2>();
        if let Some(pair) = pairs.get_mut(place) { *pair = value.to_array() } else { single[0] = value.to_array()[0] }
    }

    /// Applies a function to two vectors, pair by pair.
    #[inline]
    pub fn with(&self, other: &Self, function: impl Fn(f64x2, f64x2) -> f64x2) -> Self {
        let mut result = Self::ZERO;
        let (pairs, single) = result.as_chunks_mut::<2>();
        for (i, pair) in pairs.iter_mut().enumerate() {
            let [x, y] = [self, other].map(|vector| f64x2::new([vector[2 * i], vector[2 * i + 1]]));
            *pair = function(x, y).to_array();
        }
        if let [last] = single {
            *last = function(f64x2::splat(self[N - 1]), f64x2::splat(other[N - 1])).to_array()[0];
        }
        result
    }
}

/// A vector is stored like an array.
impl<const N: usize> BorshSerialize for Vector<N> {
    fn serialize<W: Write>(&self, writer: &mut W) -> io::Result<()> {
        write(&self.0, writer)
    }
}

impl<const N: usize> BorshDeserialize for Vector<N> {
    #[inline(never)]
    fn deserialize_reader<R: Read>(reader: &mut R) -> io::Result<Self> {
        let mut vector = Self::ZERO;
        read(&mut vector.0, reader)?;
        Ok(vector)
    }
}

/// Number of elements in one call of a writer or reader: all coordinates of a state.
const CHUNK: usize = 12;

/// Writes elements; one compiled copy for vectors of every length.
#[inline(never)]
fn write(elements: &[f64], writer: &mut dyn Write) -> io::Result<()> {
    for elements in elements.chunks(CHUNK) {
        let mut bytes = [0; CHUNK * size_of::<f64>()];
        let mut rest = &mut bytes[..];
        for element in elements {
            element.serialize(&mut rest)?;
        }
        writer.write_all(&bytes[..size_of_val(elements)])?;
    }
    Ok(())
}

/// Reads elements; one compiled copy for vectors of every length.
#[inline(never)]
fn read(elements: &mut [f64], reader: &mut dyn Read) -> io::Result<()> {
    for elements in elements.chunks_mut(CHUNK) {
        let mut bytes = [0; CHUNK * size_of::<f64>()];
        reader.read_exact(&mut bytes[..size_of_val(elements)])?;
        let mut rest = &bytes[..];
        for element in elements {
            *element = f64::deserialize(&mut rest)?;
        }
    }
    Ok(())
}

impl<const N: usize> From<[f64; N]> for Vector<N> {
    fn from(elements: [f64; N]) -> Self {
        Self(elements)
    }
}

impl<const N: usize> From<Vector<N>> for [f64; N] {
    fn from(vector: Vector<N>) -> Self {
        vector.0
    }
}

impl<const N: usize> Deref for Vector<N> {
    type Target = [f64; N];

    fn deref(&self) -> &[f64; N] {
        &self.0
    }
}

impl<const N: usize> DerefMut for Vector<N> {
    fn deref_mut(&mut self) -> &mut [f64; N] {
        &mut self.0
    }
}

impl<'a, const N: usize> IntoIterator for &'a Vector<N> {
    type Item = &'a f64;
    type IntoIter = std::slice::Iter<'a, f64>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<const N: usize> Add for Vector<N> {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        self.with(&other, |x, y| x + y)
    }
}

impl<const N: usize> AddAssign for Vector<N> {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const N: usize> Sub for Vector<N> {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self.with(&other, |x, y| x - y)
    }
}

impl<const N: usize> Neg for Vector<N> {
    type Output = Self;

    fn neg(self) -> Self {
        self.with(&self, |x, _| -x)
    }
}

impl<const N: usize> Mul<Vector<N>> for f64 {
    type Output = Vector<N>;

    fn mul(self, vector: Vector<N>) -> Vector<N> {
        vector.with(&vector, |x, _| f64x2::splat(self) * x)
    }
}

/// Multiplies the first element of each pair by the first lane and the second element by the second lane.
impl<const N: usize> Mul<Vector<N>> for f64x2 {
    type Output = Vector<N>;

    fn mul(self, vector: Vector<N>) -> Vector<N> {
        vector.with(&vector, |x, _| self * x)
    }
}

impl<const N: usize> Div<f64> for Vector<N> {
    type Output = Self;

    fn div(self, divisor: f64) -> Self {
        self.with(&self, |x, _| x / f64x2::splat(divisor))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lengths are odd and even, because the last element of an odd length is treated separately.
    #[test]
    fn operators_follow_linear_algebra() {
        let (x, y) = (Vector::from([1.0, -2.0, 3.0]), Vector::from([4.0, 5.0, -6.0]));
        assert_eq!(*(x + y), [5.0, 3.0, -3.0]);
        assert_eq!(*(x - y), [-3.0, -7.0, 9.0]);
        assert_eq!(*(2.0 * -x), [-2.0, 4.0, -6.0]);
        assert_eq!(*(y / 2.0), [2.0, 2.5, -3.0]);
        assert_eq!((x.dot(&y), y.max_norm(), Vector::from([3.0, 4.0]).norm()), (-24.0, 6.0, 5.0));
        assert_eq!(*Vector::<2>::unit(1), [0.0, 1.0]);
    }

    #[test]
    fn nan_is_detected() {
        assert!(Vector::from([1.0, 2.0, 3.0]).is_finite());
        assert!(!Vector::from([1.0, f64::NAN, 3.0]).is_finite());
        assert!(!Vector::from([1.0, 2.0, f64::INFINITY]).is_finite());
    }
}
