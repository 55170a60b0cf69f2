//! Steps near a bifurcation of the closure with coaxial motors, a posture with all links in line. The twelve coordinates resolve neither
//! the branch of the closure nor friction that sticks there, but the link angles on a closure branch are regular. So `i3alp` and the
//! conserving method leave steps of a motion on a branch to this file.
//!
//! A machine with lengths nearly equal in pairs, or motors nearly coaxial, has no branches: its motion turns beside the posture, within the
//! square root of the difference. Error estimates do not see a turn that a step jumps over, so steps are limited by the distance.

use super::angles::{AngleSystem, Angles, LINK_INDICES, angles_of, legs};
use super::five_bar::FiveBar;
use super::model::Model;
use super::state::Core;
use crate::integrator::dense::{DenseStep, Horizon, Schemes, Settings};
use crate::integrator::{EnergyBalance, Events, Passage, Posed, Transit, equilibrium};
use crate::mechanism::coordinates::angles_by_leg;
use crate::mechanism::{COORDINATES, ClosureBranch, Coordinates, TOLERANCE_OF_TURN};

/// Angular distance from the posture with all links in line, rad. Below it, the twelve coordinates may fail.
const NEAR_BIFURCATION: f64 = 1e-2;

/// Angular distance from the posture with all links in line, rad. Below it, a step of the conserving method may leave its branch.
const LEAST_DISTANCE: f64 = 1e-4;

/// Longest step in the link angles, s, so that its work stays small.
const LONGEST: f64 = 5e-3;

/// Largest number of evaluations of a step across a bifurcation.
const MOST_WORK: u32 = 20_000;

/// Smallest error tolerance of a step across a bifurcation, rad, unless friction may stick and a step with the tolerance of the run
/// succeeds. At its start the closure determines rates only to round-off divided by the distance from the bifurcation. With a smaller
/// tolerance, dense output would contradict such a start.
const LEAST_TOLERANCE: f64 = 1e-10;

/// Longest way of a step relative to its distance from the posture with all links in line, or to the distance at which the motion turns.
const LARGEST_WAY: f64 = 0.5;

/// Longest step, s, of a machine that turns within `turn` of the posture with all links in line: no step jumps over the turn.
#[cold]
pub(super) fn longest_step(turn: f64, [q, v]: [&Angles; 2]) -> f64 {
    LARGEST_WAY * angle_to_bifurcation(q).max(turn) / turning_rate(v)
}

/// Whether a step of h seconds from these angles and rates begins or ends near a bifurcation.
pub(super) fn is_near(model: &Model, [q, v]: [&Angles; 2], h: f64) -> bool {
    model.mechanism.geometry.base_distance == 0.0
        && angle_to_bifurcation(&(*q + h * *v)).min(angle_to_bifurcation(q)) <= NEAR_BIFURCATION
}

/// Distance from the posture with all links in line: the larger sine of two angles, at the left elbow and between the proximal links.
fn angle_to_bifurcation(q: &Angles) -> f64 {
    let [left, elbow, _, right] = LINK_INDICES;
    f64::max(libm::sin(q[elbow] - q[left]).abs(), libm::sin(q[right] - q[left]).abs())
}

/// Largest rate, rad/s, of the two angles in [`angle_to_bifurcation`].
fn turning_rate(v: &Angles) -> f64 {
    let [left, elbow, _, right] = LINK_INDICES;
    f64::max((v[elbow] - v[left]).abs(), (v[right] - v[left]).abs())
}

/// Length of a step, s, of at most `longest`, from coordinates and velocities on a closure branch so near its bifurcation that steps of `h`
/// seconds in the twelve coordinates may fail or leave the branch. Nor do the twelve coordinates resolve friction there, because the
/// closure of the tip constrains one direction only in proportion to the square of the distance.
pub(super) fn must_cross<const BARE: bool>(
    system: &FiveBar<'_, BARE>,
    [q, v]: [&Coordinates; 2],
    h: f64,
    longest: f64,
) -> Option<f64> {
    is_within(system, NEAR_BIFURCATION, [q, v], h).then_some(longest.min(LONGEST))
}

/// Whether a step of `h` seconds of the conserving method may leave its closure branch.
pub(super) fn may_leave_branch<const BARE: bool>(system: &FiveBar<'_, BARE>, at: [&Coordinates; 2], h: f64) -> bool {
    is_within(system, LEAST_DISTANCE, at, h)
}

/// Whether a motion on a closure branch is within a distance, rad, of a bifurcation, or comes there within `h` seconds.
#[inline(always)]
fn is_within<const BARE: bool>(system: &FiveBar<'_, BARE>, distance: f64, at: [&Coordinates; 2], h: f64) -> bool {
    let Model { mechanism, turn_in_line, .. } = system.model;
    (mechanism.geometry.base_distance == 0.0 || turn_in_line.is_some()) && is_on_branch_within(system.model, distance, at, h)
}

#[cold]
fn is_on_branch_within(model: &Model, distance: f64, [q, v]: [&Coordinates; 2], h: f64) -> bool {
    let [by_leg, rates] = [q, v].map(angles_by_leg);
    let (q, v) = (angles_of(q), angles_of(v));
    angle_to_bifurcation(&q) <= distance.max(h * turning_rate(&v))
        && (model.turn_in_line.is_some_and(|turn| turn <= NEAR_BIFURCATION)
            || ClosureBranch::of(&model.mechanism.geometry, by_leg, rates).is_some())
}

/// Step of h seconds along a closure branch, integrated in the link angles; `None` if the motion is on no branch or the step fails.
pub(super) fn crossing(system: FiveBar<'_>, from: &Core, h: f64) -> Option<Transit<COORDINATES>> {
    let model = system.model;
    let tolerance = model.settings.error_tolerance;
    // The rate below which a joint may stick follows the tolerance of the run. A step with a larger tolerance leaves faster rates where a
    // slip ends, so the joint never sticks and events have no end.
    let with_sticking =
        if model.features.may_stick && tolerance < LEAST_TOLERANCE { crossing_within(system, from, h, tolerance) } else { None };
    let largest = model.turn_in_line.map_or(0.0, |turn| TOLERANCE_OF_TURN * turn);
    let least = tolerance.max(LEAST_TOLERANCE);
    // Round-off may exceed the tolerance where a motion turns.
    let tolerances = std::iter::successors(Some(least), |last| Some(10.0 * last).filter(|next| *next <= largest));
    with_sticking.or_else(|| tolerances.into_iter().find_map(|tolerance| crossing_within(system, from, h, tolerance)))
}

/// Step of [`crossing`] with an error tolerance, rad.
fn crossing_within(system: FiveBar<'_>, from: &Core, h: f64, error_tolerance: f64) -> Option<Transit<COORDINATES>> {
    let (system, model) = (AngleSystem::new(system), system.model);
    let settings = Settings {
        schemes: Schemes::Automatic,
        error_tolerance,
        energy_scale: f64::INFINITY,
        first_step: h,
        max_iterations: model.settings.max_iterations,
        max_work: MOST_WORK,
        regularization: model.regularization_by_angles,
    };
    let mut step = DenseStep::start(&system, angles_of(&from.q), angles_of(&from.v), &settings);
    if model.turn_in_line.is_none() {
        step.mode().closure_branch?;
    }
    step.advance(&system, &settings, h, Horizon { output: f64::INFINITY, limit: h }, None).ok()?;
    let sample = step.sample(&system, &settings);
    let on_branch = system.on(step.mode());
    let (a, ..) = equilibrium(&*on_branch, Posed { q: &sample.q, pose: &sample.pose, v: &sample.v }, settings.regularization);
    let (q, v) = system.coordinates(&sample.pose, &sample.q, &sample.v);
    let a = sample.pose.velocities(legs(&a)) + sample.pose.centripetal(legs(&sample.v));
    Some(Transit { q, v, duration: h, on_ray: false, passed: false, from_rest: None, known: Some((a, sample.work)) })
}

/// Step of [`crossing`] with its rates scaled to the energy if no force dissipates it.
pub(super) fn conserving_crossing(system: FiveBar<'_>, from: &Core, h: f64) -> Option<Transit<COORDINATES>> {
    let transit = crossing(system, from, h)?;
    if !system.model.conservative {
        return Some(transit);
    }
    let [kinetic, potential, power] = AngleSystem::new(system).energies(&angles_of(&from.q), &angles_of(&from.v));
    let before = EnergyBalance { energy: kinetic + potential, power };
    let scale = system.energy_scale(&before, &transit.q, &transit.v, h).ok()?;
    Some(Transit { v: scale * transit.v, ..transit })
}
