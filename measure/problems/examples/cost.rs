//! Cost of precision for the published problems: the first table of `docs/notes/problems.md`.
//!
//! `cargo run --release -p problems --example cost`

use fivebar::integrator::{Events, Implicit, Passage, StepError};
use problems::{Method, Outcome, Problem, four_bars, pendulum, squeezer};

fn main() {
    println!(
        "| problem | method | macro step | error | energy drift, J | violation, m | sub-steps | rejected | iterations | wall time, s |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |");
    show("A01", &pendulum::problem(), &[1e-2, 1e-3], [&[1e-8, 1e-10, 1e-13], &[1e-6, 1e-9, 1e-12]], 1e-2);
    show("A02, N = 2", &four_bars::two(), &[1e-2, 1e-3, 1e-4], [&[1e-6, 1e-8, 1e-10], &[1e-6, 1e-9, 1e-12]], 1e-2);
    show("A02, N = 40", &four_bars::forty(), &[1e-2, 1e-3], [&[1e-6, 1e-7, 1e-8, 1e-9, 1e-10], &[1e-6]], 1e-2);
    show("Andrews", &squeezer::problem(), &[1e-5, 1e-6], [&[1e-8, 1e-10, 1e-12], &[1e-6, 1e-9, 1e-12]], 1e-4);
}

/// Two methods at fixed steps, and i3-ALP and DOP853 at several tolerances, read every h.
fn show<S: Implicit<N, M> + Passage<N> + Events<N>, const N: usize, const M: usize>(
    name: &str,
    problem: &Problem<S, N, M>,
    steps: &[f64],
    [implicit, explicit]: [&[f64]; 2],
    h: f64,
) {
    for &h in steps {
        row(name, "i3-ALP, fixed", h, problem.run(problem.fixed(), h));
        row(name, "RK4, projected", h, problem.run(problem.rk4(), h));
    }
    for &tolerance in implicit {
        let method: Method = problem.adaptive(tolerance);
        row(name, &format!("i3-ALP, {tolerance:.0e}"), h, problem.run(method, h));
    }
    for &tolerance in explicit {
        row(name, &format!("DOP853, {tolerance:.0e}"), h, problem.run(problem.dop853(tolerance), h));
    }
}

fn row(name: &str, method: &str, h: f64, outcome: Result<Outcome, StepError>) {
    match outcome {
        Ok(Outcome { error, energy_drift, violation, substeps, rejected, iterations, seconds }) => println!(
            "| {name} | {method} | {h:.0e} | {error:.1e} | {energy_drift:.1e} | {violation:.0e} | {substeps} | {rejected} | {iterations} | {seconds:.3} |"
        ),
        Err(failure) => println!("| {name} | {method} | {h:.0e} | {failure} | | | | | | |"),
    }
}
