//! Generalised loads in the link angles with their tangents, for the estimator.
//!
//! ```text
//! x = x(θ), T = ∂x/∂θ, ẋ = T ω           Q  = Tᵀ F
//! K' = Tᵀ(K T + C ∂(Tω)/∂θ) − ∂Tᵀ/∂θ F   C' = Tᵀ C T
//! ```
//!
//! F, K and C are the forces and tangents of the effects in the twelve coordinates; K' and C' are in the link angles.

use super::five_bar::FiveBar;
use super::inertia::proximal_arm;
use crate::effects::Tangents;
use crate::estimator::linkage::LEGS;
use crate::estimator::{Links, Loads, Scene};
use crate::integrator::System;
use crate::mechanism::coordinates::{D_THETA, D_X, D_Y, P_THETA, P_X, P_Y, legs_of, set_legs};
use crate::mechanism::legs::Legs2;
use crate::mechanism::{COORDINATES, Coordinates, Pose};

/// Pose, and the twelve coordinates with their rates, of given link angles, rad, and rates, rad/s.
#[inline(never)]
fn pose_and_coordinates(five_bar: &FiveBar<'_>, theta: &Links, omega: &Links) -> (Pose, [Coordinates; 2]) {
    let mechanism = &five_bar.model.mechanism;
    let by_legs = |x: &Links| {
        let pairs = [x[0], x[3], x[1], x[2]];
        [legs_of(&pairs, 0), legs_of(&pairs, 1)]
    };
    let ([p, d], [w_p, w_d]) = (by_legs(theta), by_legs(omega));
    let pose = mechanism.pose_at([p, d]);
    let (l, n_p, n_l, n_d) = (proximal_arm(&pose), pose.a_p.turned(), proximal_arm(&pose).turned(), pose.a_d.turned());
    let (mut q, mut v) = (Coordinates::ZERO, Coordinates::ZERO);
    for (place, position, rate) in [
        (P_X, mechanism.ground_x + pose.a_p.x, n_p.x * w_p),
        (P_Y, pose.a_p.y, n_p.y * w_p),
        (P_THETA, p, w_p),
        (D_X, mechanism.ground_x + l.x + pose.a_d.x, n_l.x * w_p + n_d.x * w_d),
        (D_Y, l.y + pose.a_d.y, n_l.y * w_p + n_d.y * w_d),
        (D_THETA, d, w_d),
    ] {
        set_legs(&mut q, place, position);
        set_legs(&mut v, place, rate);
    }
    (pose, [q, v])
}

/// Generalised force Tᵀ F, N·m.
#[inline(never)]
fn on_links(pose: &Pose, forces: &Coordinates) -> Links {
    let on_p = Legs2 { x: legs_of(forces, P_X), y: legs_of(forces, P_Y) };
    let on_d = Legs2 { x: legs_of(forces, D_X), y: legs_of(forces, D_Y) };
    let proximal = legs_of(forces, P_THETA) + pose.a_p.turned().dot(on_p) + proximal_arm(pose).turned().dot(on_d);
    let distal = legs_of(forces, D_THETA) + pose.a_d.turned().dot(on_d);
    let ([p_left, p_right], [d_left, d_right]) = (proximal.to_array(), distal.to_array());
    [p_left, d_left, d_right, p_right]
}

/// Accumulates tangents of the twelve coordinates in the link angles.
pub(super) struct LinkTangents {
    /// Rows of T = ∂x/∂θ, with respect to the proximal and distal angle of the row's leg.
    rows: [[f64; 2]; COORDINATES],
    /// Rows of ∂(Tω)/∂θ, with respect to the proximal and distal angle of the row's leg.
    rates: [[f64; 2]; COORDINATES],
    pub(super) stiffness: [Links; 4],
    pub(super) damping: [Links; 4],
}

impl LinkTangents {
    pub(super) fn new(pose: &Pose, omega: &Links) -> Self {
        let (mut rows, mut rates) = ([[0.0; 2]; COORDINATES], [[0.0; 2]; COORDINATES]);
        let (a_p, l, a_d) = (pose.a_p, proximal_arm(pose), pose.a_d);
        for (leg, [p, d]) in LEGS.into_iter().enumerate() {
            let of = |arm: Legs2| [arm.x.to_array()[leg], arm.y.to_array()[leg]];
            let ([px, py], [lx, ly], [dx, dy]) = (of(a_p), of(l), of(a_d));
            for (place, row, rate) in [
                (P_X, [-py, 0.0], [-px * omega[p], 0.0]),
                (P_Y, [px, 0.0], [-py * omega[p], 0.0]),
                (P_THETA, [1.0, 0.0], [0.0; 2]),
                (D_X, [-ly, -dy], [-lx * omega[p], -dx * omega[d]]),
                (D_Y, [lx, dx], [-ly * omega[p], -dy * omega[d]]),
                (D_THETA, [0.0, 1.0], [0.0; 2]),
            ] {
                rows[2 * place + leg] = row;
                rates[2 * place + leg] = rate;
            }
        }
        Self { rows, rates, stiffness: [[0.0; 4]; 4], damping: [[0.0; 4]; 4] }
    }
}

/// Adds value · left rightᵀ to the entries of the links that two coordinates depend on.
fn add(to: &mut [Links; 4], (row, left): (usize, [f64; 2]), (column, right): (usize, [f64; 2]), value: f64) {
    // Coordinates of the left and the right leg alternate.
    for (i, left) in LEGS[row % 2].into_iter().zip(left) {
        for (k, right) in LEGS[column % 2].into_iter().zip(right) {
            to[i][k] += value * left * right;
        }
    }
}

impl Tangents for LinkTangents {
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        add(&mut self.stiffness, (row, self.rows[row]), (column, self.rows[column]), value);
    }

    fn damping(&mut self, row: usize, column: usize, value: f64) {
        add(&mut self.damping, (row, self.rows[row]), (column, self.rows[column]), value);
        add(&mut self.stiffness, (row, self.rows[row]), (column, self.rates[column]), value);
    }
}

impl FiveBar<'_> {
    /// Applied forces in the twelve coordinates, N and N·m, and their tangents in the link angles.
    #[inline(never)]
    pub(super) fn link_tangents(&self, [q, v]: [&Coordinates; 2], pose: &Pose, omega: &Links) -> (Coordinates, LinkTangents) {
        let forces = self.forces(q, pose, v);
        let mut by_links = LinkTangents::new(pose, omega);
        let at = self.context(q, pose, v);
        self.inputs.add_tangents(&at, &mut (&mut by_links as &mut dyn Tangents));
        for effect in &self.model.effects {
            effect.add_tangents(&at, &mut (&mut by_links as &mut dyn Tangents));
        }
        // Derivative of the arms: −∂Tᵀ/∂θ F = a·F.
        let on_p = Legs2 { x: legs_of(&forces, P_X), y: legs_of(&forces, P_Y) };
        let on_d = Legs2 { x: legs_of(&forces, D_X), y: legs_of(&forces, D_Y) };
        let proximal = (pose.a_p.dot(on_p) + proximal_arm(pose).dot(on_d)).to_array();
        let distal = pose.a_d.dot(on_d).to_array();
        for (leg, [p, d]) in LEGS.into_iter().enumerate() {
            by_links.stiffness[p][p] += proximal[leg];
            by_links.stiffness[d][d] += distal[leg];
        }
        (forces, by_links)
    }
}

impl Scene for FiveBar<'_> {
    #[inline(never)]
    fn loads(&self, theta: &Links, omega: &Links) -> Loads {
        let (pose, [q, v]) = pose_and_coordinates(self, theta, omega);
        let (forces, by_links) = self.link_tangents([&q, &v], &pose, omega);
        Loads { torque: on_links(&pose, &forces), stiffness: by_links.stiffness, damping: by_links.damping }
    }

    #[inline(never)]
    fn torque(&self, theta: &Links, omega: &Links) -> Links {
        let (pose, [q, v]) = pose_and_coordinates(self, theta, omega);
        on_links(&pose, &self.forces(&q, &pose, &v))
    }

    fn has_stiff_forces(&self) -> bool {
        System::has_stiff_forces(self)
    }
}
