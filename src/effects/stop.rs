//! Stop: one-sided end stops on the motor axes, at `lower` and `upper`.
//!
//! Beyond a limit by d > 0 a torque N = max(0, s(d)(k d + d_coeff ḋ)) drives the axis back: see `unilateral_spring.rs` for the ramp
//! s, the potential and what is dissipated. K = ∂N/∂d, C = ∂N/∂ḋ. Angles count whole turns. Defaults: lower 0, upper π rad, the
//! half turn of a table-top pantograph; k 50 N·m/rad and 0.02 N·m·s/rad, a rubber buffer at some centimetres; ramp 1 mrad.
//! Limits: no friction in the stop; restitution follows from k and d and is not a parameter.

use arrayvec::ArrayVec;

use super::force_context::{ForceContext, MOTOR_LINKS, MOTORS};
use super::kinks::{SPRINGS, STOPS, Touch};
use super::unilateral_spring::UnilateralSpring;
use super::{Force, Tangents};
use crate::mechanism::{Coordinates, LINKS, Mechanism, SceneError, finite, not_negative, positive};

/// The `stop.*` variables.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    /// Whether the scene has stops.
    pub enabled: bool,
    /// Smallest free angle of the left and right proximal link, rad.
    pub lower: [f64; 2],
    /// Largest free angle, rad.
    pub upper: [f64; 2],
    /// Stiffness, N·m/rad.
    pub k: f64,
    /// Damping, N·m·s/rad.
    pub d: f64,
    /// Penetration over which the torque ramps up, rad.
    pub width: f64,
}

/// The stops ready to act.
#[derive(Clone, Debug, PartialEq)]
pub struct Stop {
    lower: [f64; 2],
    upper: [f64; 2],
    spring: UnilateralSpring,
}

impl Stop {
    /// Each stop, with its motor and the direction of the axis into it.
    fn reaches(&self, at: &ForceContext) -> impl Iterator<Item = (usize, f64, Touch<'_>)> {
        let axes = [0, 1].map(|motor| [at.motor_angle(motor), at.motor_rate(motor)]);
        (0..2).flat_map(move |motor| {
            let [angle, rate] = axes[motor];
            let [lower, upper] = STOPS[motor];
            let mut arms = [0.0; LINKS];
            arms[MOTOR_LINKS[motor]] = 1.0;
            let touch = |place, depth, rate| Touch { place, spring: &self.spring, depth, rate, arms };
            [(motor, -1.0, touch(lower, self.lower[motor] - angle, -rate)), (motor, 1.0, touch(upper, angle - self.upper[motor], rate))]
        })
    }
}

impl Force for Stop {
    type Parameters = Parameters;

    const STEEP: bool = true;

    const TOUCHES: bool = true;

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
        for (motor, direction, touch) in self.reaches(at) {
            forces[MOTORS[motor]] -= direction * touch.force(at);
        }
    }

    #[inline(never)]
    fn add_tangents(&self, at: &ForceContext, tangents: &mut impl Tangents) {
        for (motor, _, touch) in self.reaches(at) {
            let [stiffness, damping] = touch.slopes(at);
            tangents.stiffness(MOTORS[motor], MOTORS[motor], stiffness);
            tangents.damping(MOTORS[motor], MOTORS[motor], damping);
        }
    }

    fn potential(&self, at: &ForceContext) -> f64 {
        self.reaches(at).map(|(.., touch)| touch.potential(at)).sum()
    }

    fn dissipation(&self, at: &ForceContext) -> f64 {
        self.reaches(at).map(|(.., touch)| touch.dissipation(at)).sum()
    }

    fn touches(&self, at: &ForceContext) -> ArrayVec<Touch<'_>, SPRINGS> {
        self.reaches(at).map(|(.., touch)| touch).collect()
    }
}
