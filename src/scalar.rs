//! Scalars of the observers: a number, or a dual number with its derivative along a direction (forward automatic differentiation). One
//! formula then gives an output and its derivative.
//!
//! Of the crate num-dual only arithmetic and square roots are used, which have equal bits on every platform. Elementary functions supply
//! their derivative through [`Scalar::with`].

use num_dual::{Dual64, DualNum};

/// Tolerance relative to the largest value within which values count as equal, so that their kink has a derivative by convention
/// ([`Scalar::smallest`]): half of the digits.
const TIE_TOLERANCE: f64 = 1e-8;

/// A number, with or without its derivative.
pub trait Scalar: DualNum<Primitive = f64> + Copy {
    /// Creates a scalar from its value and its derivative, which is evaluated only for dual numbers.
    fn with(value: f64, derivative: impl FnOnce() -> f64) -> Self;

    /// The value without the derivative.
    fn value(self) -> f64;

    /// The number itself, with derivative 0 if `kink` is true.
    fn with_flat_kink(self, kink: bool) -> Self;

    /// The smallest of the values. If several coincide, the minimum has a kink; its derivative is then the mean of their derivatives, as
    /// with central differences. The mean is linear in the direction.
    fn smallest<const K: usize>(values: [Self; K]) -> Self;

    /// Magnitude |x| of a value bounded by `largest`. The derivative is 0 if the value is round-off of the bound.
    fn magnitude(self, largest: f64) -> Self {
        self.abs().with_flat_kink(self.value().abs() <= TIE_TOLERANCE * largest)
    }

    /// Square root of a value bounded by `largest`; 0 for x < 0. The derivative is 0 if the root is round-off of √`largest`.
    fn root(self, largest: f64) -> Self {
        let positive = if self.value() > 0.0 { self } else { Self::with(0.0, || 0.0) };
        positive.sqrt().with_flat_kink(positive.value().sqrt() <= TIE_TOLERANCE * largest.sqrt())
    }
}

impl Scalar for f64 {
    fn with(value: f64, _: impl FnOnce() -> f64) -> Self {
        value
    }

    fn value(self) -> f64 {
        self
    }

    fn with_flat_kink(self, _: bool) -> Self {
        self
    }

    fn smallest<const K: usize>(values: [Self; K]) -> Self {
        values.into_iter().fold(f64::INFINITY, f64::min)
    }
}

impl Scalar for Dual64 {
    fn with(value: f64, derivative: impl FnOnce() -> f64) -> Self {
        Self::new(value, derivative())
    }

    fn value(self) -> f64 {
        self.re
    }

    fn with_flat_kink(self, kink: bool) -> Self {
        if kink { Self::new(self.re, 0.0) } else { self }
    }

    fn smallest<const K: usize>(values: [Self; K]) -> Self {
        let (smallest, largest) = values.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), x| (low.min(x.re), high.max(x.re)));
        let coinciding = || values.iter().filter(|x| x.re - smallest <= TIE_TOLERANCE * largest);
        Self::new(smallest, coinciding().map(|x| x.eps).sum::<f64>() / coinciding().count() as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinks_are_flat_and_ties_are_means() {
        let x = |re, eps| Dual64::new(re, eps);
        assert_eq!((x(-2.0, 3.0).magnitude(1.0).re, x(-2.0, 3.0).magnitude(1.0).eps), (2.0, -3.0));
        assert_eq!(x(1e-12, 3.0).magnitude(1.0).eps, 0.0);
        assert_eq!((x(4.0, 1.0).root(1.0).eps, x(0.0, 1.0).root(1.0).eps), (0.25, 0.0));
        let tie = Dual64::smallest([x(1.0, 2.0), x(1.0, 4.0), x(5.0, 9.0)]);
        assert_eq!((tie.re, tie.eps), (1.0, 3.0));
        assert_eq!(f64::smallest([3.0, 1.0, 2.0]), 1.0);
    }
}
