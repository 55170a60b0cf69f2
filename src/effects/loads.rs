//! Inputs set by an FMI master: motor torques on the proximal links (against the ground), a force on the tip, and servo references.
//!
//! The tip force acts on the left distal link (link 2), whose joint with link 3 is the tip; reaction 3 is the force of link 3 on link 2.
//! All inputs are constant during a macro step. Only the servo reads the references.

use borsh::{BorshDeserialize, BorshSerialize};

use super::wrench::{MOTOR_ANGLES, Planar, Wrench, dot};

/// Inputs set by the master, constant during a macro step.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Inputs {
    /// Motor torques on the left and right proximal link, N·m.
    pub tau: [f64; 2],
    /// External force on the tip, N.
    pub tip_force: [f64; 2],
    /// Reference angles of the servos for the proximal links, rad.
    pub servo_theta: [f64; 2],
    /// Reference rates of the servos for the proximal links, rad/s.
    pub servo_omega: [f64; 2],
}

/// Whether any value is nonzero. Evaluated in every step, therefore without a branch per value.
fn any(values: [[f64; 2]; 2]) -> bool {
    // The shift drops the sign bit: −0 counts as 0.
    values.as_flattened().iter().fold(0, |bits, value| bits | value.to_bits()) << 1 != 0
}

/// Whether all values are equal pair by pair, without a branch per value.
fn all_equal(a: [[f64; 2]; 2], b: [[f64; 2]; 2]) -> bool {
    a.as_flattened().iter().zip(b.as_flattened()).fold(true, |all_equal, (a, b)| all_equal & (a == b))
}

impl Inputs {
    /// Whether all inputs are finite.
    pub fn are_finite(&self) -> bool {
        [self.tau, self.tip_force, self.servo_theta, self.servo_omega].as_flattened().iter().all(|x| x.is_finite())
    }

    /// Whether any torque or force is nonzero.
    pub fn load(&self) -> bool {
        any([self.tau, self.tip_force])
    }

    /// Whether the torques and the force are the same as in other inputs.
    pub fn same_loads(&self, other: &Self) -> bool {
        all_equal([self.tau, self.tip_force], [other.tau, other.tip_force])
    }

    /// Whether the servo references are the same as in other inputs.
    pub fn same_references(&self, other: &Self) -> bool {
        all_equal([self.servo_theta, self.servo_omega], [other.servo_theta, other.servo_omega])
    }

    /// Whether any servo reference is nonzero.
    pub fn has_servo_reference(&self) -> bool {
        any([self.servo_theta, self.servo_omega])
    }

    /// The loads of these inputs with the servo references of others.
    pub fn with_references(self, other: &Self) -> Self {
        Self { servo_theta: other.servo_theta, servo_omega: other.servo_omega, ..self }
    }

    /// The servo references alone.
    pub fn references(&self) -> Self {
        Self::default().with_references(self)
    }

    /// The sum self + factor·other of all inputs.
    pub fn plus(self, factor: f64, other: &Self) -> Self {
        let sum = |a: [f64; 2], b: [f64; 2]| [a[0] + factor * b[0], a[1] + factor * b[1]];
        Self {
            tau: sum(self.tau, other.tau),
            tip_force: sum(self.tip_force, other.tip_force),
            servo_theta: sum(self.servo_theta, other.servo_theta),
            servo_omega: sum(self.servo_omega, other.servo_omega),
        }
    }

    /// Wrench of the loads.
    pub fn wrench(&self) -> Wrench {
        let mut wrench = Wrench::of_tip(self.tip_force);
        for (joint, torque) in MOTOR_ANGLES.into_iter().zip(self.tau) {
            wrench.torques[joint] = torque;
        }
        wrench
    }

    /// Potential of the constant loads, −τ·θ − F·tip, J, at angles of the motor axes, rad, and a position of the tip, m. The angles need
    /// not include whole turns, because a step does not change them.
    pub fn potential(&self, angles: [f64; 2], position: Planar) -> f64 {
        -(dot(self.tau, angles) + dot(self.tip_force, position))
    }
}
