//! Commands that a forecast does not know: motor torques and servo references walk at random from their last values.
//!
//! While no samples arrive, no commands arrive either. The errors c of the four commands, τ₁, τ₂, θ_ref,1 and θ_ref,2, are random walks from
//! the time of the last samples on; references that act late by `servo.delay` walk from this delay later on. Over a step the errors c move
//! the errors e of the motion, angles and rates on the tangent basis, by Γ c, where Γ is the effect of a constant unknown force times the
//! forces by the commands. The functions here propagate the variances of c, the covariance of
//! the part of e due to c, and the covariance between both.

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::{Matrix2, Matrix2x4, Matrix4, Vector4};

use super::error_state::{FORCE, Transition, bound_variances};
use super::flow::Scene;
use super::machine::Parameters;
use super::stored;
use super::tangent::{Frame, LinkState, Links};
use super::tuning::{ANYWHERE, LARGEST_RATE_VARIANCE};

/// Time within which a command changes by its scale, s.
pub(super) const COMMAND_TIME: f64 = 0.1;

/// Errors by commands that are unknown.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Unknown {
    /// Variances of the commands, (N·m)² and rad².
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    commands: Vector4<f64>,
    /// Covariance of the errors of the motion with the commands.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    shared: Matrix4<f64>,
    /// Covariance of the errors of the motion.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    motion: Matrix4<f64>,
    /// Time for which the commands have been unknown, s.
    time: f64,
}

/// A machine at the beginning of a step with constant commands.
pub(super) struct Step<'a, S: Scene> {
    pub(super) scene: &'a S,
    pub(super) motion: &'a LinkState,
    pub(super) frame: &'a Frame,
    /// Mass matrix, kg·m².
    pub(super) mass: &'a Matrix4<f64>,
    /// Unknown force, N·m and N.
    pub(super) force: &'a Links,
    /// Transition of the errors over the step.
    pub(super) transition: &'a Transition,
    /// Length, s.
    pub(super) h: f64,
}

/// Whether commands may change while they are unknown.
pub(super) fn may_change(parameters: &Parameters) -> bool {
    (parameters.command_scale_tau, parameters.command_scale_theta) != ([0.0; 2], [0.0; 2])
}

/// Variance rates of the commands, (N·m)²/s and rad²/s.
fn rates(parameters: &Parameters) -> Vector4<f64> {
    let ([a, b], [c, d]) = (parameters.command_scale_tau, parameters.command_scale_theta);
    Vector4::new(a, b, c, d).map(|scale| scale * scale / COMMAND_TIME)
}

/// Covariances due to commands that walk with these variance rates, each for its time, s: of the errors of the motion with the commands, and
/// of the errors of the motion. `effect` is Γ of commands that are constant for these times. Accelerations count as proportional to the
/// commands, so that angles grow with t³/6 and rates with t²/2.
fn walked(effect: &Matrix4<f64>, rates: &Vector4<f64>, times: &Vector4<f64>) -> [Matrix4<f64>; 2] {
    let with_commands = effect * Matrix4::from_diagonal(&rates.component_mul(times));
    let shared = Matrix4::from_fn(|i, k| with_commands[(i, k)] / if i < 2 { 3.0 } else { 2.0 });
    let parts = |i: usize, k: usize| [[5.0, 4.0], [4.0, 3.0]][i / 2][k / 2];
    let moved = with_commands * effect.transpose();
    [shared, Matrix4::from_fn(|i, k| moved[(i, k)] / parts(i, k))]
}

impl<S: Scene> Step<'_, S> {
    /// Forces on the tangent basis by each command, N·m per N·m and per rad.
    fn forces(&self, parameters: &Parameters) -> Matrix2x4<f64> {
        let by_torques = self.frame.motors().transpose();
        let has_references = parameters.command_scale_theta != [0.0; 2];
        let by_offsets = if has_references { self.scene.by_offsets(self.motion, self.force) } else { None };
        // A reference acts like minus the mounting angle of its encoder; Nᵀ M α is the force on the tangent basis.
        let by_references = by_offsets.map_or_else(Matrix2::zeros, |by| -self.frame.basis.tr_mul(&(self.mass * by)));
        Matrix2x4::from_columns(&[by_torques.column(0), by_torques.column(1), by_references.column(0), by_references.column(1)])
    }
}

impl Unknown {
    /// Errors after a step in which the commands are `unknown`; `since` is the time for which they had already been, s. Commands that are
    /// known again add no errors from then on.
    #[inline(never)]
    pub(super) fn after<S: Scene>(
        before: Option<Self>,
        parameters: &Parameters,
        step: &Step<'_, S>,
        (unknown, since): (bool, f64),
    ) -> Self {
        let (rates, h, delay) = (rates(parameters), step.h, step.scene.command_delay());
        // Times of the four commands: references act late.
        let times = |time: f64, of_references: f64| Vector4::new(time, time, of_references, of_references);
        let along: Matrix4<f64> = step.transition.fixed_view::<4, 4>(0, 0).into();
        let effect = step.transition.fixed_view::<4, 2>(0, FORCE) * step.forces(parameters);
        let Self { mut commands, mut shared, motion, time } = before.unwrap_or_else(|| {
            // Accelerations of the step act since the commands are unknown.
            let accelerations = effect.fixed_rows::<2>(2) / h;
            let times = times(since, (since - delay).max(0.0));
            let mut earlier = Matrix4::zeros();
            earlier
                .fixed_rows_mut::<2>(0)
                .copy_from(&(accelerations * Matrix4::from_diagonal(&times.map(|time| time * time / 2.0))));
            earlier.fixed_rows_mut::<2>(2).copy_from(&(accelerations * Matrix4::from_diagonal(&times)));
            let [shared, motion] = walked(&earlier, &rates, &times);
            Self { commands: rates.component_mul(&times), shared, motion, time: since }
        });
        let time = if unknown { time.max(since) } else { 0.0 };
        let times = if unknown { times(h, (time + h - delay).clamp(0.0, h)) } else { Vector4::zeros() };
        if !unknown {
            (commands, shared) = (Vector4::zeros(), Matrix4::zeros());
        }
        let carried = effect * Matrix4::from_diagonal(&commands);
        let crossed = along * shared * effect.transpose();
        let [own, within] = walked(&effect, &rates, &times);
        let mut shared = along * shared + carried + own;
        let motion = along * motion * along.transpose() + crossed + crossed.transpose() + carried * effect.transpose() + within;
        // Symmetric to the bit.
        let mut motion = (motion + motion.transpose()) / 2.0;
        // As the variances of the estimate: a forecast without end stays finite.
        bound_variances(&mut motion, [ANYWHERE, LARGEST_RATE_VARIANCE], |i, factor| shared.row_mut(i).scale_mut(factor));
        Self { commands: commands + rates.component_mul(&times), shared, motion, time: if unknown { time + h } else { 0.0 } }
    }

    /// Covariance of the errors of angles and rates on the tangent basis.
    pub(super) fn covariance(&self) -> &Matrix4<f64> {
        &self.motion
    }

    pub(super) fn is_sound(&self) -> bool {
        self.commands.iter().chain(&self.motion.diagonal()).all(|variance| *variance >= 0.0)
            && self.commands.iter().chain(&self.shared).chain(&self.motion).all(|x| x.is_finite())
            && self.time >= 0.0
            && self.time.is_finite()
    }
}
