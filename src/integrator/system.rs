//! The interface between methods and mechanical systems: constraints, masses, forces, their tangents and linear solves.

use std::ops::AddAssign;

use borsh::{BorshDeserialize, BorshSerialize};

use super::{CONFIGURATION_SIGNS, State, StepError};
use crate::vector::Vector;

/// A constrained mechanical system M q̈ + Φ_qᵀ λ = Q(q, q̇), Φ(q) = 0 with N coordinates and M constraint equations.
///
/// Inputs belong to the system and are constant during a step. Constraints do not depend on time.
pub trait System<const N: usize, const M: usize> {
    /// Quantities that depend only on q and are computed once per q (directions, arms).
    type Pose;
    /// Factorised saddle-point matrix [M Φ_qᵀ; Φ_q −e].
    type Mass: Kkt<N, M>;

    /// Pose at q.
    fn pose(&self, q: &Vector<N>) -> Self::Pose;
    /// Pose at q + `by`, from the pose at q.
    fn pose_near(&self, q: &Vector<N>, _pose: &Self::Pose, by: &Vector<N>) -> Self::Pose {
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
    /// Generalised applied forces Q(q, q̇), and the power of inputs and of dissipative forces, W, which is 0 without [`Features::work`].
    fn forces(&self, q: &Vector<N>, pose: &Self::Pose, v: &Vector<N>) -> (Vector<N>, Work);
    /// Kinetic energy plus potential energy of all forces except the inputs, J. It changes at the rate of the inputs' power.
    fn energy(&self, _q: &Vector<N>, _pose: &Self::Pose, _v: &Vector<N>) -> f64 {
        0.0
    }
    /// Factorises [M Φ_qᵀ; Φ_q −e].
    fn factor_mass(&self, pose: &Self::Pose, regularization: f64) -> Self::Mass;
    /// Features of the forces.
    fn features(&self) -> Features {
        Features::SMOOTH
    }

    /// Signs of the singularity determinants, one bit each. A changed bit means that the motion passed a singularity.
    fn configuration_signs(&self, _pose: &Self::Pose) -> u8 {
        0
    }
    /// Sines of the angles between the posture and each singularity; [`System::configuration_signs`] are their signs. All are 0 only if the
    /// constraints lose rank, so the largest is the distance from a loss of rank, rad.
    fn determinants(&self, _pose: &Self::Pose) -> [f64; CONFIGURATION_SIGNS] {
        [0.0; CONFIGURATION_SIGNS]
    }
    /// Number of the constraint branch on which a motion is, if several branches meet and the coordinates alone do not keep it there.
    fn branch(&self, _q: &Vector<N>, _v: &Vector<N>) -> Option<u8> {
        None
    }
    /// Motion that sticking friction prevents.
    fn stuck(&self) -> Stuck {
        Stuck::Nothing
    }
    /// Sticking constraint and its reaction. Called only if [`System::stuck`] is not [`Stuck::Nothing`].
    fn sticking_constraint(&self, _q: &Vector<N>, _pose: &Self::Pose, _v: &Vector<N>) -> StickingConstraint<N> {
        StickingConstraint::Nothing
    }
    /// Tangents of q̈ with respect to q and q̇ at a state in dynamic equilibrium. `None` if they are unknown; then no implicit step begins
    /// there.
    fn acceleration_tangents(
        &self,
        _at: &State<N, M>,
        _pose: &Self::Pose,
        _regularization: f64,
    ) -> Option<AccelerationTangents<N>> {
        None
    }
    /// Maximum norm of x over the coordinates in which the local error is measured (link angles).
    fn error_norm(&self, x: &Vector<N>) -> f64;
    /// Largest magnitude of a coordinate, m: the scale of round-off in Φ.
    fn length_scale(&self) -> f64;
}

/// Features of a system's forces that decide how a method treats them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Features {
    /// Whether the work of any force must be integrated along the path.
    pub work: bool,
    /// Whether any force is stiff, or has discontinuities that a step may miss (friction, servos, stops, contact).
    pub stiff: bool,
    /// Whether there are events.
    pub events: bool,
    /// Whether friction may stick: events are then stick-slip transitions, and only the run can remember their state.
    pub may_stick: bool,
    /// Whether any force has sharp nonlinearities without an event.
    pub sharp: bool,
    /// Whether the constraints in force have separately compiled code, so that evaluations leave the regular path.
    pub special_constraints: bool,
    /// Whether steps are checked against properties that every correct step has (`checks.rs`).
    pub checks: bool,
    /// Smallest regularisation velocity of a force, in 1/s times the unit of the coordinate. A method must resolve it.
    pub regularization_velocity: f64,
}

impl Features {
    /// Smooth forces without an account of work.
    pub const SMOOTH: Self = Self {
        work: false,
        stiff: false,
        events: false,
        may_stick: false,
        sharp: false,
        special_constraints: false,
        checks: false,
        regularization_velocity: f64::INFINITY,
    };
}

/// Motion that sticking friction prevents.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stuck {
    /// No friction element sticks.
    Nothing,
    /// Some friction element sticks.
    Partly,
    /// The whole system is at rest and sticks: nothing moves while the forces stay constant.
    Wholly,
}

/// A system for implicit methods: with constraint forces and with tangents of all forces.
pub trait Implicit<const N: usize, const M: usize>: System<N, M> {
    /// The unspecialised form of the system, for rare operations. Specialised forms are compiled only for regular steps.
    type General: Implicit<N, M, Pose = Self::Pose>;

    /// Returns the unspecialised form of the system.
    fn general(&self) -> Self::General;
    /// Φ_qᵀ λ.
    fn phi_q_transposed_times(&self, pose: &Self::Pose, lambda: &Vector<M>) -> Vector<N>;
    /// Solves A₀ x + Φ_qᵀ y = b, Φ_q x − e y = c with the tangent matrix A₀ = M + h/2 C + h²/4 (K + ∂(Φ_qᵀλ)/∂q). Returns
    /// [`StepError::IndefiniteTangent`] if h is so long that A₀ is not positive definite.
    fn solve_tangent(
        &self,
        at: &TangentPoint<'_, Self::Pose, N, M>,
        regularization: f64,
        b: &Vector<N>,
        c: &Vector<M>,
    ) -> Result<(Vector<N>, Vector<M>), StepError>;

    /// Solves the system of [`Implicit::solve_tangent`] with A₀ made positive definite. The result is a descent direction of the
    /// incremental potential, for the line search after a failed Newton iteration. `None` means that there is no fallback.
    fn solve_descent(
        &self,
        _at: &TangentPoint<'_, Self::Pose, N, M>,
        _regularization: f64,
        _b: &Vector<N>,
        _c: &Vector<M>,
    ) -> Option<(Vector<N>, Vector<M>)> {
        None
    }
    /// Potential energy of all forces including constant inputs, J, for the line search. `None` if a force has no known potential.
    fn potential(&self, _q: &Vector<N>, _pose: &Self::Pose) -> Option<f64> {
        None
    }

    /// Generalised forces of drives (servos), if there are any. Called only for [`Features::stiff`] forces.
    fn drive_forces(&self, _q: &Vector<N>, _pose: &Self::Pose, _v: &Vector<N>) -> Option<Vector<N>> {
        None
    }

    /// Cost of one Newton iteration, in iterations with the fastest linear solve.
    fn iteration_work(&self) -> u64 {
        1
    }
}

/// Coordinates and rates, with the pose that belongs to the coordinates.
#[derive(Debug)]
pub struct Posed<'a, P, const N: usize> {
    /// Coordinates q, m and rad.
    pub q: &'a Vector<N>,
    /// Pose at q.
    pub pose: &'a P,
    /// Velocities q̇, m/s and rad/s.
    pub v: &'a Vector<N>,
}

impl<P, const N: usize> Clone for Posed<'_, P, N> {
    fn clone(&self) -> Self {
        *self
    }
}

/// Copied also if a pose cannot be.
impl<P, const N: usize> Copy for Posed<'_, P, N> {}

/// State and step length at which a tangent is evaluated.
#[derive(Debug)]
pub struct TangentPoint<'a, P, const N: usize, const M: usize> {
    /// Coordinates q, m and rad.
    pub q: &'a Vector<N>,
    /// Pose at q.
    pub pose: &'a P,
    /// Velocities q̇, m/s and rad/s.
    pub v: &'a Vector<N>,
    /// Multipliers λ, N for constraints in m.
    pub lambda: &'a Vector<M>,
    /// Step length, s.
    pub h: f64,
}

/// Tangents of the accelerations with respect to coordinates and rates.
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
    /// The x for b = 0: the smallest change, in the metric of A, that changes Φ_q x by c. Projections use it.
    fn correction(&self, c: &Vector<M>) -> Vector<N> {
        self.solve(&Vector::ZERO, c).0
    }
}

/// Constraint that sticking friction imposes on the motion.
#[derive(Clone, Copy, Debug)]
pub enum StickingConstraint<const N: usize> {
    /// No friction element sticks.
    Nothing,
    /// One direction of motion is blocked.
    Direction {
        /// Row of the sticking constraint: row·q̇ = 0.
        row: Vector<N>,
        /// Drift of the constraint's rate: row·q̈ = −drift.
        drift: f64,
        /// Generalised force per unit of friction reaction.
        force: Vector<N>,
    },
    /// The whole system is at rest and sticks.
    All {
        /// Generalised friction force that balances the loads, N and N·m.
        force: Vector<N>,
    },
}

/// Work integrated along the path, J, or power, W.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Work {
    /// Work of the inputs, positive into the system.
    pub input: f64,
    /// Dissipated work, positive out of the system.
    pub dissipated: f64,
}

impl AddAssign for Work {
    fn add_assign(&mut self, other: Self) {
        self.input += other.input;
        self.dissipated += other.dissipated;
    }
}

impl Work {
    /// Work of the inputs minus dissipated work.
    pub(super) fn net(self) -> f64 {
        self.input - self.dissipated
    }

    /// The vector (input, dissipated).
    pub(super) fn pair(&self) -> Vector<2> {
        Vector::from([self.input, self.dissipated])
    }

    /// Creates the work from the vector (input, dissipated).
    pub(super) fn of_pair(pair: Vector<2>) -> Self {
        Self { input: pair[0], dissipated: pair[1] }
    }

    /// The sum self + duration·rate, J for a duration in s and a rate in W.
    pub(super) fn plus(self, duration: f64, rate: Self) -> Self {
        Self { input: self.input + duration * rate.input, dissipated: self.dissipated + duration * rate.dissipated }
    }
}
