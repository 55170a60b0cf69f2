//! Explicit Runge–Kutta methods: one engine for every [`Tableau`]. It computes the stages, error estimate and end of a step.
//!
//! The local error combines two estimates; the coarser one damps the finer one (E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary
//! Differential Equations I*, 2nd ed., section II.5, eq. 5.17), so that the error falls with the order of the method.

mod dop853;
mod tsit5;

use std::marker::PhantomData;

use super::Scheme;
use super::trial::{ErrorWeights, Origin, StageDerivative, Trial, for_each, rate_between};
use crate::integrator::{State, System, Work};
use crate::vector::Vector;
pub(super) use dop853::Dop853;
pub(super) use tsit5::Tsit5;
use wide::f64x2;

/// Largest number of stages of a tableau.
const MAX_STAGES: usize = 12;

/// Coefficients of all stages in a sum; 0 for unused stages, which the compiler omits.
type Weights = [f64; MAX_STAGES];

/// Coefficients of an explicit method with its error estimates and dense output.
pub(super) trait Tableau: Sized {
    /// Scheme of the method.
    const SCHEME: Scheme;
    /// Number of stages.
    const STAGES: usize;
    /// Coefficients of the stages; each row uses earlier stages.
    const A: [Weights; MAX_STAGES];
    /// Coefficients of the end of the step.
    const END: Weights;
    /// Coefficients of the finer error estimate: solution minus embedded solution.
    const FINE: Weights;
    /// Coefficients of the coarser error estimate.
    const COARSE: Weights;
    /// Weight of the coarser estimate in the mean square.
    const DAMPING: f64;
    /// Coefficients of a second estimate with the order of the finer one, for forces with sharp nonlinearities. Contributions from both
    /// sides of a bend may cancel in one estimate, but hardly in both.
    const SECOND: Option<Weights>;

    /// Higher coefficients of the interpolant between the ends of a step.
    fn dense<const N: usize, const M: usize, S: System<N, M>>(
        stages: &Stages<N>,
        system: &S,
        regularization: f64,
        ends: [&State<N, M>; 2],
    ) -> [StageDerivative<N>; 4];
}

/// Upper limit of the second error estimate in the mean square, relative to the coarser one. It excludes round-off of stiff forces.
const SECOND_ERROR_WEIGHT: f64 = 0.09;

/// Derivatives at the stages of one step.
pub(super) struct Stages<const N: usize> {
    slopes: [StageDerivative<N>; MAX_STAGES],
    /// Coordinates at the beginning, m and rad.
    q: Vector<N>,
    /// Step length, s.
    h: f64,
}

/// One step by a tableau.
pub(super) struct Explicit<T, const N: usize> {
    stages: Stages<N>,
    /// Increments of q from the beginning of the step to the last two stages, m and rad.
    last: [Vector<N>; 2],
    tableau: PhantomData<T>,
}

/// Last nonzero coefficient.
const fn last(weights: &Weights) -> f64 {
    let mut stage = MAX_STAGES - 1;
    while stage > 0 && weights[stage] == 0.0 {
        stage -= 1;
    }
    weights[stage]
}

impl<const N: usize> Stages<N> {
    /// Weighted sum of the power over the stages, W.
    fn power(&self, weights: &Weights) -> Work {
        self.slopes.iter().zip(weights).fold(Work::default(), |sum, (slope, weight)| sum.plus(*weight, slope.power))
    }

    /// Weighted sums of q̇ and q̈ over the stages. A plain loop instead of unrolled code, because few scenes need these sums.
    fn sums(&self, weights: &Weights) -> [Vector<N>; 2] {
        self.slopes
            .iter()
            .zip(weights)
            .fold([Vector::ZERO; 2], |[q, v], (slope, weight)| [q + *weight * slope.q, v + *weight * slope.v])
    }
}

impl<T: Tableau, const N: usize> Explicit<T, N> {
    /// Begins a step of `h` seconds.
    pub(super) fn new<const M: usize>(from: &State<N, M>, h: f64) -> Self {
        let mut stages = Stages { slopes: [StageDerivative::NONE; MAX_STAGES], q: from.q, h };
        stages.slopes[0] = StageDerivative { q: from.v, v: from.a, power: from.power };
        Self { stages, last: [Vector::ZERO; 2], tableau: PhantomData }
    }

    /// Increment of q or q̇ from the beginning of the step to a stage. The coefficients are divided by the last nonzero one; the sum is
    /// then multiplied by it and h together. This saves a multiplication.
    fn increment<const STAGE: usize>(&self, part: impl Fn(&StageDerivative<N>) -> Vector<N>) -> Vector<N> {
        let mut sum = const { T::A[STAGE][0] / last(&T::A[STAGE]) } * part(&self.stages.slopes[0]);
        macro_rules! add {
            ($stage:literal) => {
                if const { T::A[STAGE][$stage] != 0.0 } {
                    sum += const { T::A[STAGE][$stage] / last(&T::A[STAGE]) } * part(&self.stages.slopes[$stage]);
                }
            };
        }
        for_each!(add: 1 2 3 4 5 6 7 8 9 10 11);
        f64x2::splat(self.stages.h * const { last(&T::A[STAGE]) }) * sum
    }

    /// Three sums at the end of the step, over q̇ or q̈: mean slope, finer and coarser error estimate. Two elements at a time are loaded
    /// once for all sums and stay in registers.
    #[inline(never)]
    fn end_sums(&self, of_rates: bool) -> [Vector<N>; 3] {
        let mut sums = [Vector::ZERO; 3];
        for index in 0..N.div_ceil(2) {
            let slopes: [f64x2; MAX_STAGES] = std::array::from_fn(|stage| {
                let StageDerivative { q, v, .. } = &self.stages.slopes[stage];
                (if of_rates { v } else { q }).pair(index)
            });
            let pairs = [
                row_sum(&slopes, |stage| T::END[stage]),
                row_sum(&slopes, |stage| T::FINE[stage]),
                row_sum(&slopes, |stage| T::COARSE[stage]),
            ];
            for (sum, pair) in sums.iter_mut().zip(pairs) {
                sum.set_pair(index, pair);
            }
        }
        sums
    }

    /// Evaluates the stages of the step in place, which avoids copying returned values.
    #[inline(never)]
    fn evaluate_all<const M: usize, S: System<N, M>>(&mut self, system: &S, origin: &Origin<'_, S::Pose, N>) {
        macro_rules! evaluate {
            ($stage:literal) => {
                if const { $stage < T::STAGES } {
                    let [q, v] = [self.increment::<$stage>(|slope| slope.q), self.increment::<$stage>(|slope| slope.v)];
                    self.stages.slopes[$stage].q = self.stages.slopes[0].q + v;
                    self.stages.slopes[$stage].evaluate_acceleration(system, origin, &q);
                    if const { $stage + 2 >= T::STAGES } {
                        self.last = [self.last[1], q];
                    }
                }
            };
        }
        for_each!(evaluate: 1 2 3 4 5 6 7 8 9 10 11);
    }

    /// Error estimate in units of the tolerance: root mean square over coordinates, rates and work.
    fn error(&self, weights: &ErrorWeights, [fine, coarse]: [[Vector<N>; 2]; 2], v_end: &Vector<N>) -> f64 {
        let rates = [&self.stages.slopes[0].q, v_end];
        let mut fine = weights.mean_square(fine, rates, || self.stages.power(&T::FINE));
        let coarse = weights.mean_square(coarse, rates, || self.stages.power(&T::COARSE));
        if weights.has_sharp_nonlinearity
            && let Some(second) = T::SECOND
        {
            let second = weights.mean_square(self.stages.sums(&second), rates, Work::default);
            fine = fine.max(second.min(SECOND_ERROR_WEIGHT * coarse));
        }
        let damped = fine + T::DAMPING * coarse;
        // Both estimates are 0 if nothing moves.
        if damped == 0.0 { 0.0 } else { self.stages.h * fine / damped.sqrt() }
    }
}

/// Σ coefficient · slope over the stages; the compiler omits zero coefficients.
fn row_sum(slopes: &[f64x2; MAX_STAGES], coefficient: impl Fn(usize) -> f64) -> f64x2 {
    let mut sum = f64x2::splat(coefficient(0)) * slopes[0];
    macro_rules! add {
        ($stage:literal) => {
            if coefficient($stage) != 0.0 {
                sum += f64x2::splat(coefficient($stage)) * slopes[$stage];
            }
        };
    }
    for_each!(add: 1 2 3 4 5 6 7 8 9 10 11);
    sum
}

impl<T: Tableau, const N: usize> Trial<N> for Explicit<T, N> {
    const SCHEME: Scheme = T::SCHEME;

    fn complete<const M: usize, S: System<N, M>>(
        &mut self,
        system: &S,
        origin: &Origin<'_, S::Pose, N>,
        weights: &ErrorWeights,
    ) -> (f64, [Vector<N>; 2]) {
        self.evaluate_all(system, origin);
        let ([mean_q, fine_q, coarse_q], [mean_v, fine_v, coarse_v]) = (self.end_sums(false), self.end_sums(true));
        let Stages { q, h, slopes } = &self.stages;
        let end = [*q + *h * mean_q, slopes[0].q + *h * mean_v];
        (self.error(weights, [[fine_q, fine_v], [coarse_q, coarse_v]], &end[1]), end)
    }

    fn work<const M: usize>(&self, _: &impl System<N, M>) -> Work {
        Work::default().plus(self.stages.h, self.stages.power(&T::END))
    }

    /// Fastest rate, from the difference between two evaluations at almost the same time: the last stage and the end of the step, or the
    /// last two stages.
    fn fastest_rate<const M: usize>(&self, end: &State<N, M>) -> f64 {
        let Stages { slopes, q, .. } = &self.stages;
        let [before, stage] = [&slopes[T::STAGES - 2], &slopes[T::STAGES - 1]];
        rate_between(if const { T::SCHEME.properties().evaluates_end } {
            [end.q - *q - self.last[1], end.v - stage.q, end.a - stage.v]
        } else {
            [self.last[1] - self.last[0], stage.q - before.q, stage.v - before.v]
        })
    }

    fn dense<const M: usize>(
        &self,
        system: &impl System<N, M>,
        regularization: f64,
        ends: [&State<N, M>; 2],
    ) -> [StageDerivative<N>; 4] {
        T::dense(&self.stages, system, regularization, ends)
    }
}
