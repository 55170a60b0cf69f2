//! Interface of all schemes: how a step is completed and projected; error weights, evaluation of stages, projection of the end.

use borsh::{BorshDeserialize, BorshSerialize};

use super::stiff_metric::StiffMetric;
use super::{Scheme, Settings};
use crate::integrator::dense_output::Interpolant;
use crate::integrator::equilibrium::{acceleration_near, project_sticking};
use crate::integrator::state::StepEnd;
use crate::integrator::{
    ERROR_RATE, EnergyBalance, Features, Passage, Posed, Projection, State, StepError, Stuck, System, Work, velocity_correction,
};
use crate::vector::Vector;
use wide::f64x2;

/// Expands a macro for each stage instead of a loop, because stages and their coefficients are constants.
macro_rules! for_each {
    ($do:ident: $($stage:literal)*) => {
        $($do!($stage);)*
    };
}
pub(super) use for_each;

/// One step of a scheme that is not yet accepted.
pub(super) trait Trial<const N: usize>: Sized {
    /// Scheme of the step.
    const SCHEME: Scheme;

    /// Computes the remaining stages. Returns the error of the step, in tolerances, and q and q̇ at its end before projection.
    fn complete<const M: usize, S: System<N, M>>(
        &mut self,
        system: &S,
        origin: &Origin<'_, S::Pose, N>,
        weights: &ErrorWeights,
    ) -> (f64, [Vector<N>; 2]);

    /// Work over the step, J.
    fn work<const M: usize>(&self, system: &impl System<N, M>) -> Work;

    /// Metric of the projection onto the constraints; `None` means the mass metric.
    fn stiff_metric(&self) -> Option<StiffMetric<'_, N>> {
        None
    }

    /// Ends the step at q and q̇: projects them onto the constraints and, if the scheme evaluates its ends, solves for q̈, λ and power
    /// there. `energy_target` is the energy at the beginning, if the step has to conserve it, and the length of the step, s; `work` is the
    /// work over the step, J. `None` if the projection or the energy fails, or the end is not finite.
    fn project<const M: usize, S: System<N, M> + Passage<N>>(
        &self,
        system: &S,
        settings: &Settings,
        (origin, [mut q, mut v]): (&Origin<'_, S::Pose, N>, [Vector<N>; 2]),
        energy_target: Option<(EnergyBalance, f64)>,
        work: Work,
    ) -> Option<StepResult<N, M>> {
        let mut pose = origin.pose_at(system, &(q - origin.q));
        let (iterations, mass) = project(settings, system, self.stiff_metric(), &mut pose, [&mut q, &mut v]).ok()?;
        if let Some((energy, h)) = &energy_target {
            v = system.energy_scale(energy, &q, &v, *h).ok()? * v;
        }
        let end_state = match const { Self::SCHEME.properties().evaluates_end } {
            true => StepEnd::in_balance(system, [q, v], &pose, &mass),
            false => StepEnd::without_balance(system, [q, v], &pose),
        };
        end_state.is_finite().then_some(StepResult { iterations, end_state, work })
    }

    /// Fastest rate of the step, 1/s, estimated from its stages.
    fn fastest_rate<const M: usize>(&self, end: &State<N, M>) -> f64;

    /// Higher coefficients of the interpolant between `ends`.
    fn dense<const M: usize>(
        &self,
        system: &impl System<N, M>,
        regularization: f64,
        ends: [&State<N, M>; 2],
    ) -> [StageDerivative<N>; 4];
}

/// End of a step, and its work.
pub(super) struct StepResult<const N: usize, const M: usize> {
    /// Number of iterations of the projection.
    pub(super) iterations: u32,
    /// State at the end.
    pub(super) end_state: StepEnd<N, M>,
    /// Work over the step, J.
    pub(super) work: Work,
}

/// Weights of the local error.
pub(super) struct ErrorWeights {
    /// Admissible error of a coordinate, m or rad.
    pub(super) coordinate: f64,
    /// Rate added to |q̇| in the admissible error of a rate, 1/s; the sum is multiplied by [`Self::coordinate`].
    pub(super) rate: f64,
    /// Admissible error of the work, J, if the work is judged.
    pub(super) work: Option<f64>,
    /// Whether forces have sharp nonlinearities without an event.
    pub(super) has_sharp_nonlinearity: bool,
}

impl ErrorWeights {
    /// Weights of a system. With events the work is weighted too: it depends on discontinuous forces, and the motion does not reveal their
    /// error.
    pub(super) fn of(settings: &Settings, features: Features) -> Self {
        /// Admissible error of a slow rate, relative to the regularisation velocity: larger errors would step over sticking.
        const SLOW_RATE_PART: f64 = 0.3;
        let Features { events, sharp, regularization_velocity, .. } = features;
        Self {
            coordinate: settings.error_tolerance,
            rate: ERROR_RATE.min(SLOW_RATE_PART * regularization_velocity / settings.error_tolerance),
            work: events.then_some(settings.error_tolerance * settings.energy_scale),
            has_sharp_nonlinearity: sharp,
        }
    }

    /// Mean square of an error of q, q̇ and the work, in units of the admissible error, given the rates at both ends of the step.
    pub(super) fn mean_square<const N: usize>(
        &self,
        [q, v]: [Vector<N>; 2],
        [from, to]: [&Vector<N>; 2],
        work: impl FnOnce() -> Work,
    ) -> f64 {
        let units = from.with(to, |from, to| f64x2::splat(1.0) / (f64x2::splat(self.rate) + from.abs().fast_max(to.abs())));
        let rates = v.with(&units, |v, unit| v * unit);
        let squares = q.with(&rates, |q, rate| q * q + rate * rate);
        let mean = squares.sum() / (2.0 * N as f64 * self.coordinate * self.coordinate);
        let Some(admissible) = self.work else { return mean };
        let Work { input, dissipated } = work();
        mean + (input * input + dissipated * dissipated) / (admissible * admissible)
    }
}

/// Work of a step with its dissipated part raised to at least 0: a negative value reveals an error of at least its size. If this error
/// exceeds the admissible one, the step is refused with the error in tolerances.
pub(super) fn checked_work(settings: &Settings, work: Work) -> Result<Work, f64> {
    let error = -work.dissipated / (settings.error_tolerance * settings.energy_scale);
    if error > 1.0 { Err(error) } else { Ok(Work { dissipated: work.dissipated.max(0.0), ..work }) }
}

/// Projects q and q̇ onto the constraints, from the pose at q. Close to a vertex nothing is projected, because round-off would be
/// amplified. `stiff` is the metric if it is not the mass metric. Returns the number of iterations and the mass factor.
#[inline(always)]
pub(super) fn project<const N: usize, const M: usize, S: System<N, M> + Passage<N>>(
    settings: &Settings,
    system: &S,
    stiff: Option<StiffMetric<'_, N>>,
    pose: &mut S::Pose,
    [q, v]: [&mut Vector<N>; 2],
) -> Result<(u32, S::Mass), StepError> {
    if !system.can_project(q) {
        return Ok((0, system.factor_mass(pose, settings.regularization)));
    }
    let projection = Projection::to_round_off(system.length_scale(), settings.regularization, settings.max_iterations);
    let iterations = match stiff {
        Some(metric) => metric.project(&projection, system, pose, [q, v])?,
        None => projection.position_from(system, pose, q)?,
    };
    let mass = system.factor_mass(pose, settings.regularization);
    *v += velocity_correction(system, pose, &mass, v);
    if system.stuck() != Stuck::Nothing {
        *v = project_sticking(system, Posed { q, pose, v }, &mass);
    }
    Ok((iterations, mass))
}

/// Derivatives of q, q̇ and work at a stage, or a weighted sum of them.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct StageDerivative<const N: usize> {
    pub(super) q: Vector<N>,
    pub(super) v: Vector<N>,
    pub(super) power: Work,
}

impl<const N: usize> StageDerivative<N> {
    pub(super) const NONE: Self = Self { q: Vector::ZERO, v: Vector::ZERO, power: Work { input: 0.0, dissipated: 0.0 } };

    /// Higher coefficients if one polynomial serves coordinates and rates.
    pub(super) fn of_positions(positions: Interpolant<N>) -> [Self; 4] {
        positions.higher().map(|q| Self { q, ..Self::NONE })
    }

    /// Evaluates acceleration and power at an increment from the origin. A single copy of the code for all stages fits into the processor's
    /// cache of decoded instructions.
    #[inline(never)]
    pub(super) fn evaluate_acceleration<const M: usize, S: System<N, M>>(
        &mut self,
        system: &S,
        origin: &Origin<'_, S::Pose, N>,
        by: &Vector<N>,
    ) {
        let Origin { q, pose, regularization } = origin;
        (self.v, self.power) = acceleration_near(system, q, pose, by, &self.q, *regularization);
    }
}

/// Beginning of a step; the poses of its stages are near its pose.
pub(super) struct Origin<'a, P, const N: usize> {
    pub(super) q: Vector<N>,
    pub(super) pose: &'a P,
    /// Regularisation e of the saddle-point systems, 1/kg.
    pub(super) regularization: f64,
}

impl<P, const N: usize> Origin<'_, P, N> {
    /// Pose at an increment from the origin.
    #[inline(always)]
    pub(super) fn pose_at<const M: usize, S: System<N, M, Pose = P>>(&self, system: &S, by: &Vector<N>) -> P {
        system.pose_near(&self.q, self.pose, by)
    }
}

/// Fastest rate r, 1/s, from r² |Δq| + r |Δq̇| = |Δq̈| for differences between two states: frequency of a spring, or decay rate of a
/// damper.
pub(super) fn rate_between<const N: usize>([dq, dv, da]: [Vector<N>; 3]) -> f64 {
    let [q, v, a] = [dq, dv, da].map(|x| x.norm());
    let both = v + (v * v + 4.0 * q * a).sqrt();
    if both > 0.0 { 2.0 * a / both } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::super::Schemes;
    use super::*;

    #[test]
    fn dissipation_is_never_negative() {
        let settings = Settings {
            schemes: Schemes::Automatic,
            error_tolerance: 1e-6,
            energy_scale: 2.0,
            first_step: 1e-3,
            max_iterations: 10,
            max_work: 1000,
            regularization: 1e-20,
        };
        let lost = |dissipated: f64| checked_work(&settings, Work { input: 1.0, dissipated });
        assert_eq!(lost(3e-6), Ok(Work { input: 1.0, dissipated: 3e-6 }));
        assert_eq!(lost(-1e-6), Ok(Work { input: 1.0, dissipated: 0.0 }));
        // Negative dissipation of 1.5 times the admissible error.
        assert!(lost(-3e-6).is_err_and(|error| (error - 1.5).abs() < 1e-15));
    }
}
