//! A scene whose masses, friction, lengths and encoder biases are learned: its parameters with the learned values, and machines that
//! differ by one of them.

use super::Parameters;
use crate::dynamics::angles::{Inertia, Weight};
use crate::effects::friction::Friction;
use crate::effects::payload::CARRIER;
use crate::estimator::error_state::{DRY, LENGTHS, Learned, OFFSETS, PAYLOAD, VISCOUS};
use crate::estimator::{MEASURED, Prior, set_lengths};
use crate::mechanism::{ClosureBranch, Link, Mechanism};

/// Limits, in standard deviations of a length, within which lengths are not learned: the length difference of a pair of links, and the base
/// distance. The limits come from 72 falls of exact machines with coaxial motors (1 s, 16 bits, links of 0.12 to 0.3 m, σ = 0.2 mm of each
/// length). If lengths are not learned, the tip stays within 2 mm in all 72 falls; if lengths are learned, in only 17. With learned lengths
/// and pairs that differ by up to 0.4 mm, the tip stays within 2 mm in 59 falls, up to 1 mm in 66; with a base of 0.5, 1, 2 and 100 mm in
/// 57, 66, 69 and 70.
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

    /// Whether lengths are learned. They are not if the closure splits into branches for some lengths within their uncertainty: the lengths
    /// then decide on which branch a motion leaves the posture with all links in line, and no earlier sample reveals the branch.
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
    pub(super) parameters: &'a Parameters,
    /// Bodies with learned masses; all other masses are zero in each.
    pub(super) bodies: [(Inertia, Weight); 3],
    /// Whether lengths are learned.
    pub(super) lengths: bool,
    /// Friction by the `friction.*` variables, also in a scene without it, because the machine may have some. `None` if they are not valid.
    pub(super) friction: Option<Friction>,
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
