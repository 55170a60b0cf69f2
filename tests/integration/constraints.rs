//! Φ, Φ_q, Φ̇_q q̇ and the geometric stiffness against finite differences along real motions.

use fivebar::fmi::bindings::default_inputs;
use fivebar::mechanism::coordinates::THETA;
use fivebar::mechanism::{COORDINATES, Coordinates, Mechanism, Multipliers};
use fivebar::simulation::{Method, Simulation};

use crate::support::{fall_90_120, unequal};

/// Central difference of f along a direction.
fn along<const K: usize>(q: &Coordinates, direction: &Coordinates, f: impl Fn(&Coordinates) -> [f64; K]) -> [f64; K] {
    let step = 1e-6;
    let moved = |s: f64| f(&std::array::from_fn(|i| q[i] + s * direction[i]));
    let (ahead, behind) = (moved(step), moved(-step));
    std::array::from_fn(|i| (ahead[i] - behind[i]) / (2.0 * step))
}

fn largest_difference<const K: usize>(x: &[f64; K], y: &[f64; K]) -> f64 {
    x.iter().zip(y).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
}

/// Calls `check` with (mechanism, q, q̇, λ) every 20 ms of two motions, one with nothing equal.
fn along_motions(check: impl Fn(&Mechanism, &Coordinates, &Coordinates, &Multipliers)) {
    for parameters in [fall_90_120(Method::I3alp), unequal()] {
        let mut simulation = Simulation::new(&parameters, &default_inputs()).expect("scene");
        for _ in 0..50 {
            simulation.advance(&default_inputs(), 1e-3, 20).expect("steps");
            let core = &simulation.state().core;
            check(&simulation.model().mechanism, &core.q, &core.v, &core.lambda);
        }
    }
}

// Central differences with 1e-6: truncation 1e-12 and round-off 1e-10, times rates of up to 100 rad/s and forces of up to 10 N.

#[test]
fn the_jacobian_is_the_derivative_of_phi() {
    along_motions(|mechanism, q, v, lambda| {
        let pose = mechanism.pose(q);
        let phi = |q: &Coordinates| mechanism.phi(q, &mechanism.pose(q));
        let scale = v.iter().fold(1.0, |largest: f64, v| largest.max(v.abs()));
        assert!(largest_difference(&along(q, &v.map(|v| v / scale), phi).map(|x| x * scale), &pose.phi_q_times(v)) < 1e-7);
        // The transposed product is the same matrix.
        let (left, right) = (pose.phi_q_times(v), pose.phi_q_transposed_times(lambda));
        let powers = [left.iter().zip(lambda).map(|(x, l)| x * l).sum::<f64>(), right.iter().zip(v).map(|(x, v)| x * v).sum()];
        assert!((powers[0] - powers[1]).abs() <= 1e-12 * (1.0 + powers[0].abs()), "{powers:?}");
    });
}

#[test]
fn the_velocity_term_is_the_change_of_the_jacobian() {
    along_motions(|mechanism, q, v, _| {
        let scale = v.iter().fold(1.0, |largest: f64, v| largest.max(v.abs()));
        let unit = v.map(|v| v / scale);
        let change = along(q, &unit, |q| mechanism.pose(q).phi_q_times(&unit)).map(|x| x * scale * scale);
        let term = mechanism.pose(q).phi_q_dot_times(v);
        assert!(largest_difference(&change, &term) < 1e-8 * scale * scale, "{change:?} {term:?}");
    });
}

#[test]
fn the_geometric_stiffness_is_the_change_of_the_constraint_forces() {
    along_motions(|mechanism, q, _, lambda| {
        let (p, d) = mechanism.pose(q).geometric_stiffness(lambda);
        let ([p_left, p_right], [d_left, d_right]) = (p.to_array(), d.to_array());
        let stiffness = [p_left, d_left, d_right, p_right];
        for j in 0..COORDINATES {
            let mut direction = Coordinates::ZERO;
            direction[j] = 1.0;
            let mut expected = Coordinates::ZERO;
            if let Some(link) = THETA.iter().position(|&i| i == j) {
                expected[j] = stiffness[link];
            }
            let change = along(q, &direction, |q| mechanism.pose(q).phi_q_transposed_times(lambda));
            assert!(largest_difference(&change, &expected) < 1e-7, "column {j}: {change:?} {expected:?}");
        }
    });
}

#[test]
fn the_matrix_holds_the_same_as_the_products() {
    along_motions(|mechanism, q, v, lambda| {
        let pose = mechanism.pose(q);
        let matrix = pose.phi_q();
        let product: Multipliers = (matrix * nalgebra::SVector::from(*v)).into();
        let transposed: Coordinates = (matrix.transpose() * nalgebra::SVector::from(*lambda)).into();
        assert!(largest_difference(&product, &pose.phi_q_times(v)) < 1e-12);
        assert!(largest_difference(&transposed, &pose.phi_q_transposed_times(lambda)) < 1e-12);
    });
}
