//! The integrator knows only its `System`, so the same code also runs a pendulum in x, y.

use fivebar::integrator::State;
use problems::pendulum;

use crate::slope;

#[test]
fn the_pendulum_benchmark_is_met_by_every_method() {
    let problem = pendulum::problem();
    let error = |method, h| problem.run(method, h).expect("steps").error;

    let points = [4e-3, 2e-3, 1e-3, 5e-4].map(|h| (h, error(problem.fixed(), h)));
    assert!((slope(&points) - 2.0).abs() < 0.05, "{points:?}");
    let points = [4e-3, 2e-3, 1e-3].map(|h| (h, error(problem.rk4(), h)));
    assert!((slope(&points) - 4.0).abs() < 0.3, "{points:?}");
    // Local errors of 1e-13 m in some 4e5 sub-steps.
    let adaptive = error(problem.adaptive(1e-13), 1e-2);
    assert!(adaptive < 1e-7, "{adaptive:e}");
    // Local errors of 1e-12 m in some 400 steps; most cancel: 1.2e-11 m.
    let explicit = error(problem.dop853(1e-12), 1e-2);
    assert!(explicit < 1e-10, "{explicit:e}");
}

#[test]
fn the_pendulum_is_back_after_its_period() {
    let mut problem = pendulum::problem();
    problem.duration = pendulum::PERIOD;
    let mut end = problem.q;
    problem.watch(problem.rk4(), pendulum::PERIOD / 1e4, |_, State { q, .. }| end = *q).expect("steps");
    assert!((end[0] - 1.0).abs() < 1e-12 && end[1].abs() < 1e-10, "{end:?}");
}
