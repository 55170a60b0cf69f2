//! The five-bar from the benchmark of state observers by Sanjurjo and others (mbde): gravity off by 1 m/s², start angles off by π/16.

use fivebar::estimator::{LinkState, Linkage, Links, MEASURED, Scene};
use fivebar::mechanism::{Assembly, Link};
use fivebar::simulation::bindings::default_inputs;
use fivebar::simulation::{FollowedScene, Method, Parameters};

use crate::machine::{Encoder, Plan, Random, Scenario, exact, follow, motion, no_inputs};
use crate::report::{Figure, Table};

/// Encoders with the best row of the published table: angle, rate, acceleration, torque.
const ROWS: [(Encoder, [f64; 4]); 2] = [
    (Encoder { name: "1 deg", sigma: std::f64::consts::PI / 180.0, quantum: 0.0 }, [0.0064, 0.121, 1.51, 0.78]),
    (Encoder { name: "1.3e-4 rad", sigma: 1.3e-4, quantum: 0.0 }, [0.9e-4, 0.0072, 0.40, 0.19]),
];

fn machine() -> Parameters {
    let mut parameters = exact();
    parameters.geometry.base_distance = 3.0;
    for (link, (length, mass)) in parameters.geometry.links.iter_mut().zip([(0.5, 3.0), (2.062, 1.0), (3.202, 2.0), (0.5, 3.0)]) {
        *link = Link { length, mass, inertia: mass * length * length / 12.0, com: length / 2.0 };
    }
    parameters.start.theta = [0.0, std::f64::consts::PI];
    parameters.start.assembly = Assembly::Plus;
    parameters.settings.method = Method::Dop853;
    parameters
}

/// Errors relative to the best rows.
pub fn table(seeds: u64, first: u64) -> Table {
    let mut table =
        Table::new("Benchmark of mbde, 5 ms, 10 s without the first second: at most 1.10 times the best row of its table");
    for (encoder, best) in ROWS {
        let mut sums = [0.0; 5];
        for seed in 0..seeds {
            let mut model = machine();
            model.effects.gravity.g = 8.81;
            for theta in &mut model.start.theta {
                *theta += std::f64::consts::PI / 16.0;
            }
            let scenario =
                Scenario { model, truth: machine(), course: no_inputs, plan: Plan::default(), duration: 10.0, from: None };
            let one = run(&scenario, &encoder, &mut Random::new(first + 7_200_000 + seed));
            sums.iter_mut().zip(one).for_each(|(sum, one)| *sum += one / seeds as f64);
        }
        for (i, name) in ["angle, rad", "rate, rad/s", "acceleration, rad/s2", "torque, N.m"].into_iter().enumerate() {
            let name = format!("{}: {name}", encoder.name);
            table.push(Figure::at_most(name, sums[i].sqrt(), 1.10 * best[i], format!("best row {}", best[i])));
        }
        table.push(Figure::between(format!("{}: NEES", encoder.name), sums[4], [2.0, 6.5], format!("{seeds} seeds")));
    }
    table
}

/// Mean squared errors of a run, and NEES.
fn run(scenario: &Scenario, encoder: &Encoder, random: &mut Random) -> [f64; 5] {
    let inputs = default_inputs();
    let turns = [0; 4];
    let (truth, twin) = (scenario.machine(), scenario.twin(encoder));
    let linkage = Linkage::new(&truth.model().mechanism.geometry);
    let scenes = [truth.model(), twin.simulation().model()].map(|model| FollowedScene {
        model,
        inputs,
        before: &inputs,
        turns: &turns,
        learned: None,
    });
    let (mut sums, mut count) = ([0.0; 5], 0.0);
    follow(scenario, encoder, 5e-3, random, |at| {
        if at.time < 1.0 {
            return;
        }
        let ((theta, omega), (estimated, rates)) = (motion(at.truth), motion(at.estimate));
        let acceleration =
            |state: &fivebar::simulation::State, link: usize| state.core.a[fivebar::mechanism::coordinates::THETA[link]];
        for link in MEASURED {
            let off = theta[link] - estimated[link];
            let off = off - (off / std::f64::consts::TAU).round() * std::f64::consts::TAU;
            sums[0] += off * off / 2.0;
            sums[1] += (omega[link] - rates[link]).powi(2) / 2.0;
            sums[2] += (acceleration(at.truth, link) - acceleration(at.estimate, link)).powi(2) / 2.0;
        }
        // Motor torques equivalent to the gravity missing in the model.
        let (state, basis) = (LinkState::new(theta, omega), linkage.frame(&theta.into()).basis);
        let [with, without] = scenes.each_ref().map(|scene| scene.acceleration(&state, &Links::zeros()));
        let accelerations = basis.tr_mul(&(with - without));
        // Accelerations per motor torque.
        let [left, right] = [Links::x(), Links::y()].map(|torque| basis.tr_mul(&(scenes[0].acceleration(&state, &torque) - with)));
        let determinant = left.perp(&right);
        if let Some((tau, _)) = at.twin.motor_torques().filter(|_| determinant != 0.0) {
            let torque = [accelerations.perp(&right), left.perp(&accelerations)].map(|part| part / determinant);
            sums[3] += ((tau[0] - torque[0]).powi(2) + (tau[1] - torque[1]).powi(2)) / 2.0;
        }
        sums[4] += at.twin.nees(&theta, &omega).min(1e4);
        count += 1.0;
    })
    .unwrap_or_else(|failure| panic!("{failure}"));
    sums.map(|sum| sum / count)
}
