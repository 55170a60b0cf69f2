//! A machine that is followed, beside the bare step: with samples of both encoders at every step, and without.

use std::hint::black_box;

use fivebar::estimator::{MEASURED, Measured};
use fivebar::simulation::{Following, Signal, Simulation};

use super::{H, STEPS};
use crate::case::{Case, Work};
use crate::scene::Scene;

/// The table of machines that are followed.
pub(crate) const FOLLOWING: &str = "following";

/// Steps of the encoders, rad: 16 bits.
const QUANTUM: f64 = std::f64::consts::TAU / 65536.0;

/// The fall, followed: `samples` says whether the encoders speak.
fn followed(name: &'static str, samples: bool) -> Case {
    Case::new(FOLLOWING, name, STEPS, move || {
        let Scene { mut parameters, inputs, .. } = Scene::fall();
        let mut machine = Simulation::new(&parameters, &inputs)?;
        let mut measured = Vec::new();
        for step in 0..STEPS {
            let theta = machine.state().angles();
            measured.push(Measured {
                theta: MEASURED.map(|link| (theta[link] / QUANTUM).round() * QUANTUM),
                time: [step as f64 * H; 2],
            });
            machine.advance(&inputs, H, 1)?;
        }
        parameters.estimator.enabled = true;
        parameters.estimator.quantum = [QUANTUM; 2];
        parameters.estimator.sigma0_theta = 1e-3;
        parameters.estimator.sigma0_omega = 1e-2;
        let mut twin = Following::new(&parameters, &inputs)?;
        let work: Work = Box::new(move || {
            for (step, measured) in measured.iter().enumerate() {
                if samples {
                    twin.correct(black_box(measured), step as f64 * H);
                }
                twin.advance_along(black_box(&Signal::held(inputs)), H, 1).expect("the fall does not fail");
            }
        });
        Ok(work)
    })
}

/// Table `following`.
pub(super) fn cases() -> Vec<Case> {
    vec![followed("a step with a sample of both encoders", true), followed("a coasting step", false)]
}
