//! Friction: Coulomb and Stribeck friction in the joints. By `law` 1, smooth:
//!
//! ```text
//! T_j = −[√(2e) (T_brk − T_c) exp(−(w/w_st)²) w/w_st + T_c tanh(w/w_c)]      w_st = √2 w_brk,  w_c = w_brk/10
//! ```
//!
//! with w the joint's rate, T_c = `coulomb[j]`, T_brk = `breakaway[j]` ≥ T_c, w_brk = `breakawayVelocity`: the Stribeck curve of a widely
//! used rotational friction block (Simscape's "Rotational Friction", without its viscous term, which is the effect `viscous`;
//! Armstrong-Hélouvry et al., Automatica 30 (1994) 1083). T_brk is met at w_brk to within 1e-4 of T_c. C = −∂T/∂w, K = 0; the power
//! −T w ≥ 0 is dissipated.
//!
//! By `law` 2, stick, friction is set-valued (`stick_slip.rs`): a sticking joint transmits the torque that keeps w = 0, up to T_brk, and
//! a slipping joint has
//!
//! ```text
//! T_j = −[T_c + (T_brk − T_c) exp(−(w/w_st)²)] sign w
//! ```
//!
//! which falls from T_brk at rest to T_c.
//! Defaults: 1 mN·m, 1.2 mN·m at 0.1 rad/s, a preloaded miniature bearing.
//! Limits: by the smooth law there is no true sticking: under a load T below breakaway a joint creeps at about w_c T/T_c. The eigenvalue
//! near w = 0 is T_c/(w_c I), some 1,500/s for the paper's links: stiff for explicit methods. Above w_brk the slope is negative. By the
//! set-valued law there is no presliding displacement and no growth of T_brk with the time at rest.

use super::force_context::{JOINTS, ForceContext, add_joint_damping, add_joint_torque, is_inner};
use super::stick_slip::{FrictionConstraint, FrictionConstraints, Law};
use super::step_context::{add_joint_slopes, end_weight};
use super::{Force, MeanForce, StepContext, Tangents};
use crate::mechanism::coordinates::THETA;
use crate::mechanism::exponential::gaussian_and_tanh;
use crate::mechanism::{COORDINATES, Coordinates, LINKS, Mechanism, SceneError, not_negative, positive};

/// The `friction.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has dry friction.
    pub enabled: bool,
    /// Coulomb torques of joints 1 to 5, N·m.
    pub coulomb: [f64; JOINTS],
    /// Breakaway torques of joints 1 to 5, N·m.
    pub breakaway: [f64; JOINTS],
    /// Rate at which the breakaway torque is reached, rad/s.
    pub breakaway_velocity: f64,
    /// Law of the friction at rest.
    pub law: Law,
}

/// The friction curve of one joint.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Curve {
    joint: usize,
    /// Coulomb torque T_c, N·m.
    coulomb: f64,
    /// Breakaway torque T_brk, N·m.
    breakaway: f64,
    /// Amplitude √(2e) (T_brk − T_c) of the Stribeck term, N·m.
    stribeck: f64,
}

/// Dry friction, made ready from its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Friction {
    curves: [Option<Curve>; JOINTS],
    /// Stribeck rate w_st, rad/s.
    stribeck_rate: f64,
    /// Regularisation rate w_c of the Coulomb term, rad/s.
    coulomb_rate: f64,
    law: Law,
}

impl Friction {
    fn curves(&self) -> impl Iterator<Item = &Curve> {
        self.curves.iter().flatten()
    }

    /// Friction torque −T by the chosen law at a joint's rate, rad/s, N·m.
    #[inline]
    fn drag_by_law(&self, curve: &Curve, rate: f64, at: &ForceContext) -> f64 {
        match self.law {
            Law::Smooth => self.drag(curve, rate),
            Law::Stick => at.mode.stick_slip.direction(curve.joint, rate) * self.sliding(curve, rate),
        }
    }

    /// Derivative −∂T/∂w by the chosen law, N·m·s/rad.
    fn slope_by_law(&self, curve: &Curve, at: &ForceContext) -> f64 {
        let rate = at.joint_rate(curve.joint);
        match self.law {
            Law::Smooth => self.slope(curve, rate),
            Law::Stick => {
                let u = rate / self.stribeck_rate;
                let fall = (curve.breakaway - curve.coulomb) * libm::exp(-u * u) * 2.0 * u / self.stribeck_rate;
                -at.mode.stick_slip.direction(curve.joint, rate) * fall
            }
        }
    }

    /// Magnitude |T| in a slipping joint by the set-valued law, N·m.
    fn sliding(&self, curve: &Curve, rate: f64) -> f64 {
        let u = rate / self.stribeck_rate;
        curve.coulomb + (curve.breakaway - curve.coulomb) * libm::exp(-u * u)
    }

    /// Friction torque −T by the smooth law, N·m.
    fn drag(&self, curve: &Curve, rate: f64) -> f64 {
        let u = rate / self.stribeck_rate;
        let [bell, tanh] = gaussian_and_tanh(u, rate / self.coulomb_rate);
        curve.stribeck * bell * u + curve.coulomb * tanh
    }

    /// Derivative −∂T/∂w by the smooth law, N·m·s/rad.
    fn slope(&self, curve: &Curve, rate: f64) -> f64 {
        let u = rate / self.stribeck_rate;
        let [bell, tanh] = gaussian_and_tanh(u, rate / self.coulomb_rate);
        curve.stribeck / self.stribeck_rate * bell * (1.0 - 2.0 * u * u)
            + curve.coulomb / self.coulomb_rate * (1.0 - tanh * tanh)
    }
}

impl Force for Friction {
    type Parameters = Parameters;

    const HAS_STIFF_FORCES: bool = true;

    fn new(parameters: &Parameters, _mechanism: &Mechanism) -> Result<Self, SceneError> {
        let mut curves = [None; JOINTS];
        for (joint, curve) in curves.iter_mut().enumerate() {
            let (coulomb, breakaway) = (parameters.coulomb[joint], parameters.breakaway[joint]);
            not_negative(format_args!("friction.coulomb[{}]", joint + 1), coulomb, "N.m")?;
            not_negative(format_args!("friction.breakaway[{}]", joint + 1), breakaway, "N.m")?;
            if breakaway < coulomb {
                return Err(SceneError(format!(
                    "friction.breakaway[{0}] = {breakaway} N.m is not allowed: it must be at least friction.coulomb[{0}] = {coulomb} N.m.",
                    joint + 1
                )));
            }
            if breakaway > 0.0 {
                let stribeck = (2.0 * std::f64::consts::E).sqrt() * (breakaway - coulomb);
                *curve = Some(Curve { joint, coulomb, breakaway, stribeck });
            }
        }
        let velocity = parameters.breakaway_velocity;
        positive("friction.breakawayVelocity", velocity, "rad/s")?;
        Ok(Self { curves, stribeck_rate: std::f64::consts::SQRT_2 * velocity, coulomb_rate: velocity / 10.0, law: parameters.law })
    }

    fn couples_links(&self) -> bool {
        self.curves().any(|curve| is_inner(curve.joint))
    }

    fn conservative(&self) -> bool {
        false
    }

    #[inline(never)]
    fn add_forces(&self, at: &ForceContext, forces: &mut Coordinates) {
        for curve in self.curves() {
            add_joint_torque(curve.joint, -self.drag_by_law(curve, at.joint_rate(curve.joint), at), forces);
        }
    }

    #[inline(never)]
    fn add_tangents(&self, at: &ForceContext, tangents: &mut impl Tangents) {
        for curve in self.curves() {
            add_joint_damping(curve.joint, self.slope_by_law(curve, at), tangents);
        }
    }

    #[inline(never)]
    fn act(&self, at: &ForceContext, forces: &mut Coordinates) -> [f64; 2] {
        let mut dissipated = 0.0;
        for curve in self.curves() {
            let rate = at.joint_rate(curve.joint);
            let drag = self.drag_by_law(curve, rate, at);
            add_joint_torque(curve.joint, -drag, forces);
            dissipated += drag * rate;
        }
        [0.0, dissipated]
    }

    fn dissipation(&self, at: &ForceContext) -> f64 {
        let power = |curve: &Curve| {
            let rate = at.joint_rate(curve.joint);
            self.drag_by_law(curve, rate, at) * rate
        };
        self.curves().map(power).sum()
    }

    fn sticks(&self) -> bool {
        self.law == Law::Stick
    }

    // Out of line: inlined, it would read a field that another variant of `Effect` has not written and discard the value, which valgrind
    // reports.
    #[cold]
    #[inline(never)]
    fn regularization_velocity(&self) -> f64 {
        if self.sticks() { f64::INFINITY } else { self.coulomb_rate }
    }

    #[cold]
    fn has_sharp_nonlinearity(&self) -> bool {
        !self.sticks()
    }

    #[cold]
    fn add_friction_constraints(&self, at: &ForceContext, friction_constraints: &mut FrictionConstraints<COORDINATES>) {
        if self.law == Law::Smooth {
            return;
        }
        for curve in self.curves() {
            let mut row = Coordinates::ZERO;
            add_joint_torque(curve.joint, 1.0, &mut row);
            let arms = std::array::from_fn::<_, LINKS, _>(|link| row[THETA[link]].abs());
            let rate = at.joint_rate(curve.joint);
            friction_constraints.push(FrictionConstraint { place: curve.joint, row, drift: 0.0, rate, bound: curve.breakaway, arms });
        }
    }
}

impl MeanForce for Friction {
    #[inline(never)]
    fn add_mean_forces(&self, over: &StepContext, forces: &mut Coordinates) {
        let softened = self.softened(over.softening);
        for curve in self.curves() {
            let rate = softened.rate_over(curve, over);
            add_joint_torque(curve.joint, -softened.drag(curve, rate), forces);
        }
    }

    #[inline(never)]
    fn add_mean_tangents(&self, over: &StepContext, tangents: &mut impl Tangents) {
        let softened = self.softened(over.softening);
        for curve in self.curves() {
            let slope = softened.slope(curve, softened.rate_over(curve, over));
            let weight = softened.end_weight(curve, over);
            add_joint_slopes(curve.joint, [(1.0 - weight) * slope / over.h, weight * slope], tangents);
        }
    }

    fn dissipated_over(&self, over: &StepContext) -> f64 {
        self.curves().map(|curve| self.drag(curve, self.rate_over(curve, over)) * over.joint(curve.joint)[0]).sum()
    }
}

impl Friction {
    /// Friction with the rates w_c and w_st multiplied by a factor.
    fn softened(&self, factor: f64) -> Self {
        Self { coulomb_rate: factor * self.coulomb_rate, stribeck_rate: factor * self.stribeck_rate, ..*self }
    }

    /// Weight γ of the rate at the step's end (`step_context.rs`): the larger, the steeper the curve.
    fn end_weight(&self, curve: &Curve, over: &StepContext) -> f64 {
        // The slope at w = 0 in closed form: avoids exp(0), which raises an inexact flag that some masters trap.
        end_weight(over.decay(curve.stribeck / self.stribeck_rate + curve.coulomb / self.coulomb_rate))
    }

    /// Rate at which the torque of a step is evaluated, rad/s.
    fn rate_over(&self, curve: &Curve, over: &StepContext) -> f64 {
        let [change, end] = over.joint(curve.joint);
        let mean = change / over.h;
        mean + self.end_weight(curve, over) * (end - mean)
    }
}
