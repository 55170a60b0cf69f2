//! What steps of every kind have in common: how one is made, judged and completed.

use borsh::{BorshDeserialize, BorshSerialize};

use super::{Scheme, Settings};
use crate::integrator::controller::StepSizeController;
use crate::integrator::equilibrium::acceleration_near;
use crate::integrator::state::StepEnd;
use crate::integrator::{EnergyBalance, Passage, State, System, Work};
use crate::vector::Vector;
use wide::f64x2;

/// Does something for each stage, without a loop at run time: stages and their coefficients are constants.
macro_rules! for_each {
    ($do:ident: $($stage:literal)*) => {
        $($do!($stage);)*
    };
}
pub(super) use for_each;

/// One step of a kind, made but not accepted yet.
pub(super) trait Trial<const N: usize>: Sized {
    /// Which.
    const KIND: Scheme;
    /// What all tries from one state share.
    type Shared;
    /// How the next step follows from the error of this one.
    const CONTROLLER: StepSizeController;

    /// What tries from a state share; `None` where steps of this kind cannot begin.
    fn prepare<const M: usize, S: System<N, M>>(
        system: &S,
        settings: &Settings,
        from: (&State<N, M>, &Origin<S::TrigBase, N>),
    ) -> Option<Self::Shared>;

    /// A step of h seconds, to be made by [`conclude`](Self::land) at the latest.
    fn new<const M: usize, S: System<N, M>>(
        system: &S,
        shared: &Self::Shared,
        from: (&State<N, M>, &Origin<S::TrigBase, N>),
        h: f64,
    ) -> Self;

    /// Its error in units of what is allowed, and where it leads, on the constraints, if that is 1 at most; near a vertex
    /// with the energy there, so many seconds before.
    fn conclude<const M: usize, S: System<N, M> + Passage<N>>(
        &mut self,
        system: &S,
        settings: &Settings,
        origin: &Origin<S::TrigBase, N>,
        weights: &ErrorWeights,
        energy_target: Option<(EnergyBalance, f64)>,
    ) -> (f64, Option<StepResult<N, M>>);

    /// The fastest rate of change, 1/s, that a step to this end shows.
    fn fastest_rate<const M: usize>(&self, end: &State<N, M>) -> f64;

    /// The higher coefficients of the interpolant between its ends.
    fn dense<const M: usize>(
        &mut self,
        system: &impl System<N, M>,
        regularization: f64,
        ends: [&State<N, M>; 2],
    ) -> [StageDerivative<N>; 4];
}

/// Where a step leads.
pub(super) struct StepResult<const N: usize, const M: usize> {
    /// Iterations of the projection.
    pub(super) iterations: u32,
    pub(super) end_state: StepEnd<N, M>,
    /// Work on the way, J.
    pub(super) work: Work,
}

impl<const N: usize, const M: usize> StepResult<N, M> {
    /// Where it does no work, unless something there is not finite.
    #[inline(always)]
    pub(super) fn at(iterations: u32, end_state: StepEnd<N, M>) -> Option<Self> {
        Self::after(Work::default(), iterations, end_state)
    }

    /// The same after some work, J.
    #[inline(always)]
    pub(super) fn after(work: Work, iterations: u32, end_state: StepEnd<N, M>) -> Option<Self> {
        end_state.is_finite().then_some(Self { iterations, end_state, work })
    }
}

/// What the local error of a step may be.
pub(super) struct ErrorWeights {
    /// Of a coordinate.
    pub(super) coordinate: f64,
    /// Of a rate, in what a coordinate may be off: this and its own magnitude, 1/s.
    pub(super) rate: f64,
    /// Of the work, J, where it is judged.
    pub(super) work: Option<f64>,
    /// Whether forces bend sharply without a kink.
    pub(super) has_sharp_nonlinearity: bool,
}

/// A rate may be off by what a coordinate may, times this and its own magnitude, 1/s.
pub(super) const RATE: f64 = 10.0;

impl ErrorWeights {
    /// The mean square of an error of q, q̇ and the work between rates at both ends of a step, in units of what is allowed.
    #[inline(always)]
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
        let Some(weights) = self.work else { return mean };
        let Work { input, dissipated } = work();
        mean + (input * input + dissipated * dissipated) / (weights * weights)
    }
}

impl Settings {
    /// The work of a step. What is dissipated in it is less than nothing by an error only, and that is so large at least: 0 is nearer to the
    /// truth. Where the error is more than the work may be off the step is to be refused with it, in units of that.
    #[inline]
    pub(super) fn credible(&self, work: Work) -> Result<Work, f64> {
        let error = -work.dissipated / (self.error_tolerance * self.energy_scale);
        if error > 1.0 { Err(error) } else { Ok(Work { dissipated: work.dissipated.max(0.0), ..work }) }
    }
}

impl ErrorWeights {
    /// The work of a step if it is followed, as [`Settings::credible`] has it; where there are kinks that is asked when it is known where the
    /// step ends.
    #[inline]
    pub(super) fn work(&self, settings: &Settings, follows: bool, work: impl FnOnce() -> Work) -> Result<Work, f64> {
        match follows {
            false => Ok(Work::default()),
            true if self.work.is_some() => Ok(work()),
            true => settings.credible(work()),
        }
    }

    /// The same where it is not asked in every step: one piece of code.
    #[inline(never)]
    pub(super) fn mean_square_of<const N: usize>(&self, error: [Vector<N>; 2], ends: [&Vector<N>; 2], work: Work) -> f64 {
        self.mean_square(error, ends, || work)
    }
}

/// The derivatives of q, q̇ and the work, or a sum of such.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct StageDerivative<const N: usize> {
    pub(super) q: Vector<N>,
    pub(super) v: Vector<N>,
    pub(super) power: Work,
}

impl<const N: usize> StageDerivative<N> {
    pub(super) const NONE: Self = Self { q: Vector::ZERO, v: Vector::ZERO, power: Work { input: 0.0, dissipated: 0.0 } };

    /// Completes that of q̇ at a distance from an origin. One piece of code for all stages: written out for each of them it would not fit
    /// into what a processor keeps decoded.
    #[inline(never)]
    pub(super) fn complete<const M: usize, S: System<N, M>>(
        &mut self,
        system: &S,
        origin: &Origin<S::TrigBase, N>,
        by: &Vector<N>,
    ) {
        match system.acceleration_by_weight(&origin.trig_base, by, &self.q) {
            // The power stays what it is before: none.
            Some(a) => self.v = a,
            None => self.complete_under_loads(system, origin, by),
        }
    }

    /// The same for any forces. Out of line, so that where only weight acts there is little to save and restore.
    #[inline(never)]
    fn complete_under_loads<const M: usize, S: System<N, M>>(
        &mut self,
        system: &S,
        origin: &Origin<S::TrigBase, N>,
        by: &Vector<N>,
    ) {
        let Origin { q, trig_base, regularization } = origin;
        (self.v, self.power) = acceleration_near(system, (q, trig_base), by, &self.q, *regularization);
    }
}

/// Where a step begins: its stages are not far away, and their poses are turned from there.
pub(super) struct Origin<P, const N: usize> {
    q: Vector<N>,
    trig_base: P,
    /// e of the saddle-point systems, 1/kg.
    regularization: f64,
}

impl<P, const N: usize> Origin<P, N> {
    #[inline(always)]
    pub(super) fn new<const M: usize, S: System<N, M, TrigBase = P>>(
        system: &S,
        q: &Vector<N>,
        pose: &S::Pose,
        regularization: f64,
    ) -> Self {
        Self { q: *q, trig_base: system.trig_base(pose), regularization }
    }

    /// The pose at a distance.
    #[inline(always)]
    pub(super) fn turned<const M: usize, S: System<N, M, TrigBase = P>>(&self, system: &S, by: &Vector<N>) -> S::Pose {
        system.pose_near((&self.q, &self.trig_base), by)
    }
}

/// The larger magnitudes, element by element; the first has none below 0.
#[inline]
pub(super) fn larger<const N: usize>(most: &Vector<N>, x: &Vector<N>) -> Vector<N> {
    Vector::from_fn(|i| most[i].max(x[i].abs()))
}

/// The fastest rate, 1/s, that a difference of q, q̇ and q̈ between two states shows: the r of r² |Δq| + r |Δq̇| = |Δq̈|, which is the
/// frequency of a spring and the decay of a damper.
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
    fn a_step_gives_nothing_back() {
        let settings = Settings {
            schemes: Schemes::Automatic,
            error_tolerance: 1e-6,
            energy_scale: 2.0,
            first_step: 1e-3,
            max_iterations: 10,
            max_work: 1000,
            regularization: 1e-20,
        };
        let lost = |dissipated: f64| settings.credible(Work { input: 1.0, dissipated });
        assert_eq!(lost(3e-6), Ok(Work { input: 1.0, dissipated: 3e-6 }));
        assert_eq!(lost(-1e-6), Ok(Work { input: 1.0, dissipated: 0.0 }));
        // Off by three halves of what it may be.
        assert!(lost(-3e-6).is_err_and(|error| (error - 1.5).abs() < 1e-15));
    }
}
