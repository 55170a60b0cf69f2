//! Checks of a stored state: numbers are finite, counters possible, and the loop is closed. A forged state that passes is a valid motion.

use super::{Counters, Passage, State, System};
use crate::vector::Vector;

/// Defect of a state, as the end of a sentence with the state as its subject.
pub type Inconsistency = &'static str;

/// Admissible deviations of a state.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Admissible max |Φ|, relative to the size of the system.
    pub position: f64,
    /// Admissible max |Φ_q q̇|, relative to its largest term.
    pub velocity: f64,
}

/// Upper limit of counters: a larger count would take longer than a lifetime.
const MOST_COUNTED: u64 = 1 << 62;

/// Rates below this limit, 1/s, may be round-off at rest.
const AT_REST: f64 = 1e-9;

/// Admissible violations of position and velocity on a ray through a vertex, where nothing is projected, in the units of [`Bounds`].
const ON_RAY: [f64; 2] = [1e-4, 1e-1];

impl Counters {
    fn are_countable(&self) -> bool {
        let &Self {
            steps,
            substeps,
            iterations,
            rejected,
            rescued,
            restarts,
            launches,
            vertex_passes,
            sign_changes,
            fallbacks,
            breaches,
        } = self;
        let counters = [steps, substeps, iterations, rejected, rescued, restarts, launches, vertex_passes, fallbacks, breaches];
        counters.iter().chain(&sign_changes).all(|count| *count < MOST_COUNTED)
    }
}

impl<const N: usize, const M: usize> State<N, M> {
    /// Refuses impossible values and a loop that is not closed. Until the next step, accelerations and joint forces are as stored, even in
    /// a forged state.
    pub fn check<S: System<N, M> + Passage<N>>(&self, system: &S, bounds: &Bounds) -> Result<(), Inconsistency> {
        let Self { work, power, energy, .. } = self;
        let energies = [work.input, work.dissipated, power.input, power.dissipated, energy.unwrap_or(0.0)];
        let values = self.a.iter().chain(&self.jerk).chain(&self.lambda).chain(&energies);
        if !(self.q.is_finite() && self.v.is_finite() && values.into_iter().all(|x| x.is_finite())) {
            return Err("a coordinate, rate, acceleration, force or energy is not finite");
        }
        if !(self.substep > 0.0 && self.error_estimate >= 0.0 && self.error_estimate.is_finite()) {
            return Err("a sub-step length is not positive, or a local error is negative or not finite");
        }
        if !self.counters.are_countable() {
            return Err("a counter is larger than any run can make it");
        }
        if self.on_ray && !system.is_near_vertex(&self.q) {
            return Err("it passes a constraint singularity, but none is near");
        }
        if let (Some(stored), Some(present)) = (self.branch, system.branch(&self.q, &self.v))
            && stored != present
        {
            return Err("its branch of the closure is not the one of its angles");
        }
        bounds.hold(system, [&self.q, &self.v], self.on_ray)
    }
}

impl Bounds {
    /// Refuses coordinates and rates that do not close the loop.
    pub(super) fn hold<const N: usize, const M: usize>(
        &self,
        system: &impl System<N, M>,
        [q, v]: [&Vector<N>; 2],
        on_ray: bool,
    ) -> Result<(), Inconsistency> {
        let [position, velocity] = if on_ray { ON_RAY } else { [self.position, self.velocity] };
        let pose = system.pose(q);
        // Comparisons with NaN are false.
        let is_closed = system.phi(q, &pose).max_norm() <= position * system.length_scale();
        if !(q.is_finite() && is_closed) {
            return Err("the loop is not closed");
        }
        // Largest term of Φ_q q̇: each coordinate alone.
        let terms = (0..N).map(|i| system.phi_q_times(&pose, &(v[i] * Vector::unit(i))).max_norm());
        let allowed = velocity * terms.fold(0.0, f64::max) + AT_REST * system.length_scale();
        if !(v.is_finite() && system.phi_q_times(&pose, v).max_norm() <= allowed) {
            return Err("the rates do not keep the loop closed");
        }
        Ok(())
    }
}
