//! The polynomial of degree 7 between the ends of a step (Hairer, Nørsett, Wanner, section II.6).

use crate::vector::Vector;

/// c₀ + θ (c₁ + (1−θ) (c₂ + θ (c₃ + (1−θ) (c₄ + …)))) with θ the part of the step.
pub(super) struct Interpolant<const K: usize>([Vector<K>; 8]);

impl<const K: usize> Interpolant<K> {
    /// From the values and the derivatives (times the step) at both ends, and the higher coefficients.
    #[inline]
    pub(super) fn new([from, to]: [Vector<K>; 2], [rate, rate_to]: [Vector<K>; 2], [d, e, f, g]: [Vector<K>; 4]) -> Self {
        let difference = to - from;
        let second = rate - difference;
        let third = difference - rate_to - second;
        Self([from, difference, second, third, d, e, f, g])
    }

    /// At a part of the step.
    #[inline]
    pub(super) fn at(&self, part: f64) -> Vector<K> {
        let rest = 1.0 - part;
        let [from, difference, second, third, d, e, f, g] = self.0;
        from + part * (difference + rest * (second + part * (third + rest * (d + part * (e + rest * (f + part * g))))))
    }

    /// Its derivative there, times the step.
    pub(super) fn rate_at(&self, part: f64) -> Vector<K> {
        let (mut value, mut rate) = (self.0[7], Vector::ZERO);
        for place in (0..7).rev() {
            // The factors are θ and 1−θ in turn.
            let (factor, slope) = if place % 2 == 0 { (part, 1.0) } else { (1.0 - part, -1.0) };
            rate = slope * value + factor * rate;
            value = self.0[place] + factor * value;
        }
        rate
    }

    /// The higher coefficients of the same polynomial on the part of the step before some part.
    pub(super) fn cut(&self, part: f64) -> [Vector<K>; 4] {
        // The coefficients of its powers there, from the innermost bracket on.
        let mut powers = [Vector::ZERO; 8];
        powers[0] = self.0[7];
        for place in (0..7).rev() {
            // The factors are θ and 1−θ in turn.
            let [constant, slope] = if place % 2 == 0 { [0.0, part] } else { [1.0, -part] };
            for k in (0..8 - place).rev() {
                let below = if k > 0 { powers[k - 1] } else { Vector::ZERO };
                powers[k] = constant * powers[k] + slope * below;
            }
            powers[0] += self.0[place];
        }
        // The same brackets there: what is left at 0 and 1 in turn, and the rest divided by θ and 1−θ.
        let mut coefficients = [Vector::ZERO; 8];
        for (place, coefficient) in coefficients.iter_mut().enumerate() {
            if place % 2 == 0 {
                *coefficient = powers[0];
                powers.rotate_left(1);
                powers[7] = Vector::ZERO;
            } else {
                let mut rest = Vector::ZERO;
                for power in powers.iter_mut().rev() {
                    (*power, rest) = (-1.0 * rest, rest + *power);
                }
                *coefficient = rest;
            }
        }
        let [.., d, e, f, g] = coefficients;
        [d, e, f, g]
    }

    /// Bounds on the magnitudes of the values and of the derivatives times the step: no product of θ and 1−θ is larger than 1/4 from
    /// the third coefficient on, and none has a derivative larger than 1.
    pub(super) fn extremes(&self) -> [Vector<K>; 2] {
        let [from, difference, higher @ ..] = &self.0;
        let sum = |i: usize| higher.iter().map(|coefficient| coefficient[i].abs()).sum::<f64>();
        let value = Vector::from_fn(|i| from[i].abs().max((from[i] + difference[i]).abs()) + sum(i) / 4.0);
        [value, Vector::from_fn(|i| difference[i].abs() + sum(i))]
    }

    /// Bounds on the magnitudes of the first and second derivatives times the step and its square, where the last two coefficients are 0:
    /// the largest coefficients of both in Bernstein's polynomials, which no value exceeds.
    pub(super) fn extremes_of_quintic(&self) -> [Vector<K>; 2] {
        const RATES: [[f64; 5]; 5] = [
            [1.0, 1.0, 0.0, 0.0, 0.0],
            [1.0, 0.5, 0.5, 0.5, 0.0],
            [1.0, 0.0, 0.5, 0.0, 0.5],
            [1.0, -0.5, 0.0, -0.5, -0.5],
            [1.0, -1.0, -1.0, 0.0, 0.0],
        ];
        const CURVATURES: [[f64; 5]; 4] =
            [[0.0, -2.0, 2.0, 2.0, 0.0], [0.0, -2.0, 0.0, -2.0, 2.0], [0.0, -2.0, -2.0, -2.0, -4.0], [0.0, -2.0, -4.0, 2.0, 2.0]];
        let largest = |rows: &[[f64; 5]], i: usize| {
            let sum = |row: &[f64; 5]| (0..5).map(|k| row[k] * self.0[k + 1][i]).sum::<f64>();
            rows.iter().map(|row| sum(row).abs()).fold(0.0, f64::max)
        };
        [Vector::from_fn(|i| largest(&RATES, i)), Vector::from_fn(|i| largest(&CURVATURES, i))]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extremes_hold_on_the_whole_step() {
        let numbers = [0.3, -1.2, 2.5, 0.7, -3.1, 1.9, 0.2, -0.8];
        let [a, b, c, d, e, f, g, h] = numbers.map(|x| Vector::<1>::from([x]));
        let interpolant = Interpolant::new([a, b], [c, d], [e, f, g, h]);
        let [value, rate] = interpolant.extremes();
        // Of its first 0.3 it is the same polynomial.
        let part = 0.3;
        let ends = [interpolant.at(0.0), interpolant.at(part)];
        let rates = [0.0, part].map(|at| part * interpolant.rate_at(at));
        let first = Interpolant::new(ends, rates, interpolant.cut(part));
        for i in 0..=10 {
            let at = f64::from(i) / 10.0;
            assert!((first.at(at) - interpolant.at(part * at)).max_norm() < 1e-14, "{at}");
        }
        let step = 1e-6;
        for i in 0..1000 {
            let part = f64::from(i) / 1000.0;
            let here = interpolant.at(part)[0];
            let slope = (interpolant.at(part + step)[0] - here) / step;
            assert!(here.abs() <= value[0] && slope.abs() <= rate[0] + 1e-4, "{part}: {here} {slope}");
            // Forward differences: the curvature times half the step.
            assert!((interpolant.rate_at(part)[0] - slope).abs() < 1e-4, "{part}: {slope}");
            let quintic = Interpolant::new([a, b], [c, d], [e, f, Vector::ZERO, Vector::ZERO]);
            let curvature = (quintic.rate_at(part + step)[0] - quintic.rate_at(part)[0]) / step;
            let [rate, bend] = quintic.extremes_of_quintic();
            let slope = quintic.rate_at(part)[0];
            assert!(slope.abs() <= rate[0] && curvature.abs() <= bend[0] + 1e-4, "{part}: {slope} {curvature}");
        }
    }
}
