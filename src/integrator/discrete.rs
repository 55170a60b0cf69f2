//! Interface of the conserving step to a system: the step in the unknowns that remain when the loops are cut.

use super::{System, Work};
use crate::vector::Vector;

/// A system over finite steps from q₀ to q₁ = q₀ + d, with discrete derivatives of constraints and forces. When the loops are cut, K
/// unknowns remain.
pub trait Discrete<const N: usize, const M: usize, const K: usize>: System<N, M> {
    /// Discrete derivatives of the joints. They depend only on q₀ and d and are computed once per d.
    type Secant: Copy;
    /// The step with its loops cut, see [`Discrete::cut`].
    type Cut<'a>: CutStep<N, M, K, Secant = Self::Secant>
    where
        Self: 'a;

    /// Discrete derivatives along d from the pose at q₀.
    fn secant(&self, begin: &Self::Pose, d: &Vector<N>) -> Self::Secant;
    /// Pose at q₁.
    fn end(secant: &Self::Secant) -> &Self::Pose;

    /// Mean forces Q̄, N and N·m. Their work Q̄ᵀd is the loss of potential energy plus the work of inputs minus dissipation.
    fn mean_forces(&self, over: &StepIncrement<'_, Self::Secant, N>) -> Vector<N>;
    /// Work of inputs and dissipation over the step, J. Called only if [`System::features`] ask for work.
    fn work_over(&self, over: &StepIncrement<'_, Self::Secant, N>) -> Work;

    /// The step of `h` seconds from q₀ and q̇₀ with its loops cut. Joint coordinates satisfy all joints except the cut ones; the forces of
    /// the other joints follow from the bodies between them. `softening` multiplies the regularisation rates of friction and servos.
    fn cut<'a>(&'a self, begin: &'a Self::Pose, at: [&'a Vector<N>; 2], h: f64, softening: f64) -> Self::Cut<'a>;
    /// Whether the iteration leg by leg contracts: inertias must not differ too much.
    fn allows_staggering(&self) -> bool;

    /// Whether no effect dissipates or drives, so that there is no law to soften; see [`StepIncrement::softening`].
    fn is_conservative(&self) -> bool;
}

/// Increment of a step, as passed to the evaluation of forces.
#[derive(Clone, Copy, Debug)]
pub struct StepIncrement<'a, S, const N: usize> {
    /// Coordinates q₀ at the beginning, m and rad.
    pub q: &'a Vector<N>,
    /// Increment q₁ − q₀, m and rad.
    pub d: &'a Vector<N>,
    /// Velocities q̇₁ at the end, m/s and rad/s.
    pub v: &'a Vector<N>,
    /// Step length, s.
    pub h: f64,
    /// Factor on the regularisation rates of friction and servos; 1 except in a homotopy to a root.
    pub softening: f64,
    /// Discrete derivatives at q₀ and d.
    pub secant: &'a S,
}

/// A step with cut loops, in K reduced unknowns of d, Λ and ν. ν follows from a linear equation for given d; Newton's method solves for d
/// and Λ.
pub trait CutStep<const N: usize, const M: usize, const K: usize> {
    /// Discrete derivatives, [`Discrete::Secant`].
    type Secant;
    /// Motion of the system for given unknowns.
    type Motion;
    /// Momentum balance of a motion, with its residuals.
    type Balance;
    /// Factorised Newton matrix.
    type Factor;

    /// Unknowns of d and Λ, with ν = 0.
    fn unknowns_of(d: &Vector<N>, lambda: &Vector<M>) -> Vector<K>;
    /// Unknowns of a step that is longer by a factor: d grows with the factor, Λ and ν with its square.
    fn lengthened(x: &Vector<K>, factor: f64) -> Vector<K>;
    /// Motion with rates that satisfy the velocity constraints, by solving for ν; e only weights the change of ν.
    fn motion(&self, x: &Vector<K>, regularization: f64) -> Self::Motion;
    /// Motion with the ν of the unknowns; its rates may violate the velocity constraints.
    fn free_motion(&self, x: &Vector<K>) -> Self::Motion;
    /// Momentum balance of a motion.
    fn balance(&self, motion: &Self::Motion) -> Self::Balance;
    /// Residuals: momentum as an angle, rad; Φ, m; h/2 times the rate of Φ, m.
    fn residuals(&self, motion: &Self::Motion, balance: &Self::Balance) -> [f64; 3];
    /// Newton matrix for d and Λ, leg by leg; e only weighs increments.
    fn factor(&self, motion: &Self::Motion, balance: &Self::Balance, regularization: f64) -> Self::Factor;
    /// Unknowns after a Newton increment with the matrix of this or a nearby motion.
    fn newton_update(&self, motion: &Self::Motion, balance: &Self::Balance, factor: &Self::Factor) -> Vector<K>;
    /// Newton increment of the unknowns with the whole tangent; e only weights it.
    fn whole_correction(&self, motion: &Self::Motion, balance: &Self::Balance, regularization: f64) -> Vector<K>;
    /// Motion with rates and Λ after a Newton increment, at unchanged d.
    fn with_rates(&self, motion: &Self::Motion, balance: &Self::Balance, factor: &Self::Factor) -> Self::Motion;
    /// Error norm of d, see [`System::error_norm`], rad.
    fn rotation_norm(x: &Vector<K>) -> f64;
    /// Unknowns of a motion, including its ν.
    fn unknowns(motion: &Self::Motion) -> Vector<K>;
    /// Increment d and velocity q̇₁ at the end.
    fn end(&self, motion: &Self::Motion) -> [Vector<N>; 2];
    /// Discrete derivatives of a motion.
    fn secant(motion: &Self::Motion) -> &Self::Secant;
}
