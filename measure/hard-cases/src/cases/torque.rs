//! Item 5 of the battery: the paper's tests: 0.25 N·m on the left motor, with and without gravity, rates up to 70 rad/s. The conserving
//! step runs for 50 s, with the torque all the time, and also for the free fall.

use fivebar::simulation::Inputs;
use fivebar::simulation::bindings::default_parameters;

use super::Case;
use crate::machine::{NO_LOAD, weightless};
use crate::setting::Setting;
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let pull = Inputs { tau: [0.25, 0.0], ..NO_LOAD };
    let pulls = |duration| {
        vec![
            Trial::driven("without gravity", weightless(), pull, duration),
            Trial::driven("with gravity", default_parameters(), pull, duration),
        ]
    };
    let mut long = pulls(50.0);
    long.push(Trial::free("free fall", default_parameters(), 50.0));
    vec![
        Case::new(5, "paper test 1", [1e-2, 1e-3], pulls(2.5)),
        Case { settings: vec![Setting::CONSERVING], ..Case::new(5, "paper tests over 50 s", [1e-2, 1e-3], long) },
    ]
}
