//! Item 3 of the battery: rest in each vertex.

use fivebar::simulation::Inputs;
use fivebar::simulation::bindings::default_parameters;

use super::{Case, Extent};
use crate::gauss::branches;
use crate::machine::{NO_LOAD, weightless};
use crate::trial::Trial;
use crate::vertex::POSTURES;
use crate::watch::Watch;

/// The loads: name, gravity, inputs.
fn loads() -> Vec<(&'static str, bool, Inputs)> {
    let torque = |left, right| Inputs { tau: [left, right], ..NO_LOAD };
    let tip = |x, y| Inputs { tip_force: [x, y], ..NO_LOAD };
    vec![
        ("gravity", true, NO_LOAD),
        ("left motor 0.25 N.m", false, torque(0.25, 0.0)),
        ("left motor -0.25 N.m and gravity", true, torque(-0.25, 0.0)),
        ("left motor 0.01 N.m", false, torque(0.01, 0.0)),
        ("right motor 0.25 N.m", false, torque(0.0, 0.25)),
        ("right motor 0.25 N.m and gravity", true, torque(0.0, 0.25)),
        ("right motor -0.01 N.m", false, torque(0.0, -0.01)),
        ("tip force (0, 0.1) N", false, tip(0.0, 0.1)),
        ("tip force (0.05, -0.2) N and gravity", true, tip(0.05, -0.2)),
    ]
}

pub(super) fn cases(extent: Extent) -> Vec<Case> {
    let duration = extent.pick(2.0, 0.2);
    let mut unloaded = Vec::new();
    let mut loaded = Vec::new();
    for vertex in POSTURES {
        let mut trial = Trial::free(format!("vertex {}", vertex.name), weightless(), duration);
        trial.watch = Watch::Stays { links: [true; 4], within: 1e-9 };
        unloaded.push(trial.from_links(vertex.theta, [0.0; 4]));
        for (name, gravity, inputs) in loads() {
            let parameters = if gravity { default_parameters() } else { weightless() };
            let branches = branches(&parameters, &inputs, vertex).expect("the vertex is a posture of the paper's machine");
            let mut trial = Trial::driven(format!("vertex {}, {name}", vertex.name), parameters, inputs, duration);
            trial.watch = if branches.is_empty() {
                Watch::Stays { links: [true; 4], within: 1e-9 }
            } else {
                Watch::Leaves { vertex, branches: branches.iter().map(|branch| branch.acceleration).collect() }
            };
            // A fast rotating leg reaches thousands of mgL.
            trial.kinetic_part = 1e-2;
            trial.vertex_outputs = true;
            loaded.push(trial.from_links(vertex.theta, [0.0; 4]));
        }
    }
    vec![
        Case { also: "stays within 1e-9 rad", ..Case::new(3, "rest in a vertex, no load", [1e-2, 1e-2], unloaded) },
        Case {
            also: "leaves on the branch that Gauss's principle gives",
            status_allowed: true,
            ..Case::new(3, "rest in a vertex under load", [1e-2, 1e-2], loaded)
        },
    ]
}
