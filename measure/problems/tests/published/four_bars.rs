//! N four-bars in a row (IFToMM benchmark A02), singular twice per turn at 5 rad/s, against the equivalent pendulum.

use fivebar::integrator::{Events, Implicit, Passage, State};
use problems::{Outcome, Problem, four_bars};

#[test]
fn the_equivalent_pendulum_has_the_published_positions() {
    for (loops, t, [x, y]) in [(2, 10.0, four_bars::TWO_AT_10_S), (40, 20.0, four_bars::FORTY_AT_20_S)] {
        let phi = four_bars::phi(loops, t);
        assert!((phi.sin() - x).hypot(phi.cos() - y) < 1e-10, "{loops}: {phi}");
    }
}

#[test]
fn two_loops_keep_their_energy_at_fixed_steps() {
    let problem = four_bars::two();
    let coarse = problem.run(problem.fixed(), 1e-2).expect("steps");
    assert!(coarse.energy_drift <= 0.1, "{coarse:?}");
    let fine = problem.run(problem.fixed(), 1e-3).expect("steps");
    assert!(fine.energy_drift <= 1e-3 && fine.error <= 1e-4, "{fine:?}");
}

/// Largest difference of any link's angle from the pendulum's, for each second; and the outcome of the run.
fn against_the_pendulum<S: Implicit<N, M> + Passage<N> + Events<N>, const N: usize, const M: usize>(
    problem: &Problem<S, N, M>,
    error_tolerance: f64,
) -> (f64, Outcome) {
    let loops = (N / 3 - 1) / 2;
    let mut largest = 0.0f64;
    let outcome = problem.watch(problem.adaptive(error_tolerance), 1e-2, |t, State { q, .. }| {
        if (t - t.round()).abs() < 1e-9 {
            let phi = four_bars::phi(loops, t);
            for (link, body) in q.chunks_exact(3).enumerate() {
                let exact = if link % 2 == 0 { std::f64::consts::FRAC_PI_2 - phi } else { 0.0 };
                largest = largest.max((body[2] - exact).abs());
            }
        }
    });
    (largest, outcome.expect("steps"))
}

#[test]
fn two_loops_are_the_pendulum() {
    let (largest, outcome) = against_the_pendulum(&four_bars::two(), 1e-8);
    assert!(largest <= 3e-4 && outcome.error <= 1e-4, "{largest:e} {outcome:?}");
}

#[test]
fn forty_loops_are_the_pendulum() {
    let (largest, outcome) = against_the_pendulum(&four_bars::forty(), 1e-8);
    assert!(largest <= 3e-3 && outcome.error <= 1e-3 && outcome.violation <= 1e-11, "{largest:e} {outcome:?}");
}

/// Each macro step length places the step ends at different distances from the singular posture.
#[test]
fn sub_steps_pass_the_singularities_wherever_steps_end() {
    let problem = four_bars::two();
    for steps in (1000..1100).step_by(5) {
        let outcome = problem.run(problem.adaptive(1e-6), problem.duration / f64::from(steps)).expect("steps");
        assert!(outcome.error < 4e-3 && outcome.energy_drift < 2e-2, "{steps}: {outcome:?}");
    }
}
