//! Item 6 of the battery: extreme scales of steps, tolerances, lengths, masses, loads and communication steps.

use fivebar::simulation::Inputs;

use super::{Case, Extent};
use crate::machine::{NO_LOAD, fall_90_120, scaled};
use crate::random::Random;
use crate::setting::Setting;
use crate::trial::{Span, Trial};

/// Seed of loads and irregular steps.
const SEED: u64 = 6;

pub(super) fn cases(extent: Extent) -> Vec<Case> {
    let adaptive = vec![Setting::Default, Setting::TIGHT];
    let one = vec![Setting::Default];
    vec![
        Case { settings: adaptive.clone(), ..Case::new(6, "steps of 1 us to 20 ms", [1e-2, 1e-3], steps(extent)) },
        Case { settings: one.clone(), ..Case::new(6, "tolerances of 1e-3 to 1e-8", [f64::INFINITY; 2], tolerances(3..=8, extent)) },
        Case { settings: one, ..Case::new(6, "tolerances of 1e-9 to 1e-13", [1e-2, 1e-2], tolerances(9..=13, extent)) },
        Case::new(6, "links of 0.02 to 2 m", [1e-2, 1e-3], lengths(extent)),
        Case::new(6, "mass ratios of 1e-4 to 1e4", [1e-2, 1e-3], masses(extent)),
        Case::new(6, "payload of 1e3 links", [1e-2, 1e-3], payload(extent)),
        Case::new(6, "steps of load", [1e-2, 1e-3], loads(extent)),
        Case { settings: adaptive, ..Case::new(6, "communication steps", [1e-2, 1e-3], communication(extent)) },
    ]
}

fn steps(extent: Extent) -> Vec<Trial> {
    let steps: &[f64] = extent.pick(&[1e-6, 1e-5, 1e-4, 1e-3, 5e-3, 20e-3], &[1e-5, 1e-3, 20e-3]);
    let trial = |&step: &f64| {
        let mut parameters = fall_90_120();
        parameters.settings.step_size = step;
        // The setting determines the tolerance.
        let mut trial = Trial::free(format!("step {step:e} s"), parameters, 0.0);
        trial.schedule = vec![Span { size: step, count: (2.0 / step).round() as u64, ..trial.schedule[0] }];
        trial
    };
    steps.iter().map(trial).collect()
}

/// Error tolerances, as powers of ten.
fn tolerances(powers: impl Iterator<Item = i32>, extent: Extent) -> Vec<Trial> {
    let trial = |power: i32| {
        let mut parameters = fall_90_120();
        parameters.settings.error_tolerance = 10_f64.powi(-power);
        let mut trial = Trial::free(format!("tolerance 1e-{power} rad"), parameters, extent.pick(5.0, 0.5));
        trial.keeps_settings = true;
        trial
    };
    powers.map(trial).collect()
}

/// Machines of all sizes with the masses of the paper.
fn lengths(extent: Extent) -> Vec<Trial> {
    let trial = |length: f64| Trial::free(format!("links of {length} m"), scaled(length / 0.21), extent.pick(10.0, 1.0));
    [0.02, 0.06, 0.21, 0.7, 2.0].into_iter().map(trial).collect()
}

/// One link much lighter or heavier than the others.
fn masses(extent: Extent) -> Vec<Trial> {
    let mut trials = Vec::new();
    for link in [0, 1] {
        for ratio in [1e-4, 1e-2, 1e2, 1e4] {
            let mut parameters = fall_90_120();
            let changed = &mut parameters.geometry.links[link];
            changed.mass *= ratio;
            changed.inertia *= ratio;
            trials.push(Trial::free(format!("link[{}] times {ratio:e}", link + 1), parameters, extent.pick(5.0, 0.5)));
        }
    }
    trials
}

/// A point mass of 1,000 links at the tip, as part of the left distal link.
fn payload(extent: Extent) -> Vec<Trial> {
    let mut parameters = fall_90_120();
    let link = &mut parameters.geometry.links[1];
    let (own, load) = (link.mass, 1e3 * link.mass);
    let centre = (own * link.com + load * link.length) / (own + load);
    link.inertia += own * (centre - link.com).powi(2) + load * (link.length - centre).powi(2);
    (link.mass, link.com) = (own + load, centre);
    vec![Trial::free("payload of 17 kg at the tip", parameters, extent.pick(5.0, 0.5))]
}

/// Motor torques and tip forces that jump every 50 ms.
fn loads(extent: Extent) -> Vec<Trial> {
    let mut random = Random::new(SEED);
    let count = extent.pick(20, 2);
    (0..count)
        .map(|i| {
            let scale = random.log_uniform(1e-3, 1.0);
            let mut trial = Trial::free(format!("loads {i}, up to {scale:.3e} of 0.25 N.m and 1 N"), fall_90_120(), 0.0);
            let mut span = || Span {
                inputs: Inputs {
                    tau: [0.25, 0.25].map(|most| scale * random.uniform(-most, most)),
                    tip_force: [1.0, 1.0].map(|most| scale * random.uniform(-most, most)),
                    ..NO_LOAD
                },
                size: 1e-3,
                count: 50,
            };
            trial.schedule = (0..40).map(|_| span()).collect();
            trial.kinetic_part = 0.1;
            trial
        })
        .collect()
}

/// Communication steps much shorter and much longer than the macro step, and irregular ones.
fn communication(extent: Extent) -> Vec<Trial> {
    let mut random = Random::new(SEED + 1);
    let seconds: f64 = extent.pick(2.0, 0.1);
    let regular = [(1e-6, seconds), (1.0 / 60.0, 2.0), (1.0, 2.0)].into_iter().map(|(size, duration)| {
        let mut trial = Trial::free(format!("communication step {size} s"), fall_90_120(), 0.0);
        trial.schedule = vec![Span { size, count: (duration / size).round() as u64, ..trial.schedule[0] }];
        trial
    });
    let mut trials: Vec<Trial> = regular.collect();
    for i in 0..3 {
        let mut trial = Trial::free(format!("irregular communication steps {i} of 1e-6 to 0.1 s"), fall_90_120(), 0.0);
        let held = trial.schedule[0];
        trial.schedule = (0..200).map(|_| Span { size: random.log_uniform(1e-6, 0.1), count: 1, ..held }).collect();
        trials.push(trial);
    }
    trials
}
