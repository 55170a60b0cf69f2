//! Consistency checks of a stored state: constraints, equilibrium, power, counters.

use super::equilibrium::equilibrium;
use super::{Counters, Passage, State, System};
use crate::vector::Vector;

/// Defect of a state, as the end of a sentence whose subject is the state.
pub type Inconsistency = &'static str;

/// Admissible deviations of a state.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Admissible max |Φ|, relative to the system's size.
    pub position: f64,
    /// Admissible max |Φ_q q̇|, relative to its largest term.
    pub velocity: f64,
    /// Whether q̈ and λ must be those of equilibrium.
    pub in_balance: bool,
    /// Regularisations e of the saddle-point systems, far from every vertex and near one, 1/kg.
    pub regularizations: [f64; 2],
}

/// Admissible relative deviation of q̈, λ and power: whole turns of an angle may have been removed since.
const BALANCED: f64 = 1e-7;

/// Upper limit of counters: a larger count would take longer than a lifetime.
const MOST_COUNTED: u64 = 1 << 62;

/// Rates below this limit, 1/s, may be round-off of rest.
const AT_REST: f64 = 1e-9;

/// Admissible violations of position and velocity on a ray through a vertex, where nothing is projected, in the units of
/// [`Bounds`].
const ON_RAY: [f64; 2] = [1e-4, 1e-1];

impl Counters {
    fn are_countable(&self) -> bool {
        let &Self { steps, substeps, iterations, rejected, rescued, restarts, launches, vertex_passes, sign_changes, fallbacks } =
            self;
        let counters = [steps, substeps, iterations, rejected, rescued, restarts, launches, vertex_passes, fallbacks];
        counters.iter().chain(&sign_changes).all(|count| *count < MOST_COUNTED)
    }
}

impl<const N: usize, const M: usize> State<N, M> {
    /// Checks that accelerations, multipliers, power and signs follow from coordinates, rates and forces, and that all values are
    /// possible.
    #[cold]
    pub fn check<S: System<N, M> + Passage<N>>(&self, system: &S, bounds: &Bounds) -> Result<(), Inconsistency> {
        let vectors = [&self.q, &self.v, &self.a, &self.jerk];
        let energies = [self.work.input, self.work.dissipated, self.power.input, self.power.dissipated];
        if !(vectors.iter().all(|x| x.is_finite()) && self.lambda.is_finite() && energies.iter().all(|x| x.is_finite())) {
            return Err("a coordinate, rate, acceleration, force or energy is not finite");
        }
        if !(self.substep > 0.0 && self.error_estimate >= 0.0 && self.error_estimate.is_finite()) {
            return Err("a sub-step length is not positive, or a local error is negative or not finite");
        }
        if !self.counters.are_countable() {
            return Err("a counter is larger than any run can make it");
        }
        self.check_constraints(system, bounds)?;
        if bounds.in_balance {
            self.check_balance(system, bounds.regularizations)?;
        }
        Ok(())
    }

    #[cold]
    fn check_constraints<S: System<N, M> + Passage<N>>(&self, system: &S, bounds: &Bounds) -> Result<(), Inconsistency> {
        if self.on_ray && !system.is_near_vertex(&self.q) {
            return Err("it passes a constraint singularity, but none is near");
        }
        let [position, velocity] = if self.on_ray { ON_RAY } else { [bounds.position, bounds.velocity] };
        let pose = system.pose(&self.q);
        if system.phi(&self.q, &pose).max_norm() > position * system.length_scale() {
            return Err("the loop is not closed");
        }
        // The largest term of Φ_q q̇: each coordinate alone.
        let terms = (0..N).map(|i| system.phi_q_times(&pose, &(self.v[i] * Vector::unit(i))).max_norm());
        let allowed = velocity * terms.fold(0.0, f64::max) + AT_REST * system.length_scale();
        if system.phi_q_times(&pose, &self.v).max_norm() > allowed {
            return Err("the rates do not keep the loop closed");
        }
        Ok(())
    }

    #[cold]
    fn check_balance<S: System<N, M> + Passage<N>>(&self, system: &S, regularizations: [f64; 2]) -> Result<(), Inconsistency> {
        let in_balance = regularizations.into_iter().any(|regularization| {
            let (a, lambda) = equilibrium(system, &self.q, &self.v, regularization);
            let a = system.acceleration_from_rest(&self.q, &self.v).unwrap_or(a);
            let close = |difference: f64, scale: f64| difference <= BALANCED * (1.0 + scale);
            close((a - self.a).max_norm(), a.max_norm()) && close((lambda - self.lambda).max_norm(), lambda.max_norm())
        });
        if in_balance { Ok(()) } else { Err("accelerations and joint forces do not balance the loads") }
    }
}
