//! Item 4 of the battery: other singular postures: direct and inverse singularities, coaxial motors.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, PI};

use fivebar::mechanism::Assembly;
use fivebar::simulation::bindings::default_parameters;

use super::{Case, Extent};
use crate::machine::{leg_to, right_rates};
use crate::trial::Trial;

pub(super) fn cases(extent: Extent) -> Vec<Case> {
    let duration = extent.pick(10.0, 1.0);
    let line = rest_in_line(duration);
    vec![
        Case {
            also: "passes through direct ones",
            ..Case::new(4, "direct singularities", [1e-2, 1e-3], passing(&[0], direct(duration)))
        },
        Case {
            also: "passes through inverse ones",
            ..Case::new(4, "inverse singularities", [1e-2, 1e-3], passing(&[1, 2], inverse(duration)))
        },
        Case::new(4, "coaxial motors", [1e-2, 1e-3], coaxial(duration)),
        Case::new(4, "coaxial motors, rest in line", [1e-2, 1e-3], line),
    ]
}

/// The trials, with the requirement to pass through singularities of these configuration signs.
fn passing(passes: &'static [usize], mut trials: Vec<Trial>) -> Vec<Trial> {
    for trial in &mut trials {
        trial.passes = passes;
    }
    trials
}

/// Distal links in line: stretched as in the paper, with and without rates, and folded onto each other.
pub(super) fn direct(duration: f64) -> Vec<Trial> {
    let mut trials = Vec::new();
    for (omega, assembly) in [
        ([0.0, 0.0], Assembly::Plus),
        ([0.0, 0.0], Assembly::Minus),
        ([3.0, 3.0], Assembly::Plus),
        ([-10.0, -10.0], Assembly::Minus),
    ] {
        let mut parameters = default_parameters();
        (parameters.start.omega, parameters.start.assembly) = (omega, assembly);
        trials.push(Trial::free(format!("distal links stretched, 90/90 deg, omega {omega:?}"), parameters, duration));
    }
    // Coincident elbows, half way between the motors: the distal links can turn together about this point, to any angle.
    for (distal, rate) in [(FRAC_PI_2, 0.0), (0.3, 0.0), (2.0, 5.0), (-2.5, -20.0)] {
        let (theta, omega) = ([0.0, distal, distal, PI], [0.0, rate, rate, 0.0]);
        let label = format!("distal links on each other, theta {theta:?}, omega {omega:?}");
        trials.push(Trial::free(label, default_parameters(), duration).from_links(theta, omega));
    }
    trials
}

/// One leg stretched, one folded, both stretched; passed with nonzero rates.
pub(super) fn inverse(duration: f64) -> Vec<Trial> {
    let geometry = default_parameters().geometry;
    let (length, base) = (geometry.links[0].length, geometry.base_distance);
    let mut trials = Vec::new();
    for angle in [40_f64.to_radians(), -50_f64.to_radians()] {
        for side in [1.0, -1.0] {
            let tip = [2.0 * length * angle.cos(), 2.0 * length * angle.sin()];
            let [right, distal] = leg_to(base, [length; 2], tip, side);
            let theta = [angle, angle, distal, right];
            for left in [[0.0, 0.0], [4.0, -4.0], [-20.0, 15.0]] {
                let [w3, w4] = right_rates(&geometry, theta, left);
                let omega = [left[0], left[1], w3, w4];
                let label = format!("left leg stretched, theta {theta:?}, omega {omega:?}");
                trials.push(Trial::free(label, default_parameters(), duration).from_links(theta, omega));
            }
        }
    }
    for side in [1.0, -1.0] {
        let theta = [side * FRAC_PI_3, side * FRAC_PI_3, side * (PI - FRAC_PI_3), side * (PI - FRAC_PI_3)];
        let label = format!("both legs stretched, theta {theta:?}, at rest");
        trials.push(Trial::free(label, default_parameters(), duration).from_links(theta, [0.0; 4]));
    }
    // Folded: with equal links the tip would be on the motor. A shorter distal link avoids the vertices.
    for angle in [0.5_f64, -1.0] {
        let mut parameters = default_parameters();
        let distal = &mut parameters.geometry.links[1];
        (distal.length, distal.com) = (0.15, 0.075);
        let reach = length - 0.15;
        let tip = [reach * angle.cos(), reach * angle.sin()];
        for side in [1.0, -1.0] {
            let [right, right_distal] = leg_to(base, [length; 2], tip, side);
            let theta = [angle, angle + PI, right_distal, right];
            for left in [[0.0, 0.0], [3.0, -6.0]] {
                let [w3, w4] = right_rates(&parameters.geometry, theta, left);
                let omega = [left[0], left[1], w3, w4];
                let label = format!("left leg folded (distal 0.15 m), theta {theta:?}, omega {omega:?}");
                trials.push(Trial::free(label, parameters.clone(), duration).from_links(theta, omega));
            }
        }
    }
    trials
}

/// Base distance 0 and equal links: legs that coincide and rhombi meet in a continuum of singular postures.
pub(super) fn coaxial(duration: f64) -> Vec<Trial> {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.0;
    let mut trials = Vec::new();
    for (what, theta, omega) in [
        ("rhombus", [1.0, 2.0, 1.0, 2.0], [0.0; 4]),
        ("rhombus with rates", [1.0, 2.0, 1.0, 2.0], [3.0, -4.0, 3.0, -4.0]),
        ("legs on each other", [1.0, 2.0, 2.0, 1.0], [0.0; 4]),
        ("legs on each other with rates", [1.0, 2.0, 2.0, 1.0], [3.0, -4.0, -4.0, 3.0]),
        ("both legs folded, tip on the motors", [1.0, 1.0 + PI, 2.5 + PI, 2.5], [0.0; 4]),
        ("both legs folded, with rates", [1.0, 1.0 + PI, 2.5 + PI, 2.5], [5.0, 5.0, -3.0, -3.0]),
    ] {
        let label = format!("{what}, theta {theta:?}, omega {omega:?}");
        trials.push(Trial::free(label, parameters.clone(), duration).from_links(theta, omega));
    }
    trials
}

/// The coaxial machine with all links on one line, at rest under gravity; every angle of the line is a vertex.
fn rest_in_line(duration: f64) -> Vec<Trial> {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.0;
    let mut trials = Vec::new();
    for line in [0.0, 0.7] {
        for (what, theta) in [("stretched", [line; 4]), ("folded", [line, line + PI, line + PI, line])] {
            let label = format!("{what}, theta {theta:?}");
            trials.push(Trial::free(label, parameters.clone(), duration).from_links(theta, [0.0; 4]));
        }
    }
    trials
}
