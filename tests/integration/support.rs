//! Shared support of the tests: scenes, reference solutions, errors and slopes.

use std::path::{Path, PathBuf};

use fivebar::mechanism::coordinates::THETA;
use fivebar::mechanism::{Coordinates, Geometry, closure};
use fivebar::observers;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::methods::Steps;
use fivebar::simulation::{Inputs, Method, Parameters, Simulation};

/// m g L of the paper's links, J, the unit of energy errors.
pub(crate) const MGL: f64 = 0.017 * 9.81 * 0.21;

/// Whether tests run in their long form, `cargo xtask test --nightly`.
pub(crate) fn is_nightly() -> bool {
    std::env::var_os("FIVEBAR_NIGHTLY").is_some()
}

/// The methods with a length of steps.
fn methods(of: impl Fn(Steps) -> bool) -> Vec<Method> {
    Method::LIST.iter().copied().filter(|method| of(method.properties().steps)).collect()
}

/// The methods whose steps can end at an event, with `solver.adaptive`.
pub(crate) fn methods_with_events() -> Vec<Method> {
    methods(|steps| steps != Steps::Fixed)
}

/// The methods whose steps run past communication points.
pub(crate) fn dense_methods() -> Vec<Method> {
    methods(|steps| steps == Steps::Dense)
}

/// The methods whose steps are the macro steps, the adaptive ones without `solver.adaptive`.
pub(crate) fn methods_of_fixed_steps() -> Vec<Method> {
    methods(|steps| steps != Steps::Dense)
}

/// A file of the repository.
pub(crate) fn file(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The paper's mechanism under gravity, proximal angles 90° and 120°, at rest, with fixed steps.
pub(crate) fn fall_90_120(method: Method) -> Parameters {
    let mut parameters = default_parameters();
    parameters.start.theta[1] = 120f64.to_radians();
    parameters.settings.method = method;
    parameters.settings.adaptive = false;
    parameters
}

/// Left motor torque of 0.25 N·m from 90°/90° at rest, without gravity.
pub(crate) fn torque() -> (Parameters, Inputs) {
    let mut parameters = default_parameters();
    parameters.effects.gravity.enabled = false;
    (parameters, Inputs { tau: [0.25, 0.0], ..default_inputs() })
}

/// A mechanism with all links different and no centre of mass in the middle.
pub(crate) fn unequal() -> Parameters {
    let mut parameters = default_parameters();
    let geometry = &mut parameters.geometry;
    geometry.base_distance = 0.3;
    for (link, [length, mass, inertia, com]) in geometry.links.iter_mut().zip([
        [0.20, 0.020, 8.0e-5, 0.07],
        [0.26, 0.015, 1.1e-4, 0.15],
        [0.24, 0.030, 9.0e-5, -0.02],
        [0.17, 0.011, 3.0e-5, 0.19],
    ]) {
        (link.length, link.mass, link.inertia, link.com) = (length, mass, inertia, com);
    }
    parameters.start.theta = [2.0, 0.9];
    parameters.start.omega = [1.5, -2.5];
    parameters
}

/// Enables an effect.
pub(crate) fn enable(parameters: &mut Parameters, effect: &str) {
    *parameters.effects.switch(effect).unwrap_or_else(|| panic!("no effect is called {effect}")) = true;
}

/// A row of a reference file: time, tip, angles and rates of links 1 to 4.
pub(crate) struct Reference {
    pub(crate) t: f64,
    pub(crate) tip: [f64; 2],
    pub(crate) theta: [f64; 4],
    pub(crate) omega: [f64; 4],
}

impl Reference {
    /// Reads tests/data/reference/<name>.csv (its head states the origin).
    pub(crate) fn read(name: &str) -> Vec<Self> {
        let text = std::fs::read_to_string(file(&format!("tests/data/reference/{name}.csv"))).expect("reference file");
        text.lines()
            .filter(|line| !line.starts_with(['#', 't']))
            .map(|line| {
                let row: Vec<f64> = line.split(',').map(|cell| cell.parse().expect("a number")).collect();
                Self {
                    t: row[0],
                    tip: [row[1], row[2]],
                    theta: std::array::from_fn(|i| row[3 + i]),
                    omega: std::array::from_fn(|i| row[7 + i]),
                }
            })
            .collect()
    }

    /// q and q̇ of the reference.
    pub(crate) fn coordinates(&self, geometry: &Geometry) -> (Coordinates, Coordinates) {
        closure::assemble(geometry, self.theta, self.omega)
    }
}

/// Position of the tip, m.
pub(crate) fn tip(simulation: &Simulation) -> [f64; 2] {
    let tip = observers::motion(simulation.model(), &simulation.state()).tip;
    [tip.x, tip.y]
}

/// Distance between the simulation's tip and a point, m.
pub(crate) fn tip_error(simulation: &Simulation, [x, y]: [f64; 2]) -> f64 {
    let tip = tip(simulation);
    (tip[0] - x).hypot(tip[1] - y)
}

/// Largest difference of the link angles of two sets of coordinates.
pub(crate) fn angle_error(x: &Coordinates, y: &Coordinates) -> f64 {
    THETA.iter().map(|&i| (x[i] - y[i]).abs()).fold(0.0, f64::max)
}

/// Slope of log error against log h, least squares.
pub(crate) fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let logs: Vec<(f64, f64)> = points.iter().map(|(h, error)| (h.ln(), error.ln())).collect();
    let (sx, sy) = logs.iter().fold((0.0, 0.0), |(sx, sy), (x, y)| (sx + x, sy + y));
    let (sxx, sxy) = logs.iter().fold((0.0, 0.0), |(sxx, sxy), (x, y)| (sxx + x * x, sxy + x * y));
    (n * sxy - sx * sy) / (n * sxx - sx * sx)
}

/// Runs `duration` seconds in steps of h.
pub(crate) fn run(simulation: &mut Simulation, inputs: &Inputs, h: f64, duration: f64) {
    simulation.advance(inputs, h, (duration / h).round() as u64).expect("the run must not fail");
}
