//! Whether a state that comes from outside is one that a step can have left.

use super::equilibrium::equilibrium;
use super::{Counters, Passage, State, System, Work};
use crate::vector::Vector;

/// What is wrong with a state, as the end of a sentence that begins with it.
pub type Inconsistency = &'static str;

/// How far a state may be from what its coordinates and rates give.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    /// Of max |Φ|, in multiples of the system's size.
    pub position: f64,
    /// Of max |Φ_q q̇|, in multiples of its largest term.
    pub velocity: f64,
    /// Whether q̈ and λ are those of equilibrium.
    pub in_balance: bool,
    /// e of the saddle-point systems, far from every vertex and near one, 1/kg.
    pub regularizations: [f64; 2],
}

/// q̈, λ and the power are those of q and q̇ to this part: whole turns of an angle may have been taken off since.
const BALANCED: f64 = 1e-7;

/// Larger counters have not been counted: they would take longer than a lifetime.
const MOST_COUNTED: u64 = 1 << 62;

/// Rates below this, 1/s, are those of a system at rest, and may be round-off.
const AT_REST: f64 = 1e-9;

/// On a ray through a vertex nothing is projected: positions and rates are off by this at most, see [`Bounds`].
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
    /// Whether all that follows from coordinates, rates and forces is what these give, and the rest is possible.
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
        let pose = system.pose(&self.q);
        let power = if system.follows_work() { system.power(&self.q, &pose, &self.v) } else { Work::default() };
        let same = |x: f64, y: f64| (x - y).abs() <= BALANCED * (1.0 + y.abs());
        if !(same(self.power.input, power.input) && same(self.power.dissipated, power.dissipated)) {
            return Err("the power is not the power of the loads");
        }
        if (self.configuration_signs ^ system.configuration_signs(&pose)) & !system.uncertain_configuration_signs(&pose) != 0 {
            return Err("its configuration signs do not fit its angles");
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
