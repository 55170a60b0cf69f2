//! A scene as the estimator sees it: torques of the loads on the links, with their tangents in the link angles.

use super::five_bar::FiveBar;
use crate::dynamics::placement::{by_legs, by_links};
use crate::effects::Motion;
use crate::estimator::{Links, Loads, Scene};
use crate::integrator::System;
use crate::mechanism::Pose;

impl FiveBar<'_> {
    /// Pose and motion at link angles, rad, and rates, rad/s.
    fn at_links(&self, theta: &Links, omega: &Links) -> (Pose, Motion<'_>) {
        let (mechanism, angles) = (&self.model.mechanism, by_legs(*theta));
        let pose = mechanism.pose_at(angles);
        (pose, self.conditions().motion_of_links(mechanism, [angles, by_legs(*omega)], &pose))
    }

    /// Torques of wrench and weight on the links, N·m.
    fn torques_on_links(&self, pose: &Pose, at: &Motion) -> Links {
        let ([on_p, on_d], [weight_p, weight_d]) = (self.acting(at).0.torques_in_angles(pose), pose.torques_of(&self.model.weight));
        by_links([on_p + weight_p, on_d + weight_d])
    }
}

impl Scene for FiveBar<'_> {
    #[inline(never)]
    fn loads(&self, theta: &Links, omega: &Links) -> Loads {
        let (pose, at) = self.at_links(theta, omega);
        let [mut stiffness, damping] = self.slopes(at).torques_in_angles(&pose, *omega);
        for (i, weight) in by_links(pose.stiffness_of(&self.model.weight)).into_iter().enumerate() {
            stiffness[i][i] += weight;
        }
        Loads { torque: self.torques_on_links(&pose, &at), stiffness, damping }
    }

    #[inline(never)]
    fn torque(&self, theta: &Links, omega: &Links) -> Links {
        let (pose, at) = self.at_links(theta, omega);
        self.torques_on_links(&pose, &at)
    }

    fn has_stiff_forces(&self) -> bool {
        System::has_stiff_forces(self)
    }
}
