//! Passage through a vertex of the configuration space, where the constraints lose rank and branches cross (`docs/vertices.md`).
//!
//! If a motion is within [`PassageLimits::radius`] of a vertex and its impact parameter is below the limit, it continues straight along its
//! ray, a line on the tangent cone, to the other side of the ball. In the ball the equations of motion do not determine the acceleration,
//! and the straight line is the physical continuation. A motion with a larger impact parameter is integrated and turns. Before the ball,
//! steps form a geometric sequence, so that no step jumps over a vertex. A motion from rest exactly in a vertex starts along the branch of
//! least constraint (Gauss).
//!
//! All quantities are in the four link angles. No function here changes a state: [`AngleSystem::approach`] decides, and returns the end of
//! a straight motion.

use super::angles::{ANGLES, AngleSystem, Angles, angles_of};
use super::bifurcation;
use super::five_bar::FiveBar;
use crate::hybrid::Frictional;
use crate::integrator::{
    Approach, Departure, EnergyBalance, Implicit, Passage, PassageLimits, Posed, Projection, StepError, StepLimits, Stuck, System,
    Transit, equilibrium, velocity_correction,
};
use crate::mechanism::{COORDINATES, Coordinates};

/// Offset from a vertex, rad, and rate, rad/s, below which a state is exactly in the vertex and at rest.
const AT_REST: f64 = 1e-9;

/// Distance from a vertex below which the velocity is scaled to conserve energy, rad.
const ENERGY_SCALED_WITHIN: f64 = 1e-2;

/// Factor of e near a vertex.
pub(super) const VERTEX_REGULARIZATION: f64 = 1e-4;

/// Smallest distance, relative to the radius, at which a motion may enter a ray. The geometric sequence always ends a step at least this
/// far from the vertex, so a motion that points to the vertex from nearer is turning around it.
const LEAST_ENTRY_DISTANCE: f64 = 0.2;

/// Distance from a vertex, rad, below which round-off is assumed to stop growing, so that errors stay visible, and nothing is projected.
const UNPROJECTED_WITHIN: f64 = 1e-5;

/// Largest relative energy error of a step close to a vertex that scaling of the velocity may correct. A larger error fails the step.
const LARGEST_ENERGY_CHANGE: f64 = 0.01;

/// Largest variation of the power over a step of high order, relative to the kinetic energy, at which the energy is still corrected.
const LARGEST_POWER_VARIATION: f64 = 1e-6;

/// Kinetic energy, relative to the other energies, below which it is lost in their round-off.
const NEGLIGIBLE_KINETIC_ENERGY: f64 = 1e-9;

/// Round-off of an angle, rad, times its distance from a vertex: ε times the condition number of Φ_q, which grows as 1 / distance. Observed
/// values are up to about 10 ε / distance.
const ANGULAR_ROUND_OFF: f64 = 64.0 * f64::EPSILON;

/// Largest number of iterations for the duration of a ray and its mean acceleration; a few suffice.
const MOST_ITERATIONS: u32 = 20;

/// A straight motion through the ball: one-dimensional, with the acceleration of the forces along it.
struct Ray {
    /// Angles of the vertex, rad.
    vertex: Angles,
    /// Offset of the ray from the vertex, rad, kept during the passage.
    aside: Angles,
    direction: Angles,
    /// Position along the direction, rad; 0 next to the vertex.
    position: f64,
    speed: f64,
    acceleration: f64,
    /// Time until the motion leaves the ball, s; infinite if dissipative forces stop it first.
    duration: f64,
}

impl Passage<ANGLES> for AngleSystem<'_> {
    fn approach(&self, limits: &PassageLimits, from: &Departure<'_, ANGLES>) -> Approach<ANGLES> {
        let turn = self.model().turn_in_line;
        match self.offset(from.q) {
            // A machine that friction keeps at rest passes nothing.
            Some(_) if self.stuck() == Stuck::Wholly => Approach::Clear,
            // A motion that turns within the ball would not follow the tangent cone.
            Some(offset) if turn.is_none_or(|turn| turn > limits.radius) => self.approach_vertex(limits, from, offset),
            _ => match turn {
                Some(turn) => {
                    Approach::Limited(StepLimits { longest: bifurcation::longest_step(turn, [from.q, from.v]), ..StepLimits::NONE })
                }
                None => Approach::Clear,
            },
        }
    }

    fn energy_scale(&self, before: &EnergyBalance, q: &Angles, v: &Angles, h: f64) -> Result<f64, StepError> {
        self.energy_scale_unless(LARGEST_POWER_VARIATION, before, [q, v], h)
    }

    fn can_project(&self, q: &Angles) -> bool {
        self.offset(q).is_none_or(|offset| offset.dot(&offset) >= UNPROJECTED_WITHIN * UNPROJECTED_WITHIN)
    }

    fn energy_to_keep(&self, q: &Angles, v: &Angles) -> Option<EnergyBalance> {
        (!self.can_project(q)).then(|| self.energy_balance(q, v))
    }

    fn is_near_vertex(&self, q: &Angles) -> bool {
        self.offset(q).is_some()
    }

    fn acceleration_from_rest(&self, q: &Angles, v: &Angles) -> Option<Angles> {
        if self.offset(q)?.norm() >= AT_REST || v.norm() > 0.0 || self.stuck() == Stuck::Wholly {
            return None;
        }
        let (direction, _) = self.branch_of_least_constraint(q)?;
        Some(self.acceleration_along(q, &direction, 0.0) * direction)
    }
}

impl AngleSystem<'_> {
    /// Factor of the rates that restores the energy balance; an error if it differs too much from 1. The factor is 1 if the kinetic energy
    /// is lost in round-off, if the work is too large, or if the power varies too much for the trapezoidal rule to be better than the step.
    fn energy_scale_unless(&self, varied: f64, before: &EnergyBalance, [q, v]: [&Angles; 2], h: f64) -> Result<f64, StepError> {
        let [kinetic, potential, power] = self.energies(q, v);
        let (work, varies) = (h / 2.0 * (before.power + power), h * (power - before.power).abs() > varied * kinetic);
        if kinetic <= NEGLIGIBLE_KINETIC_ENERGY * before.energy.abs().max(potential.abs())
            || work.abs() > LARGEST_ENERGY_CHANGE * kinetic
            || varies
        {
            return Ok(1.0);
        }
        let part = (before.energy + work - potential) / kinetic - 1.0;
        if part.abs() > LARGEST_ENERGY_CHANGE { Err(StepError::EnergyChange { part }) } else { Ok((1.0 + part).sqrt()) }
    }

    /// Passage or step limits near a vertex at this offset.
    fn approach_vertex(&self, limits: &PassageLimits, from: &Departure<'_, ANGLES>, offset: Angles) -> Approach<ANGLES> {
        let (distance, speed) = (offset.norm(), from.v.norm());
        let limited = |longest: f64| {
            Approach::Limited(StepLimits {
                longest,
                round_off: ANGULAR_ROUND_OFF / distance.max(UNPROJECTED_WITHIN),
                regularization: VERTEX_REGULARIZATION,
                energy: (distance < ENERGY_SCALED_WITHIN).then(|| self.energy_balance(from.q, from.v)),
            })
        };
        if distance < AT_REST && speed < AT_REST && !(from.on_ray && speed > 0.0) {
            return self.leave_from_rest(limits, from, offset);
        }
        if speed == 0.0 || speed < AT_REST && !from.on_ray {
            return limited(f64::INFINITY);
        }
        let direction = *from.v / speed;
        let position = offset.dot(&direction);
        let aside = offset - position * direction;
        let impact_parameter = aside.norm();
        if distance > limits.radius {
            let ahead = -position / speed;
            return limited(if ahead > 0.0 && impact_parameter < 0.1 * distance { 0.75 * ahead } else { f64::INFINITY });
        }
        // Inside the ball, a ray comes from outside, starts in the vertex, or continues from the last macro step.
        let reach = (limits.radius * limits.radius - impact_parameter * impact_parameter).max(0.0).sqrt();
        let entering = position < -LEAST_ENTRY_DISTANCE * limits.radius;
        let starting = position > -AT_REST && position < 0.5 * reach && impact_parameter < AT_REST;
        if impact_parameter > limits.impact_parameter || !(entering || starting || from.on_ray) {
            return limited(f64::INFINITY);
        }
        let rest = self.rest(limits, from);
        let Some((acceleration, duration)) = self.along(from.q, &direction, [position, reach, speed], rest) else {
            return limited(f64::INFINITY);
        };
        // Forces across the ray must displace the motion by less than the impact parameter. A start from rest is already on its branch.
        let (pull, ..) = equilibrium(self, Posed { q: from.q, pose: &self.pose(from.q), v: &Angles::ZERO }, self.regularization());
        if !from.on_ray && 0.5 * self.error_norm(&pull) * duration * duration > limits.impact_parameter {
            return limited(f64::INFINITY);
        }
        let ray = Ray { vertex: *from.q - offset, aside, direction, position, speed, acceleration, duration };
        self.transit(from, &ray, rest).map_or(Approach::Limited(StepLimits::NONE), Approach::Passed)
    }

    /// Departure from rest in a vertex along the branch of least constraint, or none.
    fn leave_from_rest(&self, limits: &PassageLimits, from: &Departure<'_, ANGLES>, offset: Angles) -> Approach<ANGLES> {
        let rest = self.rest(limits, from);
        let branch = self.branch_of_least_constraint(from.q);
        let alternatives = branch.map_or(0, |(_, alternatives)| alternatives);
        let along_branch = branch.and_then(|(direction, _)| {
            let (acceleration, duration) = self.along(from.q, &direction, [0.0, limits.radius, 0.0], rest)?;
            Some((direction, acceleration, duration))
        });
        let (direction, acceleration, duration) = along_branch.unwrap_or((Angles::ZERO, 0.0, f64::INFINITY));
        let vertex = *from.q - offset;
        let ray = Ray { vertex, aside: Angles::ZERO, direction, position: 0.0, speed: 0.0, acceleration, duration };
        self.transit(from, &ray, rest).map_or(Approach::Clear, |transit| {
            Approach::Passed(Transit { from_rest: Some((acceleration > 0.0, alternatives)), ..transit })
        })
    }

    /// Longest duration of a straight motion, s.
    fn rest(&self, limits: &PassageLimits, from: &Departure<'_, ANGLES>) -> f64 {
        if self.model().conservative { from.rest } else { from.rest.min(limits.longest_with_dissipation) }
    }

    /// Motion along a ray to the boundary of the ball, or for `rest` seconds. Inside the ball nothing is projected: the error of Φ is of
    /// the order of impact parameter × radius, and near the loss of rank a projection would divide round-off by the smallest singular
    /// value.
    ///
    /// `None` if leaving the ball would change the energy, or if, with unilateral springs in the scene, the forces without potential would
    /// change it much: such a motion is not on a ray.
    fn transit(&self, from: &Departure<'_, ANGLES>, ray: &Ray, rest: f64) -> Option<Transit<ANGLES>> {
        let &Ray { vertex, aside, direction, position, speed, acceleration, .. } = ray;
        let (duration, leaves) = (ray.duration.min(rest), ray.duration <= rest);
        let ahead = position + duration * (speed + 0.5 * acceleration * duration);
        let mut q = vertex + aside + ahead * direction;
        let mut v = (speed + acceleration * duration) * direction;
        if leaves {
            let (_, pose) = self.projection().position(self, &mut q).ok()?;
            v += velocity_correction(self, &pose, &self.factor_mass(&pose, self.regularization()), &v);
        }
        // The energy determines the rate along the ray better than the acceleration does, which was taken as constant.
        let before = self.energy_balance(from.q, from.v);
        let scale = self.energy_scale_unless(f64::INFINITY, &before, [&q, &v], duration).ok()?;
        let [kinetic, _, power] = self.energies(&q, &v);
        if self.model().has_kinks && duration * before.power.abs().max(power.abs()) > LARGEST_ENERGY_CHANGE * kinetic {
            return None;
        }
        let passed = position < 0.0 && ahead >= 0.0;
        Some(Transit { q, v: scale * v, duration, on_ray: !leaves, passed, from_rest: None, known: None })
    }

    /// Mean acceleration along a ray until it leaves the ball, rad/s², and the time until then, s: infinite if dissipative forces stop the
    /// motion inside. `None` if other forces reverse it.
    fn along(&self, q: &Angles, direction: &Angles, [position, reach, speed]: [f64; 3], rest: f64) -> Option<(f64, f64)> {
        let acceleration_at = |speed: f64| self.acceleration_along(q, direction, speed);
        let mut acceleration = acceleration_at(speed);
        if self.model().conservative {
            return Some((acceleration, time_to_boundary(reach, position, speed, acceleration)?));
        }
        // Friction may be stiff: a = f(v + a t) (implicit Euler) is solved by bisection between 0 and f(v), in turn with t from a.
        let at_start = acceleration;
        let (mut duration, mut last) = (f64::INFINITY, f64::NAN);
        for _ in 0..MOST_ITERATIONS {
            duration = time_to_boundary(reach, position, speed, acceleration).unwrap_or(f64::INFINITY);
            let t = duration.min(rest);
            if t == last {
                break;
            }
            last = t;
            let (mut none, mut whole) = (0.0, at_start);
            for _ in 0..f64::MANTISSA_DIGITS {
                acceleration = (none + whole) / 2.0;
                let sufficient = acceleration_at(speed + t * acceleration) / acceleration <= 1.0;
                *(if sufficient { &mut whole } else { &mut none }) = acceleration;
            }
        }
        Some((acceleration, duration))
    }

    /// Acceleration of the forces along a direction on the tangent cone, rad/s², at a speed along it, rad/s.
    fn acceleration_along(&self, q: &Angles, direction: &Angles, speed: f64) -> f64 {
        let pose = self.pose(q);
        self.forces(q, &pose, &(speed * *direction)).0.dot(direction) / self.mass_times(&pose, direction).dot(direction)
    }

    fn energy_balance(&self, q: &Angles, v: &Angles) -> EnergyBalance {
        let [kinetic, potential, power] = self.energies(q, v);
        EnergyBalance { energy: kinetic + potential, power }
    }

    /// Projection onto the closure down to round-off.
    fn projection(&self) -> Projection {
        let model = self.model();
        Projection::to_round_off(model.length_scale, self.regularization(), model.settings.max_iterations)
    }
}

/// First time at which position + speed t + acceleration t²/2 equals `reach`, s, if any.
fn time_to_boundary(reach: f64, position: f64, speed: f64, acceleration: f64) -> Option<f64> {
    let discriminant = speed * speed + 2.0 * acceleration * (reach - position);
    (discriminant > 0.0).then(|| 2.0 * (reach - position) / (speed + discriminant.sqrt())).filter(|time| *time > 0.0)
}

/// Passage in the twelve coordinates: converted to the link angles and back.
impl<const BARE: bool> Passage<COORDINATES> for FiveBar<'_, BARE> {
    fn approach(&self, limits: &PassageLimits, from: &Departure<'_, COORDINATES>) -> Approach<COORDINATES> {
        let by_angles = AngleSystem::new(self.general());
        let (q, v) = (angles_of(from.q), angles_of(from.v));
        match by_angles.approach(limits, &Departure { q: &q, v: &v, on_ray: from.on_ray, rest: from.rest }) {
            Approach::Clear => Approach::Clear,
            Approach::Limited(limits) => Approach::Limited(limits),
            Approach::Passed(Transit { q, v, duration, on_ray, passed, from_rest, .. }) => {
                let (q, v) = by_angles.coordinates(&by_angles.pose(&q), &q, &v);
                Approach::Passed(Transit { q, v, duration, on_ray, passed, from_rest, known: None })
            }
        }
    }

    fn is_near_bifurcation(&self, q: &Coordinates, v: &Coordinates, h: f64) -> bool {
        bifurcation::is_near(self.model, [&angles_of(q), &angles_of(v)], h)
    }

    fn must_cross(&self, q: &Coordinates, v: &Coordinates, h: f64, longest: f64) -> Option<f64> {
        bifurcation::must_cross(self, [q, v], h, longest)
    }

    fn energy_scale(&self, before: &EnergyBalance, q: &Coordinates, v: &Coordinates, h: f64) -> Result<f64, StepError> {
        AngleSystem::new(self.general()).energy_scale_unless(f64::INFINITY, before, [&angles_of(q), &angles_of(v)], h)
    }

    fn is_near_vertex(&self, q: &Coordinates) -> bool {
        AngleSystem::new(self.general()).is_near_vertex(&angles_of(q))
    }

    fn acceleration_from_rest(&self, q: &Coordinates, v: &Coordinates) -> Option<Coordinates> {
        let (by_angles, q) = (AngleSystem::new(self.general()), angles_of(q));
        let a = by_angles.acceleration_from_rest(&q, &angles_of(v))?;
        Some(by_angles.coordinates(&by_angles.pose(&q), &q, &a).1)
    }
}
