//! State of a run: coordinates, rates, accelerations, multipliers, work and counters; and the end of a step before it becomes the state.

use borsh::{BorshDeserialize, BorshSerialize};

use super::checks::Checked;
use super::equilibrium::{equilibrium, equilibrium_under, project_sticking};
use super::{Passage, Posed, StepError, Stuck, System, Work};
use crate::vector::Vector;

/// Counts of the integrator's operations since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub struct Counters {
    /// Macro steps.
    pub steps: u64,
    /// Accepted sub-steps.
    pub substeps: u64,
    /// Newton iterations, including those of rejected sub-steps.
    pub iterations: u64,
    /// Rejected sub-steps.
    pub rejected: u64,
    /// Sub-steps that converged only with the line-search fallback.
    pub rescued: u64,
    /// Restarts: q̈ and λ were solved again from equilibrium because inputs or parameters changed.
    pub restarts: u64,
    /// Starts from rest at a vertex.
    pub launches: u64,
    /// Passages straight through a vertex of the configuration space.
    pub vertex_passes: u64,
    /// Sign changes of each determinant of [`System::configuration_signs`].
    pub sign_changes: [u64; CONFIGURATION_SIGNS],
    /// Steps of the conserving method that ended with the energy-only fallback because their equations were not solved.
    pub fallbacks: u64,
    /// Steps of fixed length that failed their checks (`checks.rs`).
    pub breaches: u64,
}

impl Counters {
    /// Counts the determinants that changed sign, and stores the new signs.
    pub(super) fn count_sign_changes(&mut self, stored: &mut u8, signs: u8) {
        if signs != *stored {
            for (bit, changes) in self.sign_changes.iter_mut().enumerate() {
                *changes += u64::from((*stored ^ signs) >> bit & 1);
            }
            *stored = signs;
        }
    }

    /// Counts of singular events: starts from rest at a vertex, passages through a vertex, sign changes of each determinant.
    pub fn singular(&self) -> [u64; CONFIGURATION_SIGNS + 2] {
        let [first, second, third] = self.sign_changes;
        [self.launches, self.vertex_passes, first, second, third]
    }
}

/// Number of determinants in [`System::configuration_signs`].
pub const CONFIGURATION_SIGNS: usize = 3;

/// State of a run; a copy is a complete snapshot.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct State<const N: usize, const M: usize> {
    /// Coordinates q, m and rad.
    pub q: Vector<N>,
    /// Velocities q̇, m/s and rad/s.
    pub v: Vector<N>,
    /// Accelerations q̈ from equilibrium, m/s² and rad/s².
    pub a: Vector<N>,
    /// Multipliers λ from equilibrium, N for constraints in m.
    pub lambda: Vector<M>,
    /// Predicted jerk (q̈ₙ − q̈ₙ₋₁)/h of the last sub-step, m/s³ and rad/s³; 0 after a restart.
    pub jerk: Vector<N>,
    /// Sub-step that the last local error suggests, s; infinite before the first sub-step.
    pub substep: f64,
    /// Local error of the last accepted sub-step, rad; see [`System::error_norm`].
    pub error_estimate: f64,
    /// Work since the start, J, integrated along the path with the order of the method.
    pub work: Work,
    /// Power at the state, W; 0 unless [`super::Features::work`].
    pub power: Work,
    /// Kinetic plus potential energy at the state, J, with [`super::Features::checks`]; `None` after the motion or the machine was
    /// replaced.
    pub energy: Option<f64>,
    /// Signs of the singularity determinants at q, see [`System::configuration_signs`].
    pub configuration_signs: u8,
    /// Last branch that a checked state of the motion determined, see [`System::branch`]; `None` before such a state, and after the motion
    /// was replaced.
    pub branch: Option<u8>,
    /// Whether the motion is on a ray through a vertex; then nothing is projected.
    pub on_ray: bool,
    /// Number of other branches on which the last start from rest at a vertex could have left.
    pub alternatives: u32,
    /// Counters since the start.
    pub counters: Counters,
}

impl<const N: usize, const M: usize> State<N, M> {
    /// State at q and q̇ with these signs of the singularity determinants; accelerations and history are not known yet.
    pub fn of_motion([q, v]: [Vector<N>; 2], configuration_signs: u8) -> Self {
        Self {
            q,
            v,
            a: Vector::ZERO,
            lambda: Vector::ZERO,
            jerk: Vector::ZERO,
            substep: f64::INFINITY,
            error_estimate: 0.0,
            work: Work::default(),
            power: Work::default(),
            energy: None,
            configuration_signs,
            branch: None,
            on_ray: false,
            alternatives: 0,
            counters: Counters::default(),
        }
    }

    /// State at the start, with q̈ and λ from equilibrium. If the constraints lose rank, λ has minimum norm.
    pub fn start<S: System<N, M> + Passage<N>>(system: &S, q: Vector<N>, v: Vector<N>, regularization: f64) -> Self {
        let mut state = Self::of_motion([q, v], system.configuration_signs(&system.pose(&q)));
        let pose = system.pose(&q);
        state.reinitialize(system, &pose, regularization);
        state.energy = energy_if_checked(system, &state.q, &pose, &state.v);
        state.branch = branch_if_checked(system, &state.q, &state.v);
        state
    }

    /// Solves q̈ and λ again from equilibrium after a discontinuity of the forces, and resets the predictor.
    ///
    /// Without a restart a new input would act half a step late, and every driven scene would be of first order.
    pub fn restart<S: System<N, M> + Passage<N>>(&mut self, system: &S, pose: &S::Pose, regularization: f64) {
        self.reinitialize(system, pose, regularization);
        self.counters.restarts += 1;
    }

    /// Projects q̇ onto the sticking constraints of a new mode, solves q̈ and λ from equilibrium, and resets the predictor.
    pub fn reinitialize<S: System<N, M> + Passage<N>>(&mut self, system: &S, pose: &S::Pose, regularization: f64) {
        if system.stuck() != Stuck::Nothing {
            let mass = system.factor_mass(pose, regularization);
            self.v = project_sticking(system, Posed { q: &self.q, pose, v: &self.v }, &mass);
            self.energy = energy_if_checked(system, &self.q, pose, &self.v);
        }
        self.balance(system, pose, regularization);
        self.jerk = Vector::ZERO;
    }

    /// Sets q̈, λ and power from equilibrium. At rest exactly at a vertex, q̈ belongs to the branch of least constraint.
    pub fn balance<S: System<N, M> + Passage<N>>(&mut self, system: &S, pose: &S::Pose, regularization: f64) {
        let (a, lambda, power) = equilibrium(system, Posed { q: &self.q, pose, v: &self.v }, regularization);
        self.a = system.acceleration_from_rest(&self.q, &self.v).unwrap_or(a);
        (self.lambda, self.power) = (lambda, power);
    }

    /// The quantities that a step's checks compare; `None` if the energy is not known.
    #[inline(always)]
    pub(super) fn checked(&self) -> Option<Checked<'_, N>> {
        let &Self { ref q, ref v, ref a, energy, work, configuration_signs, branch, .. } = self;
        energy.map(|energy| Checked { q, v, a, energy, work, configuration_signs, branch })
    }

    /// Counts the determinants that changed sign, and stores the new signs.
    pub(super) fn count_sign_changes(&mut self, configuration_signs: u8) {
        self.counters.count_sign_changes(&mut self.configuration_signs, configuration_signs);
    }

    /// Copies the end of an accepted step. The method sets work, predictor and step length.
    pub(super) fn take_over(&mut self, end_state: &StepEnd<N, M>) {
        let &StepEnd { q, v, a, lambda, power, energy, configuration_signs, branch } = end_state;
        (self.q, self.v, self.a, self.lambda, self.power, self.energy) = (q, v, a, lambda, power, energy);
        self.branch = branch.or(self.branch);
        self.on_ray = false;
        self.count_sign_changes(configuration_signs);
        self.counters.substeps += 1;
    }
}

/// End of a step: state, multipliers and power.
pub(super) struct StepEnd<const N: usize, const M: usize> {
    pub(super) q: Vector<N>,
    pub(super) v: Vector<N>,
    pub(super) a: Vector<N>,
    pub(super) lambda: Vector<M>,
    pub(super) power: Work,
    pub(super) energy: Option<f64>,
    pub(super) configuration_signs: u8,
    pub(super) branch: Option<u8>,
}

/// Energy of a motion, J, if steps are checked.
#[inline(always)]
fn energy_if_checked<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    q: &Vector<N>,
    pose: &S::Pose,
    v: &Vector<N>,
) -> Option<f64> {
    if system.features().checks { Some(system.energy(q, pose, v)) } else { None }
}

/// Branch of a motion, if steps are checked and the motion determines it.
#[inline(always)]
pub(super) fn branch_if_checked<const N: usize, const M: usize, S: System<N, M>>(
    system: &S,
    q: &Vector<N>,
    v: &Vector<N>,
) -> Option<u8> {
    if system.features().checks { system.branch(q, v) } else { None }
}

impl<const N: usize, const M: usize> StepEnd<N, M> {
    /// End at q and q̇ with given q̈ and λ.
    pub(super) fn new<S: System<N, M>>(system: &S, [q, v, a]: [Vector<N>; 3], pose: &S::Pose, lambda: Vector<M>) -> Self {
        let (power, energy) = (system.forces(&q, pose, &v).1, energy_if_checked(system, &q, pose, &v));
        let branch = branch_if_checked(system, &q, &v);
        Self { q, v, a, lambda, power, energy, configuration_signs: system.configuration_signs(pose), branch }
    }

    /// End at q and q̇ with q̈ and λ from equilibrium.
    #[inline(always)]
    pub(super) fn in_balance<S: System<N, M>>(system: &S, [q, v]: [Vector<N>; 2], pose: &S::Pose, mass: &S::Mass) -> Self {
        let (forces, power) = system.forces(&q, pose, &v);
        let (a, lambda) = equilibrium_under(system, &forces, Posed { q: &q, pose, v: &v }, mass);
        let energy = energy_if_checked(system, &q, pose, &v);
        let branch = branch_if_checked(system, &q, &v);
        Self { q, v, a, lambda, power, energy, configuration_signs: system.configuration_signs(pose), branch }
    }

    /// End at q and q̇ with q̈, λ and power set to 0.
    pub(super) fn without_balance<S: System<N, M>>(system: &S, [q, v]: [Vector<N>; 2], pose: &S::Pose) -> Self {
        Self {
            q,
            v,
            a: Vector::ZERO,
            lambda: Vector::ZERO,
            power: Work::default(),
            energy: energy_if_checked(system, &q, pose, &v),
            configuration_signs: system.configuration_signs(pose),
            branch: branch_if_checked(system, &q, &v),
        }
    }

    /// End at q and q̇ with q̈ and λ from equilibrium; a shared copy of the code for rare operations.
    pub(super) fn out_of_line<S: System<N, M>>(system: &S, [q, v]: [Vector<N>; 2], regularization: f64) -> Self {
        let pose = system.pose(&q);
        Self::in_balance(system, [q, v], &pose, &system.factor_mass(&pose, regularization))
    }

    /// Whether q, q̇, q̈ and their sum are finite.
    pub(super) fn is_finite(&self) -> bool {
        (self.q + self.v + self.a).is_finite()
    }

    /// Returns the end itself, or [`StepError::NotFinite`].
    pub(super) fn finite(self) -> Result<Self, StepError> {
        if self.is_finite() { Ok(self) } else { Err(StepError::NotFinite) }
    }
}
