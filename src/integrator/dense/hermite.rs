//! The interpolant of steps that have none of degree 7: a quintic polynomial with the coordinates and rates of both ends, whose derivative
//! is the interpolant of the rates, and for the work a polynomial of degree 4 that knows the power at both ends and between them.

use super::interpolant::Interpolant;
use super::trial::StageDerivative;
use crate::integrator::{State, System, Work};
use crate::vector::Vector;

/// Where the power is asked for, and as far from the other end.
const NODE: f64 = 0.211_324_865_405_187_1;

/// What else the quintic knows.
pub(super) enum Knowing<const N: usize> {
    /// The accelerations at both ends.
    Accelerations,
    /// Coordinates and rates in the middle. Where forces are stiff accelerations say little: they are those of the error at the ends, and
    /// h² times as large.
    Middle([Vector<N>; 2]),
}

/// The coefficients of [`Interpolant`] beyond the cubic ones.
#[inline(never)]
pub(super) fn coefficients<const N: usize, const M: usize>(
    [from, to]: [&State<N, M>; 2],
    h: f64,
    knowing: Knowing<N>,
) -> [StageDerivative<N>; 4] {
    let moved = to.q - from.q;
    let second = h * from.v - moved;
    let third = moved - h * to.v - second;
    // Of θ²(1−θ)² and of θ³(1−θ)² ...
    let (fourth, fifth) = match knowing {
        Knowing::Accelerations => {
            // ... the second derivatives at the ends are 2 and 2, 0 and 2;
            let fourth = 0.5 * h * h * from.a + second - third;
            (fourth, 0.5 * h * h * to.a + second + 2.0 * third - fourth)
        }
        Knowing::Middle([q, v]) => {
            // ... values and derivatives in the middle are 1/16 and 0, 1/32 and 1/16.
            let cubic = 0.5 * (from.q + to.q) + 0.25 * second + 0.125 * third;
            let fifth = 16.0 * (h * v - moved - 0.25 * third);
            (16.0 * (q - cubic) - 0.5 * fifth, fifth)
        }
    };
    let mut dense = [StageDerivative::NONE; 4];
    (dense[0].q, dense[1].q) = (fourth, fifth);
    dense
}

/// The first higher coefficient of the work between states h seconds apart, with the interpolant of the coordinates: it takes the power at
/// two places, which is why it is not asked for before the work is.
#[cold]
pub(super) fn of_work<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    [from, to]: [&State<N, M>; 2],
    h: f64,
    positions: &Interpolant<N>,
) -> Work {
    let both = |work: &Work| Vector::from([work.input, work.dissipated]);
    let rates = [&from.power, &to.power].map(|power| h * both(power));
    let cubic = Interpolant::new([&from.work, &to.work].map(both), rates, [Vector::ZERO; 4]);
    let missing = |part: f64| {
        let (q, v) = (positions.at(part), (1.0 / h) * positions.rate_at(part));
        h * both(&system.power(&q, &system.pose(&q), &v)) - cubic.rate_at(part)
    };
    // The derivative of θ²(1−θ)², which is as large with the other sign at the other node.
    const SLOPE: f64 = 2.0 * NODE * (1.0 - NODE) * (1.0 - 2.0 * NODE);
    let coefficient = (0.5 / SLOPE) * (missing(NODE) - missing(1.0 - NODE));
    Work { input: coefficient[0], dissipated: coefficient[1] }
}
