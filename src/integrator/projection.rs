//! Back onto the constraints, along the shortest way in the mass metric.

use super::vectors::{add, max_norm, minus};
use super::{Failure, Kkt, System};

/// How far a projection goes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Projection {
    /// e of the saddle-point systems, 1/kg.
    pub(super) softness: f64,
    /// max |Φ| to be met, m.
    pub(super) tolerance: f64,
    /// Most Newton iterations.
    pub(super) max_iterations: u32,
}

impl Projection {
    /// Newton onto Φ = 0; the iterations spent, and the pose there.
    #[inline(always)]
    pub(super) fn position<const N: usize, const M: usize, S: System<N, M>>(
        &self,
        system: &S,
        q: &mut [f64; N],
    ) -> Result<(u32, S::Pose), Failure> {
        let (mut violation, mut last) = (f64::INFINITY, 0.0);
        for iteration in 0..=self.max_iterations {
            let pose = system.pose(q);
            let phi = system.phi(q, &pose);
            let previous = violation;
            violation = max_norm(&phi);
            let at_round_off = violation >= previous && violation < 64.0 * f64::EPSILON * system.size();
            if violation < self.tolerance || at_round_off {
                return Ok((iteration, pose));
            }
            let correction = system.factor_mass(&pose, self.softness).correction(&minus(&phi));
            last = max_norm(&correction);
            *q = add(q, &correction);
        }
        Err(Failure::NotConverged { iterations: self.max_iterations, violation, tolerance: self.tolerance, correction: last })
    }
}

/// Φ_q q̇ = 0, with the mass factor at hand.
#[inline(always)]
pub(super) fn velocity<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    pose: &S::Pose,
    mass: &S::Mass,
    v: &[f64; N],
) -> [f64; N] {
    mass.correction(&minus(&system.phi_q_times(pose, v)))
}
