//! Contact: a plane that the tip may touch; the half-plane n·(x, y) ≥ offset is free.
//!
//! With the penetration d = offset − n·p and the tip's velocity v_t along t = (−n_y, n_x):
//!
//! ```text
//! F = N (n − mu tanh(v_t/slipVelocity) t),      N = max(0, s(d)(k d + d_coeff ḋ))
//! ```
//!
//! see `unilateral_spring.rs` for N; the tangential part is Coulomb friction, regularised. K = −∂F/∂p = (n − mu tanh t) ∂N/∂d nᵀ,
//! C = −∂F/∂ṗ; both couple the coordinates of link 2 and are not symmetric. Potential: the spring part of N; the damper and the
//! friction dissipate. The tanh belongs to `law` 1, smooth. By `law` 2, stick, friction is set-valued (`stick_slip.rs`): a slipping tip
//! feels mu N against its motion, and a sticking tip feels the force that keeps it at rest along the plane, up to mu N.
//! Defaults: a floor 1 m below the motor axes, out of reach of the paper's mechanism; k 2e3 N/m and 5 N·s/m, a soft fingertip or a
//! haptic wall; mu 0.3, slip velocity 0.01 m/s, ramp 0.1 mm.
//! Limits: a point against a plane; by the smooth law the tip creeps under a tangential load F_t below mu N, at about
//! slipVelocity F_t/(mu N).

use arrayvec::ArrayVec;

use super::force_context::{ForceContext, Tip};
use super::stick_slip::{FRICTION_PLACES, FrictionConstraint, FrictionConstraints, Law, TIP_FRICTION};
use super::guards::{CONTACT, SPRINGS, UnilateralGuard};
use super::unilateral_spring::{MeanReaction, UnilateralSpring};
use super::step_context::{TipStep, end_weight};
use super::{Force, MeanForce, StepContext, Tangents};
use crate::mechanism::{COORDINATES, Coordinates, LINKS, Mechanism, SceneError, finite, not_negative, positive};

/// The `contact.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has the plane.
    pub enabled: bool,
    /// Normal of the plane, x; normalised with `ny`.
    pub nx: f64,
    /// Normal of the plane, y.
    pub ny: f64,
    /// Distance of the plane from the left motor axis along the normal, m.
    pub offset: f64,
    /// Stiffness, N/m.
    pub k: f64,
    /// Damping, N·s/m.
    pub d: f64,
    /// Penetration over which the force ramps up, m.
    pub width: f64,
    /// Coefficient of friction.
    pub mu: f64,
    /// Tangential velocity at which 76 % of the friction is reached, m/s.
    pub slip_velocity: f64,
    /// Law of the friction at rest.
    pub law: Law,
}

/// The plane, made ready from its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Contact {
    normal: [f64; 2],
    offset: f64,
    spring: UnilateralSpring,
    mu: f64,
    slip_velocity: f64,
    law: Law,
    /// Lever arms: largest |∂p/∂θ| of the tip's position by the angle of each link of the leg that carries the tip, m/rad.
    arms: [f64; LINKS],
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

impl Contact {
    /// The unilateral spring at penetration d, m, and its rate ḋ, m/s.
    fn guard(&self, tip: &Tip) -> UnilateralGuard<'_> {
        let depth = self.offset - dot(self.normal, tip.position);
        let rate = -dot(self.normal, tip.velocity);
        UnilateralGuard { place: CONTACT, spring: &self.spring, depth, rate, arms: &self.arms }
    }

    /// Tangential velocity v_t of the tip, m/s.
    fn slip(&self, tip: &Tip) -> f64 {
        dot(self.tangent(), tip.velocity)
    }

    /// Unit tangent t of the plane.
    fn tangent(&self) -> [f64; 2] {
        [-self.normal[1], self.normal[0]]
    }

    /// Friction along −t divided by mu N: tanh(v_t/slipVelocity) by the smooth law, ±1 (slip) or 0 (stick) by the set-valued law.
    fn friction_ratio(&self, at: &ForceContext, slip: f64) -> f64 {
        match self.law {
            Law::Smooth => libm::tanh(slip / self.slip_velocity),
            Law::Stick => at.mode.stick_slip.direction(TIP_FRICTION, slip),
        }
    }

    /// Contact force divided by N, F/N = n − mu `friction_ratio` t.
    fn direction(&self, friction_ratio: f64) -> [f64; 2] {
        let (drag, tangent) = (self.mu * friction_ratio, self.tangent());
        [self.normal[0] - drag * tangent[0], self.normal[1] - drag * tangent[1]]
    }

    /// Force on the tip, N, when friction sticks with the given torques of the joints, N·m, and tangential force, N.
    pub fn force(&self, at: &ForceContext, sticking_loads: &[f64; FRICTION_PLACES]) -> [f64; 2] {
        let (tip, tangent) = (at.tip(), self.tangent());
        let normal = self.guard(&tip).force(at);
        let slipping = self.direction(self.friction_ratio(at, self.slip(&tip))).map(|x| normal * x);
        [0, 1].map(|i| slipping[i] + sticking_loads[TIP_FRICTION] * tangent[i])
    }
}

impl Force for Contact {
    type Parameters = Parameters;

    const HAS_STIFF_FORCES: bool = true;

    const HAS_CONTACT: bool = true;

    fn new(parameters: &Parameters, mechanism: &Mechanism) -> Result<Self, SceneError> {
        let Parameters { nx, ny, offset, k, d, width, mu, slip_velocity, .. } = *parameters;
        finite("contact.nx", nx, "(ratio)")?;
        finite("contact.ny", ny, "(ratio)")?;
        finite("contact.offset", offset, "m")?;
        not_negative("contact.k", k, "N/m")?;
        not_negative("contact.d", d, "N.s/m")?;
        positive("contact.width", width, "m")?;
        not_negative("contact.mu", mu, "(ratio)")?;
        positive("contact.slipVelocity", slip_velocity, "m/s")?;
        let length = libm::hypot(nx, ny);
        if length == 0.0 {
            return Err(SceneError("contact.nx = 0 and contact.ny = 0 are not allowed together: the plane needs a normal.".into()));
        }
        let spring = UnilateralSpring { stiffness: k, damping: d, width };
        let [proximal, distal, ..] = mechanism.geometry.links;
        let arms = [proximal.length, distal.length, 0.0, 0.0];
        Ok(Self { normal: [nx / length, ny / length], offset, spring, mu, slip_velocity, law: parameters.law, arms })
    }

    fn couples_links(&self) -> bool {
        true
    }

    fn conservative(&self) -> bool {
        self.spring.damping == 0.0 && self.mu == 0.0
    }

    fn add_forces(&self, at: &ForceContext, forces: &mut Coordinates) {
        self.act(at, forces);
    }

    #[inline(never)]
    fn act(&self, at: &ForceContext, forces: &mut Coordinates) -> [f64; 2] {
        let tip = at.tip();
        let guard = self.guard(&tip);
        if guard.is_idle(at) {
            return [0.0; 2];
        }
        let (normal, slip) = (guard.force(at), self.slip(&tip));
        let friction_ratio = self.friction_ratio(at, slip);
        tip.add_force(self.direction(friction_ratio).map(|x| normal * x), forces);
        [0.0, guard.dissipation(at) + normal * self.mu * friction_ratio * slip]
    }

    #[inline(never)]
    fn add_tangents(&self, at: &ForceContext, tangents: &mut impl Tangents) {
        let tip = at.tip();
        let guard = self.guard(&tip);
        if guard.is_idle(at) {
            return;
        }
        let (normal_force, slip) = (guard.force(at), self.slip(&tip));
        let [by_depth, by_rate] = guard.slopes(at);
        let friction_ratio = self.friction_ratio(at, slip);
        let by_slip = match self.law {
            Law::Smooth => self.mu * normal_force * (1.0 - friction_ratio * friction_ratio) / self.slip_velocity,
            Law::Stick => 0.0,
        };
        let (normal, tangent, direction) = (self.normal, self.tangent(), self.direction(friction_ratio));
        let matrix = |entry: &dyn Fn(usize, usize) -> f64| [[entry(0, 0), entry(0, 1)], [entry(1, 0), entry(1, 1)]];
        let stiffness = matrix(&|i, j| by_depth * direction[i] * normal[j]);
        let damping = matrix(&|i, j| by_rate * direction[i] * normal[j] + by_slip * tangent[i] * tangent[j]);
        tip.add_tangents(stiffness, damping, tangents);
        tip.add_geometric_stiffness(direction.map(|x| normal_force * x), tangents);
    }

    fn potential(&self, at: &ForceContext) -> f64 {
        self.guard(&at.tip()).potential(at)
    }

    fn dissipation(&self, at: &ForceContext) -> f64 {
        let [_, dissipated] = self.act(at, &mut { Coordinates::ZERO });
        dissipated
    }

    fn guard_values(&self, at: &ForceContext) -> ArrayVec<UnilateralGuard<'_>, SPRINGS> {
        ArrayVec::from_iter([self.guard(&at.tip())])
    }

    fn sticks(&self) -> bool {
        self.law == Law::Stick && self.mu > 0.0
    }

    #[cold]
    fn add_friction_constraints(&self, at: &ForceContext, friction_constraints: &mut FrictionConstraints<COORDINATES>) {
        let tip = at.tip();
        let guard = self.guard(&tip);
        if !self.sticks() || !guard.phase(&at.mode).pushes() {
            return;
        }
        let (mut row, tangent) = (Coordinates::ZERO, self.tangent());
        tip.add_force(tangent, &mut row);
        let (rate, bound) = (self.slip(&tip), self.mu * guard.force(at));
        let [proximal, distal, ..] = self.arms;
        friction_constraints.push(FrictionConstraint { place: TIP_FRICTION, row, drift: dot(tangent, tip.centripetal()), rate, bound, arms: [proximal, distal, 0.0, 0.0] });
    }
}

impl MeanForce for Contact {
    #[inline(never)]
    fn add_mean_forces(&self, over: &StepContext, forces: &mut Coordinates) {
        if let Some(sliding_contact) = self.sliding_contact(over) {
            sliding_contact.tip.add_force(self.mean_force(&sliding_contact), forces);
        }
    }

    #[inline(never)]
    fn add_mean_tangents(&self, over: &StepContext, tangents: &mut impl Tangents) {
        let Some(sliding_contact) = self.sliding_contact(over) else { return };
        let SlidingContact { push, slip_slope, weight, by_normal, .. } = &sliding_contact;
        let (normal, tangent) = (self.normal, self.tangent());
        let matrix = |entry: &dyn Fn(usize, usize) -> f64| [[entry(0, 0), entry(0, 1)], [entry(1, 0), entry(1, 1)]];
        let stiffness = matrix(&|i, j| {
            push.slope * (normal[i] - by_normal * tangent[i]) * normal[j] + slip_slope * (1.0 - weight) / over.h * tangent[i] * tangent[j]
        });
        let damping = matrix(&|i, j| slip_slope * weight * tangent[i] * tangent[j]);
        sliding_contact.tip.add_tangents(stiffness, damping, tangents);
        sliding_contact.tip.add_geometric_stiffness(self.mean_force(&sliding_contact), tangents);
    }

    fn dissipated_over(&self, over: &StepContext) -> f64 {
        self.sliding_contact(over).map_or(0.0, |sliding_contact| sliding_contact.push.dissipated + sliding_contact.drag * dot(self.tangent(), sliding_contact.tip.change))
    }
}

/// Mean reaction of the plane on the tip over a finite step.
struct SlidingContact {
    tip: TipStep,
    push: MeanReaction,
    /// Mean friction along −t, N.
    drag: f64,
    /// Derivative of the friction by the slip velocity, N·s/m.
    slip_slope: f64,
    /// Weight γ of the step's end in the slip velocity, 0 to 1 (`step_context.rs`).
    weight: f64,
    /// Derivative of the friction by N.
    by_normal: f64,
}

impl Contact {
    /// The reaction over a step; `None` where the tip is off the plane at both ends.
    fn sliding_contact(&self, over: &StepContext) -> Option<SlidingContact> {
        let tip = over.tip();
        let (depth, change) = (self.offset - dot(self.normal, tip.begin), -dot(self.normal, tip.change));
        if depth <= 0.0 && depth + change <= 0.0 {
            return None;
        }
        let push = self.spring.mean_reaction(depth, change, over.h);
        let slip_velocity = over.softening * self.slip_velocity;
        let (mean, end) = (dot(self.tangent(), tip.change) / over.h, dot(self.tangent(), tip.velocity));
        let decay = 0.5 * over.h * self.mu / (slip_velocity * over.inertia.tip);
        let weight = end_weight(decay * push.force);
        let tanh = libm::tanh((mean + weight * (end - mean)) / slip_velocity);
        let slip_slope = self.mu * push.force * (1.0 - tanh * tanh) / slip_velocity;
        let by_normal = self.mu * tanh + slip_slope * (end - mean) * decay * (1.0 - weight) * (1.0 - weight);
        Some(SlidingContact { tip, drag: self.mu * push.force * tanh, push, slip_slope, weight, by_normal })
    }

    /// Mean force on the tip, N.
    fn mean_force(&self, sliding_contact: &SlidingContact) -> [f64; 2] {
        let tangent = self.tangent();
        [0, 1].map(|i| sliding_contact.push.force * self.normal[i] - sliding_contact.drag * tangent[i])
    }
}
