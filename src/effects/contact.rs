//! Contact: a plane that the tip may touch. The half-plane n·(x, y) ≥ offset is free.
//!
//! With the penetration d = offset − n·p of the tip at p and its velocity v_t along t = (−n_y, n_x):
//!
//! ```text
//! F = N (n − mu tanh(v_t/slipVelocity) t),      N = max(0, s(d)(k d + c ḋ))
//! ```
//!
//! `hybrid/unilateral.rs` describes N. The tangential part is regularised Coulomb friction. K = −∂F/∂p = (n − mu tanh t) ∂N/∂d nᵀ and
//! C = −∂F/∂ṗ couple links and are not symmetric. The spring part of N has a potential; the damper and the friction dissipate. The formula
//! above is for `law` 1, smooth. With `law` 2, stick, friction is set-valued (`hybrid/friction.rs`): mu N opposes the motion of a slipping
//! tip, and a sticking tip feels the force that keeps it at rest along the plane, up to mu N.
//! Defaults: a floor 1 m below the motor axes, out of reach of the paper's mechanism; k 2e3 N/m and 5 N·s/m, a soft fingertip or a haptic
//! wall; mu 0.3, slip velocity 0.01 m/s, ramp 0.1 mm.
//! Limits: a point against a plane. With the smooth law the tip creeps under a tangential load F_t below mu N, at about slipVelocity
//! F_t/(mu N).

use super::finite_motion::{FiniteMotion, end_weight};
use super::force_law::{ForceLaw, Properties};
use super::wrench::{FrictionElement, FrictionElements, Matrix, Motion, Planar, Slopes, Wrench, dot};
use crate::hybrid::{FRICTION_PLACES, FrictionPlace, Kink, Kinks, Law, MeanReaction, Mode, TIP_FRICTION, UnilateralSpring};
use crate::mechanism::{LINKS, Mechanism, SceneError};

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
    /// Law of dry friction, smooth or set-valued.
    pub law: Law,
}

/// The plane, prepared from its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Contact {
    normal: [f64; 2],
    offset: f64,
    spring: UnilateralSpring,
    mu: f64,
    slip_velocity: f64,
    law: Law,
    /// Largest |∂p/∂θ| of the tip's position for the angle of each link in the leg that carries the tip, m/rad.
    arms: [f64; LINKS],
}

/// Product of a factor, a column and a row.
fn outer(factor: f64, column: Planar, row: Planar) -> Matrix {
    column.map(|x| row.map(|y| factor * x * y))
}

/// Adds a 2×2 matrix.
fn add(sum: &mut Matrix, matrix: Matrix) {
    for (sum, entry) in sum.as_flattened_mut().iter_mut().zip(matrix.as_flattened()) {
        *sum += entry;
    }
}

impl Contact {
    /// Prepares the plane. Refuses a normal of length 0.
    pub(super) fn new(parameters: &Parameters, mechanism: &Mechanism) -> Result<Self, SceneError> {
        let Parameters { nx, ny, offset, k, d, width, mu, slip_velocity, .. } = *parameters;
        let length = libm::hypot(nx, ny);
        if length == 0.0 {
            return Err(SceneError("contact.nx = 0 and contact.ny = 0 are not allowed together: the plane needs a normal.".into()));
        }
        let spring = UnilateralSpring { stiffness: k, damping: d, width };
        let [proximal, distal, ..] = mechanism.geometry.links;
        let arms = [proximal.length, distal.length, 0.0, 0.0];
        Ok(Self { normal: [nx / length, ny / length], offset, spring, mu, slip_velocity, law: parameters.law, arms })
    }

    /// Kink of the plane, with the penetration d as its quantity.
    fn kink(&self, at: &Motion) -> Kink<'_, UnilateralSpring> {
        let x = self.offset - dot(self.normal, at.position);
        let rate = -dot(self.normal, at.velocity);
        Kink { place: Self::KINKS.start, law: &self.spring, x, rate, arms: &self.arms }
    }

    /// Tangential velocity v_t of the tip, m/s.
    fn slip(&self, at: &Motion) -> f64 {
        dot(self.tangent(), at.velocity)
    }

    /// Whether friction can stick.
    fn may_stick(&self) -> bool {
        self.law == Law::Stick && self.mu > 0.0
    }

    /// Unit tangent t of the plane.
    fn tangent(&self) -> Planar {
        [-self.normal[1], self.normal[0]]
    }

    /// Friction along −t divided by mu N: tanh(v_t/slipVelocity) with the smooth law, ±1 (slip) or 0 (stick) with the set-valued law.
    fn friction_ratio(&self, mode: &Mode, slip: f64) -> f64 {
        match self.law {
            Law::Smooth => libm::tanh(slip / self.slip_velocity),
            Law::Stick => mode.stick_slip.direction(TIP_FRICTION, slip),
        }
    }

    /// Contact force divided by N: n − mu `friction_ratio` t.
    fn direction(&self, friction_ratio: f64) -> Planar {
        let (drag, tangent) = (self.mu * friction_ratio, self.tangent());
        [0, 1].map(|i| self.normal[i] - drag * tangent[i])
    }

    /// Force on the tip, N. `sticking_loads` are the loads of friction that sticks: torques in the joints, N·m, then the tangential force
    /// at the tip, N.
    pub fn force(&self, at: &Motion, sticking_loads: &[f64; FRICTION_PLACES]) -> Planar {
        let (mut wrench, tangent) = (Wrench::default(), self.tangent());
        self.act(at, &mut wrench);
        [0, 1].map(|i| wrench.force[i] + sticking_loads[TIP_FRICTION] * tangent[i])
    }

    /// Mean reaction over a step; `None` if the tip is off the plane at both ends.
    fn reaction(&self, over: &FiniteMotion) -> Option<Reaction> {
        let (depth, change) = (self.offset - dot(self.normal, over.begin), -dot(self.normal, over.change));
        if depth <= 0.0 && depth + change <= 0.0 {
            return None;
        }
        let push = self.spring.mean_reaction(depth, change, over.h);
        let slip_velocity = over.softening * self.slip_velocity;
        let (mean, end) = (dot(self.tangent(), over.change) / over.h, dot(self.tangent(), over.velocity));
        let decay = 0.5 * over.h * self.mu / (slip_velocity * over.inertia.tip);
        let weight = end_weight(decay * push.force);
        let tanh = libm::tanh((mean + weight * (end - mean)) / slip_velocity);
        let slip_slope = self.mu * push.force * (1.0 - tanh * tanh) / slip_velocity;
        let by_normal = self.mu * tanh + slip_slope * (end - mean) * decay * (1.0 - weight) * (1.0 - weight);
        Some(Reaction { drag: self.mu * push.force * tanh, push, slip_slope, weight, by_normal })
    }

    /// Mean force on the tip over a step, N.
    fn mean_force(&self, Reaction { push, drag, .. }: &Reaction) -> Planar {
        let tangent = self.tangent();
        [0, 1].map(|i| push.force * self.normal[i] - drag * tangent[i])
    }
}

impl ForceLaw for Contact {
    fn properties(&self) -> Properties {
        Properties { may_stick: self.may_stick(), ..Properties::contact(self.spring.damping == 0.0 && self.mu == 0.0) }
    }

    fn act(&self, at: &Motion, wrench: &mut Wrench) -> [f64; 2] {
        let (kink, mode) = (self.kink(at), &at.joints.mode);
        if kink.is_idle(mode) {
            return [0.0; 2];
        }
        let (normal, slip) = (kink.force(mode), self.slip(at));
        let friction_ratio = self.friction_ratio(mode, slip);
        *wrench = wrench.plus(normal, &Wrench::of_tip(self.direction(friction_ratio)));
        [0.0, kink.dissipation(mode) + normal * self.mu * friction_ratio * slip]
    }

    fn add_slopes(&self, at: &Motion, slopes: &mut Slopes) {
        let (kink, mode) = (self.kink(at), &at.joints.mode);
        if kink.is_idle(mode) {
            return;
        }
        let (normal_force, slip) = (kink.force(mode), self.slip(at));
        let [by_depth, by_rate] = kink.slopes(mode);
        let friction_ratio = self.friction_ratio(mode, slip);
        let by_slip = match self.law {
            Law::Smooth => self.mu * normal_force * (1.0 - friction_ratio * friction_ratio) / self.slip_velocity,
            Law::Stick => 0.0,
        };
        let (tangent, direction) = (self.tangent(), self.direction(friction_ratio));
        add(&mut slopes.tip[0], outer(by_depth, direction, self.normal));
        add(&mut slopes.tip[1], outer(by_rate, direction, self.normal));
        add(&mut slopes.tip[1], outer(by_slip, tangent, tangent));
        slopes.force = [0, 1].map(|i| slopes.force[i] + normal_force * direction[i]);
    }

    fn act_over(&self, over: &FiniteMotion, wrench: &mut Wrench) -> [f64; 2] {
        let Some(reaction) = self.reaction(over) else { return [0.0; 2] };
        *wrench = wrench.plus(1.0, &Wrench::of_tip(self.mean_force(&reaction)));
        [0.0, reaction.push.dissipated + reaction.drag * dot(self.tangent(), over.change)]
    }

    fn add_slopes_over(&self, over: &FiniteMotion, slopes: &mut Slopes) {
        let Some(reaction) = self.reaction(over) else { return };
        let Reaction { push, slip_slope, weight, by_normal, .. } = &reaction;
        let (normal, tangent) = (self.normal, self.tangent());
        let direction = [0, 1].map(|i| normal[i] - by_normal * tangent[i]);
        add(&mut slopes.tip[0], outer(push.slope, direction, normal));
        add(&mut slopes.tip[0], outer(slip_slope * (1.0 - weight) / over.h, tangent, tangent));
        add(&mut slopes.tip[1], outer(slip_slope * weight, tangent, tangent));
        let force = self.mean_force(&reaction);
        slopes.force = [0, 1].map(|i| slopes.force[i] + force[i]);
    }

    fn potential(&self, at: &Motion) -> f64 {
        self.kink(at).potential(&at.joints.mode)
    }

    fn add_kinks<'a>(&'a self, at: &Motion, kinks: &mut Kinks<'a>) {
        kinks.push(self.kink(at).erased());
    }

    fn add_friction(&self, at: &Motion, elements: &mut FrictionElements) {
        let (kink, mode) = (self.kink(at), &at.joints.mode);
        if self.may_stick() && kink.pushes(mode) {
            let (rate, bound) = (self.slip(at), self.mu * kink.force(mode));
            let place = FrictionPlace { place: TIP_FRICTION, rate, bound, arms: self.arms };
            elements.push(FrictionElement { at: place, wrench: Wrench::of_tip(self.tangent()) });
        }
    }
}

/// Mean reaction of the plane on the tip over a finite step.
struct Reaction {
    push: MeanReaction,
    /// Mean friction along −t, N.
    drag: f64,
    /// Derivative of the friction with respect to the slip velocity, N·s/m.
    slip_slope: f64,
    /// Weight γ of the step's end in the slip velocity, 0 to 1 (`finite_motion.rs`).
    weight: f64,
    /// Derivative of the friction with respect to N.
    by_normal: f64,
}
