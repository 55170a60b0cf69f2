//! The phases of the i3-ALP step, each alone over recorded states.
//!
//! Within a step phases are interleaved and keep their operands in registers; alone, a phase reads them from memory. So their sum differs
//! from the step's cost and only shows how it is distributed. The predictor is a few sums and has no function of its own.

use std::hint::black_box;

use anyhow::Result;
use fivebar::integrator::{Implicit, Kkt, State, System, TangentPoint};
use fivebar::mechanism::{COORDINATES, MULTIPLIERS};
use fivebar::simulation::five_bar::FiveBar;

use super::{H, advance};
use crate::case::{Case, Work};
use crate::scene::Scene;

type Core = State<COORDINATES, MULTIPLIERS>;

/// Recorded states, 5 ms apart.
const SAMPLES: u64 = 200;

fn phase(name: &str, run: impl Fn(&FiveBar<'_>, &Core, f64) + Copy + 'static) -> Case {
    Case::new("phases", name, SAMPLES, move || {
        let scene = Scene::fall();
        let mut simulation = scene.simulation()?;
        let states: Vec<Core> = (0..SAMPLES)
            .map(|_| {
                advance(&mut simulation, &scene.inputs, 5);
                simulation.state().core
            })
            .collect();
        let work: Work = Box::new(move || {
            let (model, turns) = (simulation.model(), &simulation.state().turns);
            let system = FiveBar::new(model, &scene.inputs, turns);
            for state in &states {
                run(black_box(&system), black_box(state), model.regularization);
            }
        });
        Ok(work)
    })
}

pub(super) fn cases() -> Result<Vec<Case>> {
    Ok(vec![
        phase("assemble: pose, constraints, forces, inertia", |system, state, _| {
            let pose = system.pose(&state.q);
            black_box((
                system.phi(&state.q, &pose),
                system.forces(&state.q, &pose, &state.v).0,
                system.mass_times(&pose, &state.a),
            ));
        }),
        phase("pose alone, which each of the following contains", |system, state, _| {
            black_box(system.pose(&state.q));
        }),
        phase("factor the tangent and solve", |system, state, regularization| {
            let pose = system.pose(&state.q);
            let at = TangentPoint { q: &state.q, pose: &pose, v: &state.v, lambda: &state.lambda, h: H };
            black_box(system.solve_tangent(&at, regularization, &state.a, &state.lambda).expect("positive"));
        }),
        phase("project: factor M, velocity, acceleration", |system, state, regularization| {
            let pose = system.pose(&state.q);
            let mass = system.factor_mass(&pose, regularization);
            let correction = mass.correction(&system.phi_q_times(&pose, &state.v));
            let forces = system.forces(&state.q, &pose, &state.v).0;
            black_box((correction, mass.solve(&forces, &system.phi_q_dot_times(&pose, &state.v))));
        }),
    ])
}
