//! Through a vertex of the configuration space, where the constraints lose rank and branches cross.
//!
//! A motion that comes within [`Gate::ball`] of a vertex on a ray through it (missing it by less than [`Gate::miss`]) is carried
//! along the ray, a line on the tangent cone, to the other side of the ball: there and only there the equations of motion do not
//! say where it goes, and continuing straight is its physical continuation. A motion that misses the vertex by more is resolved
//! and turns. On the way in, steps become a geometric sequence, so that no step jumps over a vertex unseen. From rest exactly in a
//! vertex the motion starts along the branch of least constraint (Gauss). `docs/method.md`, "Through a vertex".
//!
//! Displacements and rates are measured in those coordinates in which the system says how far its vertices are (link angles).

use super::equilibrium::equilibrium_at;
use super::projection::{self, Projection};
use super::vectors::finite;
use super::{StepError, Power, State, System, equilibrium};

/// How close to a vertex the gate works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// Radius of the ball around a vertex inside which motions on a ray are carried straight, rad.
    pub ball: f64,
    /// A ray misses the vertex by less than this, rad.
    pub miss: f64,
}

impl Gate {
    /// A motion meant to pass through a vertex misses it by what the method's local errors have added up to: thousands of them. So
    /// the miss follows the error tolerance.
    pub fn for_error_tolerance(tolerance: f64) -> Self {
        let miss = (1e4 * tolerance).clamp(1e-7, 1e-4);
        Self { ball: miss.sqrt().min(1e-3), miss }
    }
}

/// Below these offsets (rad) and rates (rad/s) a state is exactly in a vertex, or on a ray, and at rest.
const AT_REST: f64 = 1e-9;

/// Closer than this, rad, energy is kept by scaling the velocity.
const CLOSE: f64 = 1e-2;

/// By how much e is smaller near a vertex.
const NEAR_SOFTNESS: f64 = 1e-4;

/// A motion on a ray is caught when it enters the ball: the steps on the way in leave at least this part of its radius. Deeper
/// inside, a motion that points at the vertex is one that is turning around it.
const ENTRY: f64 = 0.2;

/// Nearer than this, rad, the round-off is not taken to be larger still: no error passes unseen.
const NEAREST: f64 = 1e-5;

/// Largest part of the kinetic energy by which a sub-step close to a vertex may be off before it is put right.
const ENERGY_CHANGE: f64 = 0.01;

/// Round-off of an angle at distance 1 from a vertex, rad (errors of up to some 10 ε / distance are seen).
const ROUND_OFF: f64 = 64.0 * f64::EPSILON;

/// Most rounds in which the time along a ray and the acceleration on the way settle.
const ROUNDS: u32 = 20;

/// What the gate says about the next sub-step.
pub(super) enum Verdict<const N: usize> {
    /// Go on.
    Free,
    /// Go on, with care.
    Near(Care),
    /// Be carried along a ray.
    Carry(Ray<N>),
}

/// What a sub-step near a vertex needs.
pub(super) struct Care {
    /// Not farther than this, s.
    pub(super) longest: f64,
    /// What round-off alone makes of the local error here, rad: ε divided by the smallest singular value of Φ_q relative to its
    /// largest, which is proportional to the distance from the vertex. Shorter steps would not get below it.
    pub(super) round_off: f64,
    /// e of the saddle-point systems, 1/kg: it must stay small against the smallest eigenvalue of S, which falls with the square of
    /// the distance.
    pub(super) regularization: f64,
    /// What is known of the energy, which is to be kept: close to a vertex round-off in the direction of the velocity would change it.
    pub(super) energy: Option<Ledger>,
}

/// The energy before a sub-step, and how it changes.
#[derive(Clone, Copy)]
pub(super) struct Ledger {
    /// Kinetic plus potential, J.
    energy: f64,
    /// Power of the forces that have no potential, W.
    power: f64,
}

/// A straight motion through the ball: one-dimensional, with the acceleration that the forces have along it.
pub(super) struct Ray<const N: usize> {
    /// Displacement from the vertex that the motion misses it by, kept on the way.
    aside: [f64; N],
    direction: [f64; N],
    position: f64,
    speed: f64,
    acceleration: f64,
    /// s.
    duration: f64,
    /// Whether the ball is left, and with it the neighbourhood in which nothing may be projected.
    leaves: bool,
}

fn dot<const N: usize>(x: &[f64; N], y: &[f64; N]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}

/// Acceleration that the forces have along a direction on the cone, at a speed along it.
fn acceleration_along<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    q: &[f64; N],
    direction: &[f64; N],
    speed: f64,
) -> f64 {
    let pose = system.pose(q);
    let (_, motion) = system.rebuilt(q, direction);
    let forces = system.forces(q, &pose, &motion.map(|x| x * speed));
    dot(&forces, &motion) / dot(&motion, &system.mass_times(&pose, &motion))
}

/// The verdict for a state near a vertex, with what [`System::vertex`] says of it, of whose macro step `rest` seconds are left.
#[cold]
pub(super) fn near<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    gate: &Gate,
    state: &mut State<N, M>,
    rest: f64,
    regularization: f64,
    (offset, rate): ([f64; N], [f64; N]),
) -> Verdict<N> {
    let (distance, speed) = (dot(&offset, &offset).sqrt(), dot(&rate, &rate).sqrt());
    let before = if distance < CLOSE { ledger(system, &state.q, &state.v) } else { None };
    let free = |longest: f64| {
        Verdict::Near(Care {
            longest,
            round_off: ROUND_OFF / distance.max(NEAREST),
            regularization: NEAR_SOFTNESS * regularization,
            energy: before,
        })
    };
    if distance < AT_REST && speed < AT_REST && !(state.on_ray && speed > 0.0) {
        return launch(system, gate, state, rest);
    }
    if speed == 0.0 || speed < AT_REST && !state.on_ray {
        return free(f64::INFINITY);
    }
    let direction = rate.map(|x| x / speed);
    let position = dot(&offset, &direction);
    let aside: [f64; N] = std::array::from_fn(|i| offset[i] - position * direction[i]);
    let miss = dot(&aside, &aside).sqrt();
    if distance > gate.ball {
        let ahead = -position / speed;
        return free(if ahead > 0.0 && miss < 0.1 * distance { 0.75 * ahead } else { f64::INFINITY });
    }
    // Inside the ball: on a ray from outside, from the vertex itself, or interrupted by the end of a macro step.
    let reach = (gate.ball * gate.ball - miss * miss).max(0.0).sqrt();
    let entering = position < -ENTRY * gate.ball;
    let starting = position > -AT_REST && position < 0.5 * reach && miss < AT_REST;
    if miss > gate.miss || !(entering || starting || state.on_ray) {
        return free(f64::INFINITY);
    }
    let Some((acceleration, duration)) = ride(system, &state.q, &direction, [position, reach], speed, rest) else {
        return free(f64::INFINITY);
    };
    // What forces across the ray could do meanwhile must stay below the miss. A start from rest is on its branch already.
    let (pull, _) = equilibrium(system, &state.q, &[0.0; N], regularization);
    if !state.on_ray && 0.5 * system.angle_norm(&pull) * duration * duration > gate.miss {
        return free(f64::INFINITY);
    }
    Verdict::Carry(Ray { aside, direction, position, speed, acceleration, duration: duration.min(rest), leaves: duration <= rest })
}

/// From rest in a vertex: along the branch of least constraint, or not at all.
fn launch<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    gate: &Gate,
    state: &mut State<N, M>,
    rest: f64,
) -> Verdict<N> {
    let start = system.least_constraint(&state.q).and_then(|(direction, alternatives)| {
        state.alternatives = alternatives;
        let (acceleration, duration) = ride(system, &state.q, &direction, [0.0, gate.ball], 0.0, rest)?;
        Some((direction, acceleration, duration))
    });
    let (direction, acceleration, duration) = start.unwrap_or(([0.0; N], 0.0, f64::INFINITY));
    Verdict::Carry(Ray {
        aside: [0.0; N],
        direction,
        position: 0.0,
        speed: 0.0,
        acceleration,
        duration: duration.min(rest),
        leaves: duration <= rest,
    })
}

/// q̈ at rest exactly in a vertex: that of the branch of least constraint, which the equations of motion alone do not single out.
pub(super) fn start_acceleration<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    q: &[f64; N],
    v: &[f64; N],
) -> Option<[f64; N]> {
    let (offset, rate) = system.vertex(q, v)?;
    if dot(&offset, &offset).sqrt() >= AT_REST || dot(&rate, &rate) > 0.0 {
        return None;
    }
    let (direction, _) = system.least_constraint(q)?;
    let acceleration = acceleration_along(system, q, &direction, 0.0);
    Some(system.rebuilt(q, &direction.map(|x| x * acceleration)).1)
}

/// Mean acceleration along a ray from `position` to `reach`, and the time that takes, s; infinite if forces that fall with the speed
/// stop the motion on the way, `None` if others turn it round.
fn ride<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    q: &[f64; N],
    direction: &[f64; N],
    [position, reach]: [f64; 2],
    speed: f64,
    rest: f64,
) -> Option<(f64, f64)> {
    let acceleration_at = |speed: f64| acceleration_along(system, q, direction, speed);
    let mut acceleration = acceleration_at(speed);
    if system.conservative() {
        return Some((acceleration, time_to(reach, position, speed, acceleration)?));
    }
    // Friction may be stiff: the implicit Euler rule a = f(v + a t), by bisection between 0 and f(v), for the time that follows from a.
    let at_start = acceleration;
    let (mut duration, mut last) = (f64::INFINITY, f64::NAN);
    for _ in 0..ROUNDS {
        duration = time_to(reach, position, speed, acceleration).unwrap_or(f64::INFINITY);
        let t = duration.min(rest);
        if t == last {
            break;
        }
        last = t;
        let (mut none, mut whole) = (0.0, at_start);
        for _ in 0..f64::MANTISSA_DIGITS {
            acceleration = (none + whole) / 2.0;
            let enough = acceleration_at(speed + t * acceleration) / acceleration <= 1.0;
            *(if enough { &mut whole } else { &mut none }) = acceleration;
        }
    }
    Some((acceleration, duration))
}

/// First time at which position + speed t + acceleration t²/2 reaches `reach`, if ever.
fn time_to(reach: f64, position: f64, speed: f64, acceleration: f64) -> Option<f64> {
    let discriminant = speed * speed + 2.0 * acceleration * (reach - position);
    (discriminant > 0.0).then(|| 2.0 * (reach - position) / (speed + discriminant.sqrt())).filter(|time| *time > 0.0)
}

/// Carries the state along a ray. Inside the ball nothing is projected: Φ is met to the order of miss × ball, and near the rank
/// loss a projection would divide round-off by the smallest singular value.
///
/// False, and nothing changed, where leaving the ball would change the energy: then the motion was on no ray.
pub(super) fn carry<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    ray: &Ray<N>,
    state: &mut State<N, M>,
    projection: &Projection,
    power: &mut Power,
) -> Result<bool, StepError> {
    let Ray { aside, direction, position, speed, acceleration, duration, .. } = ray;
    let before = ledger(system, &state.q, &state.v);
    let (offset, _) = system.vertex(&state.q, &state.v).unwrap_or(([0.0; N], [0.0; N]));
    let ahead = position + duration * (speed + 0.5 * acceleration * duration);
    let speed_ahead = speed + acceleration * duration;
    // q of the vertex plus the displacement: only the measured coordinates count, the others follow from them.
    let moved = std::array::from_fn(|i| state.q[i] - offset[i] + aside[i] + ahead * direction[i]);
    let (mut q, mut v) = system.rebuilt(&moved, &direction.map(|x| x * speed_ahead));
    if ray.leaves && projection.position(system, &mut q).is_err() {
        return Ok(false);
    }
    let pose = system.pose(&q);
    let mass = system.factor_mass(&pose, projection.regularization);
    if ray.leaves {
        let correction = projection::velocity(system, &pose, &mass, &v);
        v = std::array::from_fn(|i| v[i] + correction[i]);
    }
    // The rate along the ray is known from the energy better than from the acceleration, which was taken as constant.
    if let Some(before) = before {
        match with_energy(system, &q, &pose, &v, before, *duration) {
            Ok(scaled) => v = scaled,
            Err(_) => return Ok(false),
        }
    }

    (state.a, state.lambda) = equilibrium_at(system, &q, &pose, &v, &mass);
    if !finite(&state.a) {
        return Err(StepError::NotFinite);
    }
    (state.q, state.v, state.jerk) = (q, v, [0.0; N]);
    state.on_ray = !ray.leaves;
    state.observe_modes(system.modes(&pose));
    if system.follows_work() {
        let at_end = system.power(&state.q, &pose, &state.v);
        state.work = state.work.plus(duration / 2.0, *power).plus(duration / 2.0, at_end);
        *power = at_end;
    }
    state.counters.substeps += 1;
    if *speed == 0.0 && *acceleration > 0.0 {
        state.counters.launches += 1;
    }
    if *position < 0.0 && ahead >= 0.0 {
        state.counters.vertex_passes += 1;
    }
    Ok(true)
}

/// Whether q is so close to a vertex, without being on a ray through it, that a projection would divide round-off by next to nothing.
#[inline(always)]
pub(super) fn too_close<const N: usize, const M: usize>(system: &impl System<N, M>, q: &[f64; N], v: &[f64; N]) -> bool {
    system.vertex(q, v).is_some_and(|(offset, _)| dot(&offset, &offset) < NEAREST * NEAREST)
}

/// The energy and how it changes, where the potential is known.
fn ledger<const N: usize, const M: usize>(system: &impl System<N, M>, q: &[f64; N], v: &[f64; N]) -> Option<Ledger> {
    let pose = system.pose(q);
    let energy = dot(v, &system.mass_times(&pose, v)) / 2.0 + system.potential(q, &pose)?;
    Some(Ledger { energy, power: system.power_without_potential(q, &pose, v) })
}

/// The velocity scaled to the energy that follows from that `h` seconds before, within the constraints: by little, or the sub-step
/// has failed. Unchanged where so little energy is involved that it is lost in round-off, or so much is lost or put in on the way
/// that the trapezoidal rule says less about it than the step itself.
pub(super) fn with_energy<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    q: &[f64; N],
    pose: &S::Pose,
    v: &[f64; N],
    before: Ledger,
    h: f64,
) -> Result<[f64; N], StepError> {
    let Some(potential) = system.potential(q, pose) else { return Ok(*v) };
    let kinetic = dot(v, &system.mass_times(pose, v)) / 2.0;
    let work = h / 2.0 * (before.power + system.power_without_potential(q, pose, v));
    if kinetic <= 1e-9 * before.energy.abs().max(potential.abs()) || work.abs() > ENERGY_CHANGE * kinetic {
        return Ok(*v);
    }
    let change = (before.energy + work - potential) / kinetic - 1.0;
    if change.abs() > ENERGY_CHANGE {
        Err(StepError::EnergyChange { part: change })
    } else {
        Ok(v.map(|v| v * (1.0 + change).sqrt()))
    }
}

impl<const N: usize> Ray<N> {
    /// How long it takes, s.
    pub(super) fn duration(&self) -> f64 {
        self.duration
    }
}
