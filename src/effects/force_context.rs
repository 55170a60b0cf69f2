//! State at an instant as force laws see it, and the places where forces act: joints, motor axes, the tip.
//!
//! With r the arm from the centre of mass of link 2 to the tip, p = c₂ + r and ṗ = ċ₂ + ω₂ r⊥; a force F on the tip is F at c₂ and the
//! torque r × F on link 2, and its tangents K, C in p are mapped by ∂p/∂q.

use std::f64::consts::TAU;

use super::{Inputs, Mode, Tangents};
use crate::mechanism::coordinates::{THETA, X, Y};
use crate::mechanism::{Coordinates, Pose};

/// Number of joints: left base, left elbow, tip, right elbow, right base.
pub const JOINTS: usize = 5;

/// Coordinates of the two motor angles: links 1 and 4.
pub(super) const MOTOR_ANGLES: [usize; 2] = [THETA[0], THETA[3]];

/// Links of each joint, first and second. The rate of a joint is the rate of its first link minus the rate of its second link, if any; a
/// joint torque acts with + on the first and with − on the second.
pub(super) const JOINT_LINKS: [(usize, Option<usize>); JOINTS] = [(0, None), (1, Some(0)), (1, Some(2)), (2, Some(3)), (3, None)];

/// Index of the link on which forces on the tip act.
pub(super) const TIP_LINK: usize = 1;

/// State, inputs and mode at which force laws are evaluated.
#[derive(Clone, Copy)]
pub struct ForceContext<'a> {
    /// Coordinates, m and rad.
    pub q: &'a Coordinates,
    /// Velocities, m/s and rad/s.
    pub v: &'a Coordinates,
    /// Pose at q.
    pub pose: &'a Pose,
    /// Inputs set by the master.
    pub inputs: &'a Inputs,
    /// Whole turns of links 1 to 4 that are not counted in q.
    pub turns: &'a [i64; 4],
    /// Mode: the smooth branch on which each force law is evaluated.
    pub mode: Mode,
}

impl ForceContext<'_> {
    /// Absolute angle of a motor axis, rad, whole turns included.
    #[inline]
    pub fn motor_angle(&self, motor: usize) -> f64 {
        const TURNS: [usize; 2] = [0, 3];
        self.q[MOTOR_ANGLES[motor]] + self.turns[TURNS[motor]] as f64 * TAU
    }

    /// Rate of a motor axis, rad/s.
    #[inline]
    pub fn motor_rate(&self, motor: usize) -> f64 {
        self.v[MOTOR_ANGLES[motor]]
    }

    /// Rate of a joint, rad/s.
    #[inline]
    pub fn joint_rate(&self, joint: usize) -> f64 {
        let (first, second) = JOINT_LINKS[joint];
        self.v[THETA[first]] - second.map_or(0.0, |second| self.v[THETA[second]])
    }

    /// Position and velocity of the tip.
    #[inline]
    pub fn tip(&self) -> Tip {
        let [rx, ry] = tip_arm(self.pose);
        let (x, y, theta) = (X[TIP_LINK], Y[TIP_LINK], THETA[TIP_LINK]);
        let rate = self.v[theta];
        Tip {
            arm: [rx, ry],
            rate,
            position: [self.q[x] + rx, self.q[y] + ry],
            velocity: [self.v[x] - rate * ry, self.v[y] + rate * rx],
        }
    }
}

/// Arm from the centre of mass of link 2 to the tip, m. The left leg's sign in the tip's closure is +.
#[inline]
fn tip_arm(pose: &Pose) -> [f64; 2] {
    [pose.sigma_b_d.x.to_array()[0], pose.sigma_b_d.y.to_array()[0]]
}

/// Adds a torque at a joint, N·m, to the generalised forces.
#[inline]
pub(super) fn add_joint_torque(joint: usize, torque: f64, forces: &mut Coordinates) {
    let (first, second) = JOINT_LINKS[joint];
    forces[THETA[first]] += torque;
    if let Some(second) = second {
        forces[THETA[second]] -= torque;
    }
}

/// Adds the tangent of a joint torque T by the joint's rate w: `damping` = −∂T/∂w, N·m·s/rad.
#[inline]
pub(super) fn add_joint_damping(joint: usize, damping: f64, tangents: &mut impl Tangents) {
    let (first, second) = JOINT_LINKS[joint];
    tangents.damping(THETA[first], THETA[first], damping);
    if let Some(second) = second {
        tangents.damping(THETA[second], THETA[second], damping);
        tangents.damping(THETA[first], THETA[second], -damping);
        tangents.damping(THETA[second], THETA[first], -damping);
    }
}

/// Whether a torque at the joint couples two links.
pub(super) fn is_inner(joint: usize) -> bool {
    JOINT_LINKS[joint].1.is_some()
}

/// State of the tip, the end of link 2.
pub struct Tip {
    /// Arm r from the centre of mass of link 2 to the tip, m.
    arm: [f64; 2],
    /// Rate of link 2, rad/s.
    rate: f64,
    /// Position, m.
    pub position: [f64; 2],
    /// Velocity, m/s.
    pub velocity: [f64; 2],
}

impl Tip {
    /// Adds a force on the tip, N, to the generalised forces.
    #[inline]
    pub fn add_force(&self, [fx, fy]: [f64; 2], forces: &mut Coordinates) {
        let [rx, ry] = self.arm;
        forces[X[TIP_LINK]] += fx;
        forces[Y[TIP_LINK]] += fy;
        forces[THETA[TIP_LINK]] += rx * fy - ry * fx;
    }

    /// Centripetal acceleration of the tip about the centre of mass of link 2, −ω² r, m/s².
    pub fn centripetal(&self) -> [f64; 2] {
        self.arm.map(|arm| -self.rate * self.rate * arm)
    }

    /// Adds the geometric stiffness of a force F on the tip, N, whose arm rotates with link 2: K = r·F in the angle, N·m/rad.
    #[inline]
    pub fn add_geometric_stiffness(&self, [fx, fy]: [f64; 2], tangents: &mut impl Tangents) {
        let [rx, ry] = self.arm;
        tangents.stiffness(THETA[TIP_LINK], THETA[TIP_LINK], rx * fx + ry * fy);
    }

    /// Adds the tangents of a force F on the tip, given as K = −∂F/∂p, N/m, and C = −∂F/∂ṗ, N·s/m, with p the tip's position.
    pub fn add_tangents(&self, stiffness: [[f64; 2]; 2], damping: [[f64; 2]; 2], tangents: &mut impl Tangents) {
        let ([rx, ry], rate) = (self.arm, self.rate);
        let columns = [X[TIP_LINK], Y[TIP_LINK], THETA[TIP_LINK]];
        // ∂p/∂q, and ∂ṗ/∂θ = −ω r, by columns.
        let position_columns = [[1.0, 0.0], [0.0, 1.0], [-ry, rx]];
        let velocity_columns = [[0.0, 0.0], [0.0, 0.0], [-rate * rx, -rate * ry]];
        let product = |row: [f64; 2], matrix: [[f64; 2]; 2], column: [f64; 2]| {
            let times = matrix.map(|line| line[0] * column[0] + line[1] * column[1]);
            row[0] * times[0] + row[1] * times[1]
        };
        for (i, row) in position_columns.into_iter().enumerate() {
            for (j, column) in position_columns.into_iter().enumerate() {
                let from_motion = product(row, stiffness, column) + product(row, damping, velocity_columns[j]);
                tangents.stiffness(columns[i], columns[j], from_motion);
                tangents.damping(columns[i], columns[j], product(row, damping, column));
            }
        }
    }
}
