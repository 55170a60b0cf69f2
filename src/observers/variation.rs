//! How outputs change, to first order, when a state does: the derivatives of the observers along a [`Variation`].

use nalgebra::Vector2;

use super::{Motion, reactions_of};
use crate::effects::{Change, Effect};
use crate::mechanism::coordinates::{THETA, X, Y};
use crate::mechanism::{Coordinates, Link, MULTIPLIERS};
use crate::simulation::{Model, State, Variation};

/// Singular values closer together than this part of the largest, or smaller, have no derivative of their own: see [`of_smallest`].
const MULTIPLE: f64 = 1e-8;

/// Changes of outputs, in their units.
#[derive(Clone, Debug)]
pub struct OutputChanges {
    /// Of angles, rates, accelerations and points.
    pub motion: Motion,
    /// Of the joint forces.
    pub reactions: [Vector2<f64>; 5],
    /// Of the kinetic energy.
    pub kinetic: f64,
    /// Of the potential energy.
    pub potential: f64,
    /// Of the servo torques.
    pub servo_torques: [f64; 2],
    /// Of the contact force.
    pub contact_force: Vector2<f64>,
    /// Of the distances to singularities.
    pub singularity: SingularityChanges,
}

/// Changes of the determinants and the smallest singular values of J_x and J_q, in the units of [`Singularity`](super::Singularity).
#[derive(Clone, Copy, Debug)]
pub struct SingularityChanges {
    /// Of det J_x.
    pub det_jx: f64,
    /// Of det J_q.
    pub det_jq: f64,
    /// Of the smallest singular value of J_x.
    pub sigma_jx: f64,
    /// Of that of J_q.
    pub sigma_jq: f64,
}

/// How the outputs change with a state.
pub fn output_changes(model: &Model, state: &State, along: &Variation) -> OutputChanges {
    let momentum = model.mechanism.mass_times(&state.core.v);
    let motors = |forces: Coordinates| [forces[THETA[0]], forces[THETA[3]]];
    // What acts on the tip acts on link 2, with its force in the rows of the centre of mass.
    let tip = |forces: Coordinates| Vector2::new(forces[X[1]], forces[Y[1]]);
    OutputChanges {
        motion: motion(model, state, along),
        reactions: reactions_of(&along.lambda),
        kinetic: momentum.iter().zip(&along.change.v).map(|(p, v)| p * v).sum(),
        potential: state.at(model, |at| model.potential_change(at, &along.change)),
        servo_torques: force(model, state, &along.change, |effect| matches!(effect, Effect::Servo(_)))
            .map(motors)
            .unwrap_or_default(),
        contact_force: force(model, state, &along.change, |effect| matches!(effect, Effect::Contact(_)))
            .map(tip)
            .unwrap_or_default(),
        singularity: singularity(model, state, &along.change.q),
    }
}

/// The change of an effect's generalised force; `None` where it is off.
fn force(model: &Model, state: &State, change: &Change, wanted: impl Fn(&Effect) -> bool) -> Option<Coordinates> {
    let effect = model.effects.iter().find(|effect| wanted(effect))?;
    Some(state.at(model, |at| effect.force_change(at, change)))
}

/// Changes of position, velocity and acceleration of a point on a link, `arm` m beyond its centre of mass.
fn point(state: &State, along: &Variation, link: usize, arm: f64) -> [Vector2<f64>; 3] {
    let core = &state.core;
    let (x, v, a) = (&along.change.q, &along.change.v, &along.a);
    let centre = |x: &Coordinates| Vector2::new(x[X[link]], x[Y[link]]);
    let i = THETA[link];
    let (sin, cos) = libm::sincos(core.q[i]);
    let (radial, across) = (Vector2::new(cos, sin) * arm, Vector2::new(-sin, cos) * arm);
    let (omega, alpha) = (core.v[i], core.a[i]);
    [
        centre(x) + across * x[i],
        centre(v) + across * v[i] - radial * (omega * x[i]),
        centre(a) + across * (a[i] - omega * omega * x[i]) - radial * (alpha * x[i] + 2.0 * omega * v[i]),
    ]
}

fn motion(model: &Model, state: &State, along: &Variation) -> Motion {
    let end = |link: usize| {
        let Link { length, com, .. } = model.mechanism.geometry.links[link];
        point(state, along, link, length - com)
    };
    let [tip, tip_velocity, tip_acceleration] = end(1);
    let [left, right] = [end(0), end(3)];
    Motion {
        theta: THETA.map(|i| along.change.q[i]),
        omega: THETA.map(|i| along.change.v[i]),
        alpha: THETA.map(|i| along.a[i]),
        tip,
        tip_velocity,
        tip_acceleration,
        elbows: [left[0], right[0]],
        elbow_velocities: [left[1], right[1]],
        elbow_accelerations: [left[2], right[2]],
    }
}

fn singularity(model: &Model, state: &State, q: &Coordinates) -> SingularityChanges {
    let [l1, l2, l3, l4] = model.mechanism.geometry.links.map(|link| link.length);
    let angles = THETA.map(|i| state.core.q[i]);
    // l l′ sin of the angle from one link to another, and its change.
    let between = |from: usize, to: usize, product: f64| {
        let (sin, cos) = libm::sincos(angles[to] - angles[from]);
        [product * sin, product * cos * (q[THETA[to]] - q[THETA[from]])]
    };
    let [det_jx, det_jx_change] = between(1, 2, l2 * l3);
    let [[left, left_change], [right, right_change]] = [between(0, 1, l1 * l2), between(3, 2, l4 * l3)];
    // Both singular values of J_x from σ_max σ_min = |det|, σ_max² + σ_min² = l₂² + l₃²; the trace does not change.
    let squares = l2 * l2 + l3 * l3;
    let spread = ((squares - 2.0 * det_jx.abs()) * (squares + 2.0 * det_jx.abs())).max(0.0).sqrt();
    let largest = ((squares + spread) / 2.0).sqrt();
    let sigma_jx = if spread > MULTIPLE * squares { largest / spread * sign(det_jx, l2 * l3) * det_jx_change } else { 0.0 };
    SingularityChanges {
        det_jx: det_jx_change,
        det_jq: left_change * right + left * right_change,
        sigma_jx,
        sigma_jq: of_smallest([
            (left.abs(), sign(left, l1 * l2) * left_change),
            (right.abs(), sign(right, l4 * l3) * right_change),
        ]),
    }
}

/// The sign of a value, 0 where it is round-off of its largest.
fn sign(value: f64, largest: f64) -> f64 {
    if value.abs() > MULTIPLE * largest { value.signum() } else { 0.0 }
}

/// The change of the smallest of some singular values, given each with its own change.
///
/// A smallest value that is multiple, or 0, has a kink there; the answer is then the mean of both sides, which is what central
/// differences give and is linear in the direction: the mean of the changes of those that coincide, and 0 at 0.
fn of_smallest<const K: usize>(values: [(f64, f64); K]) -> f64 {
    let (smallest, largest) = values.iter().fold((f64::INFINITY, 0.0_f64), |(low, high), &(x, _)| (low.min(x), high.max(x)));
    let coinciding = || values.iter().filter(|(value, _)| value - smallest <= MULTIPLE * largest);
    coinciding().map(|(_, change)| change).sum::<f64>() / coinciding().count() as f64
}

/// The change of the smallest singular value σ of Φ_q: uᵀ δΦ_q v with its singular vectors. By itself, since it costs more than all the
/// others.
pub fn sigma_phi_change(model: &Model, state: &State, along: &Variation) -> f64 {
    let q = &along.change.q;
    let pose = model.mechanism.pose(&state.core.q);
    let svd = pose.phi_q().svd(true, true);
    let (Some(u), Some(v)) = (svd.u, svd.v_t) else { unreachable!("both have been asked for") };
    let changed = |i: usize| {
        let right: Coordinates = std::array::from_fn(|j| v[(i, j)]);
        let product = pose.phi_q_varied_times(q, &right);
        product.iter().zip(u.column(i).iter()).map(|(x, y)| x * y).sum()
    };
    of_smallest(std::array::from_fn::<_, MULTIPLIERS, _>(|i| (svd.singular_values[i], changed(i))))
}
