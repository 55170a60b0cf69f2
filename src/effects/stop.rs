//! Stop: unilateral end stops on the motor axes, at `lower` and `upper`.
//!
//! At a penetration d > 0 of a limit a torque N = max(0, s(d)(k d + d_coeff ḋ)) drives the axis back: see `unilateral_spring.rs` for the
//! ramp s, the potential and the dissipation. K = ∂N/∂d, C = ∂N/∂ḋ. Angles count whole turns. Defaults: lower 0, upper π rad, the
//! half turn of a table-top pantograph; k 50 N·m/rad and 0.02 N·m·s/rad, a rubber buffer at some centimetres; ramp 1 mrad.
//! Limits: no friction in the stop; restitution follows from k and d and is not a parameter.

use arrayvec::ArrayVec;

use super::force_context::{ForceContext, MOTOR_ANGLES};
use super::guards::{SPRINGS, STOPS, UnilateralGuard};
use super::unilateral_spring::{MeanReaction, UnilateralSpring};
use super::{Force, MeanForce, StepContext, Tangents};
use crate::mechanism::{Coordinates, LINKS, Mechanism, SceneError, finite, not_negative, positive};

/// The `stop.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has stops.
    pub enabled: bool,
    /// Smallest free angle of the left and right proximal link, rad.
    pub lower: [f64; 2],
    /// Largest free angle of the left and right proximal link, rad.
    pub upper: [f64; 2],
    /// Stiffness, N·m/rad.
    pub k: f64,
    /// Damping, N·m·s/rad.
    pub d: f64,
    /// Penetration over which the torque ramps up, rad.
    pub width: f64,
}

/// The stops, made ready from their parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Stop {
    lower: [f64; 2],
    upper: [f64; 2],
    spring: UnilateralSpring,
}

/// Lever arms |∂d/∂θ| of the penetrations of a motor's stops by the angle of each link.
const ARMS: [[f64; LINKS]; 2] = [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

/// Directions of an axis into its lower and its upper stop.
const DIRECTIONS: [f64; 2] = [-1.0, 1.0];

impl Stop {
    /// Unilateral springs of a motor's lower and upper stop at a state.
    #[inline(always)]
    fn guards_of(&self, at: &ForceContext, motor: usize) -> [UnilateralGuard<'_>; 2] {
        let (angle, rate) = (at.motor_angle(motor), at.motor_rate(motor));
        let depths = [self.lower[motor] - angle, angle - self.upper[motor]];
        [0, 1].map(|i| {
            let rate = DIRECTIONS[i] * rate;
            UnilateralGuard { place: STOPS[motor][i], spring: &self.spring, depth: depths[i], rate, arms: &ARMS[motor] }
        })
    }

    /// Visits the active stops: motor, direction of its axis into the stop, and the unilateral spring.
    #[inline(always)]
    fn for_each_guard(&self, at: &ForceContext, mut visit: impl FnMut(usize, f64, &UnilateralGuard<'_>)) {
        for motor in 0..2 {
            for (direction, guard) in DIRECTIONS.into_iter().zip(self.guards_of(at, motor)) {
                if !guard.is_idle(at) {
                    visit(motor, direction, &guard);
                }
            }
        }
    }
}

impl Force for Stop {
    type Parameters = Parameters;

    const HAS_STIFF_FORCES: bool = true;

    const HAS_CONTACT: bool = true;

    fn new(parameters: &Parameters, _mechanism: &Mechanism) -> Result<Self, SceneError> {
        let Parameters { lower, upper, k, d, width, .. } = *parameters;
        for i in 0..2 {
            finite(format_args!("stop.lower[{}]", i + 1), lower[i], "rad")?;
            finite(format_args!("stop.upper[{}]", i + 1), upper[i], "rad")?;
            if lower[i] >= upper[i] {
                return Err(SceneError(format!(
                    "stop.lower[{0}] = {1} rad is not allowed: it must be below stop.upper[{0}] = {2} rad.",
                    i + 1,
                    lower[i],
                    upper[i]
                )));
            }
        }
        not_negative("stop.k", k, "N.m/rad")?;
        not_negative("stop.d", d, "N.m.s/rad")?;
        positive("stop.width", width, "rad")?;
        Ok(Self { lower, upper, spring: UnilateralSpring { stiffness: k, damping: d, width } })
    }

    fn conservative(&self) -> bool {
        self.spring.damping == 0.0
    }

    #[inline(never)]
    fn add_forces(&self, at: &ForceContext, forces: &mut Coordinates) {
        self.for_each_guard(at, |motor, direction, guard| forces[MOTOR_ANGLES[motor]] -= direction * guard.force(at));
    }

    #[inline(never)]
    fn add_tangents(&self, at: &ForceContext, tangents: &mut impl Tangents) {
        self.for_each_guard(at, |motor, _, guard| {
            let [stiffness, damping] = guard.slopes(at);
            tangents.stiffness(MOTOR_ANGLES[motor], MOTOR_ANGLES[motor], stiffness);
            tangents.damping(MOTOR_ANGLES[motor], MOTOR_ANGLES[motor], damping);
        });
    }

    fn potential(&self, at: &ForceContext) -> f64 {
        (0..2).flat_map(|motor| self.guards_of(at, motor)).map(|guard| guard.potential(at)).sum()
    }

    fn dissipation(&self, at: &ForceContext) -> f64 {
        let mut power = 0.0;
        self.for_each_guard(at, |_, _, guard| power += guard.dissipation(at));
        power
    }

    fn guard_values(&self, at: &ForceContext) -> ArrayVec<UnilateralGuard<'_>, SPRINGS> {
        [0, 1].into_iter().flat_map(|motor| self.guards_of(at, motor)).collect()
    }
}

impl MeanForce for Stop {
    #[inline(never)]
    fn add_mean_forces(&self, over: &StepContext, forces: &mut Coordinates) {
        for (motor, direction, push) in self.mean_reactions(over) {
            forces[MOTOR_ANGLES[motor]] -= direction * push.force;
        }
    }

    #[inline(never)]
    fn add_mean_tangents(&self, over: &StepContext, tangents: &mut impl Tangents) {
        for (motor, _, push) in self.mean_reactions(over) {
            tangents.stiffness(MOTOR_ANGLES[motor], MOTOR_ANGLES[motor], push.slope);
        }
    }

    fn dissipated_over(&self, over: &StepContext) -> f64 {
        self.mean_reactions(over).map(|(_, _, push)| push.dissipated).sum()
    }
}

impl Stop {
    /// Motor, direction into the stop and mean reaction of each stop over a step: a fast axis may leave one stop and reach the other.
    fn mean_reactions(&self, over: &StepContext) -> impl Iterator<Item = (usize, f64, MeanReaction)> {
        (0..2).flat_map(move |motor| {
            let [begin, change] = over.motor_angle(motor);
            let push = |direction: f64, depth: f64| (motor, direction, self.spring.mean_reaction(depth, direction * change, over.h));
            [push(1.0, begin - self.upper[motor]), push(-1.0, self.lower[motor] - begin)]
        })
    }
}
