//! From link angles to the 12 coordinates: each leg is built up from its motor axis.
//!
//! ```text
//! c_P = ground + a_P,   c_D = ground + l_P + a_D      q̇ = T ω,   q̈ = T α + Ṫ ω,   torques = Tᵀ Q
//! ```
//!
//! Here l_P is the arm from motor axis to elbow, and a_P, a_D are the arms to the centres of mass.

use super::coordinates::{
    D_THETA, D_X, D_Y, E_X, E_Y, G_X, G_Y, P_THETA, P_X, P_Y, TIP_X, TIP_Y, angles_by_leg, centres, set_legs,
};
use super::legs::{Legs, Legs2, SIGMA, both};
use super::{Coordinates, Mechanism, Multipliers, Pose};

/// Values of the proximal and of the distal links; each holds the left and the right leg.
pub type ByLink = [Legs; 2];

/// Arm from motor axis to elbow, m.
pub fn proximal_arm(pose: &Pose) -> Legs2 {
    pose.a_p + pose.b_p
}

/// Arms of the left leg, m: motor axis to elbow, and elbow to tip.
pub fn tip_levers(pose: &Pose) -> [[f64; 2]; 2] {
    let l = proximal_arm(pose);
    let of = |x: Legs| x.to_array()[0];
    [[of(l.x), of(l.y)], [of(pose.a_d.x) + of(pose.sigma_b_d.x), of(pose.a_d.y) + of(pose.sigma_b_d.y)]]
}

/// Coordinate vector from positions of the proximal and distal centres of mass and from link angles.
fn arranged([p, d]: [Legs2; 2], [angle_p, angle_d]: ByLink) -> Coordinates {
    let mut x = Coordinates::ZERO;
    for (place, value) in [(P_X, p.x), (P_Y, p.y), (P_THETA, angle_p), (D_X, d.x), (D_Y, d.y), (D_THETA, angle_d)] {
        set_legs(&mut x, place, value);
    }
    x
}

impl Mechanism {
    /// Coordinates q at link angles, rad; `pose` is their pose.
    pub fn coordinates(&self, pose: &Pose, angles: ByLink) -> Coordinates {
        let l = proximal_arm(pose);
        let proximal = Legs2 { x: self.ground_x + pose.a_p.x, y: pose.a_p.y };
        let distal = Legs2 { x: self.ground_x + l.x + pose.a_d.x, y: l.y + pose.a_d.y };
        arranged([proximal, distal], angles)
    }
}

impl Pose {
    /// Velocities q̇ = T ω at link rates ω, rad/s.
    pub fn velocities(&self, rates @ [w_p, w_d]: ByLink) -> Coordinates {
        let (n_p, n_l, n_d) = (self.a_p.turned(), proximal_arm(self).turned(), self.a_d.turned());
        arranged([n_p.scaled(w_p), n_l.scaled(w_p) + n_d.scaled(w_d)], rates)
    }

    /// Centripetal part Ṫ ω of the accelerations q̈ at link rates ω, rad/s.
    pub fn centripetal(&self, [w_p, w_d]: ByLink) -> Coordinates {
        self.inward([w_p * w_p, w_d * w_d])
    }

    /// Accelerations towards the first joint of each link, for squared link rates, rad²/s².
    pub fn inward(&self, [s_p, s_d]: ByLink) -> Coordinates {
        let l = proximal_arm(self);
        arranged([self.a_p.scaled(-s_p), l.scaled(-s_p) - self.a_d.scaled(s_d)], [Legs::ZERO; 2])
    }

    /// Torques Tᵀ Q on the links, N·m, of a generalised force Q.
    pub fn torques_of(&self, forces: &Coordinates) -> ByLink {
        let ([on_p, on_d], [torque_p, torque_d]) = (centres(forces), angles_by_leg(forces));
        let proximal = torque_p + self.a_p.turned().dot(on_p) + proximal_arm(self).turned().dot(on_d);
        [proximal, torque_d + self.a_d.turned().dot(on_d)]
    }
}

/// Multipliers λ of all joints, N, from the force at the tip and the forces `taken` that the joints exert on the centres of mass. The sum
/// runs from the tip to the ground: the force at a joint is the force at the next joint plus the load of the link between them.
pub fn joint_forces(taken: &Coordinates, [x, y]: [f64; 2]) -> Multipliers {
    let [on_p, on_d] = centres(taken);
    let elbow = on_d - Legs2 { x: SIGMA * both(x), y: SIGMA * both(y) };
    let ground = on_p + elbow;
    let mut joints = Multipliers::ZERO;
    for (place, value) in [(E_X, elbow.x), (E_Y, elbow.y), (G_X, ground.x), (G_Y, ground.y)] {
        set_legs(&mut joints, place, value);
    }
    (joints[TIP_X], joints[TIP_Y]) = (x, y);
    joints
}

/// Reorders values from legs to links 1 to 4.
pub fn by_links([p, d]: ByLink) -> [f64; 4] {
    let ([p_left, p_right], [d_left, d_right]) = (p.to_array(), d.to_array());
    [p_left, d_left, d_right, p_right]
}

/// Reorders values from links 1 to 4 to legs.
pub fn by_legs([p_left, d_left, d_right, p_right]: [f64; 4]) -> ByLink {
    [Legs::new([p_left, p_right]), Legs::new([d_left, d_right])]
}
