//! Projection onto the position and velocity constraints in the mass metric (`docs/method.md`, (15) and (21)).

use super::convergence::{Convergence, LastCorrection};
use super::{Kkt, StepError, System};
use crate::vector::Vector;

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

/// Admissible violation of a projection to round-off, relative to the size of the system.
const TO_ROUND_OFF: f64 = 8.0 * f64::EPSILON;

impl Projection {
    /// Projection to round-off for a system with this [`System::length_scale`], m.
    pub fn to_round_off(length_scale: f64, regularization: f64, max_iterations: u32) -> Self {
        Self { regularization, tolerance: TO_ROUND_OFF * length_scale, max_iterations }
    }

    /// Projects q onto Φ = 0 by Newton's method. Returns the number of iterations and the pose; fails if `max_iterations` do not suffice.
    pub fn position<const N: usize, const M: usize, S: System<N, M>>(
        &self,
        system: &S,
        q: &mut Vector<N>,
    ) -> Result<(u32, S::Pose), StepError> {
        let mut pose = system.pose(q);
        Ok((self.position_from(system, &mut pose, q)?, pose))
    }

    /// Projects q onto Φ = 0 from the pose at q, with corrections in the mass metric. Returns the number of iterations.
    #[inline(always)]
    pub(super) fn position_from<const N: usize, const M: usize, S: System<N, M>>(
        &self,
        system: &S,
        pose: &mut S::Pose,
        q: &mut Vector<N>,
    ) -> Result<u32, StepError> {
        self.position_along(system, pose, q, |pose, missing| system.factor_mass(pose, self.regularization).correction(&missing))
    }

    /// Projects q onto Φ = 0 with corrections from a given map of the residual Φ to a change of q.
    #[inline(always)]
    pub(super) fn position_along<const N: usize, const M: usize, S: System<N, M>>(
        &self,
        system: &S,
        pose: &mut S::Pose,
        q: &mut Vector<N>,
        mut correction: impl FnMut(&S::Pose, Vector<M>) -> Vector<N>,
    ) -> Result<u32, StepError> {
        let mut convergence = Convergence::new(self.tolerance, system.length_scale(), LastCorrection::ANY);
        loop {
            let phi = system.phi(q, pose);
            if convergence.is_met(phi.max_norm()) {
                return Ok(convergence.iterations);
            }
            if convergence.iterations >= self.max_iterations {
                return Err(convergence.failure());
            }
            let corrected = *q + correction(pose, -phi);
            let by = corrected - *q;
            *pose = system.pose_near(q, pose, &by);
            *q = corrected;
            convergence.corrected(by.max_norm());
        }
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
