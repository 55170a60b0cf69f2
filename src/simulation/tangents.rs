//! Jacobian of the accelerations in the link angles with respect to angles and rates, for the Rosenbrock methods.
//!
//! With r the arm of each link along the closure (its sign included), m and s the coupling m_D l_P·a_D of a leg and its derivative, the
//! equations of motion and their variation are
//!
//! ```text
//! M α + Jᵀλ   = Q + c                J α  − e λ  = Σ r ω²                         J = n̂(r)
//! M δα + Jᵀδλ = −K δθ − C δω + δc − δM α − δJᵀ λ      J δα − e δλ = Σ (r α + n̂(r) ω²) δθ + 2 r ω δω
//! ```
//!
//! with the same matrix for both. K and C are those of the force laws (`src/dynamics/wrench.rs`).

use super::angles::{ANGLES, AngleSystem, Angles, CLOSURES, DISTAL, LINK_INDICES, PROXIMAL, legs};
use crate::dynamics::placement::{by_links, proximal_arm};
use crate::integrator::{AccelerationTangents, Kkt, State, System};
use crate::mechanism::Pose;
use crate::mechanism::coordinates::{legs_of, set_legs};
use crate::mechanism::legs::{Legs2, both};
use crate::vector::Vector;

impl AngleSystem<'_> {
    /// Jacobian at a state in equilibrium; `regularization` is e of that equilibrium. Sticking contacts are ignored: their reactions have
    /// multipliers of their own.
    #[inline(never)]
    pub(super) fn tangents_of_acceleration(
        &self,
        at: &State<ANGLES, CLOSURES>,
        pose: &Pose,
        regularization: f64,
    ) -> AccelerationTangents<ANGLES> {
        let State { q, v, a, lambda, .. } = at;
        let factor = self.factor_mass(pose, regularization);
        let slopes = self.five_bar().slopes(self.motion(pose, q, v));
        let [stiffness, damping] = slopes.torques_in_angles(pose, by_links(legs(v)));
        let weight = by_links(pose.stiffness_of(&self.model().weight));

        // Right-hand sides by columns: tangents of the loads.
        let (mut by_q, mut by_v) = ([Angles::ZERO; ANGLES], [Angles::ZERO; ANGLES]);
        for (i, row) in LINK_INDICES.into_iter().enumerate() {
            for (j, column) in LINK_INDICES.into_iter().enumerate() {
                by_q[column][row] = -stiffness[i][j];
                by_v[column][row] = -damping[i][j];
            }
            by_q[row][row] -= weight[i];
        }
        // Right-hand sides: derivatives of mass matrix and centripetal torques, leg by leg.
        let (w_p, w_d) = (legs_of(v, PROXIMAL), legs_of(v, DISTAL));
        let (a_p, a_d) = (legs_of(a, PROXIMAL), legs_of(a, DISTAL));
        let (carried, l) = (self.model().mechanism.mass_d, proximal_arm(pose));
        let (coupling, slope) = (carried * l.dot(pose.a_d), carried * l.turned().dot(pose.a_d));
        let on_p = (coupling * w_d * w_d + slope * a_d).to_array();
        let on_d = (slope * a_p - coupling * w_p * w_p).to_array();
        let (turn_p, turn_d) = ((both(2.0) * slope * w_d).to_array(), (both(2.0) * slope * w_p).to_array());
        // Right-hand sides: derivatives of the closure's arms, which are constant on a closure branch.
        let turning = if self.is_on_branch() { 0.0 } else { 1.0 };
        let [n_p, n_d] = self.phi_q(pose).map(|n| n.scaled(both(turning)));
        let [r_p, r_d] = [n_p, n_d].map(|n| n.turned().scaled(both(-1.0)));
        let pulled = |r: Legs2| r.x * both(lambda[0]) + r.y * both(lambda[1]);
        let mut along = Angles::ZERO;
        set_legs(&mut along, PROXIMAL, pulled(r_p));
        set_legs(&mut along, DISTAL, pulled(r_d));
        for leg in 0..2 {
            let (p, d) = (2 * PROXIMAL + leg, 2 * DISTAL + leg);
            by_q[p][p] += along[p] - on_p[leg];
            by_q[d][p] += on_p[leg];
            by_q[p][d] -= on_d[leg];
            by_q[d][d] += along[d] + on_d[leg];
            by_v[d][p] += turn_p[leg];
            by_v[p][d] -= turn_d[leg];
        }
        let mut closure_q = [Vector::<CLOSURES>::ZERO; ANGLES];
        let mut closure_v = closure_q;
        for (place, r, n, w, a) in [(PROXIMAL, r_p, n_p, w_p, a_p), (DISTAL, r_d, n_d, w_d, a_d)] {
            let (x, y) = ((r.x * a + n.x * w * w).to_array(), (r.y * a + n.y * w * w).to_array());
            let (x_v, y_v) = ((both(2.0) * r.x * w).to_array(), (both(2.0) * r.y * w).to_array());
            for leg in 0..2 {
                closure_q[2 * place + leg] = [x[leg], y[leg]].into();
                closure_v[2 * place + leg] = [x_v[leg], y_v[leg]].into();
            }
        }
        for i in 0..ANGLES {
            by_q[i] = factor.solve(&by_q[i], &closure_q[i]).0;
            by_v[i] = factor.solve(&by_v[i], &closure_v[i]).0;
        }
        AccelerationTangents { by_q, by_v }
    }
}
