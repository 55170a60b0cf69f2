//! The interpolant of steps that have none of their own: the quintic polynomial that has angle, rate and acceleration in common with the
//! motion at both ends, and for the work the polynomial of degree 4 that knows the power at both ends and between them.

use super::interpolant::Interpolant;
use super::trial::Slope;
use crate::integrator::{State, System, Work};
use crate::vector::Vector;

/// Where the power is asked for, and as far from the other end.
const NODE: f64 = 0.211_324_865_405_187_12;

/// The coefficients of [`Interpolant`] beyond the cubic ones: two for q, and for q̇, whose interpolant is the derivative of that, one.
#[inline(never)]
pub(super) fn coefficients<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    [from, to]: [&State<N, M>; 2],
    h: f64,
) -> [Slope<N>; 4] {
    let moved = to.q - from.q;
    let second = h * from.v - moved;
    let third = moved - h * to.v - second;
    // θ²(1−θ)² has second derivatives 2 and 2 at the ends, θ³(1−θ)² has 0 and 2.
    let fourth = 0.5 * h * h * from.a + second - third;
    let fifth = 0.5 * h * h * to.a + second + 2.0 * third - fourth;
    // In the middle the rate is the derivative of the quintic; θ²(1−θ)² is 1/16 there.
    let rate = (1.0 / h) * (moved + 0.25 * third + 0.0625 * fifth);
    let cubic = 0.5 * (from.v + to.v) + 0.125 * h * (from.a - to.a);
    let mut dense = [Slope::NONE; 4];
    (dense[0].q, dense[1].q, dense[0].v) = (fourth, fifth, 16.0 * (rate - cubic));
    if system.follows_work() {
        dense[0].power = follow_work(system, [from, to], h, &dense);
    }
    dense
}

/// The coefficient of the work.
fn follow_work<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    [from, to]: [&State<N, M>; 2],
    h: f64,
    dense: &[Slope<N>; 4],
) -> Work {
    let positions = Interpolant::new([from.q, to.q], [h * from.v, h * to.v], dense.map(|slope| slope.q));
    let velocities = Interpolant::new([from.v, to.v], [h * from.a, h * to.a], dense.map(|slope| slope.v));
    let both = |work: &Work| Vector::from([work.input, work.dissipated]);
    let rates = [&from.power, &to.power].map(|power| h * both(power));
    let cubic = Interpolant::new([&from.work, &to.work].map(both), rates, [Vector::ZERO; 4]);
    let missing = |part: f64| {
        let (q, v) = (positions.at(part), velocities.at(part));
        h * both(&system.power(&q, &system.pose(&q), &v)) - cubic.rate_at(part)
    };
    // The derivative of θ²(1−θ)², which is as large with the other sign at the other node.
    const SLOPE: f64 = 2.0 * NODE * (1.0 - NODE) * (1.0 - 2.0 * NODE);
    let coefficient = (0.5 / SLOPE) * (missing(NODE) - missing(1.0 - NODE));
    Work { input: coefficient[0], dissipated: coefficient[1] }
}
