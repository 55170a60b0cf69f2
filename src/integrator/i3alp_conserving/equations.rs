//! Residuals of the conserving step, equations (37) of `docs/conserving.md`.

use crate::integrator::{Discrete, StepIncrement};
use crate::vector::Vector;

/// Data of a step that stay constant during its iterations.
pub(super) struct Step<'a, S: Discrete<N, M>, const N: usize, const M: usize> {
    pub(super) system: &'a S,
    pub(super) q: Vector<N>,
    /// Velocity q̇₀ at the beginning, m/s and rad/s.
    pub(super) v: Vector<N>,
    /// Pose at q₀.
    pub(super) pose: S::Pose,
    pub(super) h: f64,
    /// Factor on the regularisation rates of friction and servos, see [`StepIncrement::softening`].
    pub(super) softening: f64,
}

/// Unknowns of the step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unknowns<const N: usize, const M: usize> {
    /// Increment d = q₁ − q₀, m and rad.
    pub(super) d: Vector<N>,
    /// Λ = h²λ/2 with the mean joint forces λ, N·s².
    pub(super) lambda: Vector<M>,
    /// Multipliers ν of the velocity constraints, kg·m.
    pub(super) nu: Vector<M>,
}

/// Discrete derivatives at d, with the residuals of the equations.
pub(super) struct Evaluation<S: Discrete<N, M>, const N: usize, const M: usize> {
    pub(super) secant: S::Secant,
    /// Velocity q̇₁ at the end, m/s and rad/s.
    pub(super) v: Vector<N>,
    /// Momentum residual in the mass metric, M⁻¹ f, m and rad.
    pub(super) offset: Vector<N>,
    /// Momentum residual f, kg·m and kg·m².
    pub(super) force: Vector<N>,
    /// Position residual Φ(q₁), m.
    pub(super) phi: Vector<M>,
}

impl<'a, S: Discrete<N, M>, const N: usize, const M: usize> Step<'a, S, N, M> {
    /// Step of `h` seconds from q₀ and q̇₀.
    #[inline(always)]
    pub(super) fn new(system: &'a S, [q, v]: [&Vector<N>; 2], h: f64) -> Self {
        Self { system, q: *q, v: *v, pose: system.pose_in_place(q), h, softening: 1.0 }
    }

    /// The step with another length `h`, s.
    pub(super) fn shortened(&self, h: f64) -> Self {
        Self { pose: self.pose.clone(), h, ..*self }
    }

    /// The step with regularisation rates of friction multiplied by `softening`.
    pub(super) fn softened(&self, softening: f64) -> Self {
        Self { pose: self.pose.clone(), softening, ..*self }
    }

    /// Discrete derivatives of the joints at d.
    #[inline(always)]
    pub(super) fn secant(&self, d: &Vector<N>) -> S::Secant {
        self.system.secant(&self.pose, d)
    }

    /// Step increment as forces take it.
    #[inline(always)]
    pub(super) fn increment<'b>(
        &'b self,
        secant: &'b S::Secant,
        d: &'b Vector<N>,
        v: &'b Vector<N>,
    ) -> StepIncrement<'b, S::Secant, N> {
        StepIncrement { q: &self.q, d, v, h: self.h, softening: self.softening, secant }
    }

    /// z = d − M⁻¹J_cᵀν, the mean of h q̇₀ and h q̇₁.
    #[inline(always)]
    pub(super) fn mean_motion(&self, secant: &S::Secant, x: &Unknowns<N, M>) -> Vector<N> {
        x.d - self.system.apply_inverse_mass(&self.system.mean_transposed_times(secant, &x.nu))
    }

    /// Momentum residual f = M (z − h q̇₀) + J_bᵀΛ + ½ K_b(z)ᵀν − ½h² Q̄, with position residual and velocity at the end.
    #[inline(always)]
    pub(super) fn evaluate(&self, secant: S::Secant, z: Vector<N>, x: &Unknowns<N, M>) -> Evaluation<S, N, M> {
        let &Self { system, q, v: v0, h, .. } = self;
        let v = (2.0 / h) * z - v0;
        let joint_forces = system.discrete_transposed_times(&secant, &x.lambda);
        let turning = system.discrete_hessian_times(&secant, &z, &x.nu);
        let applied = system.mean_forces(&self.increment(&secant, &x.d, &v));
        let force = system.mass_times(S::end(&secant), &(z - h * v0)) + joint_forces + 0.5 * turning - 0.5 * h * h * applied;
        let phi = system.phi(&(q + x.d), S::end(&secant));
        Evaluation { v, offset: system.apply_inverse_mass(&force), force, phi, secant }
    }
}
