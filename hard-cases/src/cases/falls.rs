//! 1: perturbed free falls.

use fivebar::fmi::bindings::default_parameters;
use fivebar::mechanism::{Assembly, close};
use std::f64::consts::FRAC_PI_2;

use super::{Case, Conserving, Extent};
use crate::random::Random;
use crate::trial::Trial;

/// The seed of the starts.
const SEED: u64 = 20_090_417;
/// How many of the falls are run for comparison.
const COMPARED: usize = 100;

/// What the explicit method may lose at its tolerance of 1e-10 rad, mgL: 50 s of some thousand whips.
const EXPLICIT_ENERGY: f64 = 1e-7;

/// Falls of 50 s from about 90°/90° at rest: both proximal angles off by 1e-3 to 0.3 rad, uniform in the logarithm and of either
/// sign, drawn anew where the elbows would be out of reach; the tip in turn above and below.
pub(super) fn falls(extent: Extent) -> Case {
    let (count, duration) = extent.pick((1000, 50.0), (20, 5.0));
    let mut random = Random::new(SEED);
    let mut trials = Vec::new();
    while trials.len() < count {
        let mut parameters = default_parameters();
        for theta in &mut parameters.start.theta {
            let amplitude = random.log_uniform(1e-3, 0.3);
            *theta = FRAC_PI_2 + random.sign() * amplitude;
        }
        parameters.start.assembly = if trials.len() % 2 == 0 { Assembly::Plus } else { Assembly::Minus };
        if close(&parameters.geometry, &parameters.start).is_ok() {
            let label = format!("theta {:?} rad, {:?}", parameters.start.theta, parameters.start.assembly);
            trials.push(Trial::free(label, parameters, duration));
        }
    }
    let name = "perturbed free falls";
    Case {
        compared: COMPARED.min(count),
        also: "both assemblies",
        explicit_energy: EXPLICIT_ENERGY,
        conserving: Conserving { energy: 1e-8, constraints: [1e-14, 1e-11], path: true, all_steps: true },
        ..Case::new(1, name, [1e-2, 1e-3], trials)
    }
}
