//! Projection onto the position and velocity constraints in the mass metric (`docs/method.md`, (15) and (21)).

use super::{Kkt, StepError, System};
use crate::vector::Vector;

/// Violation below which stagnation counts as round-off, relative to the system's size.
pub(super) const ROUND_OFF: f64 = 64.0 * f64::EPSILON;

/// Settings of a position projection.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    /// Regularisation e of the saddle-point systems, 1/kg.
    pub regularization: f64,
    /// Admissible max |Φ|, m.
    pub tolerance: f64,
    /// Largest number of Newton iterations.
    pub max_iterations: u32,
}

/// Admissible violation of a projection to round-off, relative to the system's size.
const TO_ROUND_OFF: f64 = 8.0 * f64::EPSILON;

impl Projection {
    /// Projection to round-off in a system of this [`System::length_scale`], m.
    pub fn to_round_off(length_scale: f64, regularization: f64, max_iterations: u32) -> Self {
        Self { regularization, tolerance: TO_ROUND_OFF * length_scale, max_iterations }
    }

    /// Projects q onto Φ = 0 by Newton's method; returns iterations and pose.
    #[inline(never)]
    pub fn position<const N: usize, const M: usize, S: System<N, M>>(
        &self,
        system: &S,
        q: &mut Vector<N>,
    ) -> Result<(u32, S::Pose), StepError> {
        let mut pose = system.pose(q);
        Ok((self.position_from(system, &mut pose, q)?, pose))
    }

    /// Projects q onto Φ = 0 from the pose at q, inlined and unrolled for one correction, as most steps need; returns the
    /// iterations.
    #[inline(always)]
    pub(super) fn position_from<const N: usize, const M: usize, S: System<N, M>>(
        &self,
        system: &S,
        pose: &mut S::Pose,
        q: &mut Vector<N>,
    ) -> Result<u32, StepError> {
        let phi = system.phi(q, pose);
        let violation = phi.max_norm();
        if violation < self.tolerance {
            return Ok(0);
        }
        let corrected = *q + system.factor_mass(pose, self.regularization).correction(&-phi);
        let correction = corrected - *q;
        *pose = system.updated_pose((q, pose), &correction);
        *q = corrected;
        if self.max_iterations > 0 && system.phi(q, pose).max_norm() < self.tolerance {
            return Ok(1);
        }
        let iterations;
        (iterations, *q, *pose) = self.position_after((violation, correction.max_norm()), system, corrected)?;
        Ok(iterations)
    }

    /// Continues [`Self::position_from`] after the first correction, with violation, m, and correction, m and rad, before.
    /// Arguments by value keep the caller's copies in registers.
    #[inline(never)]
    fn position_after<const N: usize, const M: usize, S: System<N, M>>(
        &self,
        before: (f64, f64),
        system: &S,
        mut q: Vector<N>,
    ) -> Result<(u32, Vector<N>, S::Pose), StepError> {
        let mut pose = system.pose(&q);
        let correction = |pose: &S::Pose, missing| system.factor_mass(pose, self.regularization).correction(&missing);
        let iterations = self.position_on((1, before), system, &mut pose, &mut q, correction)?;
        Ok((iterations, q, pose))
    }

    /// Projects q onto Φ = 0 with corrections by a given map from the residual of Φ to a change of q, instead of the mass metric.
    #[inline(always)]
    pub(super) fn position_along<const N: usize, const M: usize, S: System<N, M>>(
        &self,
        system: &S,
        pose: &mut S::Pose,
        q: &mut Vector<N>,
        correction: impl FnMut(&S::Pose, Vector<M>) -> Vector<N>,
    ) -> Result<u32, StepError> {
        self.position_on((0, (f64::INFINITY, 0.0)), system, pose, q, correction)
    }

    /// Newton loop of the projections from a given iteration count, with the last violation, m, and correction, m and rad.
    #[inline(always)]
    fn position_on<const N: usize, const M: usize, S: System<N, M>>(
        &self,
        (iterations, (mut violation, mut last)): (u32, (f64, f64)),
        system: &S,
        pose: &mut S::Pose,
        q: &mut Vector<N>,
        mut correction: impl FnMut(&S::Pose, Vector<M>) -> Vector<N>,
    ) -> Result<u32, StepError> {
        for iteration in iterations..=self.max_iterations {
            let phi = system.phi(q, pose);
            let previous = violation;
            violation = phi.max_norm();
            let at_round_off = violation >= previous && violation < ROUND_OFF * system.length_scale();
            if violation < self.tolerance || at_round_off {
                return Ok(iteration);
            }
            let correction = correction(pose, -phi);
            last = correction.max_norm();
            let corrected = *q + correction;
            *pose = system.updated_pose((q, pose), &(corrected - *q));
            *q = corrected;
        }
        Err(StepError::NotConverged { iterations: self.max_iterations, violation, tolerance: self.tolerance, correction: last })
    }
}

/// Correction of q̇ to Φ_q q̇ = 0 in the mass metric, from the factorised mass matrix.
#[inline]
pub fn velocity_correction<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    pose: &S::Pose,
    mass: &S::Mass,
    v: &Vector<N>,
) -> Vector<N> {
    mass.correction(&-system.phi_q_times(pose, v))
}
