//! What the integrator asks of a mechanical system, and nothing else.

use std::fmt;

use borsh::{BorshDeserialize, BorshSerialize};

use super::vectors::{combine, max_norm};

/// A constrained mechanical system M q̈ + Φ_qᵀ λ = Q(q, q̇), Φ(q) = 0 with N coordinates and M constraint equations.
///
/// Inputs are part of the system: they are held while it is stepped. Constraints do not depend on time.
pub trait System<const N: usize, const M: usize> {
    /// What depends on q only and is computed once per q (directions, arms).
    type Pose;
    /// The factorised saddle-point matrix with the mass matrix in its corner.
    type Mass: Kkt<N, M>;

    /// Pose at q.
    fn pose(&self, q: &[f64; N]) -> Self::Pose;
    /// Φ(q).
    fn phi(&self, q: &[f64; N], pose: &Self::Pose) -> [f64; M];
    /// Φ_q v.
    fn phi_q_times(&self, pose: &Self::Pose, v: &[f64; N]) -> [f64; M];
    /// Φ̇_q q̇.
    fn phi_q_dot_times(&self, pose: &Self::Pose, v: &[f64; N]) -> [f64; M];
    /// M x.
    fn mass_times(&self, pose: &Self::Pose, x: &[f64; N]) -> [f64; N];
    /// Generalised applied forces Q(q, q̇).
    fn forces(&self, q: &[f64; N], pose: &Self::Pose, v: &[f64; N]) -> [f64; N];

    /// Factorises [M Φ_qᵀ; Φ_q −e].
    fn factor_mass(&self, pose: &Self::Pose, softness: f64) -> Self::Mass;
    /// Potential energy of the forces that have one, held loads included, J; `None` where it is not known.
    fn potential(&self, _q: &[f64; N], _pose: &Self::Pose) -> Option<f64> {
        None
    }

    /// Whether all forces have a potential.
    fn conservative(&self) -> bool {
        true
    }
    /// Power of the forces that have no potential, W.
    fn power_without_potential(&self, _q: &[f64; N], _pose: &Self::Pose, _v: &[f64; N]) -> f64 {
        0.0
    }

    /// Displacement of q from the vertex that it is near to, and q̇, both in the coordinates in which that is measured (the others
    /// 0). A vertex is an isolated q where Φ_q loses rank and branches cross. `None`: no vertex near.
    fn vertex(&self, _q: &[f64; N], _v: &[f64; N]) -> Option<([f64; N], [f64; N])> {
        None
    }
    /// q and q̇ with all other coordinates following from the measured ones.
    fn rebuilt(&self, q: &[f64; N], v: &[f64; N]) -> ([f64; N], [f64; N]) {
        (*q, *v)
    }
    /// At rest in a vertex: the unit direction, in the measured coordinates, of the motion of least constraint, and how many other
    /// local minima there are. `None`: no direction is driven.
    fn least_constraint(&self, _q: &[f64; N]) -> Option<([f64; N], u32)> {
        None
    }
    /// One bit for each determinant whose sign tells modes apart. A changed bit is a singularity passed.
    fn modes(&self, _pose: &Self::Pose) -> u8 {
        0
    }

    /// Whether any force does work that must be followed along the path.
    fn follows_work(&self) -> bool;
    /// Power of the inputs and of dissipation, W. Asked only if [`System::follows_work`].
    fn power(&self, q: &[f64; N], pose: &Self::Pose, v: &[f64; N]) -> Power;

    /// Largest magnitude among those coordinates of x in which the local error is measured (link angles).
    fn angle_norm(&self, x: &[f64; N]) -> f64;
    /// The largest magnitude a coordinate in m can have: what round-off in Φ is proportional to.
    fn size(&self) -> f64;
}

/// What the implicit methods ask in addition: forces of the constraints and the tangents of all forces.
pub trait Implicit<const N: usize, const M: usize>: System<N, M> {
    /// The factorised saddle-point matrix with the tangent matrix A₀ = M + h/2 C + h²/4 (K + ∂(Φ_qᵀλ)/∂q).
    type Tangent: Kkt<N, M>;
    /// The same system for what happens rarely.
    type Rare: Implicit<N, M, Pose = Self::Pose>;

    /// The same system for what happens rarely (a second try, the way through a vertex). A system that is compiled with several linear
    /// solves gives the most general one: the code is there once, however many fast ones there are.
    fn rare(&self) -> Self::Rare;
    /// Φ_qᵀ λ.
    fn phi_q_transposed_times(&self, pose: &Self::Pose, lambda: &[f64; M]) -> [f64; N];
    /// (M + h/2 C + h²/4 K) x with K = −∂Q/∂q and C = −∂Q/∂q̇: the weight of the printed projections.
    fn weight_times(&self, q: &[f64; N], pose: &Self::Pose, v: &[f64; N], h: f64, x: &[f64; N]) -> [f64; N];
    /// Factorises [A₀ Φ_qᵀ; Φ_q −e]; [`Failure::IndefiniteTangent`] where the step is too long for A₀ to be a minimum.
    fn factor_tangent(
        &self,
        q: &[f64; N],
        pose: &Self::Pose,
        v: &[f64; N],
        lambda: &[f64; M],
        h: f64,
        softness: f64,
    ) -> Result<Self::Tangent, Failure>;

    /// The same with A₀ made positive definite where it is not: a descent direction of the incremental potential, for the second
    /// try of a Newton loop that failed. `None`: no second try.
    fn factor_descent(
        &self,
        _q: &[f64; N],
        _pose: &Self::Pose,
        _v: &[f64; N],
        _lambda: &[f64; M],
        _h: f64,
        _softness: f64,
    ) -> Option<Self::Tangent> {
        None
    }
}

/// A factorised saddle-point matrix [A Φ_qᵀ; Φ_q −e].
pub trait Kkt<const N: usize, const M: usize> {
    /// Solves A x + Φ_qᵀ y = b, Φ_q x − e y = c.
    fn solve(&self, b: &[f64; N], c: &[f64; M]) -> ([f64; N], [f64; M]);

    /// The x of b = 0: the shortest change, in the metric of A, that moves Φ_q x by c. What projections ask for.
    fn correction(&self, c: &[f64; M]) -> [f64; N] {
        self.solve(&[0.0; N], c).0
    }
}

/// Work or power of the forces that are followed along the path, J or W.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Power {
    /// Of the inputs, positive into the system.
    pub input: f64,
    /// Of dissipative forces, positive out of the system.
    pub dissipated: f64,
}

impl Power {
    /// self + duration·other.
    pub(super) fn plus(self, duration: f64, other: Self) -> Self {
        Self { input: self.input + duration * other.input, dissipated: self.dissipated + duration * other.dissipated }
    }
}

/// Why a step could not be done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Failure {
    /// Newton did not meet its tolerance.
    NotConverged {
        /// Iterations spent.
        iterations: u32,
        /// Largest constraint violation left, m.
        violation: f64,
        /// What was asked for, m.
        tolerance: f64,
        /// Largest last correction of a coordinate, m or rad, which is judged as well.
        correction: f64,
    },
    /// The tangent matrix is not positive: the step is too long for this posture and load.
    IndefiniteTangent,
    /// A value became NaN or infinite.
    NotFinite,
    /// Close to a vertex a sub-step changed the energy.
    EnergyChange {
        /// By this part of the kinetic energy.
        part: f64,
    },
    /// The local error is too large however short the sub-step.
    StepTooShort {
        /// The last sub-step tried, s.
        substep: f64,
        /// Its local error, rad; NaN if it failed altogether.
        error: f64,
    },
    /// The local error, or sub-steps that failed, asked for more sub-steps than one macro step may have.
    TooManySubsteps {
        /// The bound.
        most: u32,
        /// The last sub-step tried, s.
        substep: f64,
        /// Its local error, rad; infinite if it failed altogether.
        error: f64,
    },
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotConverged { iterations, violation, tolerance, correction } => write!(
                f,
                "the iteration did not converge: after {iterations} iterations the constraints are violated by {violation:.3e} m \
                 (allowed {tolerance:.3e} m) and the last correction was {correction:.3e} m or rad"
            ),
            Self::IndefiniteTangent => {
                f.write_str("the tangent matrix is not positive definite: the step is too long for this posture and load")
            }
            Self::EnergyChange { part } => {
                write!(f, "next to a constraint singularity a sub-step changed the kinetic energy by {part:.3e} of itself")
            }
            Self::NotFinite => f.write_str("a coordinate, velocity or acceleration is not finite"),
            Self::StepTooShort { substep, error } => {
                write!(f, "a sub-step of only {substep:.3e} s still had a local error of {error:.3e} rad")
            }
            Self::TooManySubsteps { most, substep, error } => write!(
                f,
                "a macro step needs more than {most} sub-steps: the last, of {substep:.3e} s, had a local error of {error:.3e} rad"
            ),
        }
    }
}

impl std::error::Error for Failure {}

/// Local error of a step of h over the angles: of the trapezoidal rule, from the change of q̈, and of the velocity projection.
#[inline(always)]
pub(super) fn local_error<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    h: f64,
    [before, after]: [&[f64; N]; 2],
    projection: &[f64; N],
) -> f64 {
    let jump = combine([before, after], |[before, after]| after - before);
    max_norm(&[h * h / 12.0 * system.angle_norm(&jump), h / 2.0 * system.angle_norm(projection)])
}
