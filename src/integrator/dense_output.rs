//! Dense output: the interpolating polynomial between the ends of a step, of degree 7 with the stages of DOP853 (Hairer, Nørsett, Wanner I,
//! section II.6), of degree 5 from Hermite's conditions, with rigorous bounds from its Bernstein coefficients.

use crate::vector::Vector;

/// Polynomial c₀ + θ (c₁ + (1−θ) (c₂ + θ (c₃ + (1−θ) (c₄ + …)))) in the fraction θ of the step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Interpolant<const K: usize>([Vector<K>; 8]);

/// Larger of `most` and |x|, element by element; `most` is not negative.
pub(super) fn max_magnitude<const K: usize>(most: &Vector<K>, x: &Vector<K>) -> Vector<K> {
    Vector::from_fn(|i| if x[i].abs() > most[i] { x[i].abs() } else { most[i] })
}

impl<const K: usize> Interpolant<K> {
    /// Interpolant from values and derivatives (times the step) at both ends, and from the higher coefficients.
    pub(super) fn new([from, to]: [Vector<K>; 2], [rate, rate_to]: [Vector<K>; 2], [d, e, f, g]: [Vector<K>; 4]) -> Self {
        let difference = to - from;
        let second = rate - difference;
        let third = difference - rate_to - second;
        Self([from, difference, second, third, d, e, f, g])
    }

    /// Hermite quintic between two states `h` seconds apart, each given by q, q̇ and q̈.
    pub(super) fn between([[from, v, a], [to, v_to, a_to]]: [[Vector<K>; 3]; 2], h: f64) -> Self {
        let mut quintic = Self::new([from, to], [h * v, h * v_to], [Vector::ZERO; 4]);
        let [_, _, second, third, ..] = quintic.0;
        // Second derivatives of the basis functions θ²(1−θ)² and θ³(1−θ)² at the ends: 2 and 2, 0 and 2.
        let fourth = 0.5 * (h * h * a) + second - third;
        (quintic.0[4], quintic.0[5]) = (fourth, 0.5 * (h * h * a_to) + second + 2.0 * third - fourth);
        quintic
    }

    /// Quintic from values and derivatives (times the step) at both ends and in the middle. With stiff forces second derivatives would
    /// contain the error of the ends, times h².
    pub(super) fn through_middle([from, to]: [Vector<K>; 2], rates: [Vector<K>; 2], [value, rate]: [Vector<K>; 2]) -> Self {
        let mut quintic = Self::new([from, to], rates, [Vector::ZERO; 4]);
        let [_, displacement, second, third, ..] = quintic.0;
        // Values and derivatives of the basis functions θ²(1−θ)² and θ³(1−θ)² in the middle: 1/16 and 0, 1/32 and 1/16.
        let fifth = 16.0 * (rate - displacement - 0.25 * third);
        let off = value - (0.5 * (from + to) + 0.25 * second + 0.125 * third);
        (quintic.0[4], quintic.0[5]) = (16.0 * off - 0.5 * fifth, fifth);
        quintic
    }

    /// Interpolant of selected components.
    pub(super) fn components<const L: usize>(&self, components: [usize; L]) -> Interpolant<L> {
        Interpolant(std::array::from_fn(|row| Vector::from_fn(|i| self.0[row][components[i]])))
    }

    /// Higher coefficients, which values and derivatives at the ends do not determine.
    pub(super) fn higher(&self) -> [Vector<K>; 4] {
        let [.., d, e, f, g] = self.0;
        [d, e, f, g]
    }

    /// Value at the fraction θ of the step.
    pub(super) fn at(&self, part: f64) -> Vector<K> {
        let rest = 1.0 - part;
        let [from, difference, second, third, d, e, f, g] = self.0;
        from + part * (difference + rest * (second + part * (third + rest * (d + part * (e + rest * (f + part * g))))))
    }

    /// Derivative at the fraction θ of the step, times the step.
    pub(super) fn rate_at(&self, part: f64) -> Vector<K> {
        let (mut value, mut rate) = (self.0[7], Vector::ZERO);
        for place in (0..7).rev() {
            // The factors alternate between θ and 1−θ.
            let (factor, slope) = if place % 2 == 0 { (part, 1.0) } else { (1.0 - part, -1.0) };
            rate = slope * value + factor * rate;
            value = self.0[place] + factor * value;
        }
        rate
    }

    /// Higher coefficients of the polynomial restricted to the step before `part`.
    pub(super) fn truncate(&self, part: f64) -> [Vector<K>; 4] {
        // Power coefficients on the shorter step, starting with the innermost bracket.
        let mut powers = [Vector::ZERO; 8];
        powers[0] = self.0[7];
        for place in (0..7).rev() {
            // The factors alternate between θ and 1−θ.
            let [constant, slope] = if place % 2 == 0 { [0.0, part] } else { [1.0, -part] };
            for k in (0..8 - place).rev() {
                let below = if k > 0 { powers[k - 1] } else { Vector::ZERO };
                powers[k] = constant * powers[k] + slope * below;
            }
            powers[0] += self.0[place];
        }
        // Bracket coefficients on the shorter step: the value at 0 and 1 alternately, then division by θ and 1−θ.
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

    /// Running maximum of a component up to a fraction of the step. For a quantity that never falls, the interpolant is wrong where it
    /// falls, and the running maximum is at most as wrong as the interpolant.
    pub(super) fn running_maximum(&self, component: usize, part: f64) -> f64 {
        let rates: [f64; 7] = std::array::from_fn(|row| (1..8).fold(0.0, |sum, k| sum + RATES[row][k] * self.0[k][component]));
        maximum_until(&|part| self.at(part)[component], rates, [0.0, 1.0], part)
    }

    /// Bounds on the magnitudes of the first four derivatives with respect to θ: the largest Bernstein coefficients, which no value
    /// exceeds.
    pub(super) fn derivative_bounds(&self) -> [Vector<K>; 4] {
        let mut coefficients: [Vector<K>; 7] =
            std::array::from_fn(|row| (1..8).fold(Vector::ZERO, |sum, k| sum + RATES[row][k] * self.0[k]));
        std::array::from_fn(|order| {
            let count = 7 - order;
            let derivative_bounds =
                coefficients[..count].iter().fold(Vector::ZERO, |most, coefficient| max_magnitude(&most, coefficient));
            // Bernstein coefficients of a derivative are the differences of the coefficients, times the degree.
            for row in 0..count - 1 {
                coefficients[row] = (count - 1) as f64 * (coefficients[row + 1] - coefficients[row]);
            }
            derivative_bounds
        })
    }
}

/// Maximum over a part of the step, up to `until`, of a function whose derivative has these Bernstein coefficients there. If they have one
/// sign, the function is monotone; otherwise both halves are examined.
fn maximum_until(at: &impl Fn(f64) -> f64, rates: [f64; 7], [from, to]: [f64; 2], until: f64) -> f64 {
    /// Fraction of the step below which values next to a maximum differ by round-off.
    const SHORTEST_STRETCH: f64 = 1e-8;
    let end = to.min(until);
    if rates.iter().all(|rate| *rate >= 0.0) {
        return at(end);
    }
    if rates.iter().all(|rate| *rate <= 0.0) {
        return at(from);
    }
    if to - from < SHORTEST_STRETCH {
        return at(from).max(at(end));
    }
    // Subdivision with de Casteljau's algorithm.
    let mut second = rates;
    let first = std::array::from_fn(|round| {
        let coefficient = second[0];
        for row in 0..rates.len() - 1 - round {
            second[row] = 0.5 * (second[row] + second[row + 1]);
        }
        coefficient
    });
    let middle = 0.5 * (from + to);
    let before = maximum_until(at, first, [from, middle], until);
    if until <= middle { before } else { before.max(maximum_until(at, second, [middle, to], until)) }
}

/// Bernstein coefficients, degree 6, of the derivatives of 1, θ, θ(1−θ), θ²(1−θ), …
const RATES: [[f64; 8]; 7] = rates();

const fn rates() -> [[f64; 8]; 7] {
    const DEGREE: usize = 6;
    let mut table = [[0.0; 8]; DEGREE + 1];
    let mut powers = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let mut bracket = 0;
    while bracket < 8 {
        let mut place = 0;
        while place <= DEGREE {
            // The power θ^k is the sum of Bernstein polynomials times C(place, k)/C(6, k).
            let (mut weight, mut k) = (1.0, 0);
            while k <= place {
                table[place][bracket] += weight * (k + 1) as f64 * powers[k + 1];
                if k < place {
                    weight *= (place - k) as f64 / (DEGREE - k) as f64;
                }
                k += 1;
            }
            place += 1;
        }
        // Multiplication by θ and 1−θ alternately.
        let mut k = 7;
        while k > 0 {
            powers[k] = if bracket % 2 == 0 { powers[k - 1] } else { powers[k] - powers[k - 1] };
            k -= 1;
        }
        if bracket % 2 == 0 {
            powers[0] = 0.0;
        }
        bracket += 1;
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_hold_on_the_whole_step() {
        let numbers = [0.3, -1.2, 2.5, 0.7, -3.1, 1.9, 0.2, -0.8];
        let [a, b, c, d, e, f, g, h] = numbers.map(|x| Vector::<1>::from([x]));
        let interpolant = Interpolant::new([a, b], [c, d], [e, f, g, h]);
        let [rate, curvature_bound, ..] = interpolant.derivative_bounds().map(|derivative_bounds| derivative_bounds[0]);
        // The bounds are attained at the ends, or are slightly above the largest value.
        let mut steepest = 0.0_f64;
        // Restricted to the first 0.3 of the step, the polynomial keeps its values.
        let part = 0.3;
        let ends = [interpolant.at(0.0), interpolant.at(part)];
        let rates = [0.0, part].map(|at| part * interpolant.rate_at(at));
        let first = Interpolant::new(ends, rates, interpolant.truncate(part));
        for i in 0..=10 {
            let at = f64::from(i) / 10.0;
            assert!((first.at(at) - interpolant.at(part * at)).max_norm() < 1e-14, "{at}");
        }
        let step = 1e-6;
        for i in 0..1000 {
            let part = f64::from(i) / 1000.0;
            let here = interpolant.at(part)[0];
            let slope = (interpolant.at(part + step)[0] - here) / step;
            steepest = steepest.max(slope.abs());
            // The error of forward differences is the curvature times half the step.
            assert!((interpolant.rate_at(part)[0] - slope).abs() < 1e-4, "{part}: {slope}");
            let curvature = (interpolant.rate_at(part + step)[0] - interpolant.rate_at(part)[0]) / step;
            assert!(slope.abs() <= rate + 1e-4 && curvature.abs() <= curvature_bound + 1e-3, "{part}: {slope} {curvature}");
        }
        assert!(rate < 1.5 * steepest, "{rate} of {steepest}");
    }

    /// Compares the running maxima of random polynomials at 500 places with their values at 4000.
    #[test]
    fn the_running_maximum_never_falls() {
        let (mut number, mut falling) = (1_u64, 0);
        let mut next = || {
            number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (number >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        };
        for _ in 0..100 {
            let [a, b, c, d, e, f, g, h] = std::array::from_fn(|_| Vector::<1>::from([next()]));
            let interpolant = Interpolant::new([a, b], [c, d], [e, f, g, h]);
            let (mut most, mut falls) = (f64::NEG_INFINITY, false);
            for i in 0..=4000 {
                let part = f64::from(i) / 4000.0;
                let here = interpolant.at(part)[0];
                (most, falls) = (most.max(here), falls || here < most);
                if i % 8 != 0 {
                    continue;
                }
                let running_maximum = interpolant.running_maximum(0, part);
                // Between two places a maximum is higher by at most an eighth of their squared distance times the curvature, which is at
                // most 100.
                assert!((most..most + 1e-6).contains(&running_maximum), "{part}: {running_maximum} instead of {most}");
            }
            falling += u32::from(falls);
        }
        assert!(falling > 50, "only {falling} of them fall anywhere");
    }
}
