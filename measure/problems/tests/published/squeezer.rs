//! Andrews' squeezing mechanism against the test set's published values.

use fivebar::integrator::{State, System};
use problems::squeezer::{self, AT_30_MS, NAMES, START, START_ACCELERATIONS, published};

use crate::slope;

/// The geometry is the test set's: its angles close the loops, and the accelerations at the start agree.
#[test]
fn the_start_is_the_published_one() {
    let problem = squeezer::problem();
    let system = &problem.system;
    let phi = system.phi(&problem.q, &system.pose(&problem.q));
    assert!(phi.iter().all(|phi| phi.abs() < 1e-16), "{phi:?}");
    assert!(published(&problem.q).iter().zip(START).all(|(angle, start)| (angle - start).abs() < 1e-15));

    // Without regularization, which would change the accelerations by 3e-11.
    let accelerations = published(&State::start(system, problem.q, problem.v, 0.0).a);
    for (i, name) in NAMES.iter().enumerate() {
        let expected = START_ACCELERATIONS.get(i).copied().unwrap_or(0.0);
        assert!((accelerations[i] - expected).abs() < 1e-8, "{name}: {} instead of {expected}", accelerations[i]);
    }
}

#[test]
fn seven_angles_have_six_digits_at_the_end() {
    let problem = squeezer::problem();
    for (method, h) in [(problem.adaptive(1e-11), 1e-4), (problem.rk4(), 1e-5), (problem.dop853(1e-8), 1e-4)] {
        let mut angles = [0.0; 7];
        let outcome = problem.watch(method, h, |_, state| angles = published(&state.q)).expect("steps");
        for i in 0..7 {
            let error = (angles[i] / AT_30_MS[i] - 1.0).abs();
            assert!(error < 5e-7, "{}: {} instead of {}, {outcome:?}", NAMES[i], angles[i], AT_30_MS[i]);
        }
        assert!(outcome.violation < 1e-12, "{outcome:?}");
    }
}

#[test]
fn fixed_steps_are_second_order() {
    let problem = squeezer::problem();
    let points = [2e-5, 1e-5, 5e-6, 2.5e-6].map(|h| (h, problem.run(problem.fixed(), h).expect("steps").error));
    assert!((slope(&points) - 2.0).abs() < 0.1, "{points:?}");
}

/// At a tight tolerance DOP853 is as accurate as Runge-Kutta at 1 µs, up to the precision of the published angles, in 0.7 % of the steps.
#[test]
fn dop853_is_as_exact_as_the_values() {
    let problem = squeezer::problem();
    let outcome = problem.run(problem.dop853(1e-12), 1e-4).expect("steps");
    // The published values have errors of 2.7e-10 (docs/notes/problems.md); the energy error is the method's own.
    assert!(outcome.error < 3e-10 && outcome.energy_drift < 3e-12 && outcome.substeps < 300, "{outcome:?}");
}
