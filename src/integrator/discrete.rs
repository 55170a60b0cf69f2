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
    /// What is left of the unknowns where the loops are cut.
    type CutUnknowns;
    /// See [`Discrete::cut`].
    type Cut<'a>: CutStep<N, M, Unknowns = Self::CutUnknowns, Secant = Self::Secant>
    where
        Self: 'a;

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
    fn mean_forces(&self, over: &StepIncrement<'_, Self::Secant, N>) -> Vector<N>;
    /// What the inputs put in and what is dissipated over the step, J. Asked only if [`System::follows_work`].
    fn work_over(&self, over: &StepIncrement<'_, Self::Secant, N>) -> Work;

    /// The step of h seconds from q₀ and q̇₀ with its loops cut: in coordinates in which all joints but some are met, whose forces follow
    /// from what the bodies between them take. What is left has the same roots and is small.
    fn cut<'a>(&'a self, begin: &'a Self::Pose, at: [&'a Vector<N>; 2], h: f64) -> Self::Cut<'a>;
    /// Of d, Λ and ν the unknowns of that.
    fn cut_unknowns(&self, d: &Vector<N>, multipliers: [&Vector<M>; 2]) -> Self::CutUnknowns;
    /// Whether Λ and ν may be found in turn, with the loops cut: inertias are not far apart.
    fn alternates(&self) -> bool;
    /// Newton's increments of d, Λ and ν with the whole tangent; e weighs increments only.
    fn newton(
        &self,
        over: &StepIncrement<'_, Self::Secant, N>,
        multipliers: [&Vector<M>; 2],
        residuals: (&Vector<N>, &Vector<M>, &Vector<M>),
        regularization: f64,
    ) -> (Vector<N>, [Vector<M>; 2]);

    /// Whether no effect dissipates or drives, so that no law can be made softer, see [`StepIncrement::softening`].
    fn is_conservative(&self) -> bool;
}

/// A step as the forces see it.
#[derive(Clone, Copy, Debug)]
pub struct StepIncrement<'a, S, const N: usize> {
    /// q₀.
    pub q: &'a Vector<N>,
    /// q₁ − q₀.
    pub d: &'a Vector<N>,
    /// q̇₁.
    pub v: &'a Vector<N>,
    /// The step, s.
    pub h: f64,
    /// Factor on the rates at which friction and servos turn, 1 but on the way to a root that Newton's method does not find at once.
    pub softening: f64,
    /// What belongs to q₀ and d.
    pub secant: &'a S,
}

/// A step whose loops are cut: ν by a linear equation for a given d, Newton's method on d and Λ.
pub trait CutStep<const N: usize, const M: usize> {
    /// What is left of the unknowns d, Λ and ν.
    type Unknowns;
    /// [`Discrete::Secant`].
    type Secant;
    /// How the system moves at some unknowns.
    type Motion;
    /// What forces make of it.
    type Balance;
    /// A factorised matrix.
    type Factor;

    /// Meets the constraints of the rates, by ν. e weighs how ν changes only.
    fn motion(&self, x: &Self::Unknowns, regularization: f64) -> Self::Motion;
    /// What that leaves of the momentum.
    fn balance(&self, motion: &Self::Motion) -> Self::Balance;
    /// What is left: of the momentum, as an angle, rad; of Φ and of h/2 times its rate, m.
    fn left(&self, motion: &Self::Motion, balance: &Self::Balance) -> [f64; 3];
    /// The matrix of Newton's method for d and Λ: e weighs increments only.
    fn factor(&self, motion: &Self::Motion, balance: &Self::Balance, regularization: f64) -> Self::Factor;
    /// The unknowns with Newton's increments, by the matrix of this motion or one close by.
    fn improved(&self, motion: &Self::Motion, balance: &Self::Balance, factor: &Self::Factor) -> Self::Unknowns;
    /// The motion with the rates, and Λ, of these increments, but on its own way.
    fn with_rates(&self, motion: &Self::Motion, balance: &Self::Balance, factor: &Self::Factor) -> Self::Motion;
    /// [`System::error_norm`] of d.
    fn turn(x: &Self::Unknowns) -> f64;
    /// The unknowns, with the ν of this motion.
    fn unknowns(motion: &Self::Motion) -> Self::Unknowns;
    /// d and q̇₁.
    fn end(&self, motion: &Self::Motion) -> [Vector<N>; 2];
    /// What depends on d.
    fn secant(&self, motion: &Self::Motion) -> Self::Secant;
    /// Λ and ν of all joints.
    fn multipliers(&self, motion: &Self::Motion) -> [Vector<M>; 2];
}
