//! What observers compute with: a number, or a number with its derivative along a direction. One formula gives an output and its change.
//!
//! Only arithmetic and square roots of the crate num-dual are used, which give the same bits on every platform; elementary functions are
//! given with their derivative, by [`Scalar::with`].

use num_dual::{Dual64, DualNum};

/// Values closer together than this part of the largest have no derivative of their own: see [`Scalar::smallest`].
const TIE_TOLERANCE: f64 = 1e-8;

/// A number, with or without its derivative.
pub trait Scalar: DualNum<Primitive = f64> + Copy {
    /// A value and, where it is asked for, its derivative.
    fn with(value: f64, derivative: impl FnOnce() -> f64) -> Self;

    /// The value.
    fn value(self) -> f64;

    /// The same number with derivative 0 where it has a kink.
    fn with_flat_kink(self, kink: bool) -> Self;

    /// The smallest of some values. One that is multiple has a kink; its derivative is then the mean of both sides, which is what central
    /// differences give and is linear in the direction: the mean of the derivatives of those that coincide.
    fn smallest<const K: usize>(values: [Self; K]) -> Self;

    /// |x|, of a value that can be as large as `largest`: flat where it is round-off of that.
    fn magnitude(self, largest: f64) -> Self {
        self.abs().with_flat_kink(self.value().abs() <= TIE_TOLERANCE * largest)
    }

    /// √x of a value that can be as large as `largest`, not below 0: flat where the root is round-off of that of `largest`.
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
