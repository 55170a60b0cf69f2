//! Vectors of coordinates and of multipliers, element by element.
//!
//! Two elements at a time, from the first on: the five-bar has its two legs side by side, and pairs that stay together need no
//! shuffling. Left to itself the compiler pairs the second with the third.

use wide::f64x2;

/// Element by element a function of the elements of K vectors.
#[inline(always)]
pub(crate) fn combine<const K: usize, const N: usize>(vectors: [&[f64; N]; K], function: impl Fn([f64x2; K]) -> f64x2) -> [f64; N] {
    let mut result = [0.0; N];
    let (pairs, single) = result.as_chunks_mut::<2>();
    for (i, pair) in pairs.iter_mut().enumerate() {
        *pair = function(vectors.map(|x| f64x2::new([x[2 * i], x[2 * i + 1]]))).to_array();
    }
    if let [last] = single {
        *last = function(vectors.map(|x| f64x2::splat(x[N - 1]))).to_array()[0];
    }
    result
}

/// x + y.
#[inline(always)]
pub(super) fn add<const N: usize>(x: &[f64; N], y: &[f64; N]) -> [f64; N] {
    combine([x, y], |[x, y]| x + y)
}

/// −x.
#[inline(always)]
pub(super) fn minus<const N: usize>(x: &[f64; N]) -> [f64; N] {
    combine([x], |[x]| -x)
}

/// Largest magnitude of those values that are numbers: one instruction for each pair. NaN is caught where a step ends.
#[inline(always)]
pub(super) fn max_norm<const N: usize>(x: &[f64; N]) -> f64 {
    let larger = |largest: f64, value: f64| if value.abs() > largest { value.abs() } else { largest };
    let (pairs, single) = x.as_chunks::<2>();
    let [left, right] = pairs.iter().fold([0.0; 2], |[left, right], pair| [larger(left, pair[0]), larger(right, pair[1])]);
    single.iter().copied().fold(larger(left, right), larger)
}

/// Whether all elements are finite, and not so large that their sum is infinite.
#[inline(always)]
pub(super) fn finite<const N: usize>(x: &[f64; N]) -> bool {
    let (pairs, single) = x.as_chunks::<2>();
    let [left, right] = pairs.iter().fold([0.0; 2], |[left, right], pair| [left + pair[0], right + pair[1]]);
    single.iter().fold(left + right, |sum, x| sum + x).is_finite()
}
