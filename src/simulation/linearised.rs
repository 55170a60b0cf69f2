//! A scene as the estimator uses it: equations of motion in the link angles and their derivatives, under loads, weight and an unknown
//! force.

use nalgebra::{Matrix4, Matrix4x2, SMatrix};

use super::five_bar::FiveBar;
use super::learned::Perturbed;
use super::model::Model;
use super::{Inputs, Parameters};
use crate::dynamics::angles::{Angles, Closure, Equations, LINK_INDICES, angles, in_link_order};
use crate::effects::{ForceLaw, JOINT_LINKS, JOINTS, Motion};
use crate::estimator::error_state::{DRY, LOADS, Learned, MASSES, OFFSETS, PAYLOAD, VISCOUS};
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

/// Length step of the differences, m: with links of 0.1 m, round-off adds a relative error of 1e-8 to the derivatives.
const LONGER: f64 = 1e-8;

/// A model under constant inputs; unknown forces are added to the inputs.
#[derive(Clone, Copy, Debug)]
pub struct FollowedScene<'a> {
    /// Model with its effects.
    pub model: &'a Model,
    /// Inputs without the unknown force; their servo references are true angles.
    pub inputs: Inputs,
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
        let (model, inputs) = (self.model, with_unknown_force(&self.inputs, force));
        let five_bar = FiveBar::new(model, &inputs, self.turns);
        let (turned, rates) = (by_legs(at.theta.into()), by_legs(at.omega.into()));
        let pose = model.mechanism.pose_at(turned);
        let motion = five_bar.conditions().motion_of_links(&model.mechanism, [turned, rates], &pose);
        let (closure, rates) = (Closure::new(&model.mechanism, None), angles(rates));
        let equations = Equations::<false>::new(&model.inertia, &closure, &pose, &rates, model.regularization_by_angles);
        answer(&five_bar, &equations, &pose, motion)
    }
}

/// Matrix over links 1 to 4 from its columns.
fn columns(of: &[Angles; 4]) -> Matrix4<f64> {
    Matrix4::from_columns(&LINK_INDICES.map(|i| links(&of[i])))
}

/// Accelerations of links 1 to 4 due to torques on them, N·m, by columns.
fn by_torques<const C: usize>(equations: &Equations<'_>, torques: &SMatrix<f64, 4, C>) -> SMatrix<f64, 4, C> {
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
            let near = equations.linearised(&alpha, &lambda, five_bar.slopes_of_torques(pose, motion, at.omega.into()));
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
        let earlier = FollowedScene { inputs: *self.before, ..*self };
        (earlier.acceleration(at, force) - self.acceleration(at, force)) / h
    }

    fn by_loads(&self, at: &LinkState, force: &Links, alpha: &Links) -> SMatrix<f64, 4, LOADS> {
        // The equations are solved for the torques that each load adds, minus the inertial torques of its masses.
        let Some(Perturbed { bodies, friction, .. }) = self.learned else { return SMatrix::zeros() };
        self.at(at, force, |_, equations, pose, motion| {
            let (alpha, rates) = (angles(by_legs((*alpha).into())), angles(by_legs(at.omega.into())));
            let missing = bodies.each_ref().map(|(inertia, weight)| {
                let held = inertia.with_centripetal(weight.torques(pose), pose, &rates);
                in_link_order(&(held - inertia.mass_times(pose, &alpha)))
            });
            let [proximal, distal, payload] = missing;
            let mut added = SMatrix::<f64, 4, LOADS>::zeros();
            let mut set = |i: usize, torques: [f64; 4]| added.set_column(i, &torques.into());
            set(MASSES.start, [proximal[0], 0.0, 0.0, 0.0]);
            set(MASSES.start + 1, [distal[0], distal[1], 0.0, 0.0]);
            set(MASSES.start + 2, [0.0, 0.0, distal[2], distal[3]]);
            set(MASSES.start + 3, [0.0, 0.0, 0.0, proximal[3]]);
            set(PAYLOAD, [payload[0], payload[1], 0.0, 0.0]);
            for (joint, rate) in motion.joints.rates.into_iter().enumerate() {
                let mut torques = [0.0; JOINTS];
                torques[joint] = -rate;
                set(VISCOUS.start + joint, on_links(torques));
            }
            if let Some(friction) = friction {
                set(DRY, on_links(friction.torques(&motion.joints)));
            }
            by_torques(equations, &added)
        })
    }

    /// By differences to machines with one link longer by `LONGER`. The base distance has no column: it changes only the angles that close
    /// the loop.
    #[inline(never)]
    fn by_lengths(&self, at: &LinkState, force: &Links, alpha: &Links) -> Option<Matrix4<f64>> {
        let Perturbed { parameters: Parameters { geometry, effects, .. }, lengths, .. } = self.learned?;
        lengths.then(|| {
            let mut longer = self.model.clone();
            Matrix4::from_columns(&[0, 1, 2, 3].map(|i| {
                let mut geometry = *geometry;
                geometry.links[i].length += LONGER;
                longer.lengthen(&effects.with_added_masses(&geometry));
                (FollowedScene { model: &longer, ..*self }.acceleration(at, force) - alpha) / LONGER
            }))
        })
    }

    /// Minus the derivatives with respect to the servo references.
    #[inline(never)]
    fn by_offsets(&self, at: &LinkState, force: &Links) -> Option<Matrix4x2<f64>> {
        self.model.has_servo.then(|| {
            self.at(at, force, |_, equations, _, motion| {
                let torques = [[-1.0, 0.0], [0.0, -1.0]].map(|servo_theta| {
                    let change = Inputs { servo_theta, ..Inputs::default() };
                    let by_effects =
                        self.model.effects.iter().map(|effect| on_links(effect.torques_by_inputs(&motion.joints, &change)));
                    by_effects.map(Links::from).sum()
                });
                by_torques(equations, &Matrix4x2::from_columns(&torques))
            })
        })
    }

    fn command_delay(&self) -> f64 {
        self.model.command_delay
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

/// Torques on links 1 to 4 from joint torques, N·m.
fn on_links(torques: [f64; JOINTS]) -> [f64; 4] {
    let mut on_links = [0.0; 4];
    for (torque, (first, second)) in torques.into_iter().zip(JOINT_LINKS) {
        on_links[first] += torque;
        if let Some(second) = second {
            on_links[second] -= torque;
        }
    }
    on_links
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimator::error_state::{LEARNED, LENGTHS};
    use crate::estimator::flow::{flow, motion};
    use crate::estimator::{Linkage, MEASURED};
    use crate::simulation::Model;
    use crate::simulation::bindings::{default_inputs, default_parameters};

    /// A scene with every effect that is learned, all links unequal, in a loaded motion.
    fn scene() -> (Parameters, Inputs, LinkState) {
        let mut parameters = default_parameters();
        parameters.geometry.base_distance = 0.1;
        for (i, link) in parameters.geometry.links.iter_mut().enumerate() {
            link.mass *= 1.0 + 0.1 * i as f64;
            link.com *= 1.0 - 0.1 * i as f64;
        }
        parameters.estimator.learn_enabled = true;
        let effects = &mut parameters.effects;
        (effects.gravity.enabled, effects.payload.enabled, effects.viscous.enabled, effects.friction.enabled) =
            (true, true, true, true);
        (effects.servo.enabled, effects.servo.kp, effects.servo.kd) = (true, [0.4, 0.5], [4e-3, 5e-3]);
        effects.viscous.b = [1e-3, 2e-3, 3e-3, 2e-3, 1e-3];
        effects.friction.breakaway_velocity = 1.0;
        let inputs = Inputs { tau: [0.02, -0.01], tip_force: [0.3, -0.2], servo_theta: [2.3, 1.0], ..default_inputs() };
        parameters.start.theta = [2.2, 0.9];
        parameters.start.omega = [2.0, -3.0];
        let simulation = crate::simulation::Simulation::new(&parameters, &inputs).expect("a scene");
        let at = simulation.run().motion(simulation.model());
        (parameters, inputs, at)
    }

    /// Derivatives with respect to learned parameters are differences: for accelerations and motions over a step; for lengths also for
    /// readings and the tip.
    #[test]
    fn derivatives_by_what_is_learned_are_differences() {
        let (parameters, inputs, at) = scene();
        let known = parameters.known();
        let made = |learned: &Learned| {
            let mut machine = parameters.clone();
            machine.learn(&parameters, learned);
            (Model::new(&machine).expect("a scene"), Linkage::new(&machine.geometry))
        };
        let (perturbed, (model, linkage), none) = (Perturbed::new(&parameters, true), made(&known), Links::zeros());
        let here = FollowedScene { model: &model, inputs, before: &inputs, turns: &[0; 4], learned: Some(&perturbed) };
        let alpha = here.linearised(&at, &none, &Matrix4x2::zeros()).alpha;
        let loads = Scene::by_loads(&here, &at, &none, &alpha);
        let lengths = Scene::by_lengths(&here, &at, &none, &alpha).expect("lengths are learned");
        let offsets = Scene::by_offsets(&here, &at, &none).expect("servos");
        let (h, least, frame) = (2e-3, 4, linkage.frame(&at.theta));
        let moved = flow::<LEARNED>(&linkage, &here, &at, &frame, &none, h, least);
        let links = frame.links_by_geometry();
        let (readings, tip) = (frame.readings_by_geometry(), frame.tip_by_geometry());
        for i in 0..LEARNED {
            let is_length = LENGTHS.contains(&i);
            let step = if i == PAYLOAD || VISCOUS.contains(&i) || is_length { 1e-6 } else { 1e-5 };
            let [ahead, behind] = [step, -step].map(|by| {
                let mut learned = known;
                learned[i] += by;
                let (model, linkage) = made(&learned);
                let inputs = by_true_angles(&model, &inputs, Some(&learned));
                let scene = FollowedScene { model: &model, inputs, before: &inputs, turns: &[0; 4], learned: None };
                let from = linkage.closed(at).expect("a closed loop").0;
                let end = motion(&scene, &from, &none, h, moved.steps);
                (scene.acceleration(&at, &none), end, from, linkage.tip(&from.theta))
            });
            // Derivatives with respect to loads are taken in the middle of a step, with respect to lengths at its beginning.
            let tolerance = if is_length { 1e-3 } else { 1e-4 };
            let close = |got: Links, ahead: Links, behind: Links, (size, tolerance): (f64, f64)| {
                let off = (got - (ahead - behind) / (2.0 * step)).amax();
                assert!(off <= tolerance * size, "{i}: {off:e} of {size:e}");
            };
            let is_base = i == LENGTHS.end - 1;
            let exact: Links = match i {
                _ if is_base => Links::zeros(),
                _ if is_length => lengths.column(i - LENGTHS.start).into(),
                _ if OFFSETS.contains(&i) => offsets.column(i - OFFSETS.start).into(),
                _ => loads.column(i).into(),
            };
            let size = exact.amax();
            assert!(size > 0.0 || is_base);
            // Round-off of the difference, and step² times a third derivative.
            close(exact, ahead.0, behind.0, (size, 1e-5));
            let [by_angle, by_rate] = moved.by_learned.map(|by| Links::from(by.column(i)));
            let size = by_rate.amax();
            close(by_angle, ahead.1.theta, behind.1.theta, (size, tolerance));
            close(by_rate, ahead.1.omega, behind.1.omega, (size, tolerance));
            if is_length {
                let k = i - LOADS;
                close(links.column(k).into(), ahead.2.theta, behind.2.theta, (10.0, 1e-6));
                let off = tip.column(k) - (ahead.3 - behind.3) / (2.0 * step);
                assert!(off.amax() < 1e-6, "{off}");
                for (row, link) in readings.iter().zip(MEASURED) {
                    assert_eq!(row[k], links[(link, k)]);
                }
            }
        }
        for (row, own) in readings.iter().zip([0, 1]) {
            assert!(OFFSETS.enumerate().all(|(k, i)| row[i - LOADS] == f64::from(u8::from(k == own))));
        }
    }

    /// Lengths are not learned if any two pairs of links have nearly equal lengths and the motors are nearly coaxial; masses and biases
    /// still are.
    #[test]
    fn lengths_nearly_in_pairs_are_not_learned() {
        let (scene, ..) = scene();
        let sigma = scene.estimator.sigma0_length;
        let learns = |pattern: [f64; 4], [pair, base]: [f64; 2]| {
            let mut parameters = scene.clone();
            parameters.geometry.base_distance = base * sigma;
            parameters.geometry.links.iter_mut().zip(pattern).for_each(|(link, length)| link.length = length);
            parameters.geometry.links[3].length += pair * sigma;
            let learned = parameters.prior().expect("it learns").sigma.map(|sigma| sigma > 0.0);
            let (links, learns) = (LENGTHS.start..LENGTHS.end - 1, parameters.learns_lengths());
            assert!(links.clone().all(|i| learned[i] == learns) && (0..LENGTHS.start).chain(OFFSETS).all(|i| learned[i]));
            assert_eq!(learned[links.end], learns && base > 0.0);
            learns
        };
        for pattern in [[0.25, 0.2, 0.2, 0.25], [0.25, 0.2, 0.25, 0.2], [0.2, 0.2, 0.25, 0.25], [0.2; 4]] {
            for (off, expected) in
                [([0.0, 0.0], false), ([2.9, 0.0], false), ([-2.9, 9.9], false), ([3.1, 0.0], true), ([0.0, 10.1], true)]
            {
                assert_eq!(learns(pattern, off), expected, "{pattern:?}, {off:?}");
            }
        }
        assert!(learns([0.25, 0.2, 0.21, 0.25], [0.0; 2]));
    }

    /// A scene of exact geometry, without payload and friction, learns only its masses.
    #[test]
    fn absent_effects_are_not_learned() {
        let (mut parameters, ..) = scene();
        assert!(parameters.prior().expect("it learns").sigma.iter().all(|sigma| *sigma > 0.0));
        parameters.estimator.take_geometry_as_exact();
        parameters.effects.payload.enabled = false;
        parameters.effects.viscous.enabled = false;
        parameters.effects.friction.enabled = false;
        let sigma = parameters.prior().expect("it learns").sigma;
        assert!(sigma.iter().enumerate().all(|(i, sigma)| (*sigma > 0.0) == MASSES.contains(&i)), "{sigma}");
        parameters.estimator.learn_enabled = false;
        assert!(parameters.prior().is_none());
    }
}
