//! Gauss's principle on the tangent cone, by brute force: the acceleration from rest in a vertex, independent of the library's code.
//!
//! Among the motions d of the cone the true one maximises (F·d)²/(d·M d), with F the loads and M the mass matrix in link angles; then
//! q̈ = d (F·d)/(d·M d) (`docs/vertices.md`, "The start from rest"). Every local maximum is a branch on which the machine may leave.

use std::f64::consts::TAU;

use fivebar::integrator::System;
use fivebar::mechanism::SceneError;
use fivebar::simulation::five_bar::FiveBar;
use fivebar::simulation::{Inputs, Parameters, Simulation};
use fivebar::vector::Vector;

use crate::machine::unit_motion;
use crate::vertex::Vertex;

/// A local maximum.
#[derive(Clone, Copy, Debug)]
pub struct Branch {
    /// (F·d)²/(d·M d), J/s².
    pub value: f64,
    /// Accelerations of the links, rad/s².
    pub acceleration: [f64; 4],
}

/// Number of sampled directions.
const DIRECTIONS: u32 = 3600;

/// The branches on which the machine may leave rest in `vertex` under its loads, strongest first; empty if no load does work.
pub fn branches(parameters: &Parameters, inputs: &Inputs, vertex: Vertex) -> Result<Vec<Branch>, SceneError> {
    let simulation = Simulation::at(parameters, inputs, vertex.theta, [0.0; 4])?;
    let model = simulation.model();
    let system = FiveBar::new(model, inputs, &[0; 4]);
    let q = simulation.state().core.q;
    let forces = system.forces(&q, &system.pose(&q), &Vector::ZERO).0;
    let motions: [_; 4] = std::array::from_fn(|i| unit_motion(&parameters.geometry, vertex.theta, i));
    let product = |x: &[f64; 12], y: &[f64; 12]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    let load: [f64; 4] = std::array::from_fn(|i| product(&motions[i], &forces));
    let mass: [[f64; 4]; 4] = std::array::from_fn(|i| {
        let momentum = model.mechanism.mass_times(&motions[i]);
        std::array::from_fn(|j| product(&momentum, &motions[j]))
    });
    // Power and value of a direction.
    let value = |f: f64| {
        let d = vertex.direction(f);
        let power: f64 = (0..4).map(|i| load[i] * d[i]).sum();
        let inertia: f64 = (0..4).map(|i| (0..4).map(|j| d[i] * mass[i][j] * d[j]).sum::<f64>()).sum();
        (power * power / inertia, d.map(|d| d * power / inertia))
    };
    let at = |i: u32| TAU * f64::from(i) / f64::from(DIRECTIONS);
    let values: Vec<f64> = (0..DIRECTIONS).map(|i| value(at(i)).0).collect();
    // Smaller loads are round-off of loads that do no work.
    let least = 1e-20 * load.iter().map(|load| load * load).sum::<f64>() / mass[0][0];
    let n = DIRECTIONS as usize;
    let mut found = Vec::new();
    for i in 0..n {
        if values[i] > least && values[i] >= values[(i + n - 1) % n] && values[i] > values[(i + 1) % n] {
            let i = u32::try_from(i).expect("fewer directions");
            let f = maximum(|f| value(f).0, at(i) - at(1), at(i) + at(1));
            let (value, acceleration) = value(f);
            found.push(Branch { value, acceleration });
        }
    }
    found.sort_by(|a, b| b.value.total_cmp(&a.value));
    Ok(found)
}

/// Position of the largest `f` in an interval with a single maximum.
fn maximum(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    for _ in 0..60 {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if f(a) < f(b) { low = a } else { high = b }
    }
    f64::midpoint(low, high)
}
