//! A scene as the estimator sees it: torques of the loads on the links, with their tangents in the link angles.

use super::five_bar::FiveBar;
use crate::dynamics::placement::{ByLink, by_legs, by_links};
use crate::effects::Motion;
use crate::estimator::{Links, Loads, Scene};
use crate::integrator::{System, Work};
use crate::mechanism::Pose;

impl FiveBar<'_> {
    /// Pose and motion at link angles, rad, and rates, rad/s.
    fn at_links(&self, theta: &Links, omega: &Links) -> (Pose, Motion<'_>) {
        let (mechanism, angles) = (&self.model.mechanism, by_legs(*theta));
        let pose = mechanism.pose_at(angles);
        (pose, self.conditions().motion_of_links(mechanism, [angles, by_legs(*omega)], &pose))
    }

    /// Torques of wrench and weight on the links, N·m, by legs, and the power of the wrench, W.
    #[inline(always)]
    pub(super) fn torques_and_power(&self, pose: &Pose, at: &Motion) -> (ByLink, Work) {
        let (wrench, power) = self.acting(at);
        let ([on_p, on_d], [weight_p, weight_d]) = (wrench.torques_in_angles(pose), self.model.weight_torques.torques(pose));
        ([on_p + weight_p, on_d + weight_d], power)
    }

    /// Stiffness, N·m/rad, and damping, N·m·s/rad, of links 1 to 4 by wrench and weight, at link rates, rad/s.
    pub(super) fn slopes_of_torques(&self, pose: &Pose, at: Motion, rates: Links) -> [[Links; 4]; 2] {
        let [mut stiffness, damping] = self.slopes(at).torques_in_angles(pose, rates);
        for (i, weight) in by_links(self.model.weight_torques.stiffness(pose)).into_iter().enumerate() {
            stiffness[i][i] += weight;
        }
        [stiffness, damping]
    }
}

impl Scene for FiveBar<'_> {
    #[inline(never)]
    fn loads(&self, theta: &Links, omega: &Links) -> Loads {
        let (pose, at) = self.at_links(theta, omega);
        let [stiffness, damping] = self.slopes_of_torques(&pose, at, *omega);
        Loads { torque: by_links(self.torques_and_power(&pose, &at).0), stiffness, damping }
    }

    #[inline(never)]
    fn torque(&self, theta: &Links, omega: &Links) -> Links {
        let (pose, at) = self.at_links(theta, omega);
        by_links(self.torques_and_power(&pose, &at).0)
    }

    fn has_stiff_forces(&self) -> bool {
        System::has_stiff_forces(self)
    }
}
