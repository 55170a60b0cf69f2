//! Φ, Φ_q, Φ̇_q q̇ and the geometric stiffness against finite differences along real motions.

use fivebar::mechanism::coordinates::THETA;
use fivebar::mechanism::{COORDINATES, Coordinates, Mechanism, Multipliers};
use fivebar::simulation::bindings::default_inputs;
use fivebar::simulation::{Method, Simulation};
use fivebar::vector::Vector;
use nalgebra::SVector;

use crate::support::{fall_90_120, unequal};

/// Central difference of f along a direction.
fn along<const K: usize>(q: &Coordinates, direction: &Coordinates, f: impl Fn(&Coordinates) -> Vector<K>) -> Vector<K> {
    let step = 1e-6;
    let moved = |s: f64| f(&(*q + s * *direction));
    (moved(step) - moved(-step)) / (2.0 * step)
}

/// Counts NaN, which the norm ignores, as infinite.
fn largest_difference<const K: usize>(x: Vector<K>, y: Vector<K>) -> f64 {
    let difference = x - y;
    if difference.is_finite() { difference.max_norm() } else { f64::INFINITY }
}

/// Calls `check` with (mechanism, q, q̇, λ) every 20 ms of two motions, one with all links different.
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
        let scale = v.max_norm().max(1.0);
        assert!(largest_difference(scale * along(q, &(*v / scale), phi), pose.phi_q_times(v)) < 1e-7);
        // The transposed product uses the same matrix.
        let powers = [pose.phi_q_times(v).dot(lambda), pose.phi_q_transposed_times(lambda).dot(v)];
        assert!((powers[0] - powers[1]).abs() <= 1e-12 * (1.0 + powers[0].abs()), "{powers:?}");
    });
}

#[test]
fn the_velocity_term_is_the_change_of_the_jacobian() {
    along_motions(|mechanism, q, v, _| {
        let scale = v.max_norm().max(1.0);
        let unit = *v / scale;
        let change = scale * scale * along(q, &unit, |q| mechanism.pose(q).phi_q_times(&unit));
        let term = mechanism.pose(q).phi_q_dot_times(v);
        assert!(largest_difference(change, term) < 1e-8 * scale * scale, "{change:?} {term:?}");
    });
}

#[test]
fn the_geometric_stiffness_is_the_change_of_the_constraint_forces() {
    along_motions(|mechanism, q, _, lambda| {
        let (p, d) = mechanism.pose(q).geometric_stiffness(lambda);
        let ([p_left, p_right], [d_left, d_right]) = (p.to_array(), d.to_array());
        let stiffness = [p_left, d_left, d_right, p_right];
        for j in 0..COORDINATES {
            let unit = Coordinates::unit(j);
            let expected = THETA.iter().position(|&i| i == j).map_or(0.0, |link| stiffness[link]) * unit;
            let change = along(q, &unit, |q| mechanism.pose(q).phi_q_transposed_times(lambda));
            assert!(largest_difference(change, expected) < 1e-7, "column {j}: {change:?} {expected:?}");
        }
    });
}

#[test]
fn the_matrix_holds_the_same_as_the_products() {
    along_motions(|mechanism, q, v, lambda| {
        let pose = mechanism.pose(q);
        let matrix = pose.phi_q();
        let product = Multipliers::from_fn(|i| (matrix.row(i) * SVector::from(**v))[0]);
        let transposed = Coordinates::from_fn(|j| matrix.column(j).dot(&SVector::from(**lambda)));
        assert!(largest_difference(product, pose.phi_q_times(v)) < 1e-12);
        assert!(largest_difference(transposed, pose.phi_q_transposed_times(lambda)) < 1e-12);
    });
}
