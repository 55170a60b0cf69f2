//! i3-ALP and its companions, generic over the [`System`] they integrate.
//!
//! Invariant: knows neither mechanism nor FMI; does no input or output, allocates nothing, reads no clock.

pub mod dop853;
mod equilibrium;
pub mod i3alp;
pub mod i3alp_printed;
mod projection;
pub mod rk4;
mod system;
mod vectors;
pub mod vertex;

use borsh::{BorshDeserialize, BorshSerialize};

pub use equilibrium::{equilibrium, equilibrium_at};
pub use system::{Failure, Implicit, Kkt, Power, System};
pub(crate) use vectors::combine;

/// What the integrator has done since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub struct Counters {
    /// Macro steps.
    pub steps: u64,
    /// Accepted sub-steps.
    pub substeps: u64,
    /// Newton iterations, those of rejected sub-steps included.
    pub iterations: u64,
    /// Rejected sub-steps.
    pub rejected: u64,
    /// Sub-steps that converged only in the second try.
    pub rescued: u64,
    /// Times that q̈ and λ were found anew from equilibrium because the inputs had changed.
    pub restarts: u64,
    /// Starts from rest in a vertex.
    pub launches: u64,
    /// Vertices of the configuration space passed straight through.
    pub vertex_passes: u64,
    /// Changes of each bit of [`System::modes`].
    pub mode_changes: [u64; MODES],
}

impl Counters {
    /// Singularities: starts from rest in a vertex, vertices passed, changes of each mode.
    pub fn singular(&self) -> [u64; MODES + 2] {
        let [first, second, third] = self.mode_changes;
        [self.launches, self.vertex_passes, first, second, third]
    }
}

/// Bits of [`System::modes`] that are counted.
pub const MODES: usize = 3;

/// Everything that changes during a run: a copy of it is a complete snapshot.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
#[repr(C, align(16))] // pairs of elements are read from memory by the instruction that uses them
pub struct State<const N: usize, const M: usize> {
    /// Coordinates q, m and rad.
    pub q: [f64; N],
    /// Velocities q̇, m/s and rad/s.
    pub v: [f64; N],
    /// Accelerations q̈ from equilibrium, m/s² and rad/s².
    pub a: [f64; N],
    /// Multipliers λ from equilibrium, N for constraints in m.
    pub lambda: [f64; M],
    /// (q̈ₙ − q̈ₙ₋₁)/h of the last sub-step, m/s³ and rad/s³, for the predictor; 0 after a restart.
    pub jerk: [f64; N],
    /// The sub-step that the local error last asked for, s; infinite before the first.
    pub substep: f64,
    /// Local error of the last accepted sub-step, rad; see [`System::angle_norm`].
    pub error_estimate: f64,
    /// Work since the start, J: along the path, by the order of the method.
    pub work: Power,
    /// [`System::modes`] of q.
    pub modes: u8,
    /// Whether it is being carried along a ray through a vertex: not projected until it leaves the ball.
    pub on_ray: bool,
    /// Other branches on which the last start from rest in a vertex could have gone as well.
    pub alternatives: u32,
    /// Counters since the start.
    pub counters: Counters,
}

impl<const N: usize, const M: usize> State<N, M> {
    /// The state at the start, with q̈ and λ from equilibrium (λ of minimum norm where the constraints lose rank).
    pub fn start(system: &impl System<N, M>, q: [f64; N], v: [f64; N], softness: f64) -> Self {
        let (a, lambda) = Self::in_balance(system, &q, &v, softness);
        Self {
            q,
            v,
            a,
            lambda,
            jerk: [0.0; N],
            substep: f64::INFINITY,
            error_estimate: 0.0,
            work: Power::default(),
            modes: system.modes(&system.pose(&q)),
            on_ray: false,
            alternatives: 0,
            counters: Counters::default(),
        }
    }

    /// The forces have changed at once: q̈ and λ follow from equilibrium, the predictor starts anew.
    ///
    /// Without it a new input would act half a step late and every driven scene would be first order only.
    pub fn restart(&mut self, system: &impl System<N, M>, softness: f64) {
        (self.a, self.lambda) = Self::in_balance(system, &self.q, &self.v, softness);
        self.jerk = [0.0; N];
        self.counters.restarts += 1;
    }

    /// q̈ and λ from equilibrium; at rest exactly in a vertex q̈ is that of the branch of least constraint.
    fn in_balance(system: &impl System<N, M>, q: &[f64; N], v: &[f64; N], softness: f64) -> ([f64; N], [f64; M]) {
        let (a, lambda) = equilibrium(system, q, v, softness);
        (vertex::start_acceleration(system, q, v).unwrap_or(a), lambda)
    }

    /// Counts the determinants that have changed sign.
    #[inline(always)]
    fn observe_modes(&mut self, modes: u8) {
        if modes != self.modes {
            for (bit, changes) in self.counters.mode_changes.iter_mut().enumerate() {
                *changes += u64::from((modes ^ self.modes) >> bit & 1);
            }
            self.modes = modes;
        }
    }
}
