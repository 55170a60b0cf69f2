//! Motion of joints and tip as force laws see it: from the 12 coordinates, from the link angles, or over a finite step.

use std::f64::consts::TAU;

use super::wrench::TipArm;
use crate::effects::{FiniteMotion, Inputs, JOINTS, JointMotion, Mode, Motion, MotionChange, TypicalInertia, across_joints};
use crate::mechanism::coordinates::{THETA, X, Y, link_angles};
use crate::mechanism::placement::{ByLink, by_links, tip_levers};
use crate::mechanism::secant::Secant;
use crate::mechanism::{Coordinates, Mechanism, Pose};

/// Conditions under which force laws act; they are constant during a step.
#[derive(Clone, Copy, Debug)]
pub struct Conditions<'a> {
    /// Inputs set by the master.
    pub inputs: &'a Inputs,
    /// Whole turns of links 1 to 4 that the angles do not include.
    pub turns: &'a [i64; 4],
    /// Mode: the smooth branch on which each force law is evaluated.
    pub mode: Mode,
}

/// Rates of the joints, or increments of their angles, from the link entries of the coordinates.
fn of_joints(x: &Coordinates) -> [f64; JOINTS] {
    across_joints(link_angles(x))
}

impl<'a> Conditions<'a> {
    /// Absolute angles of the motor axes, rad, from the angles of links 1 and 4 without whole turns.
    fn motor_angles(&self, angles: [f64; 2]) -> [f64; 2] {
        [angles[0] + self.turns[0] as f64 * TAU, angles[1] + self.turns[3] as f64 * TAU]
    }

    fn joints(&self, angles: [f64; 2], links: [f64; 4]) -> JointMotion<'a> {
        let &Self { inputs, mode, .. } = self;
        JointMotion {
            angles: self.motor_angles(angles),
            moved: [0.0; 2],
            rates: across_joints(links),
            softening: 1.0,
            inputs,
            mode,
        }
    }

    /// Motion at coordinates q and velocities v; `pose` belongs to q.
    pub fn motion(&self, [q, v]: [&Coordinates; 2], pose: &Pose) -> Motion<'a> {
        let TipArm { column: [rx, ry], .. } = TipArm::of_pose(pose, v);
        let (x, y, rate) = (X[1], Y[1], v[THETA[1]]);
        Motion {
            joints: self.joints([q[THETA[0]], q[THETA[3]]], link_angles(v)),
            position: [q[x] + rx, q[y] + ry],
            velocity: [v[x] - rate * ry, v[y] + rate * rx],
        }
    }

    /// Motion at link angles, rad, and rates, rad/s; `pose` belongs to the angles.
    pub fn motion_of_links(&self, mechanism: &Mechanism, [angles, rates]: [ByLink; 2], pose: &Pose) -> Motion<'a> {
        let ([left, right], links) = (angles[0].to_array(), by_links(rates));
        let [p, d] = tip_levers(pose);
        Motion {
            joints: self.joints([left, right], links),
            position: [mechanism.ground_x.to_array()[0] + p[0] + d[0], p[1] + d[1]],
            velocity: [-p[1] * links[0] - d[1] * links[1], p[0] * links[0] + d[0] * links[1]],
        }
    }

    /// Motion over a step of length h, s, that starts at coordinates q, adds increments d and ends with velocities v.
    pub fn finite_motion(
        &self,
        [q, d, v]: [&Coordinates; 3],
        secant: &Secant,
        h: f64,
        softening: f64,
        inertia: TypicalInertia,
    ) -> FiniteMotion<'a> {
        let TipArm { row, column, .. } = TipArm::of_step(secant, d, v);
        let (x, y, turn, rate) = (X[1], Y[1], d[THETA[1]], v[THETA[1]]);
        let change = [d[x] - turn * row[1], d[y] + turn * row[0]];
        FiniteMotion {
            angles: self.motor_angles([q[THETA[0]], q[THETA[3]]]),
            changes: of_joints(d),
            rates: of_joints(v),
            begin: [q[x] + d[x] + column[0] - change[0], q[y] + d[y] + column[1] - change[1]],
            change,
            velocity: [v[x] - rate * column[1], v[y] + rate * column[0]],
            h,
            softening,
            inertia,
            inputs: self.inputs,
        }
    }
}

/// Change of the motion for changes δq and δv, at velocities v.
pub fn change_of_motion(pose: &Pose, v: &Coordinates, [q_change, v_change]: [&Coordinates; 2]) -> MotionChange {
    let TipArm { column: [rx, ry], turning, .. } = TipArm::of_pose(pose, v);
    let (x, y, theta) = (X[1], Y[1], THETA[1]);
    let (turn, rate) = (q_change[theta], v_change[theta]);
    MotionChange {
        angles: of_joints(q_change),
        rates: of_joints(v_change),
        position: [q_change[x] - turn * ry, q_change[y] + turn * rx],
        velocity: [v_change[x] - rate * ry + turn * turning[0], v_change[y] + rate * rx + turn * turning[1]],
    }
}
