//! Interface of force laws: the motion of joints and tip that a law sees, and the wrench and slopes that it returns.
//!
//! A law acts with torques in the five joints and a force on the tip. It knows no coordinates: `src/dynamics/` computes motions from
//! coordinates or link angles, and maps wrenches and slopes to them.

use arrayvec::ArrayVec;

use super::Inputs;
use crate::hybrid::{FRICTION_PLACES, FrictionPlace, Mode};
use crate::mechanism::LINKS;

/// Number of joints: left base, left elbow, tip, right elbow, right base.
pub const JOINTS: usize = 5;

/// Joints at the left and the right motor axis.
pub const MOTOR_ANGLES: [usize; 2] = [0, 4];

/// Links of each joint, first and second. The rate of a joint is the rate of its first link minus the rate of its second link, if there is
/// one; a joint torque acts with + on the first and with − on the second link.
pub const JOINT_LINKS: [(usize, Option<usize>); JOINTS] = [(0, None), (1, Some(0)), (1, Some(2)), (2, Some(3)), (3, None)];

/// Magnitude |∂w/∂θ̇| of each joint's rate with respect to the rate of each link.
pub(super) static JOINT_ARMS: [[f64; LINKS]; JOINTS] = {
    let (mut arms, mut joint) = ([[0.0; LINKS]; JOINTS], 0);
    while joint < JOINTS {
        let (first, second) = JOINT_LINKS[joint];
        arms[joint][first] = 1.0;
        if let Some(second) = second {
            arms[joint][second] = 1.0;
        }
        joint += 1;
    }
    arms
};

/// A vector in the plane.
pub type Planar = [f64; 2];

/// A 2×2 matrix by rows.
pub type Matrix = [Planar; 2];

/// Scalar product of two vectors in the plane.
pub fn dot(a: Planar, b: Planar) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

/// Product of a 2×2 matrix and a vector.
pub fn times(matrix: Matrix, vector: Planar) -> Planar {
    matrix.map(|row| dot(row, vector))
}

/// Joint values from link values: first link minus second link.
pub fn across_joints([one, two, three, four]: [f64; LINKS]) -> [f64; JOINTS] {
    [one, two - one, two - three, three - four, four]
}

/// Motion of the joints as a joint law sees it: at an instant, or at the point where a finite step evaluates the law.
#[derive(Clone, Copy, Debug)]
pub struct JointMotion<'a> {
    /// Absolute angles of the left and right motor axis, whole turns included, rad: at the instant, or at the beginning of the step.
    pub angles: [f64; 2],
    /// Increments of these angles to the point of evaluation, rad; 0 at an instant. They are separate from `angles` because the sum would
    /// lose digits near a servo's reference.
    pub moved: [f64; 2],
    /// Rates of the joints, rad/s.
    pub rates: [f64; JOINTS],
    /// Factor on the widths of smooth nonlinearities: 1, or larger in the homotopy after a Newton iteration that did not converge.
    pub softening: f64,
    /// Inputs set by the master.
    pub inputs: &'a Inputs,
    /// Mode: the smooth branch on which each force law is evaluated.
    pub mode: Mode,
}

/// Motion of joints and tip at an instant.
#[derive(Clone, Copy, Debug)]
pub struct Motion<'a> {
    /// Motion of the joints.
    pub joints: JointMotion<'a>,
    /// Position of the tip, m.
    pub position: Planar,
    /// Velocity of the tip, m/s.
    pub velocity: Planar,
}

/// Torques in the joints and force on the tip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Torques in the joints, N·m: + on the first link of the joint, − on the second.
    pub torques: [f64; JOINTS],
    /// Force on the tip, N. It acts on link 2.
    pub force: Planar,
}

/// A place of an effect where friction may stick, at a state.
#[derive(Clone, Copy, Debug)]
pub struct FrictionElement {
    /// The place with its sliding rate.
    pub at: FrictionPlace,
    /// Wrench of a friction torque of 1 N·m or a friction force of 1 N; its power is the sliding rate.
    pub wrench: Wrench,
}

/// The active friction places at a state.
pub type FrictionElements = ArrayVec<FrictionElement, FRICTION_PLACES>;

/// Slopes of a wrench.
#[derive(Clone, Copy, Debug, Default)]
pub struct Slopes {
    /// Stiffness k = −∂T/∂φ, N·m/rad, and damping d = −∂T/∂w, N·m·s/rad, of each joint with its angle φ and rate w.
    pub joints: [[f64; 2]; JOINTS],
    /// Stiffness −∂F/∂p, N/m, and damping −∂F/∂ṗ, N·s/m, of the force on the tip, with the tip's position p; not symmetric in general.
    pub tip: [Matrix; 2],
    /// Force on the tip, N. Its lever arms rotate with the links, which adds a stiffness to the links.
    pub force: Planar,
}

/// Variation of a motion, or its derivative with respect to a parameter.
#[derive(Clone, Copy, Debug)]
pub struct MotionChange {
    /// Variations of the joint angles, rad.
    pub angles: [f64; JOINTS],
    /// Variations of the joint rates, rad/s.
    pub rates: [f64; JOINTS],
    /// Variation of the tip's position, m.
    pub position: Planar,
    /// Variation of the tip's velocity, m/s.
    pub velocity: Planar,
}

impl Wrench {
    /// Wrench of a torque of 1 N·m in a joint.
    pub fn of_joint(joint: usize) -> Self {
        let mut wrench = Self::default();
        wrench.torques[joint] = 1.0;
        wrench
    }

    /// Wrench of a force on the tip, N.
    pub fn of_tip(force: Planar) -> Self {
        Self { force, ..Self::default() }
    }

    /// Power, W, for rates of the joints, rad/s, and a velocity of the tip, m/s; or work, J, for increments of angles and position.
    pub fn power(&self, rates: &[f64; JOINTS], velocity: Planar) -> f64 {
        self.torques.iter().zip(rates).map(|(torque, rate)| torque * rate).sum::<f64>() + dot(self.force, velocity)
    }

    /// The wrench self + factor·other.
    pub fn plus(mut self, factor: f64, other: &Self) -> Self {
        for (torque, other) in self.torques.iter_mut().zip(other.torques) {
            *torque += factor * other;
        }
        self.force = [0, 1].map(|i| self.force[i] + factor * other.force[i]);
        self
    }

    /// Sum of the joint torques on each of links 1 to 4, N·m.
    pub fn on_links(&self) -> [f64; LINKS] {
        let [base_left, elbow_left, tip, elbow_right, base_right] = self.torques;
        [base_left - elbow_left, elbow_left + tip, elbow_right - tip, base_right - elbow_right]
    }
}

impl Slopes {
    /// Whether any slope couples links, so that the tangent is not diagonal in the link angles.
    pub fn couple_links(&self) -> bool {
        let inner = &self.joints[1..JOINTS - 1];
        inner.iter().chain(self.tip.as_flattened()).any(|pair| *pair != [0.0; 2])
    }

    /// Change of the wrench for a change of the motion: −k δφ − d δw in the joints, −K δp − D δṗ on the tip.
    pub fn change(&self, by: &MotionChange) -> Wrench {
        let torques = std::array::from_fn(|joint| {
            let [stiffness, damping] = self.joints[joint];
            -stiffness * by.angles[joint] - damping * by.rates[joint]
        });
        let [elastic, viscous] = [times(self.tip[0], by.position), times(self.tip[1], by.velocity)];
        Wrench { torques, force: [0, 1].map(|i| -elastic[i] - viscous[i]) }
    }
}
