//! How reliably A02 passes its singular postures: the last table of `docs/notes/problems.md`.
//!
//! The runs pass 10 and 20 singular postures. Each step size places step ends at different distances from them.
//!
//! `cargo run --release -p problems --example passes`

use fivebar::integrator::{Events, Implicit, Passage};
use problems::{Method, Problem, four_bars};

fn main() {
    println!(
        "| problem | e, 1/kg | method | macro steps | failed | median error, m | worst error, m | worst energy drift, J | rejected |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    for regularization in [1e-10, 1e-12, 1e-15, 1e-18] {
        show("N = 2", four_bars::two(), regularization, 100);
    }
    for regularization in [1e-12, 1e-15] {
        show("N = 40", four_bars::forty(), regularization, 10);
    }
}

fn show<S: Implicit<N, M> + Passage<N> + Events<N>, const N: usize, const M: usize>(
    name: &str,
    mut problem: Problem<S, N, M>,
    regularization: f64,
    runs: u32,
) {
    problem.regularization = regularization;
    let (coarse, fine) = ((problem.duration / 1e-2).round() as u32, (problem.duration / 1e-3).round() as u32);
    for (method_name, method, least) in [
        ("i3-ALP, fixed", problem.fixed(), coarse),
        ("i3-ALP, fixed", problem.fixed(), fine),
        ("i3-ALP, 1e-6", problem.adaptive(1e-6), coarse),
        ("i3-ALP, 1e-8", problem.adaptive(1e-8), coarse),
        ("RK4, projected", problem.rk4(), coarse),
        ("RK4, projected", problem.rk4(), fine),
    ] {
        let row = Row::of(&problem, method, least, runs);
        println!("| {name} | {regularization:.0e} | {method_name} | {least} … | {row}");
    }
}

/// Results of several runs.
struct Row {
    failed: usize,
    errors: Vec<f64>,
    drift: f64,
    rejected: u64,
}

impl Row {
    /// Runs with `least` macro steps, and up to a tenth more.
    fn of<S: Implicit<N, M> + Passage<N> + Events<N>, const N: usize, const M: usize>(
        problem: &Problem<S, N, M>,
        method: Method,
        least: u32,
        runs: u32,
    ) -> Self {
        let mut row = Self { failed: 0, errors: Vec::new(), drift: 0.0, rejected: 0 };
        for run in 0..runs {
            let steps = least + least / 10 * run / runs;
            match problem.run(method, problem.duration / f64::from(steps)) {
                Ok(outcome) => {
                    row.errors.push(outcome.error);
                    row.drift = row.drift.max(outcome.energy_drift);
                    row.rejected = row.rejected.max(outcome.rejected);
                }
                Err(_) => row.failed += 1,
            }
        }
        row.errors.sort_by(f64::total_cmp);
        row
    }
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { failed, errors, drift, rejected } = self;
        let of = failed + errors.len();
        let nothing = f64::NAN;
        let (median, worst) = (errors.get(errors.len() / 2).unwrap_or(&nothing), errors.last().unwrap_or(&nothing));
        write!(f, "{failed} of {of} | {median:.1e} | {worst:.1e} | {drift:.1e} | {rejected} |")
    }
}
