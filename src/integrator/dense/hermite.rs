//! Hermite interpolant for schemes without a dense output of order 7: a quintic in the coordinates from states at both ends and
//! further data, whose derivative interpolates the rates; and a quartic for the work, from the power at both ends and at two inner
//! nodes.

use super::interpolant::Interpolant;
use super::trial::StageDerivative;
use crate::integrator::{State, System, Work};
use crate::vector::Vector;

/// Inner nodes of the power, at this part of the step and at 1 minus it.
const NODE: f64 = 0.211_324_865_405_187_1;

/// Further data of the quintic.
pub(super) enum HermiteData<const N: usize> {
    /// Accelerations at both ends.
    Accelerations,
    /// Coordinates and rates in the middle. With stiff forces accelerations would carry the error of the ends, times h².
    Middle([Vector<N>; 2]),
}

/// Coefficients of [`Interpolant`] beyond the cubic ones.
#[inline(never)]
pub(super) fn coefficients<const N: usize, const M: usize>(
    [from, to]: [&State<N, M>; 2],
    h: f64,
    data: HermiteData<N>,
) -> [StageDerivative<N>; 4] {
    let displacement = to.q - from.q;
    let second = h * from.v - displacement;
    let third = displacement - h * to.v - second;
    // Coefficients of the basis functions θ²(1−θ)² and θ³(1−θ)².
    let (fourth, fifth) = match data {
        HermiteData::Accelerations => {
            // Second derivatives of the basis functions at the ends: 2 and 2, 0 and 2.
            let fourth = 0.5 * h * h * from.a + second - third;
            (fourth, 0.5 * h * h * to.a + second + 2.0 * third - fourth)
        }
        HermiteData::Middle([q, v]) => {
            // Values and derivatives of the basis functions in the middle: 1/16 and 0, 1/32 and 1/16.
            let cubic = 0.5 * (from.q + to.q) + 0.25 * second + 0.125 * third;
            let fifth = 16.0 * (h * v - displacement - 0.25 * third);
            (16.0 * (q - cubic) - 0.5 * fifth, fifth)
        }
    };
    let mut dense = [StageDerivative::NONE; 4];
    (dense[0].q, dense[1].q) = (fourth, fifth);
    dense
}

/// First higher coefficient of the work, J, between states `h` seconds apart, from the interpolant of the coordinates. It needs two
/// evaluations of the power, so it is computed only when the work is read.
#[cold]
pub(super) fn work_coefficient<const N: usize, const M: usize>(
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
    // Derivative of θ²(1−θ)² at the first node; at the other node it has the opposite sign.
    const SLOPE: f64 = 2.0 * NODE * (1.0 - NODE) * (1.0 - 2.0 * NODE);
    let coefficient = (0.5 / SLOPE) * (missing(NODE) - missing(1.0 - NODE));
    Work { input: coefficient[0], dissipated: coefficient[1] }
}
