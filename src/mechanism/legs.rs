//! The two legs side by side: a value holds the left and the right leg in the two lanes of a SIMD register.
//!
//! Both legs run ground → proximal link → distal link → tip, so both lanes execute the same code.

use std::ops::{Add, Sub};

use wide::bytemuck::cast;
use wide::{f64x2, i64x2};

use crate::vector::ROUND;

/// A quantity of both legs: lane 0 left, lane 1 right.
pub type Legs = f64x2;

/// Sign of each leg in the tip's closure: + left, − right.
pub const SIGMA: Legs = Legs::new([1.0, -1.0]);

/// Sets both legs to one value.
pub fn both(value: f64) -> Legs {
    Legs::splat(value)
}

/// Left + right.
pub fn sum(legs: Legs) -> f64 {
    let [left, right] = legs.to_array();
    left + right
}

/// A planar vector of both legs.
#[derive(Clone, Copy, Debug)]
pub struct Legs2 {
    /// Component along x.
    pub x: Legs,
    /// Component along y.
    pub y: Legs,
}

impl Legs2 {
    /// The vector of each leg times the scalar of that leg.
    pub fn scaled(self, factor: Legs) -> Self {
        Self { x: self.x * factor, y: self.y * factor }
    }

    /// Scalar product, leg by leg.
    pub fn dot(self, other: Self) -> Legs {
        self.x * other.x + self.y * other.y
    }

    /// Cross product (its z component), leg by leg.
    pub fn cross(self, other: Self) -> Legs {
        self.x * other.y - self.y * other.x
    }

    /// The vector rotated by +90°: the derivative of an arm with respect to its angle.
    pub fn turned(self) -> Self {
        Self { x: -self.y, y: self.x }
    }
}

impl Add for Legs2 {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { x: self.x + other.x, y: self.y + other.y }
    }
}

impl Sub for Legs2 {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y }
    }
}

/// Larger magnitude of the two legs; NaN if the right leg is NaN.
pub fn largest(x: Legs) -> f64 {
    let [left, right] = x.abs().to_array();
    if left > right { left } else { right }
}

/// Largest angle for [`rotated_by`], rad: the polynomials are accurate up to it.
const LARGEST_SMALL_ANGLE: f64 = 0.45;

/// Whether the angles of both legs, rad, are small enough for [`rotated_by`]. The test uses their squares because [`rotated_by`] needs them
/// too. NaN counts as small and propagates.
#[inline(always)]
pub fn are_small([one, other]: [Legs; 2]) -> bool {
    (one * one).fast_max(other * other).simd_gt(both(LARGEST_SMALL_ANGLE * LARGEST_SMALL_ANGLE)).to_bitmask() == 0
}

/// Rotates a direction of each leg by at most 0.45 rad, at less than half the cost of sine and cosine: without range reduction or
/// quadrants.
///
/// The tangent of half the angle is b/a, with polynomials of degree 5 and 4 whose angle is within 2.1e-17 rad (Remez, in 60 digits). Then
/// sin δ = 2ab/(a² + b²) and 1 − cos δ = 2b²/(a² + b²) preserve the length of the direction for any quotient. These two terms are small, so
/// the result has the round-off of the direction itself.
#[inline(always)]
pub fn rotated_by(direction: Legs2, angle: Legs) -> Legs2 {
    const A: [f64; 2] = [1_007.466_882_411_849_2, -111.946_052_422_894_71];
    const B: [f64; 3] = [0.5 * A[0], -13.995_239_444_296_098, 0.033_359_826_126_325_32];
    // Polynomials a and b; b/a is the tangent of half the angle.
    let z = angle * angle;
    let a = (z + both(A[1])) * z + both(A[0]);
    let b = ((both(B[2]) * z + both(B[1])) * z + both(B[0])) * angle;
    // The quotient is the last factor because it takes longest.
    let Legs2 { x, y } = direction;
    let quotient = (b + b) / (a * a + b * b);
    Legs2 { x: x - (b * x + a * y) * quotient, y: y + (a * x - b * y) * quotient }
}

/// Sine and cosine of an angle of each leg, rad, within 1 ulp and the rounding of the angle.
///
/// The bits are equal on every platform (no FMA, no platform libm): three-part Cody–Waite reduction by π/2 and the minimax polynomials of
/// FreeBSD's msun `k_sin.c` and `k_cos.c`, two lanes at a time. Above 2²⁰·π/2 rad, the limit of the reduction, and for non-finite angles
/// the libm crate takes over.
pub fn sin_cos(angle: Legs) -> (Legs, Legs) {
    if is_reducible(angle) { sin_cos_reduced(angle) } else { sin_cos_far(angle) }
}

/// Sine and cosine of two angles of each leg, rad, with a single size test.
#[inline(always)]
pub fn sin_cos_of_both([one, other]: [Legs; 2]) -> [(Legs, Legs); 2] {
    if is_reducible(one.abs().fast_max(other.abs())) {
        [sin_cos_reduced(one), sin_cos_reduced(other)]
    } else {
        [sin_cos_far(one), sin_cos_far(other)]
    }
}

/// Whether the range reduction is accurate for the angles of both legs, rad; false for NaN.
#[inline(always)]
fn is_reducible(angle: Legs) -> bool {
    const LIMIT: f64 = 1_647_099.0; // 2^20 · π/2
    angle.abs().simd_lt(both(LIMIT)).to_bitmask() == 0b11
}

#[cold]
#[inline(never)]
fn sin_cos_far(angle: Legs) -> (Legs, Legs) {
    let [left, right] = angle.to_array();
    let ((sl, cl), (sr, cr)) = (libm::sincos(left), libm::sincos(right));
    (Legs::new([sl, sr]), Legs::new([cl, cr]))
}

fn sin_cos_reduced(angle: Legs) -> (Legs, Legs) {
    // π/2 in three parts. The first two have 33 bits, so their products with k are exact for |k| < 2^20.
    const HALF_PI_1: f64 = 1.570_796_326_734_125_6;
    const HALF_PI_2: f64 = 6.077_100_506_303_966e-11;
    const HALF_PI_3: f64 = 2.022_266_248_795_950_7e-21;

    let shifted = angle * both(std::f64::consts::FRAC_2_PI) + both(ROUND);
    let quadrant: i64x2 = cast(shifted);
    let k = shifted - both(ROUND);
    let r = ((angle - k * both(HALF_PI_1)) - k * both(HALF_PI_2)) - k * both(HALF_PI_3);

    let z = r * r;
    let s = both(-2.505_076_025_340_686_3e-8) + z * both(1.589_690_995_211_55e-10);
    let s = both(8.333_333_333_322_49e-3) + z * (both(-1.984_126_982_985_795e-4) + z * (both(2.755_731_370_707_006_8e-6) + z * s));
    let sin = r + z * r * (both(-1.666_666_666_666_663_2e-1) + z * s);

    let c = both(2.087_572_321_298_175e-9) + z * both(-1.135_964_755_778_819_5e-11);
    let c = both(2.480_158_728_947_673e-5) + z * (both(-2.755_731_435_139_066_3e-7) + z * c);
    let c = z * (both(4.166_666_666_666_66e-2) + z * (both(-1.388_888_888_887_411e-3) + z * c));
    let half = both(0.5) * z;
    let w = both(1.0) - half;
    let cos = w + (((both(1.0) - w) - half) + z * c);

    // Odd quadrants exchange sin and cos; the second bit of the quadrant is the sign.
    let one = i64x2::splat(1);
    let odd: Legs = cast(i64x2::splat(0) - (quadrant & one));
    let exchange = (sin ^ cos) & odd;
    let sin_sign: Legs = cast((quadrant & i64x2::splat(2)) << 62);
    let cos_sign: Legs = cast(((quadrant + one) & i64x2::splat(2)) << 62);
    (sin ^ exchange ^ sin_sign, cos ^ exchange ^ cos_sign)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares rotations of directions all around, by angles of both signs up to the largest, in both components.
    #[test]
    fn small_turns_agree_with_libm() {
        let mut worst: f64 = 0.0;
        for i in 0..100 {
            let (sin, cos) = libm::sincos(f64::from(i) * 0.063);
            for j in -1000..=1000 {
                let angle = f64::from(j) * LARGEST_SMALL_ANGLE / 1000.0;
                let turned = rotated_by(Legs2 { x: both(cos), y: both(sin) }, Legs::new([angle, -angle]));
                let (s, c) = libm::sincos(angle);
                for (leg, s) in [s, -s].into_iter().enumerate() {
                    let (x, y) = (turned.x.to_array()[leg], turned.y.to_array()[leg]);
                    worst = worst.max((x - (cos * c - sin * s)).abs()).max((y - (sin * c + cos * s)).abs());
                }
            }
        }
        // Half an ulp below 1 each for sums, products and libm's values, on both sides.
        assert!(worst <= 4.5e-16, "worst difference {worst:e}");
    }

    /// Angles cover all quadrants, multiples of π/2 and their neighbourhood, and values up to and above the limit of the reduction.
    #[test]
    fn sin_cos_agrees_with_libm() {
        let mut worst: f64 = 0.0;
        let mut check = |angle: f64| {
            let (s, c) = sin_cos(Legs::new([angle, -angle]));
            let (sl, cl) = libm::sincos(angle);
            for (got, want) in [(s.to_array()[0], sl), (s.to_array()[1], -sl), (c.to_array()[0], cl), (c.to_array()[1], cl)] {
                worst = worst.max((got - want).abs());
            }
        };
        for i in -4000..4000 {
            let angle = f64::from(i) * 0.003_7;
            check(angle);
            check(angle * 1e4);
            check(f64::from(i) * std::f64::consts::FRAC_PI_2);
            check(f64::from(i) * 1e5);
        }
        // 1 ulp below 1 is 1.1e-16; both results may be off by that much.
        assert!(worst <= 2.3e-16, "worst difference {worst:e}");
    }
}
