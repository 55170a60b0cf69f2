//! A scene as the estimator uses it: equations of motion in the link angles and their derivatives, under loads, weight and an unknown
//! force.

use nalgebra::{Matrix4, Matrix4x2, SMatrix};

use super::Inputs;
use super::five_bar::FiveBar;
use super::learned::Perturbed;
use super::model::Model;
use crate::dynamics::angles::{Angles, Closure, Equations, LINK_INDICES, angles, in_link_order};
use crate::effects::Motion;
use crate::estimator::error_state::{LOADS, Learned, OFFSETS};
use crate::estimator::{Linearised, LinkState, Links, Scene};
use crate::integrator::Work;
use crate::mechanism::Pose;
use crate::mechanism::placement::{ByLink, by_legs, by_links};

impl FiveBar<'_> {
    /// Torques of the wrench and the weight on the links, N·m, by legs, and the power of the wrench, W.
    pub(super) fn torques_and_power(&self, pose: &Pose, at: &Motion) -> (ByLink, Work) {
        let (wrench, power) = self.acting(at);
        let ([on_p, on_d], [weight_p, weight_d]) = (wrench.torques_in_angles(pose), self.model.weight_torques.torques(pose));
        ([on_p + weight_p, on_d + weight_d], power)
    }

    /// Stiffness, N·m/rad, and damping, N·m·s/rad, of links 1 to 4 due to wrench and weight, at link rates, rad/s.
    pub(super) fn slopes_of_torques(&self, pose: &Pose, at: Motion, rates: [f64; 4]) -> [[[f64; 4]; 4]; 2] {
        let [mut stiffness, damping] = self.slopes(at).torques_in_angles(pose, rates);
        for (i, weight) in by_links(self.model.weight_torques.stiffness(pose)).into_iter().enumerate() {
            stiffness[i][i] += weight;
        }
        [stiffness, damping]
    }
}

/// Inputs with servo references as true angles: servos close their loop on the encoders, so the learned encoder biases are subtracted.
pub(super) fn by_true_angles(model: &Model, inputs: &Inputs, learned: Option<&Learned>) -> Inputs {
    let mut inputs = *inputs;
    if let Some(learned) = learned.filter(|_| model.has_servo) {
        inputs.servo_theta = [0, 1].map(|i| inputs.servo_theta[i] - learned[OFFSETS.start + i]);
    }
    inputs
}

/// Inputs plus an unknown force: torques, N·m, and tip forces, N.
pub(super) fn with_unknown_force(inputs: &Inputs, force: &Links) -> Inputs {
    let [left, right, x, y] = (*force).into();
    Inputs {
        tau: [inputs.tau[0] + left, inputs.tau[1] + right],
        tip_force: [inputs.tip_force[0] + x, inputs.tip_force[1] + y],
        ..*inputs
    }
}

/// A model under constant inputs; unknown forces are added to them.
#[derive(Clone, Copy, Debug)]
pub struct FollowedScene<'a> {
    /// Model with its effects.
    pub model: &'a Model,
    /// Inputs without the unknown force; their servo references are true angles.
    pub inputs: &'a Inputs,
    /// Inputs of the step before.
    pub before: &'a Inputs,
    /// Whole turns of links 1 to 4 that the angles omit.
    pub turns: &'a [i64; 4],
    /// Machines that differ by one learned parameter, if anything is learned.
    pub learned: Option<&'a Perturbed<'a>>,
}

impl FollowedScene<'_> {
    /// Calls `answer` with the equations of motion at a state and the loads that act there.
    pub(super) fn at<T>(
        &self,
        at: &LinkState,
        force: &Links,
        answer: impl FnOnce(&FiveBar<'_>, &Equations<'_>, &Pose, Motion<'_>) -> T,
    ) -> T {
        let (model, inputs) = (self.model, with_unknown_force(self.inputs, force));
        let five_bar = FiveBar::new(model, &inputs, self.turns);
        let (turned, rates) = (by_legs(at.theta.into()), by_legs(at.omega.into()));
        let pose = model.mechanism.pose_at(turned);
        let motion = five_bar.conditions().motion_of_links(&model.mechanism, [turned, rates], &pose);
        let (closure, rates) = (Closure::new(&model.mechanism, None), angles(rates));
        let equations = Equations::<false>::new((&model.inertia, &closure), &pose, &rates, model.regularization_by_angles);
        answer(&five_bar, &equations, &pose, motion)
    }
}

/// Matrix over links 1 to 4 from its columns.
fn columns(of: &[Angles; 4]) -> Matrix4<f64> {
    Matrix4::from_columns(&LINK_INDICES.map(|i| links(&of[i])))
}

/// Accelerations of links 1 to 4 due to torques on them, N·m, by columns.
pub(super) fn by_torques<const C: usize>(equations: &Equations<'_>, torques: &SMatrix<f64, 4, C>) -> SMatrix<f64, 4, C> {
    let solved = |k: usize| links(&equations.by_torques(&angles(by_legs(torques.column(k).into_owned().into()))));
    SMatrix::from_columns(&std::array::from_fn::<_, C, _>(solved))
}

/// Values of links 1 to 4.
fn links(x: &Angles) -> Links {
    in_link_order(x).into()
}

impl Scene for FollowedScene<'_> {
    #[inline(never)]
    fn acceleration(&self, at: &LinkState, force: &Links) -> Links {
        self.at(at, force, |five_bar, equations, pose, motion| {
            links(&equations.solve(five_bar.torques_and_power(pose, &motion).0).0)
        })
    }

    #[inline(never)]
    fn linearised(&self, at: &LinkState, force: &Links, torques: &Matrix4x2<f64>) -> Linearised {
        self.at(at, force, |five_bar, equations, pose, motion| {
            let (alpha, lambda) = equations.solve(five_bar.torques_and_power(pose, &motion).0);
            let near = equations.linearised((&alpha, &lambda), five_bar.slopes_of_torques(pose, motion, at.omega.into()));
            let [by_angle, by_rate] = near.columns();
            Linearised {
                alpha: links(&alpha),
                by_angle: columns(&by_angle),
                by_rate: columns(&by_rate),
                by_torque: by_torques(equations, torques),
            }
        })
    }

    #[inline(never)]
    fn by_delay(&self, at: &LinkState, force: &Links, h: f64) -> Links {
        let earlier = FollowedScene { inputs: self.before, ..*self };
        (earlier.acceleration(at, force) - self.acceleration(at, force)) / h
    }

    fn by_loads(&self, at: &LinkState, force: &Links, alpha: &Links) -> SMatrix<f64, 4, LOADS> {
        FollowedScene::by_loads(self, at, force, alpha)
    }

    #[inline(never)]
    fn by_lengths(&self, at: &LinkState, force: &Links, alpha: &Links) -> Option<Matrix4<f64>> {
        FollowedScene::by_lengths(self, at, force, alpha)
    }

    #[inline(never)]
    fn by_offsets(&self, at: &LinkState, force: &Links) -> Option<Matrix4x2<f64>> {
        self.model.has_servo.then(|| FollowedScene::by_offsets(self, at, force))
    }

    fn mass(&self, theta: &Links) -> Matrix4<f64> {
        let pose = self.model.mechanism.pose_at(by_legs((*theta).into()));
        columns(&std::array::from_fn(|i| self.model.inertia.mass_times(&pose, &Angles::unit(i))))
    }

    fn has_stiff_forces(&self) -> bool {
        self.model.features.stiff
    }

    fn has_abrupt_forces(&self) -> bool {
        self.model.features.sharp || self.model.has_kinks
    }
}
