//! What the conserving step asks of a system: derivatives over a finite step instead of those at a point.

use super::{System, Work};
use crate::vector::Vector;

/// A system that knows its constraints and forces over a step from q₀ to q₁ = q₀ + d.
///
/// J_b is the discrete Jacobian, J_b d = Φ(q₁) − Φ(q₀), J_c the mean (Φ_q(q₀) + Φ_q(q₁))/2, J₁ = Φ_q(q₁); Q̄ the forces' mean, whose
/// work Q̄ᵀd is exactly what their potentials lose and what is put in and dissipated.
pub trait Discrete<const N: usize, const M: usize>: System<N, M, Pose: Clone> {
    /// What depends on q₀ and d only, and is computed once per d.
    type Secant;
    /// The factorised matrix of [`Discrete::factor_secant`].
    type Factor: SecantFactor<N, M>;

    /// From the pose at q₀ along d.
    fn secant(&self, begin: &Self::Pose, d: &Vector<N>) -> Self::Secant;
    /// The pose at q₁.
    fn end(secant: &Self::Secant) -> &Self::Pose;
    /// J_bᵀ Λ.
    fn discrete_transposed_times(&self, secant: &Self::Secant, multipliers: &Vector<M>) -> Vector<N>;
    /// J_cᵀ ν.
    fn mean_transposed_times(&self, secant: &Self::Secant, multipliers: &Vector<M>) -> Vector<N>;
    /// The discrete derivative of νᵀ Φ_q z with respect to q: its product with d is νᵀ (Φ_q(q₁) − Φ_q(q₀)) z.
    fn turning_transposed_times(&self, secant: &Self::Secant, z: &Vector<N>, multipliers: &Vector<M>) -> Vector<N>;
    /// M⁻¹ x.
    fn apply_inverse_mass(&self, x: &Vector<N>) -> Vector<N>;

    /// Q̄.
    fn mean_forces(&self, over: &Chord<'_, Self::Secant, N>) -> Vector<N>;
    /// What the inputs put in and what is dissipated over the step, J. Asked only if [`System::follows_work`].
    fn work_over(&self, over: &Chord<'_, Self::Secant, N>) -> Work;

    /// Whether Λ and ν may be found in turn: the forces depend on no rates and couple no coordinates.
    fn alternates(&self) -> bool;
    /// Factorises [A J_bᵀ; J₁ −e], A the tangent of the step's equations with respect to d. Asked only if [`Discrete::alternates`].
    fn factor_secant(&self, over: &Chord<'_, Self::Secant, N>, pull: (&Vector<M>, &Vector<N>), regularization: f64)
    -> Self::Factor;
    /// Newton's increments of d, Λ and ν with the whole tangent; e weighs increments only.
    fn newton(
        &self,
        over: &Chord<'_, Self::Secant, N>,
        multipliers: [&Vector<M>; 2],
        residuals: (&Vector<N>, &Vector<M>, &Vector<M>),
        regularization: f64,
    ) -> (Vector<N>, [Vector<M>; 2]);

    /// Whether laws of friction can be made softer, see [`Chord::softening`].
    fn has_friction(&self) -> bool;
}

/// A step as the forces see it.
#[derive(Clone, Copy, Debug)]
pub struct Chord<'a, S, const N: usize> {
    /// q₀.
    pub q: &'a Vector<N>,
    /// q₁ − q₀.
    pub d: &'a Vector<N>,
    /// q̇₁.
    pub v: &'a Vector<N>,
    /// The step, s.
    pub h: f64,
    /// Factor on the rates at which friction turns, 1 but on the way to a root that Newton's method does not find at once.
    pub softening: f64,
    /// What belongs to q₀ and d.
    pub secant: &'a S,
}

/// A factorised matrix [A J_bᵀ; J₁ −e].
pub trait SecantFactor<const N: usize, const M: usize> {
    /// Solves A x + J_bᵀ y = b, J₁ x − e y = c.
    fn solve(&self, b: &Vector<N>, c: &Vector<M>) -> (Vector<N>, Vector<M>);
    /// (J₁ A⁻¹ J_bᵀ + e)⁻¹ r.
    fn dual(&self, r: &Vector<M>) -> Vector<M>;
}
