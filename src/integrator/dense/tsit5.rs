//! Tsit5, an explicit Runge–Kutta method of order 5 with six stages, for inputs held so shortly that no higher order pays.
//!
//! Ch. Tsitouras, *Runge–Kutta pairs of order 5(4) satisfying only the first column simplifying assumption*, Computers and
//! Mathematics with Applications 62 (2011). The author's error estimate needs the derivative at the end of the step as a seventh
//! stage, which would be discarded where inputs change; the estimate here uses the six stages.

use super::hermite::{self, HermiteData};
use super::trial::{ErrorWeights, Origin, StageDerivative, StepResult, Trial, for_each, rate_between};
use super::{Scheme, Settings};
use crate::integrator::controller::StepSizeController;
use crate::integrator::{EnergyBalance, Passage, State, System, Work};
use crate::vector::Vector;

/// Number of stages.
const STAGES: usize = 6;
/// Row of the end of the step.
const END: usize = STAGES;
/// Row of the error estimate of order 3: embedded solution minus solution. The eight conditions of order 4 admit only the solution
/// itself. Among directions that meet the four conditions of order 3 this one meets the others best, to 0.0006 (root of the sum of
/// squares, weighted as in the expansion of the error); its length makes its terms of order 5 as large as those of the author's
/// estimate, 0.001.
const ERROR: usize = END + 1;
/// Row of the error estimate of order 2: the direction that violates the two conditions of order 3 most, of a length that makes the
/// estimate for short steps as large as the author's.
const COARSE: usize = END + 2;

/// Coefficients of the stages, then rows [`END`], [`ERROR`] and [`COARSE`].
const WEIGHTS: [[f64; STAGES]; STAGES + 3] = [
    [0.0; STAGES],
    [0.161, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-0.008480655492356989, 0.335480655492357, 0.0, 0.0, 0.0, 0.0],
    [2.8971530571054935, -6.359448489975075, 4.3622954328695815, 0.0, 0.0, 0.0],
    [5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525, 0.0, 0.0],
    [5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383, 0.0],
    [0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774],
    [
        0.003014534158676784,
        -0.0015531644641268323,
        -0.0034780779268492137,
        -0.04479532242331361,
        0.2557691044049442,
        -0.20895707374933137,
    ],
    [
        -0.0015344258113236782,
        0.0005169932978093094,
        0.0015821823673065846,
        0.00043533664844560833,
        -0.0003841888054910146,
        -0.0006158976967468101,
    ],
];

/// Stages of one step.
pub(super) struct Tsit5<const N: usize> {
    slopes: [StageDerivative<N>; STAGES],
    start: [Vector<N>; 2],
    /// Step length, s.
    h: f64,
    /// Increments of q from the beginning to the last two stages, which are at nearly the same time, rad.
    last: [Vector<N>; 2],
}

impl<const N: usize> Tsit5<N> {
    /// Sums of q̇ and q̈ by a row of coefficients.
    #[inline(always)]
    fn sums<const ROW: usize>(&self) -> [Vector<N>; 2] {
        let (mut q, mut v) = (Vector::ZERO, Vector::ZERO);
        macro_rules! add {
            ($stage:literal) => {
                if const { WEIGHTS[ROW][$stage] != 0.0 } {
                    q += const { WEIGHTS[ROW][$stage] } * self.slopes[$stage].q;
                    v += const { WEIGHTS[ROW][$stage] } * self.slopes[$stage].v;
                }
            };
        }
        for_each!(add: 0 1 2 3 4 5);
        [q, v]
    }

    /// Increments of q and q̇ from the beginning of the step by a row of coefficients.
    #[inline(always)]
    fn increment<const ROW: usize>(&self) -> [Vector<N>; 2] {
        self.sums::<ROW>().map(|sum| self.h * sum)
    }

    /// Evaluates the stages of the step in place, which avoids copies of returned values.
    #[inline(never)]
    fn evaluate_all<const M: usize, S: System<N, M>>(&mut self, system: &S, origin: &Origin<S::TrigBase, N>) {
        macro_rules! evaluate {
            ($stage:literal) => {
                let [q, v] = self.increment::<$stage>();
                self.slopes[$stage].q = self.start[1] + v;
                self.slopes[$stage].evaluate_acceleration(system, origin, &q);
                if const { $stage >= STAGES - 2 } {
                    self.last[const { $stage % 2 }] = q;
                }
            };
        }
        for_each!(evaluate: 1 2 3 4 5);
    }

    /// Error estimate in units of the tolerance. The estimate of order 3 is combined with that of order 2, as in DOP853 (Hairer,
    /// Nørsett, Wanner, *Solving Ordinary Differential Equations I*, section II.5, eq. 5.17), so that it falls with the fifth power
    /// of the step.
    #[inline(always)]
    fn error(&self, weights: &ErrorWeights, v_end: &Vector<N>) -> f64 {
        let rates = [&self.start[1], v_end];
        let fine = weights.mean_square(self.sums::<ERROR>(), rates, || self.power::<ERROR>());
        let damped = fine + weights.mean_square(self.sums::<COARSE>(), rates, || self.power::<COARSE>());
        // Both estimates are 0 where nothing moves.
        if damped == 0.0 { 0.0 } else { self.h * fine / damped.sqrt() }
    }

    /// Sum over the power by a row of coefficients, W.
    fn power<const ROW: usize>(&self) -> Work {
        self.slopes.iter().zip(&WEIGHTS[ROW]).fold(Work::default(), |sum, (slope, weight)| sum.plus(*weight, slope.power))
    }
}

impl<const N: usize> Trial<N> for Tsit5<N> {
    const SCHEME: Scheme = Scheme::Tsit5;
    type Linearization = ();
    const CONTROLLER: StepSizeController = StepSizeController {
        exponent: 1.0 / 5.0 - 0.75 * 0.04,
        memory: 0.04,
        accepted: [0.3, 5.0],
        rejected: [0.2, 0.85],
        failed: 0.3,
    };

    fn linearize<const M: usize, S: System<N, M>>(_: &S, _: &Settings, _: (&State<N, M>, &Origin<S::TrigBase, N>)) -> Option<()> {
        Some(())
    }

    #[inline(always)]
    fn new<const M: usize, S: System<N, M>>(_: &S, (): &(), (from, _): (&State<N, M>, &Origin<S::TrigBase, N>), h: f64) -> Self {
        let mut slopes = [StageDerivative::NONE; STAGES];
        slopes[0] = StageDerivative { q: from.v, v: from.a, power: from.power };
        Self { slopes, start: [from.q, from.v], h, last: [Vector::ZERO; 2] }
    }

    fn conclude<const M: usize, S: System<N, M> + Passage<N>>(
        &mut self,
        system: &S,
        settings: &Settings,
        origin: &Origin<S::TrigBase, N>,
        weights: &ErrorWeights,
        energy_target: Option<(EnergyBalance, f64)>,
    ) -> (f64, Option<StepResult<N, M>>) {
        self.evaluate_all(system, origin);
        let increment = self.increment::<END>();
        let end = [self.start[0] + increment[0], self.start[1] + increment[1]];
        let error = self.error(weights, &end[1]);
        if error.is_nan() || error > 1.0 {
            return (error, None);
        }
        let work = match weights.work(settings, system.follows_work(), || Work::default().plus(self.h, self.power::<END>())) {
            Ok(work) => work,
            Err(error) => return (error, None),
        };
        let step_result = settings.project_without_balance(system, (origin, increment[0]), end, energy_target);
        (error, step_result.map(|step_result| StepResult { work, ..step_result }))
    }

    /// Fastest rate from the difference between the last two stages, which are at nearly the same time.
    fn fastest_rate<const M: usize>(&self, _: &State<N, M>) -> f64 {
        let [before, last] = [&self.slopes[STAGES - 2], &self.slopes[STAGES - 1]];
        rate_between([self.last[1] - self.last[0], last.q - before.q, last.v - before.v])
    }

    fn dense<const M: usize>(&mut self, _: &impl System<N, M>, _: f64, ends: [&State<N, M>; 2]) -> [StageDerivative<N>; 4] {
        hermite::coefficients(ends, self.h, HermiteData::Accelerations)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dot(x: &[f64; STAGES], y: &[f64; STAGES]) -> f64 {
        x.iter().zip(y).map(|(x, y)| x * y).sum()
    }

    /// Order conditions of trees with up to three vertices: sums that are 0 for estimates, and 1, 1/2, 1/3, 1/6 for the solution.
    fn conditions(weights: &[f64; STAGES]) -> [f64; 4] {
        let times: [f64; STAGES] = std::array::from_fn(|i| dot(&WEIGHTS[i], &[1.0; STAGES]));
        let squares = times.map(|time| time * time);
        let sums = std::array::from_fn(|i| dot(&WEIGHTS[i], &times));
        [&[1.0; STAGES], &times, &squares, &sums].map(|sums| dot(weights, sums))
    }

    #[test]
    fn estimates_are_of_orders_3_and_2() {
        // Round-off of sums of numbers up to 13, and of numbers below 1.
        let round_off = [2e-14, 1e-16];
        for (sum, exact) in conditions(&WEIGHTS[END]).into_iter().zip([1.0, 1.0 / 2.0, 1.0 / 3.0, 1.0 / 6.0]) {
            assert!((sum - exact).abs() < round_off[0], "{sum} instead of {exact}");
        }
        assert!(conditions(&WEIGHTS[ERROR]).iter().all(|sum| sum.abs() < 10.0 * round_off[1]), "{:?}", conditions(&WEIGHTS[ERROR]));
        let coarse = conditions(&WEIGHTS[COARSE]);
        assert!(coarse[..2].iter().all(|sum| sum.abs() < round_off[1]), "{coarse:?}");
        assert!(coarse[2..].iter().all(|sum| sum.abs() > 1e-4), "{coarse:?}");
    }
}
