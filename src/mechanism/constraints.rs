//! The five revolute joints: the constraints Φ(q) = 0 and their derivatives, evaluated at a [`Pose`].
//!
//! Per leg (σ = +1 left, −1 right), with û = (cos θ, sin θ) along each link, n̂ = û rotated by +90°, and c the centre of mass:
//!
//! ```text
//! G:  c_P − a_P û_P − ground               = 0     proximal link on its motor axis
//! E:  c_D − a_D û_D − c_P − b_P û_P        = 0     distal link on the elbow
//! Q:  Σ σ (c_D + b_D û_D)                  = 0     both distal links meet in the tip
//! ```
//!
//! Φ_q follows from dû/dθ = n̂, Φ̇_q q̇ from d(n̂ω)/dt = −û ω² at constant ω, and the geometric stiffness from d²û/dθ² = −û. The
//! constraints do not depend on time: Φ_t = 0.

use nalgebra::SMatrix;

use super::coordinates::{
    D_THETA, D_X, D_Y, E_X, E_Y, G_X, G_Y, P_THETA, P_X, P_Y, THETA, TIP_X, TIP_Y, angles_by_leg, legs_of, set_legs,
};
use super::legs::{Legs, Legs2, SIGMA, are_small, both, rotated_by, sin_cos, sin_cos_of_both, sum};
use super::{COORDINATES, Coordinates, MULTIPLIERS, Mechanism, Multipliers};

/// Directions of the links at one q, and arms from the centres of mass to the joints.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Directions û of the proximal links.
    pub(crate) u_p: Legs2,
    /// Directions û of the distal links.
    pub(crate) u_d: Legs2,
    /// Arm from motor axis to centre of mass, a_P û_P, m.
    pub(crate) a_p: Legs2,
    /// Arm from centre of mass to elbow, b_P û_P, m.
    pub(crate) b_p: Legs2,
    /// Arm from elbow to centre of mass, a_D û_D, m.
    pub(crate) a_d: Legs2,
    /// Arm from centre of mass to tip, with the leg's sign, σ b_D û_D, m.
    pub(crate) sigma_b_d: Legs2,
}

/// Multipliers λ by joint, N: ground and elbow of each leg, and the tip, which both legs share.
#[derive(Clone, Copy)]
struct ByJoint {
    ground: Legs2,
    elbow: Legs2,
    tip: Legs2,
}

fn by_joint(lambda: &Multipliers) -> ByJoint {
    ByJoint {
        ground: Legs2 { x: legs_of(lambda, G_X), y: legs_of(lambda, G_Y) },
        elbow: Legs2 { x: legs_of(lambda, E_X), y: legs_of(lambda, E_Y) },
        tip: Legs2 { x: both(lambda[TIP_X]), y: both(lambda[TIP_Y]) },
    }
}

/// Directions of links that turn by `by`, rad, from known directions at known angles: a small rotation costs half as much as a sine and a
/// cosine.
#[inline(always)]
pub(crate) fn directions_turned(angles: [Legs; 2], directions_there: [Legs2; 2], by: [Legs; 2]) -> [Legs2; 2] {
    if are_small(by) {
        [rotated_by(directions_there[0], by[0]), rotated_by(directions_there[1], by[1])]
    } else {
        directions([angles[0] + by[0], angles[1] + by[1]])
    }
}

/// Directions û of the proximal and the distal links at the given angles, rad.
#[inline(never)]
pub(crate) fn directions(angles: [Legs; 2]) -> [Legs2; 2] {
    let [(sin_p, cos_p), (sin_d, cos_d)] = sin_cos_of_both(angles);
    [Legs2 { x: cos_p, y: sin_p }, Legs2 { x: cos_d, y: sin_d }]
}

impl Mechanism {
    /// Pose at q.
    pub fn pose(&self, q: &Coordinates) -> Pose {
        self.pose_at(angles_by_leg(q))
    }

    /// Pose at angles of the proximal and the distal links, rad; one compiled copy for its many callers.
    #[inline(never)]
    pub(crate) fn pose_at(&self, [proximal, distal]: [Legs; 2]) -> Pose {
        let (sin_p, cos_p) = sin_cos(proximal);
        let (sin_d, cos_d) = sin_cos(distal);
        self.pose_along([Legs2 { x: cos_p, y: sin_p }, Legs2 { x: cos_d, y: sin_d }])
    }

    /// Pose from the directions of the proximal and the distal links.
    #[inline(always)]
    pub(crate) fn pose_along(&self, [u_p, u_d]: [Legs2; 2]) -> Pose {
        Pose {
            u_p,
            u_d,
            a_p: u_p.scaled(self.a_p),
            b_p: u_p.scaled(self.b_p),
            a_d: u_d.scaled(self.a_d),
            sigma_b_d: u_d.scaled(self.sigma_b_d),
        }
    }

    /// Constraint values Φ(q), m.
    pub fn phi(&self, q: &Coordinates, pose: &Pose) -> Multipliers {
        let mut phi = Multipliers::ZERO;
        set_legs(&mut phi, G_X, legs_of(q, P_X) - pose.a_p.x - self.ground_x);
        set_legs(&mut phi, G_Y, legs_of(q, P_Y) - pose.a_p.y);
        set_legs(&mut phi, E_X, legs_of(q, D_X) - pose.a_d.x - legs_of(q, P_X) - pose.b_p.x);
        set_legs(&mut phi, E_Y, legs_of(q, D_Y) - pose.a_d.y - legs_of(q, P_Y) - pose.b_p.y);
        phi[TIP_X] = sum(SIGMA * legs_of(q, D_X) + pose.sigma_b_d.x);
        phi[TIP_Y] = sum(SIGMA * legs_of(q, D_Y) + pose.sigma_b_d.y);
        phi
    }
}

impl Pose {
    /// Directions û of the proximal and the distal links.
    pub(crate) fn along(&self) -> [Legs2; 2] {
        [self.u_p, self.u_d]
    }

    /// The product Φ_q v, m/s for velocities.
    pub fn phi_q_times(&self, v: &Coordinates) -> Multipliers {
        let [w_p, w_d] = angles_by_leg(v);
        let (a_p, b_p) = (self.a_p.turned(), self.b_p.turned());
        let (a_d, sigma_b_d) = (self.a_d.turned(), self.sigma_b_d.turned());
        let mut product = Multipliers::ZERO;
        set_legs(&mut product, G_X, legs_of(v, P_X) - a_p.x * w_p);
        set_legs(&mut product, G_Y, legs_of(v, P_Y) - a_p.y * w_p);
        set_legs(&mut product, E_X, legs_of(v, D_X) - a_d.x * w_d - legs_of(v, P_X) - b_p.x * w_p);
        set_legs(&mut product, E_Y, legs_of(v, D_Y) - a_d.y * w_d - legs_of(v, P_Y) - b_p.y * w_p);
        product[TIP_X] = sum(SIGMA * legs_of(v, D_X) + sigma_b_d.x * w_d);
        product[TIP_Y] = sum(SIGMA * legs_of(v, D_Y) + sigma_b_d.y * w_d);
        product
    }

    /// The product Φ_qᵀ λ, N and N·m.
    pub fn phi_q_transposed_times(&self, lambda: &Multipliers) -> Coordinates {
        let at = by_joint(lambda);
        let mut product = Coordinates::ZERO;
        set_legs(&mut product, P_X, at.ground.x - at.elbow.x);
        set_legs(&mut product, P_Y, at.ground.y - at.elbow.y);
        set_legs(&mut product, P_THETA, -self.a_p.turned().dot(at.ground) - self.b_p.turned().dot(at.elbow));
        set_legs(&mut product, D_X, at.elbow.x + SIGMA * at.tip.x);
        set_legs(&mut product, D_Y, at.elbow.y + SIGMA * at.tip.y);
        set_legs(&mut product, D_THETA, self.sigma_b_d.turned().dot(at.tip) - self.a_d.turned().dot(at.elbow));
        product
    }

    /// The product Φ̇_q q̇, m/s²: the centripetal accelerations of the arms.
    pub fn phi_q_dot_times(&self, v: &Coordinates) -> Multipliers {
        let [w_p, w_d] = angles_by_leg(v).map(|rate| rate * rate);
        let mut product = Multipliers::ZERO;
        set_legs(&mut product, G_X, self.a_p.x * w_p);
        set_legs(&mut product, G_Y, self.a_p.y * w_p);
        set_legs(&mut product, E_X, self.a_d.x * w_d + self.b_p.x * w_p);
        set_legs(&mut product, E_Y, self.a_d.y * w_d + self.b_p.y * w_p);
        product[TIP_X] = -sum(self.sigma_b_d.x * w_d);
        product[TIP_Y] = -sum(self.sigma_b_d.y * w_d);
        product
    }

    /// Geometric stiffness ∂(Φ_qᵀλ)/∂q, N·m/rad: diagonal, and only in the angles (proximal, distal).
    pub fn geometric_stiffness(&self, lambda: &Multipliers) -> (Legs, Legs) {
        let at = by_joint(lambda);
        (self.a_p.dot(at.ground) + self.b_p.dot(at.elbow), self.a_d.dot(at.elbow) - self.sigma_b_d.dot(at.tip))
    }

    /// Variation of directions and arms for a variation of q. A product with the result is the derivative of the product with the pose,
    /// apart from the constant unit entries of Φ_q.
    pub fn varied(&self, q: &Coordinates) -> Self {
        let [proximal, distal] = angles_by_leg(q);
        Self {
            u_p: self.u_p.turned().scaled(proximal),
            u_d: self.u_d.turned().scaled(distal),
            a_p: self.a_p.turned().scaled(proximal),
            b_p: self.b_p.turned().scaled(proximal),
            a_d: self.a_d.turned().scaled(distal),
            sigma_b_d: self.sigma_b_d.turned().scaled(distal),
        }
    }

    /// The product (∂Φ_q/∂q w) v. It is symmetric in v and w; for v = w = q̇ it is Φ̇_q q̇.
    pub fn phi_q_varied_times(&self, w: &Coordinates, v: &Coordinates) -> Multipliers {
        let mut turning = Coordinates::ZERO;
        for i in THETA {
            turning[i] = v[i];
        }
        self.varied(w).phi_q_times(&turning)
    }

    /// Constraint Jacobian Φ_q as a matrix, for tests and the dense linear solve; a step uses products.
    pub fn phi_q(&self) -> SMatrix<f64, MULTIPLIERS, COORDINATES> {
        let mut matrix = SMatrix::<f64, MULTIPLIERS, COORDINATES>::zeros();
        for j in 0..COORDINATES {
            matrix.column_mut(j).copy_from_slice(&self.phi_q_times(&Coordinates::unit(j))[..]);
        }
        matrix
    }
}
