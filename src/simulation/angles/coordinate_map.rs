//! Map from link angles to the twelve coordinates (each leg is built up from its motor axis), and its transpose for forces.

use super::{AngleSystem, Angles, DISTAL, PROXIMAL};
use crate::integrator::{System, Work};
use crate::mechanism::coordinates::{D_THETA, D_X, D_Y, P_THETA, P_X, P_Y, legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2};
use crate::mechanism::{Coordinates, Pose};
use crate::simulation::inertia::proximal_arm;

/// Twelve coordinates with these angles and zero positions.
#[inline]
fn in_place(angles: &Angles) -> Coordinates {
    let mut x = Coordinates::ZERO;
    set_legs(&mut x, P_THETA, legs_of(angles, PROXIMAL));
    set_legs(&mut x, D_THETA, legs_of(angles, DISTAL));
    x
}

impl AngleSystem<'_> {
    /// Kinetic energy, J, potential energy with that of the held loads, J, and power of the forces that have no potential, W.
    pub(in crate::simulation) fn energies(&self, q: &Angles, v: &Angles) -> [f64; 3] {
        let pose = self.pose(q);
        let (x, rates) = self.coordinates(&pose, q, v);
        let kinetic = self.mass_times(&pose, v).dot(v) / 2.0;
        [kinetic, self.five_bar.potential_energy(&x, &pose), self.five_bar.power_without_potential(&x, &pose, &rates)]
    }

    /// Forces in the angles, N·m, and their power, W, under loads other than the weight. The function is out of line and takes copies: data
    /// behind pointers must be in memory, and without such loads they stay in registers. Directions suffice to rebuild the pose.
    #[inline(never)]
    pub(super) fn loaded_torques_and_power(&self, q: Angles, directions: [Legs2; 2], v: Angles) -> (Angles, Work) {
        let pose = self.mechanism.pose_along(directions);
        let (x, rates) = (self.positions(&q, &pose), self.velocity_map(&v, &pose));
        let (applied, power) = if self.five_bar.follows_work() {
            self.five_bar.acting(&self.five_bar.context(&x, &pose, &rates))
        } else {
            (self.five_bar.forces(&x, &pose, &rates), Work::default())
        };
        (self.torques_in_angles(&applied, &pose, &v), power)
    }

    /// Applied forces of the twelve coordinates mapped to the angles, N·m, plus the centripetal torques of the distal centre of mass.
    #[inline(always)]
    pub(super) fn torques_in_angles(&self, applied: &Coordinates, pose: &Pose, v: &Angles) -> Angles {
        let (l, a_d) = (proximal_arm(pose), pose.a_d);
        let on_p = Legs2 { x: legs_of(applied, P_X), y: legs_of(applied, P_Y) };
        let on_d = Legs2 { x: legs_of(applied, D_X), y: legs_of(applied, D_Y) };
        let proximal = legs_of(applied, P_THETA) + pose.a_p.turned().dot(on_p) + l.turned().dot(on_d);
        let distal = legs_of(applied, D_THETA) + a_d.turned().dot(on_d);
        self.with_centripetal([proximal, distal], pose, v)
    }

    /// Torques of the weight alone, N·m, plus the centripetal torques.
    #[inline(always)]
    pub(super) fn weight_torques(&self, pose: &Pose, v: &Angles) -> Angles {
        let weight_acceleration = &self.model().weight_acceleration;
        self.with_centripetal(weight_acceleration.torques([pose.u_p, pose.u_d]), pose, v)
    }

    /// Torques on the links plus the centripetal ones of the distal centre of mass, N·m.
    #[inline(always)]
    fn with_centripetal(&self, [on_p, on_d]: [Legs; 2], pose: &Pose, v: &Angles) -> Angles {
        let (w_p, w_d) = (legs_of(v, PROXIMAL), legs_of(v, DISTAL));
        let centripetal = self.inertia.centripetal(pose);
        let mut forces = Angles::ZERO;
        set_legs(&mut forces, PROXIMAL, on_p + centripetal * (w_d * w_d));
        set_legs(&mut forces, DISTAL, on_d - centripetal * (w_p * w_p));
        forces
    }

    /// Twelve coordinates and their rates.
    #[inline]
    pub fn coordinates(&self, pose: &Pose, q: &Angles, v: &Angles) -> (Coordinates, Coordinates) {
        (self.positions(q, pose), self.velocity_map(v, pose))
    }

    #[inline]
    pub(super) fn positions(&self, q: &Angles, pose: &Pose) -> Coordinates {
        let elbow = Legs2 { x: self.mechanism.ground_x + pose.a_p.x + pose.b_p.x, y: pose.a_p.y + pose.b_p.y };
        let mut x = in_place(q);
        set_legs(&mut x, P_X, self.mechanism.ground_x + pose.a_p.x);
        set_legs(&mut x, P_Y, pose.a_p.y);
        set_legs(&mut x, D_X, elbow.x + pose.a_d.x);
        set_legs(&mut x, D_Y, elbow.y + pose.a_d.y);
        x
    }

    /// Generalised force of the twelve coordinates mapped to the angles, N·m.
    #[cold]
    pub(in crate::simulation) fn mapped_force(&self, pose: &Pose, force: &Coordinates) -> Angles {
        Angles::from_fn(|i| force.dot(&self.velocity_map(&Angles::unit(i), pose)))
    }

    /// Velocity-product part of the accelerations of the twelve coordinates, m/s².
    pub(in crate::simulation) fn velocity_product(&self, pose: &Pose, v: &Angles) -> Coordinates {
        let (w_p, w_d) = (legs_of(v, PROXIMAL), legs_of(v, DISTAL));
        let (p, l, d) = (pose.a_p, proximal_arm(pose), pose.a_d);
        let mut x = Coordinates::ZERO;
        set_legs(&mut x, P_X, -p.x * w_p * w_p);
        set_legs(&mut x, P_Y, -p.y * w_p * w_p);
        set_legs(&mut x, D_X, -l.x * w_p * w_p - d.x * w_d * w_d);
        set_legs(&mut x, D_Y, -l.y * w_p * w_p - d.y * w_d * w_d);
        x
    }

    #[inline]
    pub(super) fn velocity_map(&self, v: &Angles, pose: &Pose) -> Coordinates {
        let (w_p, w_d) = (legs_of(v, PROXIMAL), legs_of(v, DISTAL));
        let (n_p, n_l, n_d) = (pose.a_p.turned(), proximal_arm(pose).turned(), pose.a_d.turned());
        let mut x = in_place(v);
        set_legs(&mut x, P_X, n_p.x * w_p);
        set_legs(&mut x, P_Y, n_p.y * w_p);
        set_legs(&mut x, D_X, n_l.x * w_p + n_d.x * w_d);
        set_legs(&mut x, D_Y, n_l.y * w_p + n_d.y * w_d);
        x
    }
}
