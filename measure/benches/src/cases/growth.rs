//! Cost per step against the size of the mechanism: N four-bars in a row, with the block-banded solve of their test.

use std::hint::black_box;

use fivebar::integrator::{State, i3alp};
use problems::{Method, four_bars};

use crate::case::{Case, Work};

/// Steps of 1 ms. The row falls from upright and does not yet lie flat, which would be singular.
const STEPS: u64 = 200;

fn row<const N: usize, const M: usize>() -> Case {
    let name = format!("N = {}, {N} coordinates, {M} constraints", (N / 3 - 1) / 2);
    Case::new("growth", name, STEPS, || {
        let problem = four_bars::row::<N, M>();
        let Method::I3alp(settings) = problem.fixed() else { unreachable!("fixed() is i3-ALP") };
        let mut state = State::start(&problem.system, problem.q, problem.v, problem.regularization);
        let work: Work = Box::new(move || {
            for _ in 0..STEPS {
                i3alp::MacroStep::of(1e-3).advance(black_box(&problem.system), &settings, &mut state, &mut ()).expect("a step");
            }
        });
        Ok(work)
    })
}

/// N from 2 to 40.
pub(super) fn cases() -> Vec<Case> {
    vec![row::<15, 14>(), row::<33, 32>(), row::<63, 62>(), row::<123, 122>(), row::<243, 242>()]
}
