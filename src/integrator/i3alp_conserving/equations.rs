//! The equations of a conserving step: what its unknowns leave of them.

use crate::integrator::{Discrete, StepIncrement};
use crate::vector::Vector;

/// A step in the making: where it starts from.
pub(super) struct Step<'a, S: Discrete<N, M>, const N: usize, const M: usize> {
    pub(super) system: &'a S,
    pub(super) q: Vector<N>,
    /// q̇₀.
    pub(super) v: Vector<N>,
    /// At q₀.
    pub(super) pose: S::Pose,
    pub(super) h: f64,
    /// See [`StepIncrement::softening`].
    pub(super) softening: f64,
}

/// The unknowns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unknowns<const N: usize, const M: usize> {
    /// d = q₁ − q₀.
    pub(super) d: Vector<N>,
    /// Λ = h²λ/2, the joint forces' mean.
    pub(super) lambda: Vector<M>,
    /// ν, the multipliers that hold the velocities.
    pub(super) nu: Vector<M>,
}

/// What depends on d, and what is left of the equations.
pub(super) struct Evaluation<S: Discrete<N, M>, const N: usize, const M: usize> {
    pub(super) secant: S::Secant,
    /// q̇₁.
    pub(super) v: Vector<N>,
    /// M⁻¹ f, m and rad.
    pub(super) offset: Vector<N>,
    /// f.
    pub(super) force: Vector<N>,
    /// Φ(q₁).
    pub(super) phi: Vector<M>,
}

impl<'a, S: Discrete<N, M>, const N: usize, const M: usize> Step<'a, S, N, M> {
    /// From q₀ and q̇₀ over h seconds.
    #[inline(always)]
    pub(super) fn new(system: &'a S, [q, v]: [&Vector<N>; 2], h: f64) -> Self {
        Self { system, q: *q, v: *v, pose: system.pose_in_place(q), h, softening: 1.0 }
    }

    /// The same step of another length.
    pub(super) fn shortened(&self, h: f64) -> Self {
        Self { pose: self.pose.clone(), h, ..*self }
    }

    /// The same with friction that turns at rates larger by a factor.
    pub(super) fn softened(&self, softening: f64) -> Self {
        Self { pose: self.pose.clone(), softening, ..*self }
    }

    /// What belongs to d.
    #[inline(always)]
    pub(super) fn secant(&self, d: &Vector<N>) -> S::Secant {
        self.system.secant(&self.pose, d)
    }

    /// The step as the forces see it.
    #[inline(always)]
    pub(super) fn chord<'b>(
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

    /// f = M (d − h q̇₀) − J_cᵀν + J_bᵀΛ + ½ K_b(z)ᵀν − ½h² Q̄, written with M (z − h q̇₀), and the rest.
    #[inline(always)]
    pub(super) fn evaluate(&self, secant: S::Secant, z: Vector<N>, x: &Unknowns<N, M>) -> Evaluation<S, N, M> {
        let &Self { system, q, v: v0, h, .. } = self;
        let v = (2.0 / h) * z - v0;
        let pull = system.discrete_transposed_times(&secant, &x.lambda);
        let turning = system.turning_transposed_times(&secant, &z, &x.nu);
        let applied = system.mean_forces(&self.chord(&secant, &x.d, &v));
        let force = system.mass_times(S::end(&secant), &(z - h * v0)) + pull + 0.5 * turning - 0.5 * h * h * applied;
        let phi = system.phi(&(q + x.d), S::end(&secant));
        Evaluation { v, offset: system.apply_inverse_mass(&force), force, phi, secant }
    }
}
