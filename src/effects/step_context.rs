//! What forces depend on over a finite step, for the method that conserves: the mean force of a potential is its change divided by the
//! displacement, that of a damper follows the mean rate.
//!
//! A force that depends on a rate so steeply that it would turn within the step takes the rate at its end instead of the mean: at
//! w̄ + γ (w₁ − w̄) with γ = x/(1 + x), x = h r/2, r its rate of decay. For x → 0 that is the rule of second order, for x → ∞ the one
//! that damps. Whatever the force, its work is force times displacement.

use std::f64::consts::TAU;

use super::force_context::{JOINED, MOTORS, TIP_LINK};
use super::{Inputs, Tangents};
use crate::mechanism::coordinates::{THETA, X, Y};
use crate::mechanism::secant::Secant;
use crate::mechanism::{Coordinates, Geometry};

/// What forces depend on over a step.
#[derive(Clone, Copy)]
pub struct StepContext<'a> {
    /// Coordinates at its beginning, m and rad.
    pub q: &'a Coordinates,
    /// How they change, m and rad.
    pub d: &'a Coordinates,
    /// Velocities at its end.
    pub v: &'a Coordinates,
    /// The step, s.
    pub h: f64,
    /// Factor on the rates at which friction turns: 1, or larger on the way to a root.
    pub softening: f64,
    /// The step of the links' directions.
    pub secant: &'a Secant,
    /// What the master sets.
    pub inputs: &'a Inputs,
    /// Whole turns of links 1 to 4 that q leaves out.
    pub turns: &'a [i64; 4],
    /// What torques and forces accelerate.
    pub inertia: &'a TypicalInertia,
}

/// The inertias by which a force's rate of decay is estimated.
#[derive(Clone, Copy, Debug)]
pub struct TypicalInertia {
    /// Of a link about its joint, kg·m².
    pub joint: f64,
    /// Of the tip, kg.
    pub tip: f64,
}

impl TypicalInertia {
    /// The mean of the links.
    pub fn new(geometry: &Geometry) -> Self {
        let about_joint = geometry.links.iter().map(|link| link.inertia + link.mass * link.length * link.length);
        Self { joint: about_joint.sum::<f64>() / 4.0, tip: geometry.mean_mass() }
    }
}

/// γ of a force whose rate of decay is r, for x = h r/2.
pub(super) fn end_weight(x: f64) -> f64 {
    // 1 also where x is infinite.
    1.0 - 1.0 / (1.0 + x)
}

/// Adds the tangents of a joint torque: −∂T/∂(change of the angle), N·m/rad, and −∂T/∂(rate at the end), N·m·s/rad.
pub(super) fn add_joint_slopes(joint: usize, [stiffness, damping]: [f64; 2], tangents: &mut impl Tangents) {
    let (first, second) = JOINED[joint];
    let mut add = |row: usize, column: usize, sign: f64| {
        tangents.stiffness(THETA[row], THETA[column], sign * stiffness);
        tangents.damping(THETA[row], THETA[column], sign * damping);
    };
    add(first, first, 1.0);
    if let Some(second) = second {
        add(second, second, 1.0);
        add(first, second, -1.0);
        add(second, first, -1.0);
    }
}

impl StepContext<'_> {
    /// Absolute angle of a motor axis at the beginning, rad, whole turns included, and how it changes.
    pub fn motor_angle(&self, motor: usize) -> [f64; 2] {
        const TURNS: [usize; 2] = [0, 3];
        let i = MOTORS[motor];
        [self.q[i] + self.turns[TURNS[motor]] as f64 * TAU, self.d[i]]
    }

    /// Rate of a motor axis at the end, rad/s.
    pub fn motor_rate(&self, motor: usize) -> f64 {
        self.v[MOTORS[motor]]
    }

    /// How the angle of a joint changes, rad, and its rate at the end, rad/s.
    pub fn joint(&self, joint: usize) -> [f64; 2] {
        let (first, second) = JOINED[joint];
        [self.d, self.v].map(|x| x[THETA[first]] - second.map_or(0.0, |second| x[THETA[second]]))
    }

    /// x of a torque at a joint that changes with its rate by so much, N·m·s/rad.
    pub(super) fn decay(&self, damping: f64) -> f64 {
        0.5 * self.h * damping / self.inertia.joint
    }

    /// The tip.
    pub fn tip(&self) -> TipStep {
        let arm = |pose: &crate::mechanism::Pose| [pose.sigma_b_d.x.to_array()[0], pose.sigma_b_d.y.to_array()[0]];
        let (middle, end) = (arm(&self.secant.middle), arm(&self.secant.end));
        let sinc = self.secant.sinc[1].to_array()[0];
        let (x, y, theta) = (X[TIP_LINK], Y[TIP_LINK], THETA[TIP_LINK]);
        let (turn, rate) = (self.d[theta], self.v[theta]);
        let mean = middle.map(|x| sinc * x);
        let change = [self.d[x] - turn * mean[1], self.d[y] + turn * mean[0]];
        TipStep {
            mean,
            // d mean/dθ: the middle turns by half, s = sinc(θ/2) falls.
            mean_slope: [-0.5 * sinc * middle[1] - turn / 12.0 * middle[0], 0.5 * sinc * middle[0] - turn / 12.0 * middle[1]],
            end,
            rate,
            begin: [self.q[x] + self.d[x] + end[0] - change[0], self.q[y] + self.d[y] + end[1] - change[1]],
            change,
            velocity: [self.v[x] - rate * end[1], self.v[y] + rate * end[0]],
        }
    }
}

/// The tip as the end of link 2, over a step.
pub struct TipStep {
    /// Discrete derivative of the tip's position: the arm from the centre of mass in the middle of the step, shortened, m.
    mean: [f64; 2],
    /// How it changes with the angle.
    mean_slope: [f64; 2],
    /// The arm at the end, m.
    end: [f64; 2],
    /// Rate of link 2 at the end, rad/s.
    rate: f64,
    /// Position at the beginning, m.
    pub begin: [f64; 2],
    /// How it changes, m.
    pub change: [f64; 2],
    /// Velocity at the end, m/s.
    pub velocity: [f64; 2],
}

impl TipStep {
    /// Adds a force on the tip, N: its work is force times displacement.
    #[inline]
    pub fn add_force(&self, [fx, fy]: [f64; 2], forces: &mut Coordinates) {
        let [rx, ry] = self.mean;
        forces[X[TIP_LINK]] += fx;
        forces[Y[TIP_LINK]] += fy;
        forces[THETA[TIP_LINK]] += rx * fy - ry * fx;
    }

    /// Adds what the turning arm makes of a force.
    #[inline]
    pub fn add_geometric_stiffness(&self, [fx, fy]: [f64; 2], tangents: &mut impl Tangents) {
        let [rx, ry] = self.mean_slope;
        tangents.stiffness(THETA[TIP_LINK], THETA[TIP_LINK], ry * fx - rx * fy);
    }

    /// Adds the tangents of a force whose own are K = −∂F/∂Δp, N/m, and C = −∂F/∂ṗ₁, N·s/m, with p the tip's position.
    pub fn add_tangents(&self, stiffness: [[f64; 2]; 2], damping: [[f64; 2]; 2], tangents: &mut impl Tangents) {
        let columns = [X[TIP_LINK], Y[TIP_LINK], THETA[TIP_LINK]];
        let motions = |[rx, ry]: [f64; 2]| [[1.0, 0.0], [0.0, 1.0], [-ry, rx]];
        let [ex, ey] = self.end;
        let turning = [[0.0, 0.0], [0.0, 0.0], [-self.rate * ex, -self.rate * ey]];
        let product = |row: [f64; 2], matrix: [[f64; 2]; 2], column: [f64; 2]| {
            let times = matrix.map(|line| line[0] * column[0] + line[1] * column[1]);
            row[0] * times[0] + row[1] * times[1]
        };
        for (i, row) in motions(self.mean).into_iter().enumerate() {
            for (j, column) in motions(self.end).into_iter().enumerate() {
                let from_motion = product(row, stiffness, column) + product(row, damping, turning[j]);
                tangents.stiffness(columns[i], columns[j], from_motion);
                tangents.damping(columns[i], columns[j], product(row, damping, column));
            }
        }
    }
}
