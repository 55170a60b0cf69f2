//! Crossing of a bifurcation of the closure with coaxial motors, a posture with all links in line. The twelve coordinates may fail there,
//! but the link angles on a closure branch are regular. If the method of a run is blocked there, the run takes one sub-step in the link
//! angles.

use super::angles::{AngleSystem, Angles, LINK_INDICES, angles_of, legs};
use super::five_bar::FiveBar;
use super::model::Model;
use super::state::Core;
use crate::integrator::dense::{DenseStep, Horizon, Schemes, Settings};
use crate::integrator::{Events, Posed, Transit, equilibrium};
use crate::mechanism::COORDINATES;

/// Distance from all links in line, rad, below which the twelve coordinates may fail.
const NEAR_BIFURCATION: f64 = 1e-2;

/// Largest number of evaluations of a step across a bifurcation.
const MOST_WORK: u32 = 20_000;

/// Smallest error tolerance of that step, rad. At its start the closure determines rates only to round-off divided by the distance from the
/// bifurcation. With a smaller tolerance, dense output would contradict such a start.
const LEAST_TOLERANCE: f64 = 1e-10;

/// Whether a step of h seconds from these angles and rates begins or ends near a bifurcation.
pub(super) fn is_near(model: &Model, [q, v]: [&Angles; 2], h: f64) -> bool {
    model.mechanism.geometry.base_distance == 0.0
        && angle_to_bifurcation(&(*q + h * *v)).min(angle_to_bifurcation(q)) <= NEAR_BIFURCATION
}

/// Distance from all links in line: the larger sine of two angles, at the left elbow and between the proximal links.
fn angle_to_bifurcation(q: &Angles) -> f64 {
    let [left, elbow, _, right] = LINK_INDICES;
    f64::max(libm::sin(q[elbow] - q[left]).abs(), libm::sin(q[right] - q[left]).abs())
}

/// Step of h seconds along a closure branch, integrated in the link angles; `None` if the motion is on no branch or the step fails.
pub(super) fn crossing(system: FiveBar<'_>, from: &Core, h: f64) -> Option<Transit<COORDINATES>> {
    let (system, model) = (AngleSystem::new(system), system.model);
    let settings = Settings {
        schemes: Schemes::Automatic,
        error_tolerance: model.settings.error_tolerance.max(LEAST_TOLERANCE),
        energy_scale: f64::INFINITY,
        first_step: h,
        max_iterations: model.settings.max_iterations,
        max_work: MOST_WORK,
        regularization: model.regularization_by_angles,
    };
    let mut step = DenseStep::start(&system, angles_of(&from.q), angles_of(&from.v), &settings);
    step.mode().closure_branch?;
    step.advance(&system, &settings, h, Horizon { output: f64::INFINITY, limit: h }, None).ok()?;
    let sample = step.sample(&system, &settings);
    let on_branch = system.on(step.mode());
    let (a, ..) = equilibrium(&*on_branch, Posed { q: &sample.q, pose: &sample.pose, v: &sample.v }, settings.regularization);
    let (q, v) = system.coordinates(&sample.pose, &sample.q, &sample.v);
    let a = sample.pose.velocities(legs(&a)) + sample.pose.centripetal(legs(&sample.v));
    Some(Transit { q, v, duration: h, on_ray: false, passed: false, from_rest: None, known: Some((a, sample.work)) })
}
