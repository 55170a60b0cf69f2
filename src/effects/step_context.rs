//! State over a finite step as force laws see it, for the energy-conserving method: the mean force of a potential is the change of the
//! potential divided by the displacement (discrete gradient); the mean force of a damper follows the mean rate.
//!
//! A damper with decay rate r, 1/s, is evaluated at the rate w̄ + γ (w₁ − w̄), with w̄ the mean rate of the step, w₁ the rate at its end,
//! γ = x/(1 + x) and x = h r/2. For x → 0 that is the midpoint rule, of second order; for x → ∞ it is implicit Euler, which damps a force
//! that would otherwise reverse within the step. For every γ the work is force times displacement.

use std::f64::consts::TAU;

use super::force_context::{JOINT_LINKS, MOTOR_ANGLES, TIP_LINK};
use super::{Inputs, Tangents};
use crate::mechanism::coordinates::{THETA, X, Y};
use crate::mechanism::secant::Secant;
use crate::mechanism::{Coordinates, Geometry};

/// State, inputs and step at which mean forces are evaluated.
#[derive(Clone, Copy)]
pub struct StepContext<'a> {
    /// Coordinates at the step's beginning, m and rad.
    pub q: &'a Coordinates,
    /// Increments of the coordinates over the step, m and rad.
    pub d: &'a Coordinates,
    /// Velocities at the step's end, m/s and rad/s.
    pub v: &'a Coordinates,
    /// Length of the step, s.
    pub h: f64,
    /// Factor on the regularisation rates of friction: 1, or larger in the homotopy of a Newton iteration that did not converge.
    pub softening: f64,
    /// Directions of the links in the middle and at the end of the step.
    pub secant: &'a Secant,
    /// Inputs set by the master.
    pub inputs: &'a Inputs,
    /// Whole turns of links 1 to 4 that are not counted in q.
    pub turns: &'a [i64; 4],
    /// Typical inertias, for estimates of decay rates.
    pub inertia: &'a TypicalInertia,
}

/// Typical inertias by which decay rates of dampers are estimated.
#[derive(Clone, Copy, Debug)]
pub struct TypicalInertia {
    /// Moment of inertia of a link about its joint, kg·m².
    pub joint: f64,
    /// Mass at the tip, kg.
    pub tip: f64,
}

impl TypicalInertia {
    /// Means over the links.
    pub fn new(geometry: &Geometry) -> Self {
        let about_joint = geometry.links.iter().map(|link| link.inertia + link.mass * link.length * link.length);
        Self { joint: about_joint.sum::<f64>() / 4.0, tip: geometry.mean_mass() }
    }
}

/// Weight γ = x/(1 + x) of the step's end for a damper with decay rate r, x = h r/2.
pub(super) fn end_weight(x: f64) -> f64 {
    // In this form the weight is 1 also where x is infinite.
    1.0 - 1.0 / (1.0 + x)
}

/// Adds the tangents of a joint torque T: −∂T/∂Δφ by the increment of the joint's angle, N·m/rad, and −∂T/∂w₁ by its rate at the step's
/// end, N·m·s/rad.
pub(super) fn add_joint_slopes(joint: usize, [stiffness, damping]: [f64; 2], tangents: &mut impl Tangents) {
    let (first, second) = JOINT_LINKS[joint];
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
    /// Absolute angle of a motor axis at the step's beginning, whole turns included, and its increment, rad.
    pub fn motor_angle(&self, motor: usize) -> [f64; 2] {
        const TURNS: [usize; 2] = [0, 3];
        let i = MOTOR_ANGLES[motor];
        [self.q[i] + self.turns[TURNS[motor]] as f64 * TAU, self.d[i]]
    }

    /// Rate of a motor axis at the step's end, rad/s.
    pub fn motor_rate(&self, motor: usize) -> f64 {
        self.v[MOTOR_ANGLES[motor]]
    }

    /// Increment of the angle of a joint, rad, and its rate at the step's end, rad/s.
    pub fn joint(&self, joint: usize) -> [f64; 2] {
        let (first, second) = JOINT_LINKS[joint];
        [self.d, self.v].map(|x| x[THETA[first]] - second.map_or(0.0, |second| x[THETA[second]]))
    }

    /// The ratio x = h r/2 of a damper at a joint with coefficient `damping`, N·m·s/rad.
    pub(super) fn decay(&self, damping: f64) -> f64 {
        0.5 * self.h * damping / self.inertia.joint
    }

    /// State of the tip over the step.
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
            // d mean/dθ: the direction in the middle rotates by half of dθ, and s = sinc(θ/2) has the slope −θ/12.
            mean_slope: [-0.5 * sinc * middle[1] - turn / 12.0 * middle[0], 0.5 * sinc * middle[0] - turn / 12.0 * middle[1]],
            end,
            rate,
            begin: [self.q[x] + self.d[x] + end[0] - change[0], self.q[y] + self.d[y] + end[1] - change[1]],
            change,
            velocity: [self.v[x] - rate * end[1], self.v[y] + rate * end[0]],
        }
    }
}

/// State of the tip, the end of link 2, over a step.
pub struct TipStep {
    /// Arm of the discrete derivative of the tip's position: s times the arm from the centre of mass in the middle of the step, m.
    mean: [f64; 2],
    /// Derivative of `mean` by the increment of the angle, m/rad.
    mean_slope: [f64; 2],
    /// Arm from the centre of mass at the step's end, m.
    end: [f64; 2],
    /// Rate of link 2 at the step's end, rad/s.
    rate: f64,
    /// Position at the step's beginning, m.
    pub begin: [f64; 2],
    /// Increment of the position over the step, m.
    pub change: [f64; 2],
    /// Velocity at the step's end, m/s.
    pub velocity: [f64; 2],
}

impl TipStep {
    /// Adds a mean force on the tip, N, to the generalised forces: its work is force times displacement.
    #[inline]
    pub fn add_force(&self, [fx, fy]: [f64; 2], forces: &mut Coordinates) {
        let [rx, ry] = self.mean;
        forces[X[TIP_LINK]] += fx;
        forces[Y[TIP_LINK]] += fy;
        forces[THETA[TIP_LINK]] += rx * fy - ry * fx;
    }

    /// Adds the geometric stiffness of a mean force on the tip, N, whose arm rotates with link 2, N·m/rad.
    #[inline]
    pub fn add_geometric_stiffness(&self, [fx, fy]: [f64; 2], tangents: &mut impl Tangents) {
        let [rx, ry] = self.mean_slope;
        tangents.stiffness(THETA[TIP_LINK], THETA[TIP_LINK], ry * fx - rx * fy);
    }

    /// Adds the tangents of a mean force F on the tip, given as K = −∂F/∂Δp, N/m, and C = −∂F/∂ṗ₁, N·s/m, with p the tip's position.
    pub fn add_tangents(&self, stiffness: [[f64; 2]; 2], damping: [[f64; 2]; 2], tangents: &mut impl Tangents) {
        let columns = [X[TIP_LINK], Y[TIP_LINK], THETA[TIP_LINK]];
        let position_columns = |[rx, ry]: [f64; 2]| [[1.0, 0.0], [0.0, 1.0], [-ry, rx]];
        let [ex, ey] = self.end;
        let velocity_columns = [[0.0, 0.0], [0.0, 0.0], [-self.rate * ex, -self.rate * ey]];
        let product = |row: [f64; 2], matrix: [[f64; 2]; 2], column: [f64; 2]| {
            let times = matrix.map(|line| line[0] * column[0] + line[1] * column[1]);
            row[0] * times[0] + row[1] * times[1]
        };
        for (i, row) in position_columns(self.mean).into_iter().enumerate() {
            for (j, column) in position_columns(self.end).into_iter().enumerate() {
                let from_motion = product(row, stiffness, column) + product(row, damping, velocity_columns[j]);
                tangents.stiffness(columns[i], columns[j], from_motion);
                tangents.damping(columns[i], columns[j], product(row, damping, column));
            }
        }
    }
}
