//! Item 1 of the battery: perturbed free falls.

use fivebar::mechanism::{Assembly, close};
use fivebar::simulation::bindings::default_parameters;
use std::f64::consts::FRAC_PI_2;

use super::{Case, Conserving, Extent};
use crate::random::Random;
use crate::setting::Setting;
use crate::trial::Trial;

/// Seed of the starts.
const SEED: u64 = 20_090_417;
/// Number of falls run for comparison.
const COMPARED: usize = 100;

/// Communication step, s, that is long enough to cost less than the fall and still shows the energy.
const SELDOM: f64 = 50e-3;

/// Allowed energy error of the explicit method at its tolerance of 1e-10 rad, mgL: 50 s with some thousand fast passages.
const EXPLICIT_ENERGY: f64 = 1e-7;

/// Falls of 50 s from about 90°/90° at rest. Both proximal angles are off by 1e-3 to 0.3 rad, log-uniform with either sign, drawn again
/// if the elbows would be out of reach; the tip is alternately above and below.
pub(super) fn falls(extent: Extent) -> Case {
    let (count, duration) = extent.pick((1000, 50.0), (20, 5.0));
    Case {
        compared: COMPARED.min(count),
        also: "both assemblies",
        explicit_energy: EXPLICIT_ENERGY,
        conserving: Conserving { energy: 1e-8, constraints: [1e-14, 1e-11], path: true, all_steps: true },
        ..Case::new(1, "perturbed free falls", [1e-2, 1e-3], of_seed(SEED, count, duration))
    }
}

/// More falls by the explicit method, in communication steps of 50 ms, with another seed. The first two pass a vertex at 2e-7 rad; they
/// are regression cases for energy losses of 1.2e-6 and 7.5e-6 mgL.
pub(super) fn more_falls(extent: Extent) -> Case {
    let (count, duration) = extent.pick((200, 50.0), (5, 5.0));
    let grazing = [([1.568397992942559, 1.5759849709417502], 20.0), ([1.5959007574745574, 1.7996878630689361], 6.0)];
    let mut trials: Vec<Trial> = grazing.into_iter().map(|(theta, duration)| fall(theta, Assembly::Plus, duration)).collect();
    trials.extend(of_seed(SEED + 1, count, duration));
    seldom_observed(&mut trials);
    by_the_explicit_method("more falls", trials)
}

/// Falls of 50 s by the explicit method, with any seed, in communication steps of 50 ms.
pub fn falls_of_seed(seed: u64, count: usize) -> Case {
    let mut trials = of_seed(seed, count, 50.0);
    seldom_observed(&mut trials);
    by_the_explicit_method("falls of a seed", trials)
}

fn by_the_explicit_method(name: &'static str, trials: Vec<Trial>) -> Case {
    Case { explicit_energy: EXPLICIT_ENERGY, settings: vec![Setting::EXPLICIT], ..Case::new(1, name, [1e-2, 1e-3], trials) }
}

fn seldom_observed(trials: &mut [Trial]) {
    for span in trials.iter_mut().flat_map(|trial| &mut trial.schedule) {
        *span = span.in_steps_of(SELDOM);
    }
}

fn of_seed(seed: u64, count: usize, duration: f64) -> Vec<Trial> {
    let mut random = Random::new(seed);
    let mut trials = Vec::new();
    while trials.len() < count {
        let theta = std::array::from_fn(|_| {
            let amplitude = random.log_uniform(1e-3, 0.3);
            FRAC_PI_2 + random.sign() * amplitude
        });
        let trial = fall(theta, if trials.len() % 2 == 0 { Assembly::Plus } else { Assembly::Minus }, duration);
        if close(&trial.parameters.geometry, &trial.parameters.start).is_ok() {
            trials.push(trial);
        }
    }
    trials
}

fn fall(theta: [f64; 2], assembly: Assembly, duration: f64) -> Trial {
    let mut parameters = default_parameters();
    (parameters.start.theta, parameters.start.assembly) = (theta, assembly);
    Trial::free(format!("theta {theta:?} rad, {assembly:?}"), parameters, duration)
}
