//! Loads of a machine in its link angles: torques of weight and wrench on the links, energies.

use super::{AngleSystem, Angles, legs};
use crate::effects::Motion;
use crate::integrator::{System, Work};
use crate::mechanism::legs::Legs2;
use crate::mechanism::{Coordinates, Pose};

impl AngleSystem<'_> {
    /// Kinetic energy, J, potential energy with that of the held loads, J, and power of the forces that have no potential, W.
    pub(in crate::simulation) fn energies(&self, q: &Angles, v: &Angles) -> [f64; 3] {
        let pose = self.pose(q);
        let kinetic = self.mass_times(&pose, v).dot(v) / 2.0;
        let x = self.mechanism.coordinates(&pose, legs(q));
        [kinetic, self.five_bar.potential_energy(&x, &pose), self.five_bar.power_without_potential(&self.motion(&pose, q, v))]
    }

    /// Forces in the angles, and their power, where anything acts but the weight. Out of line, and it takes copies: what is pointed to has
    /// to be in memory, and where nothing acts but the weight it stays in registers. Of a pose the directions are enough.
    #[inline(never)]
    pub(super) fn loaded_torques_and_power(&self, q: Angles, directions: [Legs2; 2], v: Angles) -> (Angles, Work) {
        let pose = self.mechanism.pose_along(directions);
        let (torques, power) = self.five_bar.torques_and_power(&pose, &self.motion(&pose, &q, &v));
        let forces = self.inertia.with_centripetal(torques, &pose, &v);
        (forces, if self.features().work { power } else { Work::default() })
    }

    /// Motion of joints and tip.
    pub(in crate::simulation) fn motion(&self, pose: &Pose, q: &Angles, v: &Angles) -> Motion<'_> {
        self.five_bar.conditions().motion_of_links(self.mechanism, [legs(q), legs(v)], pose)
    }

    /// The twelve coordinates and their velocities.
    pub fn coordinates(&self, pose: &Pose, q: &Angles, v: &Angles) -> (Coordinates, Coordinates) {
        (self.mechanism.coordinates(pose, legs(q)), pose.velocities(legs(v)))
    }
}
