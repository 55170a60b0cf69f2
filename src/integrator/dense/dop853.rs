//! DOP853, the explicit Runge–Kutta method of order 8 by Dormand and Prince: stages, error estimate and dense output.
//!
//! E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, 2nd ed., sections II.5 and II.6.

mod tableau;

use super::trial::{ErrorWeights, Origin, StageDerivative, StepResult, Trial, for_each, rate_between};
use super::{Scheme, Settings};
use crate::integrator::controller::StepSizeController;
use crate::integrator::{EnergyBalance, Passage, State, System, Work};
use crate::vector::Vector;
use tableau::{A, ALL, AT_ERROR_3, AT_ERROR_5, COEFFICIENTS, DENSE, END, Row, SECOND_ERROR, STAGES, last};
use wide::f64x2;

/// Upper limit of the second error estimate in mean square, relative to the estimate of order 3, which keeps round-off of stiff
/// forces out.
const SECOND_ERROR_WEIGHT: f64 = 0.09;

/// Stages of one step.
pub(super) struct Dop853<const N: usize> {
    slopes: [StageDerivative<N>; STAGES],
    q: Vector<N>,
    /// Step length, s.
    h: f64,
    /// Step length, s, in both lanes of a vector register.
    both_h: f64x2,
    /// Distance from the beginning to the q of the last stage, which is at the end of the step but of lower order, rad.
    last: Vector<N>,
}

impl<const N: usize> Dop853<N> {
    /// Σ coefficient · slope over one component of the stages, in units of the last coefficient, which saves a multiplication.
    #[inline(always)]
    fn sum<const ROW: usize>(&self, part: impl Fn(&StageDerivative<N>) -> Vector<N>) -> Vector<N> {
        let mut sum = const { COEFFICIENTS[ROW][0] / last(ROW) } * part(&self.slopes[0]);
        macro_rules! add {
            ($stage:literal) => {
                if const { COEFFICIENTS[ROW][$stage] != 0.0 } {
                    sum += const { COEFFICIENTS[ROW][$stage] / last(ROW) } * part(&self.slopes[$stage]);
                }
            };
        }
        for_each!(add: 1 2 3 4 5 6 7 8 9 10 11);
        sum
    }

    /// Sums over q and q̇ by a row of coefficients.
    #[inline(always)]
    fn sums<const ROW: usize>(&self) -> [Vector<N>; 2] {
        [self.sum::<ROW>(|slope| slope.q), self.sum::<ROW>(|slope| slope.v)]
    }

    /// Three sums at the end of the step: mean slope of order 8, error of order 5 and error of order 3, for q or q̇. Two elements
    /// at a time are loaded once for all sums and stay in registers.
    #[inline(never)]
    fn end_sums(&self, of_rates: bool) -> [Vector<N>; 3] {
        let mut sums = [Vector::ZERO; 3];
        for index in 0..N.div_ceil(2) {
            let slopes: [f64x2; STAGES] = std::array::from_fn(|stage| {
                let StageDerivative { q, v, .. } = &self.slopes[stage];
                (if of_rates { v } else { q }).pair(index)
            });
            let mean = row_sum(&slopes, |stage| COEFFICIENTS[END][stage]);
            let pairs = [
                mean,
                row_sum(&slopes, |stage| COEFFICIENTS[AT_ERROR_5][stage]),
                // The difference of rows has more zeros.
                mean + row_sum(&slopes, |stage| COEFFICIENTS[AT_ERROR_3][stage] - COEFFICIENTS[END][stage]),
            ];
            for (sum, pair) in sums.iter_mut().zip(pairs) {
                sum.set_pair(index, pair);
            }
        }
        sums
    }

    /// Sum over the power by a row of coefficients, W.
    #[inline(always)]
    fn power<const ROW: usize>(&self) -> Work {
        let mut power = Work::default();
        macro_rules! add {
            ($stage:literal) => {
                if const { COEFFICIENTS[ROW][$stage] != 0.0 } {
                    power = power.plus(const { COEFFICIENTS[ROW][$stage] }, self.slopes[$stage].power);
                }
            };
        }
        for_each!(add: 0 1 2 3 4 5 6 7 8 9 10 11);
        power
    }

    /// Increments of q and q̇ from the beginning of the step by a row of coefficients.
    #[inline(always)]
    fn increment<const ROW: usize>(&self) -> [Vector<N>; 2] {
        let unit = self.both_h * f64x2::splat(const { last(ROW) });
        self.sums::<ROW>().map(|sum| unit * sum)
    }

    /// Evaluates the stages of the step in place, which avoids copies of returned values.
    #[inline(never)]
    fn evaluate_all<const M: usize, S: System<N, M>>(&mut self, system: &S, origin: &Origin<S::TrigBase, N>) {
        macro_rules! evaluate {
            ($stage:literal) => {
                let _ = self.evaluate::<$stage, M, _>(system, origin);
            };
        }
        for_each!(evaluate: 1 2 3 4 5 6 7 8 9 10);
        self.last = self.evaluate::<{ STAGES - 1 }, M, _>(system, origin);
    }

    /// Evaluates the stage of a row, and returns the increment of its q.
    #[inline(always)]
    fn evaluate<const ROW: usize, const M: usize, S: System<N, M>>(
        &mut self,
        system: &S,
        origin: &Origin<S::TrigBase, N>,
    ) -> Vector<N> {
        let [q, v] = self.increment::<ROW>();
        self.slopes[ROW].q = self.slopes[0].q + v;
        self.slopes[ROW].evaluate_acceleration(system, origin, &q);
        q
    }

    /// Mean power over the step, of order 8, W.
    fn mean_power(&self) -> Work {
        self.power::<END>()
    }

    /// Mean square of a second error estimate of order 5, for forces with sharp nonlinearities: contributions from both sides of a
    /// bend may cancel in one estimate, but hardly in both. A loop suffices, since few scenes need it.
    #[inline(never)]
    fn second_error(&self, weights: &ErrorWeights, rates: [&Vector<N>; 2]) -> f64 {
        let (mut q, mut v) = (Vector::ZERO, Vector::ZERO);
        for &(stage, coefficient) in SECOND_ERROR {
            q += coefficient * self.slopes[stage].q;
            v += coefficient * self.slopes[stage].v;
        }
        weights.mean_square_of([q, v], rates, Work::default())
    }

    /// Error estimate in units of the tolerance: root mean square over coordinates, rates (weight 10/s + |q̇|) and work. The
    /// estimate of order 5 is combined with that of order 3 (Hairer, Nørsett, Wanner, section II.5, eq. 5.17).
    #[inline(always)]
    fn error(&self, weights: &ErrorWeights, [fifth, third]: [[Vector<N>; 2]; 2], v_end: &Vector<N>) -> f64 {
        let rates = [&self.slopes[0].q, v_end];
        let mut fifth = weights.mean_square(fifth, rates, || self.power::<AT_ERROR_5>());
        let third = weights.mean_square(third, rates, || self.power::<AT_ERROR_3>());
        if weights.has_sharp_nonlinearity {
            fifth = fifth.max(self.second_error(weights, rates).min(SECOND_ERROR_WEIGHT * third));
        }
        let damped = fifth + 0.01 * third;
        // Both estimates are 0 where nothing moves.
        if damped == 0.0 { 0.0 } else { self.h * fifth / damped.sqrt() }
    }
}

/// Σ coefficient · slope over the stages; the compiler omits zero coefficients.
#[inline(always)]
fn row_sum(slopes: &[f64x2; STAGES], coefficient: impl Fn(usize) -> f64) -> f64x2 {
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

impl<const N: usize> Trial<N> for Dop853<N> {
    const SCHEME: Scheme = Scheme::Dop853;
    type Linearization = ();
    /// Memory and a growth limit of 3 leave a quarter of the rejections of the classical controller.
    const CONTROLLER: StepSizeController = StepSizeController {
        exponent: 1.0 / 8.0 - 0.75 * 0.02,
        memory: 0.02,
        accepted: [0.3, 3.0],
        rejected: [0.3, 0.85],
        failed: 0.3,
    };

    fn linearize<const M: usize, S: System<N, M>>(_: &S, _: &Settings, _: (&State<N, M>, &Origin<S::TrigBase, N>)) -> Option<()> {
        Some(())
    }

    #[inline(always)]
    fn new<const M: usize, S: System<N, M>>(_: &S, (): &(), (from, _): (&State<N, M>, &Origin<S::TrigBase, N>), h: f64) -> Self {
        let mut stages =
            Self { slopes: [StageDerivative::NONE; STAGES], q: from.q, h, both_h: f64x2::splat(h), last: Vector::ZERO };
        stages.slopes[0].q = from.v;
        stages.slopes[0].v = from.a;
        stages.slopes[0].power = from.power;
        stages
    }

    #[inline(always)]
    fn conclude<const M: usize, S: System<N, M> + Passage<N>>(
        &mut self,
        system: &S,
        settings: &Settings,
        origin: &Origin<S::TrigBase, N>,
        weights: &ErrorWeights,
        energy_target: Option<(EnergyBalance, f64)>,
    ) -> (f64, Option<StepResult<N, M>>) {
        self.evaluate_all(system, origin);
        let ([mean_q, q_5, q_3], [mean_v, v_5, v_3]) = (self.end_sums(false), self.end_sums(true));
        let end = [self.q + self.h * mean_q, self.slopes[0].q + self.h * mean_v];
        let error = self.error(weights, [[q_5, v_5], [q_3, v_3]], &end[1]);
        if error.is_nan() || error > 1.0 {
            return (error, None);
        }
        let work = match weights.work(settings, system.follows_work(), || Work::default().plus(self.h, self.mean_power())) {
            Ok(work) => work,
            Err(error) => return (error, None),
        };
        (error, settings.project_and_evaluate(system, (origin, end[0] - self.q), end, energy_target, work))
    }

    /// Fastest rate from the difference between the last stage and the end of the step, which are at the same time.
    fn fastest_rate<const M: usize>(&self, end: &State<N, M>) -> f64 {
        let last = &self.slopes[STAGES - 1];
        rate_between([end.q - self.q - self.last, end.v - last.q, end.a - last.v])
    }

    /// Coefficients of the dense output, from three further stages.
    #[cold]
    fn dense<const M: usize>(
        &mut self,
        system: &impl System<N, M>,
        regularization: f64,
        [_, end]: [&State<N, M>; 2],
    ) -> [StageDerivative<N>; 4] {
        let mut slopes = [StageDerivative::NONE; ALL];
        slopes[..STAGES].copy_from_slice(&self.slopes);
        slopes[END] = StageDerivative { q: end.v, v: end.a, power: end.power };
        let origin = Origin::new(system, &self.q, &system.pose(&self.q), regularization);
        for stage in END + 1..ALL {
            let increment = weighted_sum(self.h, &slopes, A[stage]);
            slopes[stage].q = slopes[0].q + increment.v;
            slopes[stage].evaluate_acceleration(system, &origin, &increment.q);
        }
        DENSE.map(|row| weighted_sum(self.h, &slopes, row))
    }
}

/// h times the weighted sum of slopes, as a loop, since few steps need their interpolant.
fn weighted_sum<const N: usize>(h: f64, slopes: &[StageDerivative<N>; ALL], row: Row) -> StageDerivative<N> {
    let mut sum = StageDerivative::NONE;
    for &(stage, coefficient) in row {
        let StageDerivative { q, v, power } = &slopes[stage];
        sum.q += coefficient * *q;
        sum.v += coefficient * *v;
        sum.power = sum.power.plus(coefficient, *power);
    }
    StageDerivative { q: h * sum.q, v: h * sum.v, power: Work::default().plus(h, sum.power) }
}
