//! The loads a master sets: motor torques on the proximal links (against the ground) and a force on the tip.
//!
//! The tip force acts on the left distal link (link 2), whose joint with link 3 is the tip: reaction 3 is what link 3 adds.
//! Q = τ in the proximal angles; F at the centre of mass of link 2 and r × F in its angle, r = b û the arm to the tip, so that
//! K = r·F in that angle. Held over a communication step.

use super::Tangents;
use crate::mechanism::coordinates::THETA;
use crate::mechanism::coordinates::X;
use crate::mechanism::{Coordinates, Pose};

/// Index of the link that carries the tip force.
const TIP_LINK: usize = 1;

/// What the master sets: held over a communication step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Motor torques on the left and right proximal link, N·m.
    pub tau: [f64; 2],
    /// External force on the tip, N.
    pub tip_force: [f64; 2],
}

/// Arm from the centre of mass of link 2 to the tip, m. The left leg's sign in the tip's closure is +.
#[inline(always)]
fn tip_arm(pose: &Pose) -> [f64; 2] {
    [pose.sigma_b_d.x.to_array()[0], pose.sigma_b_d.y.to_array()[0]]
}

impl Inputs {
    /// Whether any load is there.
    pub fn any(&self) -> bool {
        *self != Self::default()
    }

    /// Adds the generalised forces.
    #[inline(always)]
    pub fn add_forces(&self, pose: &Pose, forces: &mut Coordinates) {
        let ([rx, ry], [fx, fy]) = (tip_arm(pose), self.tip_force);
        forces[THETA[0]] += self.tau[0];
        forces[THETA[3]] += self.tau[1];
        forces[X[TIP_LINK]] += fx;
        forces[X[TIP_LINK] + 2] += fy;
        forces[THETA[TIP_LINK]] += rx * fy - ry * fx;
    }

    /// Adds their tangents.
    #[inline(always)]
    pub fn add_tangents(&self, pose: &Pose, tangents: &mut impl Tangents) {
        let ([rx, ry], [fx, fy]) = (tip_arm(pose), self.tip_force);
        tangents.stiffness(THETA[TIP_LINK], THETA[TIP_LINK], rx * fx + ry * fy);
    }

    /// Potential of the held loads, J: −τ·θ − F·tip.
    pub fn potential(&self, q: &Coordinates, pose: &Pose) -> f64 {
        let ([rx, ry], [fx, fy]) = (tip_arm(pose), self.tip_force);
        let tip = [q[X[TIP_LINK]] + rx, q[X[TIP_LINK] + 2] + ry];
        -(self.tau[0] * q[THETA[0]] + self.tau[1] * q[THETA[3]] + fx * tip[0] + fy * tip[1])
    }

    /// Power of the loads, W.
    #[inline(always)]
    pub fn power(&self, pose: &Pose, v: &Coordinates) -> f64 {
        let mut forces = [0.0; 12];
        self.add_forces(pose, &mut forces);
        forces.iter().zip(v).map(|(force, v)| force * v).sum()
    }
}
