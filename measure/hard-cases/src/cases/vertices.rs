//! Item 2 of the battery: the four vertices: exact crossings, near misses, and the branch with one degree of freedom. No gravity.

use std::f64::consts::{PI, TAU};

use fivebar::mechanism::coordinates::THETA;
use rayon::prelude::*;

use super::{Case, Conserving, Extent};
use crate::machine::{closed, weightless};
use crate::setting::Setting;
use crate::trial::{Ending, Trial};
use crate::vertex::{POSTURES, Vertex};
use crate::watch::Watch;

/// Time from the start to the vertex, s.
const APPROACH: f64 = 0.05;

/// Independent check of near misses: another method, without error control and without special treatment of vertices.
const INDEPENDENT: Setting = Setting::Rk4(1e-6);

pub(super) fn cases(extent: Extent) -> Vec<Case> {
    vec![crossings(extent), near_misses(extent), close_misses(extent), one_degree_of_freedom()]
}

/// Angles and rates that lead to the vertex after [`APPROACH`], arriving with `rates`: the reversed motion from the vertex.
fn approach(vertex: Vertex, rates: [f64; 4]) -> ([f64; 4], [f64; 4]) {
    let away = Trial::free("", weightless(), APPROACH).from_links(vertex.theta, rates.map(|rate| -rate));
    let outcome = away.run(Setting::REFERENCE);
    assert_eq!(outcome.ending, Ending::Complete, "the motion away from {} at {rates:?} rad/s", vertex.name);
    let core = outcome.state.expect("a run that has ended").core;
    (THETA.map(|i| core.q[i]), THETA.map(|i| -core.v[i]))
}

/// 4 vertices, 20 directions on the cone, 3 rates of the odd link: 50 ms back from the vertex, velocity reversed, 100 ms forward, all with
/// one setting. The vertex is thus met exactly, up to round-off and irreversibility of the method.
pub(super) fn crossings(extent: Extent) -> Case {
    let directions = extent.pick(20_u32, 2);
    let mut trials = Vec::new();
    for vertex in POSTURES {
        for rate in [2.0, 10.0, 40.0] {
            for k in 0..directions {
                let direction = vertex.direction(TAU * (f64::from(k) + 0.5) / f64::from(directions));
                let away = direction.map(|part| -part * rate);
                let label = format!("vertex {}, {APPROACH} s from it at {away:?} rad/s, turned round", vertex.name);
                let mut trial = Trial::free(label, weightless(), 2.0 * APPROACH).from_links(vertex.theta, away);
                trial.turned_after = APPROACH;
                trial.vertex_outputs = true;
                // About 0.03 rad on each side.
                let margin = f64::max(1e-3, 0.02 / rate);
                trial.watch = Watch::Crosses { vertex, direction, between: [APPROACH - margin, APPROACH + margin] };
                trials.push(trial);
            }
        }
    }
    Case {
        also: "crosses",
        conserving: Conserving { energy: 1e-9, ..Conserving::USUAL },
        ..Case::new(2, "exact crossings", [1e-2, 1e-2], trials)
    }
}

/// Near misses by 1e-2 or 1e-3 rad: the motion turns back before the vertex and follows the solution of i3-ALP at 1e-11 rad. At 2 and
/// 10 rad/s Runge-Kutta steps of 1 µs check the end; at 40 rad/s their own energy error is too large.
fn near_misses(extent: Extent) -> Case {
    let directions = extent.pick(5_u32, 1);
    let mut places = Vec::new();
    for vertex in POSTURES {
        for rate in [2.0, 10.0, 40.0] {
            for miss in [1e-2, 1e-3] {
                places.extend((0..directions).map(|k| (vertex, TAU * (f64::from(k) + 0.5) / f64::from(directions), rate, miss)));
            }
        }
    }
    let trials = places.into_par_iter().map(|(vertex, f, rate, miss)| near_miss(vertex, f, rate, miss)).collect();
    Case {
        conserving: Conserving { path: false, ..Conserving::USUAL },
        also: "turns, stays within 1e-2 rad of the tight solution, ends within 1e-2 rad of RK4 at 1 us (2, 10 rad/s)",
        ..Case::new(2, "near misses", [1e-2, 1e-2], trials)
    }
}

fn near_miss(vertex: Vertex, f: f64, rate: f64, miss: f64) -> Trial {
    let mut trial = beside(vertex, f, rate, miss);
    let within = 1e-2;
    // About half a radian on each side.
    let margin = f64::min(0.5 / rate, APPROACH);
    let between = [APPROACH - margin, APPROACH + margin];
    trial.watch = Watch::Turns { vertex, between, reference: Vec::new(), witness: None, within };
    let complete = |setting: Setting| {
        let outcome = trial.run(setting);
        assert_eq!(outcome.ending, Ending::Complete, "the reference of {}", trial.label);
        outcome
    };
    let reference = complete(Setting::REFERENCE).path;
    let witness = (rate < 40.0).then(|| {
        let end = complete(INDEPENDENT).state.expect("a run that has ended");
        end.angles()
    });
    trial.watch = Watch::Turns { vertex, between, reference, witness, within };
    trial
}

/// 50 ms towards the vertex, offset by `miss` rad from the straight line through it, and 50 ms beyond.
fn beside(vertex: Vertex, f: f64, rate: f64, miss: f64) -> Trial {
    let (direction, across) = (vertex.direction(f), vertex.across(f));
    let (exact, omega) = approach(vertex, direction.map(|part| part * rate));
    let aside = std::array::from_fn(|i| exact[i] + miss * across[i]);
    let (theta, omega) = closed(&weightless().geometry, aside, omega);
    let label = format!(
        "vertex {}, {rate} rad/s, direction {direction:?}, {miss:e} rad aside: theta {theta:?}, omega {omega:?}",
        vertex.name
    );
    Trial::free(label, weightless(), 2.0 * APPROACH).from_links(theta, omega)
}

/// Misses by 1e-4 to 1e-7 rad, between a near miss and an exact crossing: either branch is acceptable, but no silent error.
fn close_misses(extent: Extent) -> Case {
    let directions = extent.pick(5_u32, 1);
    let mut trials = Vec::new();
    for vertex in POSTURES {
        for rate in [2.0, 10.0, 40.0] {
            for miss in [1e-4, 1e-5, 1e-6, 1e-7] {
                for k in 0..directions {
                    let mut trial = beside(vertex, TAU * (f64::from(k) + 0.5) / f64::from(directions), rate, miss);
                    trial.vertex_outputs = true;
                    trials.push(trial);
                }
            }
        }
    }
    Case { status_allowed: true, ..Case::new(2, "close misses", [1e-2, 1e-2], trials) }
}

/// A folded leg turns about its motor while the other leg is stretched and at rest: a vertex at every half turn.
fn one_degree_of_freedom() -> Case {
    let mut trials = Vec::new();
    for vertex in POSTURES {
        let left = (vertex.theta[1] - vertex.theta[0]).abs() == PI;
        let turning = if left { [1.0, 1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0, 1.0] };
        for rate in [10.0, -10.0] {
            let omega = turning.map(|part| part * rate);
            let mut trial = Trial::free(format!("vertex {}, omega {omega:?}", vertex.name), weightless(), 2.0);
            trial.watch = Watch::Stays { links: turning.map(|part| part == 0.0), within: 1e-6 };
            trials.push(trial.from_links(vertex.theta, omega));
        }
    }
    Case { also: "the other leg stays within 1e-6 rad", ..Case::new(2, "branch with one degree of freedom", [1e-2, 1e-2], trials) }
}
