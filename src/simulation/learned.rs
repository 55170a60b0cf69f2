//! A scene whose masses, friction, lengths and encoder biases are learned: its parameters with the learned values, and the derivatives of
//! the accelerations.

use nalgebra::{Matrix4, Matrix4x2, SMatrix};

use super::linearised::by_torques;
use super::{FollowedScene, Inputs, Parameters};
use crate::dynamics::angles::{Inertia, Weight, angles, in_link_order};
use crate::effects::friction::Friction;
use crate::effects::payload::CARRIER;
use crate::effects::{ForceLaw, JOINT_LINKS, JOINTS};
use crate::estimator::error_state::{DRY, LENGTHS, LOADS, Learned, MASSES, OFFSETS, PAYLOAD, VISCOUS};
use crate::estimator::{LinkState, Links, MEASURED, Prior, Scene, set_lengths};
use crate::mechanism::placement::by_legs;
use crate::mechanism::{ClosureBranch, Link, Mechanism};

/// Length step of the differences, m: with links of 0.1 m, round-off adds a relative error of 1e-8 to the derivatives.
const LONGER: f64 = 1e-8;
/// Limits, in standard deviations of a length, within which lengths are not learned: the length difference of a pair of links, and the base
/// distance. The limits come from 72 falls of exact machines with coaxial motors (1 s, 16 bits, links of 0.12 to 0.3 m, σ = 0.2 mm of
/// each length). If lengths are not learned, the tip stays within 2 mm in all 72 falls; if they are, in only 17. If they are learned and
/// pairs differ by up to 0.4 mm, it does so in 59 falls, by up to 1 mm in 66; with a base of 0.5, 1, 2 and 100 mm in 57, 66, 69 and 70.
pub(crate) const NEARLY_IN_PAIRS: [f64; 2] = [3.0, 10.0];

impl Parameters {
    /// Prior mean and standard deviation of each learned parameter; `None` if nothing is learned. Parameters of absent effects have σ = 0.
    pub(super) fn prior(&self) -> Option<Prior> {
        let Self { estimator, effects, geometry, .. } = self;
        estimator.learn_enabled.then(|| {
            let has = |enabled: bool, sigma: f64| if enabled { sigma } else { 0.0 };
            let sigma = Learned::from_fn(|i, _| match i {
                PAYLOAD => has(effects.payload.enabled, estimator.learn_payload),
                DRY => has(effects.friction.enabled, estimator.learn_friction),
                _ if VISCOUS.contains(&i) => has(effects.viscous.enabled, estimator.learn_viscous),
                // Coaxial motors have no base.
                _ if i == LENGTHS.end - 1 => has(self.learns_lengths() && geometry.base_distance > 0.0, estimator.sigma0_length),
                _ if LENGTHS.contains(&i) => has(self.learns_lengths(), estimator.sigma0_length),
                _ if OFFSETS.contains(&i) => estimator.sigma0_offset,
                _ => estimator.learn_mass,
            });
            Prior { values: self.known(), sigma }
        })
    }

    /// Whether lengths are learned. They are not if the closure would split into branches for lengths within their uncertainty: other
    /// lengths then send a motion through the posture in line another way, and samples do not show it before.
    pub fn learns_lengths(&self) -> bool {
        let Self { estimator, geometry, .. } = self;
        let sigma = estimator.sigma0_length;
        estimator.learn_enabled
            && sigma > 0.0
            && !ClosureBranch::any_is_nearly_of(geometry, NEARLY_IN_PAIRS.map(|times| times * sigma))
    }

    /// Values of all parameters that may be learned, from the scene's parameters.
    pub(super) fn known(&self) -> Learned {
        let Self { effects, .. } = self;
        Learned::from_fn(|i, _| match i {
            PAYLOAD if effects.payload.enabled => effects.payload.mass,
            _ if effects.viscous.enabled && VISCOUS.contains(&i) => effects.viscous.b[i - VISCOUS.start],
            _ => 0.0,
        })
    }

    /// Sets the learned values on top of the `configured` parameters of the same scene.
    pub(super) fn learn(&mut self, configured: &Self, learned: &Learned) {
        self.geometry = configured.geometry;
        for (link, factor) in self.geometry.links.iter_mut().zip(learned.iter()) {
            let factor = libm::exp(*factor);
            (link.mass, link.inertia) = (link.mass * factor, link.inertia * factor);
        }
        set_lengths(&mut self.geometry, |i, length| length + learned[LENGTHS.start + i]);
        let effects = &mut self.effects;
        effects.payload.mass = learned[PAYLOAD];
        effects.viscous.b = std::array::from_fn(|joint| learned[VISCOUS.start + joint]);
        let factor = libm::exp(learned[DRY]);
        effects.friction.coulomb = configured.effects.friction.coulomb.map(|torque| torque * factor);
        effects.friction.breakaway = configured.effects.friction.breakaway.map(|torque| torque * factor);
    }
}

/// Perturbed machines: each differs from the machine of a scene by one learned parameter.
#[derive(Clone, Debug)]
pub struct Perturbed<'a> {
    /// Parameters of the scene.
    parameters: &'a Parameters,
    /// Bodies with learned masses; all other masses are zero in each.
    bodies: [(Inertia, Weight); 3],
    /// Whether lengths are learned.
    lengths: bool,
    /// Friction by the `friction.*` variables, also in a scene without it, because the machine may have some. `None` if they are not valid.
    friction: Option<Friction>,
}

impl<'a> Perturbed<'a> {
    /// Perturbations of the machine of a scene; `lengths` says whether lengths are learned.
    pub(super) fn new(parameters: &'a Parameters, lengths: bool) -> Self {
        let friction = Friction::new(&parameters.effects.friction, &Mechanism::new(&parameters.geometry)).ok();
        Self { parameters, bodies: Self::bodies(parameters), lengths, friction }
    }

    /// Proximal links, distal links, and a payload of 1 kg.
    fn bodies(parameters: &Parameters) -> [(Inertia, Weight); 3] {
        let of = |link: fn(usize, &Link) -> Link| {
            let mut alone = parameters.geometry;
            for (i, own) in alone.links.iter_mut().enumerate() {
                *own = link(i, own);
            }
            let mechanism = Mechanism::new(&alone);
            (Inertia::new(&mechanism), Weight::new(&mechanism, &parameters.effects.weight(&mechanism)))
        };
        [
            of(|i, link| if MEASURED.contains(&i) { *link } else { Link { mass: 0.0, inertia: 0.0, ..*link } }),
            of(|i, link| if MEASURED.contains(&i) { Link { mass: 0.0, inertia: 0.0, ..*link } } else { *link }),
            of(|i, link| Link { mass: if i == CARRIER { 1.0 } else { 0.0 }, inertia: 0.0, com: link.length, ..*link }),
        ]
    }
}

impl FollowedScene<'_> {
    /// ∂α/∂length at acceleration `alpha`, by differences to machines with one link longer by [`LONGER`]; `None` if lengths are known. The
    /// base distance has no column: it changes only the angles that close the loop.
    pub(super) fn by_lengths(&self, at: &LinkState, force: &Links, alpha: &Links) -> Option<Matrix4<f64>> {
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

    /// ∂α/∂load at acceleration `alpha`, for the loads that may be learned: the equations are solved for the torques that each load adds,
    /// minus the inertial torques of its masses.
    pub(super) fn by_loads(&self, at: &LinkState, force: &Links, alpha: &Links) -> SMatrix<f64, 4, LOADS> {
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

    /// ∂α/∂bias for the encoders: minus the derivatives with respect to the servo references.
    pub(super) fn by_offsets(&self, at: &LinkState, force: &Links) -> Matrix4x2<f64> {
        self.at(at, force, |_, equations, _, motion| {
            let torques = [[-1.0, 0.0], [0.0, -1.0]].map(|servo_theta| {
                let change = Inputs { servo_theta, ..Inputs::default() };
                let by_effects =
                    self.model.effects.iter().map(|effect| on_links(effect.torques_by_inputs(&motion.joints, &change)));
                by_effects.map(Links::from).sum()
            });
            by_torques(equations, &Matrix4x2::from_columns(&torques))
        })
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
    use nalgebra::Matrix4x2;

    use super::*;
    use crate::estimator::Linkage;
    use crate::estimator::error_state::LEARNED;
    use crate::estimator::flow::{flow, motion};
    use crate::simulation::Model;
    use crate::simulation::bindings::{default_inputs, default_parameters};
    use crate::simulation::linearised::by_true_angles;

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
        let here = FollowedScene { model: &model, inputs: &inputs, before: &inputs, turns: &[0; 4], learned: Some(&perturbed) };
        let alpha = here.linearised(&at, &none, &Matrix4x2::zeros()).alpha;
        let loads = Scene::by_loads(&here, &at, &none, &alpha);
        let lengths = Scene::by_lengths(&here, &at, &none, &alpha).expect("lengths are learned");
        let offsets = Scene::by_offsets(&here, &at, &none).expect("servos");
        let (h, least, frame) = (2e-3, 4, linkage.frame(&at.theta));
        let moved = flow::<LEARNED>(&linkage, &here, (&at, &frame), &none, (h, least));
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
                let scene = FollowedScene { model: &model, inputs: &inputs, before: &inputs, turns: &[0; 4], learned: None };
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
