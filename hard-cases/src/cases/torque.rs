//! 5: the paper's first test: 0.25 N·m on the left motor, with and without gravity; whips of 70 rad/s.

use fivebar::fmi::bindings::default_parameters;
use fivebar::simulation::Inputs;

use super::Case;
use crate::machine::{NO_LOAD, weightless};
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let pull = Inputs { tau: [0.25, 0.0], ..NO_LOAD };
    let trials = vec![
        Trial::driven("without gravity", weightless(), pull, 2.5),
        Trial::driven("with gravity", default_parameters(), pull, 2.5),
    ];
    vec![Case::new(5, "paper test 1", [1e-2, 1e-3], trials)]
}
