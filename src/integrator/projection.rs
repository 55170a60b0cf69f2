//! Back onto the constraints, along the shortest way in the mass metric.

use super::{Kkt, StepError, System};
use crate::vector::Vector;

/// A violation below this part of the system's size that does not fall any more is round-off.
pub(super) const ROUND_OFF: f64 = 64.0 * f64::EPSILON;

/// How far a projection goes.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    /// e of the saddle-point systems, 1/kg.
    pub regularization: f64,
    /// max |Φ| to be met, m.
    pub tolerance: f64,
    /// Most Newton iterations.
    pub max_iterations: u32,
}

/// Where a projection goes as far as round-off lets it: a violation of this part of the system's size.
const TO_ROUND_OFF: f64 = 8.0 * f64::EPSILON;

impl Projection {
    /// As far as round-off lets it, in a system of this [`System::length_scale`].
    pub fn to_round_off(length_scale: f64, regularization: f64, max_iterations: u32) -> Self {
        Self { regularization, tolerance: TO_ROUND_OFF * length_scale, max_iterations }
    }

    /// Newton onto Φ = 0; the iterations spent, and the pose there.
    #[inline(never)]
    pub fn position<const N: usize, const M: usize, S: System<N, M>>(
        &self,
        system: &S,
        q: &mut Vector<N>,
    ) -> Result<(u32, S::Pose), StepError> {
        let mut pose = system.pose(q);
        Ok((self.position_from(system, &mut pose, q)?, pose))
    }

    /// The same with the pose at q, compiled into its caller, and without a loop: one correction is what most steps need.
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
        *pose = system.pose_turned((q, pose), &correction);
        *q = corrected;
        if self.max_iterations > 0 && system.phi(q, pose).max_norm() < self.tolerance {
            return Ok(1);
        }
        let iterations;
        (iterations, *q, *pose) = self.position_after((violation, correction.max_norm()), system, corrected)?;
        Ok(iterations)
    }

    /// The same after a correction, with the violation before it. It takes a copy: what is pointed to has to be in memory.
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

    /// The same along other ways than the shortest: by what q is corrected for what Φ lacks at a pose.
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

    /// The same after some iterations, with the violation before the last of them and what it corrected.
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
            *pose = system.pose_turned((q, pose), &(corrected - *q));
            *q = corrected;
        }
        Err(StepError::NotConverged { iterations: self.max_iterations, violation, tolerance: self.tolerance, correction: last })
    }
}

/// What q̇ lacks for Φ_q q̇ = 0, with the mass factor at hand.
#[inline]
pub fn velocity_correction<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    pose: &S::Pose,
    mass: &S::Mass,
    v: &Vector<N>,
) -> Vector<N> {
    mass.correction(&-system.phi_q_times(pose, v))
}
