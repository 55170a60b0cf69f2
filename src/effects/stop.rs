//! Stop: unilateral end stops on the motor axes, at `lower` and `upper`.
//!
//! At a penetration d > 0 of a limit, the torque N = max(0, s(d)(k d + c ḋ)) drives the axis back. `hybrid/unilateral.rs` describes the
//! ramp s, the potential and the dissipation. K = ∂N/∂d, C = ∂N/∂ḋ. Angles count whole turns, so limits beyond 2π act. Defaults: lower 0,
//! upper π rad, the half turn of a table-top pantograph; k 50 N·m/rad and 0.02 N·m·s/rad, a rubber buffer at some centimetres; ramp 1 mrad.
//! Limits: no friction in the stop; restitution follows from k and d and is not a parameter.

use super::finite_motion::FiniteMotion;
use super::force_law::{ForceLaw, Properties};
use super::wrench::{JOINT_ARMS, MOTOR_ANGLES, Motion, Slopes, Wrench};
use crate::hybrid::{Kink, Kinks, MeanReaction, UnilateralSpring};
use crate::mechanism::{Mechanism, SceneError};

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

/// The stops, prepared from their parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Stop {
    lower: [f64; 2],
    upper: [f64; 2],
    spring: UnilateralSpring,
}

/// Directions of an axis into its lower and its upper stop.
const DIRECTIONS: [f64; 2] = [-1.0, 1.0];

impl Stop {
    /// Prepares the stops. Refuses limits that leave no free angle.
    pub(super) fn new(parameters: &Parameters, _mechanism: &Mechanism) -> Result<Self, SceneError> {
        let Parameters { lower, upper, k, d, width, .. } = *parameters;
        for i in 0..2 {
            if lower[i] >= upper[i] {
                return Err(SceneError(format!(
                    "stop.lower[{0}] = {1} rad is not allowed: it must be below stop.upper[{0}] = {2} rad.",
                    i + 1,
                    lower[i],
                    upper[i]
                )));
            }
        }
        Ok(Self { lower, upper, spring: UnilateralSpring { stiffness: k, damping: d, width } })
    }

    /// Kinks of a motor's lower and upper stop, with the penetration as their quantity.
    fn kinks_of(&self, at: &Motion, motor: usize) -> [Kink<'_, UnilateralSpring>; 2] {
        let (angle, rate) = (at.joints.angles[motor], at.joints.rates[MOTOR_ANGLES[motor]]);
        let depths = [self.lower[motor] - angle, angle - self.upper[motor]];
        [0, 1].map(|i| Kink {
            place: Self::KINKS.start + 2 * motor + i,
            law: &self.spring,
            x: depths[i],
            rate: DIRECTIONS[i] * rate,
            arms: &JOINT_ARMS[MOTOR_ANGLES[motor]],
        })
    }

    /// Visits the active stops with their joint, the direction of its axis into the stop, and the kink.
    fn for_each_active(&self, at: &Motion, mut visit: impl FnMut(usize, f64, &Kink<'_, UnilateralSpring>)) {
        for (motor, joint) in MOTOR_ANGLES.into_iter().enumerate() {
            for (direction, kink) in DIRECTIONS.into_iter().zip(self.kinks_of(at, motor)) {
                if !kink.is_idle(&at.joints.mode) {
                    visit(joint, direction, &kink);
                }
            }
        }
    }

    /// Joint, direction into the stop and mean reaction of each stop over a step. A fast axis may leave one stop and reach the other in one
    /// step.
    fn mean_reactions(&self, over: &FiniteMotion) -> impl Iterator<Item = (usize, f64, MeanReaction)> {
        MOTOR_ANGLES.into_iter().enumerate().flat_map(move |(motor, joint)| {
            let (begin, change) = (over.angles[motor], over.changes[joint]);
            let push =
                |direction: f64, depth: f64| (joint, direction, self.spring.mean_reaction(depth, direction * change, over.h));
            [push(1.0, begin - self.upper[motor]), push(-1.0, self.lower[motor] - begin)]
        })
    }
}

impl ForceLaw for Stop {
    fn properties(&self) -> Properties {
        Properties::contact(self.spring.damping == 0.0)
    }

    fn act(&self, at: &Motion, wrench: &mut Wrench) -> [f64; 2] {
        let (mode, mut dissipated) = (&at.joints.mode, 0.0);
        self.for_each_active(at, |joint, direction, kink| {
            wrench.torques[joint] -= direction * kink.force(mode);
            dissipated += kink.dissipation(mode);
        });
        [0.0, dissipated]
    }

    fn add_slopes(&self, at: &Motion, slopes: &mut Slopes) {
        self.for_each_active(at, |joint, _, kink| {
            let [stiffness, damping] = kink.slopes(&at.joints.mode);
            slopes.joints[joint][0] += stiffness;
            slopes.joints[joint][1] += damping;
        });
    }

    fn act_over(&self, over: &FiniteMotion, wrench: &mut Wrench) -> [f64; 2] {
        let mut dissipated = 0.0;
        for (joint, direction, push) in self.mean_reactions(over) {
            wrench.torques[joint] -= direction * push.force;
            dissipated += push.dissipated;
        }
        [0.0, dissipated]
    }

    fn add_slopes_over(&self, over: &FiniteMotion, slopes: &mut Slopes) {
        for (joint, _, push) in self.mean_reactions(over) {
            slopes.joints[joint][0] += push.slope;
        }
    }

    fn potential(&self, at: &Motion) -> f64 {
        (0..2).flat_map(|motor| self.kinks_of(at, motor)).map(|kink| kink.potential(&at.joints.mode)).sum()
    }

    fn add_kinks<'a>(&'a self, at: &Motion, kinks: &mut Kinks<'a>) {
        kinks.extend((0..2).flat_map(|motor| self.kinks_of(at, motor)).map(Kink::erased));
    }
}
