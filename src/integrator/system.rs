//! What the integrator asks of a mechanical system, and nothing else.

use std::ops::AddAssign;

use borsh::{BorshDeserialize, BorshSerialize};

use super::{State, StepError};
use crate::vector::Vector;

/// A constrained mechanical system M q̈ + Φ_qᵀ λ = Q(q, q̇), Φ(q) = 0 with N coordinates and M constraint equations.
///
/// Inputs are part of the system: they are held while it is stepped. Constraints do not depend on time.
pub trait System<const N: usize, const M: usize> {
    /// What depends on q only and is computed once per q (directions, arms).
    type Pose;
    /// What of a pose turns to poses nearby begin with.
    type TrigBase;
    /// The factorised saddle-point matrix with the mass matrix in its corner.
    type Mass: Kkt<N, M>;

    /// Pose at q.
    fn pose(&self, q: &Vector<N>) -> Self::Pose;
    /// The same compiled into its caller, for steps that keep it in registers. Elsewhere one piece of code for all callers takes less place.
    fn pose_in_place(&self, q: &Vector<N>) -> Self::Pose {
        self.pose(q)
    }
    /// Pose `by` away from a q whose pose is known: for less, where that is little.
    fn pose_turned(&self, (q, _pose): (&Vector<N>, &Self::Pose), by: &Vector<N>) -> Self::Pose {
        self.pose(&(*q + *by))
    }
    /// What turns that begin at a pose start from.
    fn trig_base(&self, pose: &Self::Pose) -> Self::TrigBase;
    /// Pose `by` away from a q where turns begin.
    fn pose_near(&self, (q, _trig_base): (&Vector<N>, &Self::TrigBase), by: &Vector<N>) -> Self::Pose {
        self.pose(&(*q + *by))
    }
    /// Φ(q).
    fn phi(&self, q: &Vector<N>, pose: &Self::Pose) -> Vector<M>;
    /// Φ_q v.
    fn phi_q_times(&self, pose: &Self::Pose, v: &Vector<N>) -> Vector<M>;
    /// Φ̇_q q̇.
    fn phi_q_dot_times(&self, pose: &Self::Pose, v: &Vector<N>) -> Vector<M>;
    /// M x.
    fn mass_times(&self, pose: &Self::Pose, x: &Vector<N>) -> Vector<N>;
    /// Generalised applied forces Q(q, q̇).
    fn forces(&self, q: &Vector<N>, pose: &Self::Pose, v: &Vector<N>) -> Vector<N>;
    /// Factorises [M Φ_qᵀ; Φ_q −e].
    fn factor_mass(&self, pose: &Self::Pose, regularization: f64) -> Self::Mass;
    /// The same compiled into its caller.
    fn factor_mass_in_place(&self, pose: &Self::Pose, regularization: f64) -> Self::Mass {
        self.factor_mass(pose, regularization)
    }

    /// Whether forces change so steeply in places that a step may miss it, or ring on it.
    fn has_stiff_forces(&self) -> bool {
        false
    }

    /// One bit for each determinant whose sign tells modes apart. A changed bit is a singularity passed.
    fn configuration_signs(&self, _pose: &Self::Pose) -> u8 {
        0
    }
    /// Whether friction holds anything.
    fn holds(&self) -> bool {
        false
    }
    /// What it holds. Asked only if [`System::holds`].
    fn held(&self, _q: &Vector<N>, _pose: &Self::Pose, _v: &Vector<N>) -> Held<N> {
        Held::Nothing
    }
    /// q̈ and λ with the forces by which friction holds, from those without. Asked only if [`System::holds`].
    fn with_friction_reaction(&self, _q: Vector<N>, _v: Vector<N>, free: (Vector<N>, Vector<M>)) -> (Vector<N>, Vector<M>) {
        free
    }
    /// q̇ without what friction holds. Asked only if [`System::holds`].
    fn project_sticking(&self, _q: Vector<N>, v: Vector<N>) -> Vector<N> {
        v
    }
    /// How q̈ changes with q and q̇ about a state whose q̈ and λ are those of equilibrium; `None` where that is not known: no step that
    /// begins there is implicit.
    fn acceleration_tangents(
        &self,
        _at: &State<N, M>,
        _pose: &Self::Pose,
        _regularization: f64,
    ) -> Option<AccelerationTangents<N>> {
        None
    }
    /// Whether any force does work that must be followed along the path.
    fn follows_work(&self) -> bool;
    /// Power of the inputs and of dissipation, W. Asked only if [`System::follows_work`].
    fn power(&self, q: &Vector<N>, pose: &Self::Pose, v: &Vector<N>) -> Work;
    /// Forces and power at once, for less than both: [`System::forces`], [`System::power`].
    fn forces_and_power(&self, q: &Vector<N>, pose: &Self::Pose, v: &Vector<N>) -> (Vector<N>, Work) {
        (self.forces(q, pose, v), if self.follows_work() { self.power(q, pose, v) } else { Work::default() })
    }
    /// q̈ at rates v, `by` away from where turns begin: for less where nothing acts but weight, which does no work that is followed, and the
    /// way is short, with the system's own e; `None` elsewhere.
    fn acceleration_by_weight(&self, _trig_base: &Self::TrigBase, _by: &Vector<N>, _v: &Vector<N>) -> Option<Vector<N>> {
        None
    }
    /// Kinetic energy and that of the forces that have a potential, but for those of the inputs, J: what changes by [`System::power`].
    /// Asked only of systems that are steep.
    fn energy(&self, _q: &Vector<N>, _pose: &Self::Pose, _v: &Vector<N>) -> f64 {
        0.0
    }
    /// Largest magnitude among those coordinates of x in which the local error is measured (link angles).
    fn error_norm(&self, x: &Vector<N>) -> f64;
    /// The largest magnitude a coordinate in m can have: what round-off in Φ is proportional to.
    fn length_scale(&self) -> f64;
}

/// What the implicit methods ask in addition: forces of the constraints and the tangents of all forces.
pub trait Implicit<const N: usize, const M: usize>: System<N, M> {
    /// The same system for what is rare. A form of its own that a system may have for its steps is compiled for these only.
    type General: Implicit<N, M, Pose = Self::Pose>;

    /// It.
    fn general(&self) -> Self::General;
    /// Φ_qᵀ λ.
    fn phi_q_transposed_times(&self, pose: &Self::Pose, lambda: &Vector<M>) -> Vector<N>;
    /// (M + h/2 C + h²/4 K) x with K = −∂Q/∂q and C = −∂Q/∂q̇: the weight of the printed projections.
    fn effective_mass_times(&self, at: &TangentPoint<'_, Self::Pose, N, M>, x: &Vector<N>) -> Vector<N>;
    /// Solves A₀ x + Φ_qᵀ y = b, Φ_q x − e y = c with the tangent matrix A₀ = M + h/2 C + h²/4 (K + ∂(Φ_qᵀλ)/∂q);
    /// [`StepError::IndefiniteTangent`] where the step is too long for A₀ to be a minimum.
    fn solve_tangent(
        &self,
        at: &TangentPoint<'_, Self::Pose, N, M>,
        regularization: f64,
        right: (&Vector<N>, &Vector<M>),
    ) -> Result<(Vector<N>, Vector<M>), StepError>;

    /// The same for what is no part of every step, without code of its own in each place.
    #[inline(never)]
    fn solve_tangent_out_of_line(
        &self,
        at: &TangentPoint<'_, Self::Pose, N, M>,
        regularization: f64,
        right: (&Vector<N>, &Vector<M>),
    ) -> Result<(Vector<N>, Vector<M>), StepError> {
        self.solve_tangent(at, regularization, right)
    }

    /// The same with A₀ made positive definite where it is not: a direction of descent of the incremental potential, for the
    /// line-search fallback of a Newton loop that failed. `None`: no fallback.
    fn solve_descent(
        &self,
        _at: &TangentPoint<'_, Self::Pose, N, M>,
        _regularization: f64,
        _right: (&Vector<N>, &Vector<M>),
    ) -> Option<(Vector<N>, Vector<M>)> {
        None
    }
    /// Potential energy of all forces, held loads included, J; `None` where they have none, or it is not known. For the same fallback.
    fn potential(&self, _q: &Vector<N>, _pose: &Self::Pose) -> Option<f64> {
        None
    }

    /// The forces of drives, whose work is put in, if there are any. Asked only of systems that are steep.
    fn drives(&self, _q: &Vector<N>, _v: &Vector<N>) -> Option<Vector<N>> {
        None
    }

    /// The work of an iteration, in those of the fastest solve.
    fn iteration_work(&self) -> u64 {
        1
    }
}

/// Where, and for which step, a tangent is asked for.
#[derive(Debug)]
pub struct TangentPoint<'a, P, const N: usize, const M: usize> {
    /// Coordinates.
    pub q: &'a Vector<N>,
    /// [`System::pose`] there.
    pub pose: &'a P,
    /// Velocities.
    pub v: &'a Vector<N>,
    /// Multipliers, N for constraints in m.
    pub lambda: &'a Vector<M>,
    /// The step, s.
    pub h: f64,
}

/// How accelerations change with coordinates and with rates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AccelerationTangents<const N: usize> {
    /// ∂q̈/∂q, by columns, 1/s² for angles.
    pub by_q: [Vector<N>; N],
    /// ∂q̈/∂q̇, by columns, 1/s for angles.
    pub by_v: [Vector<N>; N],
}

/// A factorised saddle-point matrix [A Φ_qᵀ; Φ_q −e].
pub trait Kkt<const N: usize, const M: usize> {
    /// Solves A x + Φ_qᵀ y = b, Φ_q x − e y = c.
    fn solve(&self, b: &Vector<N>, c: &Vector<M>) -> (Vector<N>, Vector<M>);
    /// The same compiled into its caller.
    fn solve_in_place(&self, b: &Vector<N>, c: &Vector<M>) -> (Vector<N>, Vector<M>) {
        self.solve(b, c)
    }

    /// The x of b = 0: the shortest change, in the metric of A, that moves Φ_q x by c. What projections ask for.
    fn correction(&self, c: &Vector<M>) -> Vector<N> {
        self.solve(&Vector::ZERO, c).0
    }
}

/// What friction holds: a force that is whatever a motion asks for.
#[derive(Clone, Copy, Debug)]
pub enum Held<const N: usize> {
    /// Nothing.
    Nothing,
    /// One direction.
    Direction {
        /// Nothing moves along it: row·q̇ = 0.
        row: Vector<N>,
        /// And row·q̈ = −drift.
        drift: f64,
        /// A multiple of this force sees to it.
        force: Vector<N>,
    },
    /// The whole system, which is at rest, by this force.
    All {
        /// The generalised force.
        force: Vector<N>,
    },
}

/// Work of the forces that are followed along the path, J, or its rate, W.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Work {
    /// Of the inputs, positive into the system.
    pub input: f64,
    /// Of dissipative forces, positive out of the system.
    pub dissipated: f64,
}

impl AddAssign for Work {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        self.input += other.input;
        self.dissipated += other.dissipated;
    }
}

impl Work {
    /// Both, of the inputs first.
    #[inline(always)]
    pub(super) fn pair(&self) -> Vector<2> {
        Vector::from([self.input, self.dissipated])
    }

    /// The same the other way round.
    #[inline(always)]
    pub(super) fn of_pair(pair: Vector<2>) -> Self {
        Self { input: pair[0], dissipated: pair[1] }
    }

    /// self + duration·rate.
    #[inline(always)]
    pub(super) fn plus(self, duration: f64, rate: Self) -> Self {
        Self { input: self.input + duration * rate.input, dissipated: self.dissipated + duration * rate.dissipated }
    }
}
