//! A scene whose masses and friction an estimator learns: its parameters with what has been learned, and the torques of each.

use nalgebra::SMatrix;

use super::{FollowedScene, Parameters};
use crate::dynamics::angles::{Inertia, Weight, angles, in_link_order};
use crate::effects::payload::CARRIER;
use crate::effects::{Effect, ForceLaw, JOINT_LINKS, JOINTS};
use crate::estimator::Prior;
use crate::estimator::error_state::{DRY, LEARNED, Learned, MASSES, PAYLOAD, VISCOUS};
use crate::estimator::{LinkState, Links, MEASURED};
use crate::mechanism::placement::by_legs;
use crate::mechanism::{Link, Mechanism, SceneError};

impl Parameters {
    /// Values and standard deviations of what is learned, before any sample; `None` where nothing is. What a scene does not have is known.
    pub(super) fn prior(&self) -> Option<Prior> {
        let Self { estimator, effects, .. } = self;
        estimator.learn_enabled.then(|| {
            let has = |enabled: bool, sigma: f64| if enabled { sigma } else { 0.0 };
            let sigma = Learned::from_fn(|i, _| match i {
                PAYLOAD => has(effects.payload.enabled, estimator.learn_payload),
                DRY => has(effects.friction.enabled, estimator.learn_friction),
                _ if VISCOUS.contains(&i) => has(effects.viscous.enabled, estimator.learn_viscous),
                _ => estimator.learn_mass,
            });
            Prior { values: self.known(), sigma }
        })
    }

    /// Values of all that may be learned, as the parameters say.
    pub(super) fn known(&self) -> Learned {
        let Self { effects, .. } = self;
        Learned::from_fn(|i, _| match i {
            PAYLOAD if effects.payload.enabled => effects.payload.mass,
            _ if effects.viscous.enabled && VISCOUS.contains(&i) => effects.viscous.b[i - VISCOUS.start],
            _ => 0.0,
        })
    }

    /// The parameters with learned values.
    pub(super) fn with_learned(&self, learned: &Learned) -> Self {
        let mut parameters = self.clone();
        for (link, factor) in parameters.geometry.links.iter_mut().zip(learned.iter()) {
            let factor = libm::exp(*factor);
            (link.mass, link.inertia) = (link.mass * factor, link.inertia * factor);
        }
        let effects = &mut parameters.effects;
        effects.payload.mass = learned[PAYLOAD];
        effects.viscous.b = std::array::from_fn(|joint| learned[VISCOUS.start + joint]);
        let factor = libm::exp(learned[DRY]);
        for joint in 0..JOINTS {
            effects.friction.coulomb[joint] *= factor;
            effects.friction.breakaway[joint] *= factor;
        }
        parameters
    }
}

/// Bodies whose masses are learned, each as if alone.
#[derive(Clone, Copy, Debug)]
pub struct Bodies([(Inertia, Weight); 3]);

impl Bodies {
    /// Proximal links, distal links, and a payload of 1 kg.
    pub(super) fn new(parameters: &Parameters) -> Result<Self, SceneError> {
        let of = |link: fn(usize, &Link) -> Link| -> Result<(Inertia, Weight), SceneError> {
            let mut alone = parameters.geometry;
            for (i, own) in alone.links.iter_mut().enumerate() {
                *own = link(i, own);
            }
            let mechanism = Mechanism::arranged(&alone);
            Ok((Inertia::new(&mechanism), Weight::new(&mechanism, &parameters.effects.weight(&mechanism)?)))
        };
        Ok(Self([
            of(|i, link| if MEASURED.contains(&i) { *link } else { Link { mass: 0.0, inertia: 0.0, ..*link } })?,
            of(|i, link| if MEASURED.contains(&i) { Link { mass: 0.0, inertia: 0.0, ..*link } } else { *link })?,
            of(|i, link| Link { mass: if i == CARRIER { 1.0 } else { 0.0 }, inertia: 0.0, com: link.length, ..*link })?,
        ]))
    }
}

impl FollowedScene<'_> {
    /// Derivatives of the accelerations, which are `alpha`, by the learned parameters: the equations solved for the torques that each parameter
    /// adds, less what its masses need to move.
    pub(super) fn by_learned(&self, at: &LinkState, force: &Links, alpha: &Links) -> SMatrix<f64, 4, LEARNED> {
        let mut by_learned = SMatrix::zeros();
        let Some(Bodies(bodies)) = self.learned else { return by_learned };
        self.at(at, force, |five_bar, equations, pose, motion| {
            let (alpha, rates) = (angles(by_legs((*alpha).into())), angles(by_legs(at.omega.into())));
            let missing = bodies.each_ref().map(|(inertia, weight)| {
                let held = inertia.with_centripetal(weight.torques(pose), pose, &rates);
                in_link_order(&(held - inertia.mass_times(pose, &alpha)))
            });
            let [proximal, distal, payload] = missing;
            let mut set = |i: usize, torques: [f64; 4]| {
                let solved = equations.by_torques(&angles(by_legs(torques)));
                by_learned.set_column(i, &Links::from(in_link_order(&solved)));
            };
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
            for effect in &five_bar.model.effects {
                if let Effect::Friction(friction) = effect {
                    set(DRY, on_links(friction.torques(&motion.joints)));
                }
            }
        });
        by_learned
    }
}

/// Torques on links 1 to 4 by those in the joints, N·m.
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
    use nalgebra::{Matrix4x2, Vector4};

    use super::*;
    use crate::effects::Inputs;
    use crate::estimator::flow::{flow, motion};
    use crate::estimator::{Linkage, Scene};
    use crate::fmi::bindings::{default_inputs, default_parameters};
    use crate::simulation::Model;

    /// A scene with every effect that is learned, all links unequal and in a loaded motion.
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
        effects.viscous.b = [1e-3, 2e-3, 3e-3, 2e-3, 1e-3];
        effects.friction.breakaway_velocity = 1.0;
        let inputs = Inputs { tau: [0.02, -0.01], tip_force: [0.3, -0.2], ..default_inputs() };
        parameters.start.theta = [2.2, 0.9];
        parameters.start.omega = [2.0, -3.0];
        let simulation = crate::simulation::Simulation::new(&parameters, &inputs).expect("a scene");
        let at = simulation.run().motion(simulation.model());
        (parameters, inputs, at)
    }

    /// Accelerations, and motions over a step, change with the learned parameters as their differences do.
    #[test]
    fn derivatives_by_what_is_learned_are_differences() {
        let (parameters, inputs, at) = scene();
        let known = parameters.known();
        let made = |learned: &Learned| Model::new(&parameters.with_learned(learned)).expect("a scene");
        let (bodies, model, none) = (Bodies::new(&parameters).expect("bodies"), made(&known), Links::zeros());
        let here = FollowedScene { model: &model, inputs: &inputs, turns: &[0; 4], learned: Some(&bodies) };
        let alpha = here.linearised(&at, &none, &Matrix4x2::zeros()).alpha;
        let exact = Scene::by_learned(&here, &at, &none, &alpha);
        let linkage = Linkage::new(&parameters.geometry);
        let (h, least) = (2e-3, 4);
        let moved = flow::<LEARNED>(&linkage, &here, (&at, &linkage.frame(&at.theta)), &none, (h, least));
        for i in 0..LEARNED {
            let step = if i == PAYLOAD || VISCOUS.contains(&i) { 1e-6 } else { 1e-5 };
            let [ahead, behind] = [step, -step].map(|by| {
                let mut learned = known;
                learned[i] += by;
                let model = made(&learned);
                let scene = FollowedScene { model: &model, inputs: &inputs, turns: &[0; 4], learned: None };
                (scene.acceleration(&at, &none), motion(&scene, &at, &none, h, moved.steps))
            });
            let close = |got: Vector4<f64>, ahead: Vector4<f64>, behind: Vector4<f64>, size: f64| {
                let off = (got - (ahead - behind) / (2.0 * step)).amax();
                // Round-off of the difference, and step² times a third derivative.
                assert!(off < 1e-5 * size, "{i}: {off:e} of {size:e}");
            };
            let size = exact.column(i).amax();
            assert!(size > 0.0);
            close(exact.column(i).into(), ahead.0, behind.0, size);
            let [by_angle, by_rate] = moved.by_learned.map(|by| Vector4::from(by.column(i)));
            close(by_angle, ahead.1.theta, behind.1.theta, by_rate.amax());
            close(by_rate, ahead.1.omega, behind.1.omega, by_rate.amax());
        }
    }

    /// A scene without payload and friction learns its masses alone.
    #[test]
    fn absent_effects_are_not_learned() {
        let (mut parameters, ..) = scene();
        assert!(parameters.prior().expect("it learns").sigma.iter().all(|sigma| *sigma > 0.0));
        parameters.effects.payload.enabled = false;
        parameters.effects.viscous.enabled = false;
        parameters.effects.friction.enabled = false;
        let sigma = parameters.prior().expect("it learns").sigma;
        assert!((0..LEARNED).all(|i| (sigma[i] > 0.0) == MASSES.contains(&i)), "{sigma}");
        parameters.estimator.learn_enabled = false;
        assert!(parameters.prior().is_none());
    }
}
