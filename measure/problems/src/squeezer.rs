//! Andrews' squeezing mechanism: seven bodies, ten revolutes, microseconds.
//!
//! A motor turns K1 with constant torque from rest; a spring holds K3. Without gravity. In 30 ms the motor makes two and a half turns.
//!
//! The published form has seven relative angles β, Θ, γ, Φ, δ, Ω, ε and six loop equations. Here each body has x, y, θ:
//!
//! | body | hinged at | θ | other joints, from the hinge in body axes |
//! | --- | --- | --- | --- |
//! | K1 | O, the origin | β | (rr, 0): K2 |
//! | K2 | K1 | β + Θ | (−d, 0): E |
//! | K3 | B | γ | (0, −ss): E; spring at (sd, −sc) |
//! | K4 | K5 | Φ + δ | (0, −e): E |
//! | K5 | A | δ | (zt, 0): K4 |
//! | K6 | K7 | Ω + ε | (zf, 0): E |
//! | K7 | A | ε | (0, −u): K6 |
//!
//! Three revolutes join K2, K3, K4 and K6 at E.
//!
//! Source: Test Set for Initial Value Problem Solvers (Lioen, de Swart, Mazzia, Magherini), "Andrews' squeezing mechanism"; Hairer and
//! Wanner, Solving Ordinary Differential Equations II, VII.7; also IFToMM benchmark A03. The values at 30 ms are from the test set.

use crate::linkage::{Body, End, Planar, Spring, rotated};
use crate::{Linkage, Problem};

/// Names of the published angles, in order.
pub const NAMES: [&str; 7] = ["β", "Θ", "γ", "Φ", "δ", "Ω", "ε"];
/// Published angles at the start, rad.
pub const START: [f64; 7] = [
    -0.061_713_890_014_276_45,
    0.0,
    0.455_279_819_163_070_4,
    0.222_668_390_165_885_88,
    0.487_364_979_543_842_55,
    -0.222_668_390_165_885_88,
    1.230_547_444_549_821_2,
];
/// Published angles at 30 ms, rad.
pub const AT_30_MS: [f64; 7] = [
    15.810_771_196_299_04,
    -15.756_371_059_842_98,
    0.040_822_240_130_731_01,
    -0.534_730_116_322_694_8,
    0.524_409_965_880_530_4,
    0.534_730_116_322_694_8,
    1.048_080_741_042_263,
];
/// Published β̈ and Θ̈ at the start, rad/s²; the other accelerations are 0.
pub const START_ACCELERATIONS: [f64; 2] = [14_222.443_919_954_114, -10_666.832_939_965_585];

const MASSES: [f64; 7] = [0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498];
const INERTIAS: [f64; 7] = [2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5];
/// Motor torque, N m.
const MOM: f64 = 0.033;

const A: Planar = [-0.06934, -0.00227];
const B: Planar = [-0.03635, 0.03273];
const C: Planar = [0.014, 0.072];
const D: f64 = 0.028;
const DA: f64 = 0.0115;
const E: f64 = 0.02;
const EA: f64 = 0.01421;
const FA: f64 = 0.01421;
const RR: f64 = 0.007;
const RA: f64 = 0.00092;
const SS: f64 = 0.035;
const SA: f64 = 0.01874;
const SB: f64 = 0.01043;
const SC: f64 = 0.018;
const SD: f64 = 0.02;
const TA: f64 = 0.02308;
const TB: f64 = 0.00916;
const U: f64 = 0.04;
const UA: f64 = 0.01228;
const UB: f64 = 0.00449;
const ZF: f64 = 0.02;
const ZT: f64 = 0.04;
const C0: f64 = 4530.0;
const L0: f64 = 0.07785;

/// Centres of mass, from the hinge in body axes.
const CENTRES: [Planar; 7] = [[RA, 0.0], [-DA, 0.0], [SB, -SA], [0.0, EA - E], [TA, TB], [ZF - FA, 0.0], [-UB, -UA]];

/// Number of coordinates, of constraints, and of entries in a row of the dual matrix up to its diagonal: joints of the same body are at
/// most three places apart.
type Squeezer = Linkage<21, 20, 8>;

/// The benchmark. Error: largest relative error of the seven angles at 30 ms.
pub fn problem() -> Problem<Squeezer, 21, 20> {
    let [k1, k2, k3, k4, k5, k6, k7] = std::array::from_fn(|i| i);
    let at = |body: usize, [x, y]: Planar| End::Body(body, [x - CENTRES[body][0], y - CENTRES[body][1]]);
    let hinge = |body: usize| at(body, [0.0; 2]);
    let e_of_k3 = at(k3, [0.0, -SS]);
    let bodies = (MASSES.iter().zip(INERTIAS))
        .enumerate()
        .map(|(body, (&mass, inertia))| Body { mass, inertia, torque: if body == k1 { MOM } else { 0.0 } })
        .collect();
    let spring_at = [SD - CENTRES[k3][0], -SC - CENTRES[k3][1]];
    Problem {
        system: Linkage {
            bodies,
            joints: vec![
                [hinge(k1), End::Ground([0.0; 2])],
                [hinge(k2), at(k1, [RR, 0.0])],
                [at(k2, [-D, 0.0]), e_of_k3],
                [hinge(k3), End::Ground(B)],
                [at(k4, [0.0, -E]), e_of_k3],
                [at(k6, [ZF, 0.0]), e_of_k3],
                [hinge(k4), at(k5, [ZT, 0.0])],
                [hinge(k6), at(k7, [0.0, -U])],
                [hinge(k5), End::Ground(A)],
                [hinge(k7), End::Ground(A)],
            ],
            springs: vec![Spring { body: k3, at: spring_at, ground: C, stiffness: C0, length: L0 }],
            gravity: [0.0; 2],
            size: 0.1,
        },
        q: assembled(START).into(),
        v: [0.0; 21].into(),
        duration: 0.03,
        regularization: 1e-12 / 0.03,
        error: |q| {
            let angles = published(q);
            (0..7).map(|i| (angles[i] / AT_30_MS[i] - 1.0).abs()).fold(0.0, f64::max)
        },
        energy: Linkage::energy,
    }
}

/// x, y, θ of the bodies from the published angles.
fn assembled([beta, theta, gamma, phi, delta, omega, epsilon]: [f64; 7]) -> [f64; 21] {
    let angles = [beta, beta + theta, gamma, phi + delta, delta, omega + epsilon, epsilon];
    let from = |[x, y]: Planar, body: usize, point: Planar| {
        let [dx, dy] = rotated(point, angles[body]);
        [x + dx, y + dy]
    };
    let origin = [0.0; 2];
    let hinges = [origin, from(origin, 0, [RR, 0.0]), B, from(A, 4, [ZT, 0.0]), A, from(A, 6, [0.0, -U]), A];
    let mut q = [0.0; 21];
    for body in 0..7 {
        let [x, y] = from(hinges[body], body, CENTRES[body]);
        q[3 * body..][..3].copy_from_slice(&[x, y, angles[body]]);
    }
    q
}

/// The published angles, rates or accelerations, from the same quantities of the bodies.
pub fn published(q: &[f64; 21]) -> [f64; 7] {
    let [k1, k2, k3, k4, k5, k6, k7] = std::array::from_fn(|body| q[3 * body + 2]);
    [k1, k2 - k1, k3, k4 - k5, k5, k6 - k7, k7]
}
