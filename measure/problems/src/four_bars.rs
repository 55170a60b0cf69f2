//! IFToMM benchmark A02: N four-bars in a row, singular if they lie flat.
//!
//! N + 1 links stand on the ground at x = 0, 1 … N m; N links connect their tips B0 … BN: 2N + 1 uniform rods of 1 m and 1 kg. Gravity is
//! 9.81 m/s² downwards; the standing links start upright, B0 with 1 m/s along x.
//!
//! Each link has coordinates x, y, θ: 3 (2N + 1) in all, with 2 (3N + 1) constraints. The mechanism has one degree of freedom, but
//! N + 1 at the instant when all links are horizontal. While it remains a row of parallelograms it equals the pendulum
//! φ̈ = (p/c) g sin φ, φ from the vertical, B0 = (sin φ, cos φ); see [`phi`].
//!
//! Source: Library of Computational Benchmark Problems, IFToMM Technical Committee for Multibody Dynamics, problem A02. The positions come
//! from the pendulum.

use std::f64::consts::FRAC_PI_2;

use crate::linkage::{Body, End};
use crate::{Linkage, Problem};
use fivebar::vector::Vector;

/// Gravity, m/s².
const G: f64 = 9.81;
/// Entries in a row of the dual matrix up to the diagonal: joints of the same link are at most two places apart.
const W: usize = 6;
/// e, 1/kg, smaller than elsewhere. At the angle d from the singular posture the dual matrix has an eigenvalue of about d²/kg. If e is
/// larger, the accelerations violate the constraints.
const SOFTNESS: f64 = 1e-15;
/// B0 for N = 2 after 10 s, m.
pub const TWO_AT_10_S: [f64; 2] = [0.328_458_111_540_815_4, 0.944_518_538_178_601];
/// B0 for N = 40 after 20 s, m.
pub const FORTY_AT_20_S: [f64; 2] = [0.410_901_153_762_945_2, 0.911_679_900_971_980_7];

/// The benchmark with N = 2 over 10 s. Error: distance of B0 from the published position, m.
pub fn two() -> Problem<Linkage<15, 14, W>, 15, 14> {
    problem(10.0, |q| distance(tip(&q[..]), TWO_AT_10_S))
}

/// The benchmark with N = 40 over 20 s. Error: distance of B0 from the published position, m.
pub fn forty() -> Problem<Linkage<243, 242, W>, 243, 242> {
    problem(20.0, |q| distance(tip(&q[..]), FORTY_AT_20_S))
}

/// The benchmark with as many loops as N coordinates allow, over 1 s, for cost. Error: distance of B0 from its circle, m.
pub fn row<const N: usize, const M: usize>() -> Problem<Linkage<N, M, W>, N, M> {
    problem(1.0, |q| (tip(&q[..])[0].hypot(tip(&q[..])[1]) - 1.0).abs())
}

/// φ(t) of the equivalent pendulum for N = `loops`, rad: c φ̈ = p g sin φ, φ(0) = 0, φ̇(0) = 1/s. The standing links turn about their
/// feet, the others translate: c = (N + 1)/3 + N and p = (N + 1)/2 + N, kg m² and kg m.
///
/// Runge-Kutta of order 4 in steps of at most 50 µs: its error is below 1e-10 within 20 s.
pub fn phi(loops: usize, t: f64) -> f64 {
    let n = loops as f64;
    let rate = ((n + 1.0) / 2.0 + n) / ((n + 1.0) / 3.0 + n) * G;
    let steps = (t / 5e-5).ceil();
    let h = t / steps;
    let (mut phi, mut omega) = (0.0f64, 1.0);
    for _ in 0..steps as u64 {
        let slope =
            |part: f64, [phi_rate, omega_rate]: [f64; 2]| [omega + part * h * omega_rate, rate * (phi + part * h * phi_rate).sin()];
        let first = slope(0.0, [0.0; 2]);
        let second = slope(0.5, first);
        let third = slope(0.5, second);
        let fourth = slope(1.0, third);
        let mean = |i: usize| (first[i] + 2.0 * (second[i] + third[i]) + fourth[i]) / 6.0;
        phi += h * mean(0);
        omega += h * mean(1);
    }
    phi
}

/// Position of B0, m.
pub fn tip(q: &[f64]) -> [f64; 2] {
    [q[0] + 0.5 * q[2].cos(), q[1] + 0.5 * q[2].sin()]
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Links from left to right: standing 0, bar 1, standing 1, bar 2 …
fn problem<const N: usize, const M: usize>(duration: f64, error: fn(&Vector<N>) -> f64) -> Problem<Linkage<N, M, W>, N, M> {
    const { assert!(N % 6 == 3 && M == N - 1, "3 (2 n + 1) coordinates and 2 (3 n + 1) constraints") };
    let loops = (N / 3 - 1) / 2;
    let (standing, bar) = (|k: usize| 2 * k, |k: usize| 2 * k - 1);
    let (begin, end) = ([-0.5, 0.0], [0.5, 0.0]);

    let (mut q, mut v) = (Vector::ZERO, Vector::ZERO);
    let mut joints = Vec::new();
    for k in 0..=loops {
        let x = k as f64;
        if k > 0 {
            q[3 * bar(k)..][..3].copy_from_slice(&[x - 0.5, 1.0, 0.0]);
            v[3 * bar(k)..][..3].copy_from_slice(&[1.0, 0.0, 0.0]);
            joints.push([End::Body(bar(k), end), End::Body(standing(k), end)]);
        }
        q[3 * standing(k)..][..3].copy_from_slice(&[x, 0.5, FRAC_PI_2]);
        v[3 * standing(k)..][..3].copy_from_slice(&[0.5, 0.0, -1.0]);
        joints.push([End::Body(standing(k), begin), End::Ground([x, 0.0])]);
        if k < loops {
            joints.push([End::Body(standing(k), end), End::Body(bar(k + 1), begin)]);
        }
    }
    Problem {
        system: Linkage {
            bodies: vec![Body { mass: 1.0, inertia: 1.0 / 12.0, torque: 0.0 }; 2 * loops + 1],
            joints,
            springs: Vec::new(),
            gravity: [0.0, -G],
            size: loops as f64 + 1.0,
        },
        q,
        v,
        duration,
        regularization: SOFTNESS,
        error,
        energy: Linkage::energy,
    }
}
