//! Scenes and machines shared by several cases.

use fivebar::mechanism::{Geometry, closure};
use fivebar::simulation::bindings::default_parameters;
use fivebar::simulation::{Inputs, Parameters};

pub(crate) const NO_LOAD: Inputs = Inputs { tau: [0.0; 2], tip_force: [0.0; 2], servo_theta: [0.0; 2], servo_omega: [0.0; 2] };

/// Gravity in the unit of energy, m/s².
const G: f64 = 9.81;

/// m g L of the machine, J, the unit of energy errors. With unequal links, from the heaviest and the longest.
pub fn mgl(geometry: &Geometry) -> f64 {
    let largest = |of: fn(&fivebar::mechanism::Link) -> f64| geometry.links.iter().map(of).fold(0.0, f64::max);
    largest(|link| link.mass) * G * largest(|link| link.length)
}

/// Ratio of the machine's size to the paper's machine; scales bounds in m and m/s.
pub(crate) fn relative_size(geometry: &Geometry) -> f64 {
    geometry.length_scale() / default_parameters().geometry.length_scale()
}

/// The paper's machine under gravity, proximal angles 90° and 120°, at rest.
pub(crate) fn fall_90_120() -> Parameters {
    let mut parameters = default_parameters();
    parameters.start.theta[1] = 120_f64.to_radians();
    parameters
}

/// The paper's machine without gravity.
pub(crate) fn weightless() -> Parameters {
    let mut parameters = default_parameters();
    parameters.effects.gravity.enabled = false;
    parameters
}

/// The paper's machine with every length multiplied by `factor`; the masses stay.
pub(crate) fn scaled(factor: f64) -> Parameters {
    let mut parameters = fall_90_120();
    parameters.geometry.base_distance *= factor;
    for link in &mut parameters.geometry.links {
        link.length *= factor;
        link.com *= factor;
        link.inertia *= factor * factor;
    }
    parameters
}

/// Angles of a leg's links (proximal, distal) that put its end at `tip`; `side` is the sign of the bend.
pub(crate) fn leg_to(base: f64, [proximal, distal]: [f64; 2], tip: [f64; 2], side: f64) -> [f64; 2] {
    let (x, y) = (tip[0] - base, tip[1]);
    let distance = x.hypot(y);
    let cosine = (proximal * proximal + distance * distance - distal * distal) / (2.0 * proximal * distance);
    let first = y.atan2(x) - side * cosine.clamp(-1.0, 1.0).acos();
    let elbow = [proximal * first.cos(), proximal * first.sin()];
    [first, (y - elbow[1]).atan2(x - elbow[0])]
}

/// Rates of the right leg (distal, proximal) that follow the tip's motion by the left leg.
pub(crate) fn right_rates(geometry: &Geometry, theta: [f64; 4], left: [f64; 2]) -> [f64; 2] {
    let [l1, l2, l3, l4] = geometry.links.map(|link| link.length);
    let normal = |i: usize| [-theta[i].sin(), theta[i].cos()];
    let (n1, n2, n3, n4) = (normal(0), normal(1), normal(2), normal(3));
    let velocity: [f64; 2] = std::array::from_fn(|k| l1 * left[0] * n1[k] + l2 * left[1] * n2[k]);
    let determinant = l3 * l4 * (n3[0] * n4[1] - n3[1] * n4[0]);
    [l4 * (velocity[0] * n4[1] - velocity[1] * n4[0]) / determinant, l3 * (n3[0] * velocity[1] - n3[1] * velocity[0]) / determinant]
}

/// q̇ of the whole machine for unit rate of one link, with each leg separate.
pub(crate) fn unit_motion(geometry: &Geometry, theta: [f64; 4], link: usize) -> fivebar::mechanism::Coordinates {
    let mut omega = [0.0; 4];
    omega[link] = 1.0;
    closure::assemble(geometry, theta, omega).1
}

/// Nearest link angles and rates that close the loop, by Newton's method with minimal corrections.
pub(crate) fn closed(geometry: &Geometry, mut theta: [f64; 4], mut omega: [f64; 4]) -> ([f64; 4], [f64; 4]) {
    let lengths = geometry.links.map(|link| link.length);
    // Left leg minus right leg.
    let signed = [lengths[0], lengths[1], -lengths[2], -lengths[3]];
    let correct = |values: &mut [f64; 4], theta: [f64; 4], residual: [f64; 2]| {
        let (x, y) = (
            std::array::from_fn::<_, 4, _>(|i| -signed[i] * theta[i].sin()),
            std::array::from_fn::<_, 4, _>(|i| signed[i] * theta[i].cos()),
        );
        let product = |a: &[f64; 4], b: &[f64; 4]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (xx, xy, yy) = (product(&x, &x), product(&x, &y), product(&y, &y));
        let determinant = xx * yy - xy * xy;
        let along = [(yy * residual[0] - xy * residual[1]) / determinant, (xx * residual[1] - xy * residual[0]) / determinant];
        for i in 0..4 {
            values[i] -= x[i] * along[0] + y[i] * along[1];
        }
    };
    let sum = |of: &dyn Fn(usize) -> f64| (0..4).map(|i| signed[i] * of(i)).sum::<f64>();
    for _ in 0..20 {
        let at = theta;
        correct(&mut theta, at, [sum(&|i| at[i].cos()) - geometry.base_distance, sum(&|i| at[i].sin())]);
    }
    for _ in 0..2 {
        let (at, rates) = (theta, omega);
        correct(&mut omega, at, [-sum(&|i| rates[i] * at[i].sin()), sum(&|i| rates[i] * at[i].cos())]);
    }
    (theta, omega)
}
