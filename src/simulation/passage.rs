//! Through a vertex of the configuration space, where the constraints lose rank and branches cross (`docs/vertices.md`).
//!
//! A motion that comes within [`PassageLimits::radius`] of a vertex on a ray through it (missing it by less than the impact parameter)
//! goes straight on along the ray, a line on the tangent cone, to the other side of the ball: there and only there the equations of
//! motion do not say where it goes, and continuing straight is its physical continuation. A motion that misses the vertex by more is
//! resolved and turns. On the way in, steps become a geometric sequence, so that no step jumps over a vertex unseen. From rest exactly
//! in a vertex the motion starts along the branch of least constraint (Gauss).
//!
//! All of it is in the four link angles. Nothing here changes a state: [`ByAngles::approach`] decides, and says where a straight motion
//! ends.

use std::borrow::Borrow;

use super::angles::{ANGLES, Angles, ByAngles, PLACES, angles_of};
use super::five_bar::FiveBar;
use crate::integrator::dense::{DenseStep, Horizon, Schemes, Settings};
use crate::integrator::{
    Approach, Departure, EnergyBalance, Events, Passage, PassageLimits, Projection, StepError, StepLimits, System, Transit,
    equilibrium, velocity_correction,
};
use crate::mechanism::{COORDINATES, Coordinates};

/// Below these offsets (rad) and rates (rad/s) a state is exactly in a vertex, or on a ray, and at rest.
const AT_REST: f64 = 1e-9;

/// Closer than this, rad, energy is kept by scaling the velocity.
const CLOSE: f64 = 1e-2;

/// By how much e is smaller near a vertex.
pub(super) const REGULARIZATION: f64 = 1e-4;

/// A motion on a ray is caught when it enters the ball: the steps on the way in leave at least this part of its radius. Deeper
/// inside, a motion that points at the vertex is one that is turning around it.
const ENTRY: f64 = 0.2;

/// Nearer than this, rad, round-off is not taken to be larger still (no error passes unseen), and nothing is projected.
const NEAREST: f64 = 1e-5;

/// Largest part of the kinetic energy by which a step close to a vertex may be off before it is put right.
const ENERGY_CHANGE: f64 = 0.01;

/// Largest part of it by which the power over a step of high order may vary for that.
const VARIED: f64 = 1e-6;
/// With coaxial motors, nearer than this to a posture with all links in line, rad, the twelve coordinates may fail.
const NEAR_BIFURCATION: f64 = 1e-2;

/// Most evaluations of the way past it.
const MOST_WORK: u32 = 20_000;

/// A kinetic energy below this part of the others is lost in their round-off.
const LOST: f64 = 1e-9;

/// Round-off of an angle at distance 1 from a vertex, rad (errors of up to some 10 ε / distance are seen): ε divided by the smallest
/// singular value of Φ_q relative to its largest, which is proportional to the distance.
const ANGULAR_ROUND_OFF: f64 = 64.0 * f64::EPSILON;

/// Most rounds in which the time along a ray and the acceleration on the way settle.
const ROUNDS: u32 = 20;

/// A straight motion through the ball: one-dimensional, with the acceleration that the forces have along it.
struct Ray {
    /// The vertex.
    vertex: Angles,
    /// Displacement from the vertex that the motion misses it by, kept on the way.
    aside: Angles,
    direction: Angles,
    /// Place along the direction, 0 next to the vertex, rad.
    position: f64,
    speed: f64,
    acceleration: f64,
    /// How long it takes to leave the ball, s; infinite if forces that fall with the speed stop it before.
    duration: f64,
}

impl Passage<ANGLES> for ByAngles<'_> {
    #[inline]
    fn approach(&self, limits: &PassageLimits, from: &Departure<'_, ANGLES>) -> Approach<ANGLES> {
        match self.offset(from.q) {
            // What friction holds there stays.
            Some(_) if self.is_at_rest() => Approach::Clear,
            Some(offset) => self.near(limits, from, offset),
            None => Approach::Clear,
        }
    }

    fn energy_scale(&self, before: &EnergyBalance, q: &Angles, v: &Angles, h: f64) -> Result<f64, StepError> {
        self.energy_scale_unless(VARIED, before, [q, v], h)
    }

    #[inline]
    fn can_project(&self, q: &Angles) -> bool {
        self.offset(q).is_none_or(|offset| offset.dot(&offset) >= NEAREST * NEAREST)
    }

    #[cold]
    #[inline(never)]
    fn energy_to_keep(&self, q: &Angles, v: &Angles) -> Option<EnergyBalance> {
        (!self.can_project(q)).then(|| self.energy_balance(q, v))
    }

    #[inline]
    fn is_near_vertex(&self, q: &Angles) -> bool {
        self.offset(q).is_some()
    }

    fn acceleration_from_rest(&self, q: &Angles, v: &Angles) -> Option<Angles> {
        if self.offset(q)?.norm() >= AT_REST || v.norm() > 0.0 || self.is_at_rest() {
            return None;
        }
        let branch = self.branch_of_least_constraint(q)?;
        Some(self.acceleration_along(q, &branch.direction, 0.0) * branch.direction)
    }
}

impl ByAngles<'_> {
    /// What scales rates to the energy: by little, or the step has failed. 1 where so little energy is involved that it is lost in
    /// round-off, or so much is lost or put in, by a power that varies by more, that the trapezoidal rule says less than the step itself.
    fn energy_scale_unless(&self, varied: f64, before: &EnergyBalance, [q, v]: [&Angles; 2], h: f64) -> Result<f64, StepError> {
        let [kinetic, potential, power] = self.energies(q, v);
        let (work, varies) = (h / 2.0 * (before.power + power), h * (power - before.power).abs() > varied * kinetic);
        if kinetic <= LOST * before.energy.abs().max(potential.abs()) || work.abs() > ENERGY_CHANGE * kinetic || varies {
            return Ok(1.0);
        }
        let part = (before.energy + work - potential) / kinetic - 1.0;
        if part.abs() > ENERGY_CHANGE { Err(StepError::EnergyChange { part }) } else { Ok((1.0 + part).sqrt()) }
    }

    /// Where a motion on a branch of the closure is h seconds later, if that is near to where branches meet: by steps in the angles, for
    /// which it is a place like any other. In the twelve coordinates.
    #[cold]
    #[inline(never)]
    fn along_branch(&self, [q, v]: [Angles; 2], h: f64) -> Option<Transit<COORDINATES>> {
        let model = self.model();
        let settings = Settings {
            schemes: Schemes::Automatic,
            error_tolerance: model.error_tolerance,
            energy_scale: f64::INFINITY,
            first_step: h,
            max_iterations: model.max_iterations,
            max_work: MOST_WORK,
            regularization: self.regularization_by_angles(),
        };
        if angle_to_bifurcation(&(q + h * v)).min(angle_to_bifurcation(&q)) > NEAR_BIFURCATION {
            return None;
        }
        let mut step = DenseStep::start(self, q, v, &settings);
        step.mode().closure_branch?;
        step.advance(self, &settings, h, Horizon { output: f64::INFINITY, limit: h }, None).ok()?;
        let sample = step.sample(self, &settings);
        let on_branch = self.on(step.mode());
        let (a, _) = equilibrium(on_branch.borrow(), &sample.q, &sample.v, settings.regularization);
        let (x, rates) = self.coordinates(&sample.pose, &sample.q, &sample.v);
        let a = self.coordinates(&sample.pose, &sample.q, &a).1 + self.velocity_product(&sample.pose, &sample.v);
        Some(Transit { q: x, v: rates, duration: h, on_ray: false, passed: false, from_rest: None, known: Some((a, sample.work)) })
    }

    /// What a vertex at this offset makes of the next step.
    #[cold]
    #[inline(never)]
    fn near(&self, limits: &PassageLimits, from: &Departure<'_, ANGLES>, offset: Angles) -> Approach<ANGLES> {
        let (distance, speed) = (offset.norm(), from.v.norm());
        let limited = |longest: f64| {
            Approach::Limited(StepLimits {
                longest,
                round_off: ANGULAR_ROUND_OFF / distance.max(NEAREST),
                regularization: REGULARIZATION,
                energy: (distance < CLOSE).then(|| self.energy_balance(from.q, from.v)),
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
        // Inside the ball: on a ray from outside, from the vertex itself, or interrupted by the end of a macro step.
        let reach = (limits.radius * limits.radius - impact_parameter * impact_parameter).max(0.0).sqrt();
        let entering = position < -ENTRY * limits.radius;
        let starting = position > -AT_REST && position < 0.5 * reach && impact_parameter < AT_REST;
        if impact_parameter > limits.impact_parameter || !(entering || starting || from.on_ray) {
            return limited(f64::INFINITY);
        }
        let rest = self.rest(limits, from);
        let Some((acceleration, duration)) = self.along(from.q, &direction, [position, reach, speed], rest) else {
            return limited(f64::INFINITY);
        };
        // What forces across the ray could do meanwhile must stay below the impact parameter. A start from rest is on its branch already.
        let (pull, _) = equilibrium(self, from.q, &Angles::ZERO, self.regularization_by_angles());
        if !from.on_ray && 0.5 * self.error_norm(&pull) * duration * duration > limits.impact_parameter {
            return limited(f64::INFINITY);
        }
        let ray = Ray { vertex: *from.q - offset, aside, direction, position, speed, acceleration, duration };
        self.transit(from, &ray, rest).map_or(Approach::Limited(StepLimits::NONE), Approach::Passed)
    }

    /// From rest in a vertex: along the branch of least constraint, or not at all.
    fn leave_from_rest(&self, limits: &PassageLimits, from: &Departure<'_, ANGLES>, offset: Angles) -> Approach<ANGLES> {
        let rest = self.rest(limits, from);
        let branch = self.branch_of_least_constraint(from.q);
        let alternatives = branch.as_ref().map_or(0, |branch| branch.alternatives);
        let model_exchange = branch.and_then(|branch| {
            let (acceleration, duration) = self.along(from.q, &branch.direction, [0.0, limits.radius, 0.0], rest)?;
            Some((branch.direction, acceleration, duration))
        });
        let (direction, acceleration, duration) = model_exchange.unwrap_or((Angles::ZERO, 0.0, f64::INFINITY));
        let vertex = *from.q - offset;
        let ray = Ray { vertex, aside: Angles::ZERO, direction, position: 0.0, speed: 0.0, acceleration, duration };
        self.transit(from, &ray, rest).map_or(Approach::Clear, |transit| {
            Approach::Passed(Transit { from_rest: Some((acceleration > 0.0, alternatives)), ..transit })
        })
    }

    /// How long a straight motion may be, s.
    fn rest(&self, limits: &PassageLimits, from: &Departure<'_, ANGLES>) -> f64 {
        if self.model().conservative { from.rest } else { from.rest.min(limits.longest_with_dissipation) }
    }

    /// Along a ray, out of the ball or as far as `rest` seconds go. Inside the ball nothing is projected: Φ is met to the order of impact
    /// parameter × radius, and near the rank loss a projection would divide round-off by the smallest singular value.
    ///
    /// `None` where leaving the ball would change the energy, or stops and planes take much of it: then the motion is on no ray.
    fn transit(&self, from: &Departure<'_, ANGLES>, ray: &Ray, rest: f64) -> Option<Transit<ANGLES>> {
        let &Ray { vertex, aside, direction, position, speed, acceleration, .. } = ray;
        let (duration, leaves) = (ray.duration.min(rest), ray.duration <= rest);
        let ahead = position + duration * (speed + 0.5 * acceleration * duration);
        let mut q = vertex + aside + ahead * direction;
        let mut v = (speed + acceleration * duration) * direction;
        if leaves {
            let (_, pose) = self.projection().position(self, &mut q).ok()?;
            v += velocity_correction(self, &pose, &self.factor_mass(&pose, self.regularization_by_angles()), &v);
        }
        // The rate along the ray is known from the energy better than from the acceleration, which was taken as constant.
        let before = self.energy_balance(from.q, from.v);
        let scale = self.energy_scale_unless(f64::INFINITY, &before, [&q, &v], duration).ok()?;
        let [kinetic, _, power] = self.energies(&q, &v);
        if self.model().may_make_contact && duration * before.power.abs().max(power.abs()) > ENERGY_CHANGE * kinetic {
            return None;
        }
        let passed = position < 0.0 && ahead >= 0.0;
        Some(Transit { q, v: scale * v, duration, on_ray: !leaves, passed, from_rest: None, known: None })
    }

    /// Mean acceleration along a ray from a position to where it leaves the ball, at a speed, and the time that takes, s; infinite if
    /// forces that fall with the speed stop the motion on the way, `None` if others turn it round.
    fn along(&self, q: &Angles, direction: &Angles, [position, reach, speed]: [f64; 3], rest: f64) -> Option<(f64, f64)> {
        let acceleration_at = |speed: f64| self.acceleration_along(q, direction, speed);
        let mut acceleration = acceleration_at(speed);
        if self.model().conservative {
            return Some((acceleration, time_to_bifurcation(reach, position, speed, acceleration)?));
        }
        // Friction may be stiff: the implicit Euler rule a = f(v + a t), by bisection between 0 and f(v), for the time that follows from a.
        let at_start = acceleration;
        let (mut duration, mut last) = (f64::INFINITY, f64::NAN);
        for _ in 0..ROUNDS {
            duration = time_to_bifurcation(reach, position, speed, acceleration).unwrap_or(f64::INFINITY);
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

    /// Acceleration that the forces have along a direction on the cone, at a speed along it.
    fn acceleration_along(&self, q: &Angles, direction: &Angles, speed: f64) -> f64 {
        let pose = self.pose(q);
        self.forces(q, &pose, &(speed * *direction)).dot(direction) / self.mass_times(&pose, direction).dot(direction)
    }

    fn energy_balance(&self, q: &Angles, v: &Angles) -> EnergyBalance {
        let [kinetic, potential, power] = self.energies(q, v);
        EnergyBalance { energy: kinetic + potential, power }
    }

    /// Onto the closure, as far as round-off lets it.
    fn projection(&self) -> Projection {
        let model = self.model();
        Projection::to_round_off(model.length_scale, self.regularization_by_angles(), model.max_iterations)
    }
}

/// How far the links are from being in line, along any line: the left leg straight, and the right one along it.
fn angle_to_bifurcation(q: &Angles) -> f64 {
    let [left, elbow, _, right] = PLACES;
    f64::max(libm::sin(q[elbow] - q[left]).abs(), libm::sin(q[right] - q[left]).abs())
}

/// First time at which position + speed t + acceleration t²/2 reaches `reach`, if ever.
fn time_to_bifurcation(reach: f64, position: f64, speed: f64, acceleration: f64) -> Option<f64> {
    let discriminant = speed * speed + 2.0 * acceleration * (reach - position);
    (discriminant > 0.0).then(|| 2.0 * (reach - position) / (speed + discriminant.sqrt())).filter(|time| *time > 0.0)
}

/// The same in the twelve coordinates: each leg is built up from its motor axis.
impl<const BARE: bool> Passage<COORDINATES> for FiveBar<'_, BARE> {
    #[inline]
    fn approach(&self, limits: &PassageLimits, from: &Departure<'_, COORDINATES>) -> Approach<COORDINATES> {
        let by_angles = ByAngles::new(self.general());
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

    #[inline(always)]
    fn cross_bifurcation(&self, q: &Coordinates, v: &Coordinates, h: f64) -> Option<Transit<COORDINATES>> {
        if self.model.mechanism.geometry.base_distance != 0.0 {
            return None;
        }
        ByAngles::new(self.general()).along_branch([angles_of(q), angles_of(v)], h)
    }

    fn energy_scale(&self, before: &EnergyBalance, q: &Coordinates, v: &Coordinates, h: f64) -> Result<f64, StepError> {
        ByAngles::new(self.general()).energy_scale_unless(f64::INFINITY, before, [&angles_of(q), &angles_of(v)], h)
    }

    fn can_project(&self, q: &Coordinates) -> bool {
        ByAngles::new(self.general()).can_project(&angles_of(q))
    }

    fn is_near_vertex(&self, q: &Coordinates) -> bool {
        ByAngles::new(self.general()).is_near_vertex(&angles_of(q))
    }

    fn acceleration_from_rest(&self, q: &Coordinates, v: &Coordinates) -> Option<Coordinates> {
        let (by_angles, q) = (ByAngles::new(self.general()), angles_of(q));
        let a = by_angles.acceleration_from_rest(&q, &angles_of(v))?;
        Some(by_angles.coordinates(&by_angles.pose(&q), &q, &a).1)
    }
}
