//! Projection onto the constraints at the end of a linearly implicit step.

use crate::integrator::{Kkt, Projection, StepError, System};
use crate::matrix::{Inverse, combination};
use crate::vector::Vector;

/// Metric of an implicit step. In it, corrections of q and q̇ are (1 − hγ C − (hγ)² K)⁻¹ times the corrections of the mass metric, which
/// would leave stiff forces out of balance.
pub(super) struct StiffMetric<'a, const N: usize> {
    /// Inverse matrix (1/(hγ) − C − hγ K)⁻¹ of the step, s.
    pub(super) inverse: &'a Inverse<N>,
    /// Step length, s.
    pub(super) h: f64,
}

impl<const N: usize> StiffMetric<'_, N> {
    /// Projects q, with its pose, onto the constraints, and q̇ too if q has moved. Returns the number of iterations.
    pub(super) fn project<const M: usize, S: System<N, M>>(
        &self,
        projection: &Projection,
        system: &S,
        pose: &mut S::Pose,
        [q, v]: [&mut Vector<N>; 2],
    ) -> Result<u32, StepError> {
        let mut directions = None;
        let along = |pose: &S::Pose, missing| {
            combination(directions.get_or_insert_with(|| self.directions(system, projection.regularization, pose)), &missing)
        };
        let iterations = projection.position_along(system, pose, q, along)?;
        if let Some(directions) = &directions {
            *v += combination(directions, &-system.phi_q_times(pose, v));
        }
        Ok(iterations)
    }

    /// Corrections of q or q̇ per unit of each constraint residual.
    fn directions<const M: usize, S: System<N, M>>(&self, system: &S, regularization: f64, pose: &S::Pose) -> [Vector<N>; M] {
        let mass = system.factor_mass(pose, regularization);
        let directions: [Vector<N>; M] = std::array::from_fn(|i| self.inverse.times(&mass.correction(&Vector::unit(i))));
        // Loads couple the corrections, so the columns are combined: each correction then belongs to one constraint.
        let shares = Inverse::new(directions.map(|direction| system.phi_q_times(pose, &direction)), f64::EPSILON * self.h);
        std::array::from_fn(|i| combination(&directions, &shares.times(&Vector::unit(i))))
    }
}
