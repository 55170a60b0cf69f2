//! DOP853, the explicit method of order 8 of Dormand and Prince: the stages of one step, and what is summed from them.
//!
//! E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, 2nd ed., sections II.5 and II.6.

mod tableau;

use super::trial::{Allowed, Landing, Slope, Trial, extremes_of, for_each, rate_between};
use super::{Kind, Settings};
use crate::integrator::controller::StepSizeController;
use crate::integrator::{EnergyBalance, Passage, State, StepError, System, Work};
use crate::vector::Vector;
use tableau::{ALL, AT_DENSE, AT_ERROR_3, AT_ERROR_5, COEFFICIENTS, END, STAGES};

/// A step from a state, stage by stage.
pub(super) struct Stages<const N: usize> {
    slopes: [Slope<N>; ALL],
    q: Vector<N>,
    v: Vector<N>,
    /// The step, s.
    h: f64,
    /// Where the last stage is evaluated: at the end of the step as well, but of lower order.
    last: Vector<N>,
    /// q and q̇ at the end of the step, of order 8.
    end: [Vector<N>; 2],
}

impl<const N: usize> Stages<N> {
    /// Σ coefficient · slope over what is picked of the slopes.
    #[inline(always)]
    fn sum<const ROW: usize>(&self, part: impl Fn(&Slope<N>) -> Vector<N>) -> Vector<N> {
        let mut sum = Vector::ZERO;
        macro_rules! add {
            ($stage:literal) => {
                if const { COEFFICIENTS[ROW][$stage] != 0.0 } {
                    sum += const { COEFFICIENTS[ROW][$stage] } * part(&self.slopes[$stage]);
                }
            };
        }
        for_each!(add: 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15);
        sum
    }

    /// The same over q and q̇.
    #[inline(always)]
    fn sums<const ROW: usize>(&self) -> [Vector<N>; 2] {
        [self.sum::<ROW>(|slope| slope.q), self.sum::<ROW>(|slope| slope.v)]
    }

    /// The same over the power.
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
        for_each!(add: 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15);
        power
    }

    /// q and q̇ at the place of a row.
    #[inline(always)]
    fn at<const ROW: usize>(&self) -> [Vector<N>; 2] {
        [self.place::<ROW>(), self.rate::<ROW>()]
    }

    /// q there: what the accelerations of the stage before are does not matter.
    #[inline(always)]
    fn place<const ROW: usize>(&self) -> Vector<N> {
        self.q + self.h * self.sum::<ROW>(|slope| slope.q)
    }

    /// q̇ there.
    #[inline(always)]
    fn rate<const ROW: usize>(&self) -> Vector<N> {
        self.v + self.h * self.sum::<ROW>(|slope| slope.v)
    }

    /// Mean power over the step, of order 8.
    fn mean_power(&self) -> Work {
        self.power::<END>()
    }

    /// Estimated error in units of what is allowed: of the coordinates, of their rates (10/s + |q̇| times that) and of the work; root of
    /// the mean square. The estimate of order 5 is damped by that of order 3 (Hairer, Nørsett, Wanner, section II.5, eq. 5.17).
    #[inline(always)]
    fn error(&self, allowed: &Allowed, v_end: &Vector<N>) -> f64 {
        let rates = [&self.v, v_end];
        let fifth = allowed.mean_square(self.sums::<AT_ERROR_5>(), rates, || self.power::<AT_ERROR_5>());
        let third = allowed.mean_square(self.sums::<AT_ERROR_3>(), rates, || self.power::<AT_ERROR_3>());
        let damped = fifth + 0.01 * third;
        // Both are 0 where nothing moves.
        if damped == 0.0 { 0.0 } else { self.h * fifth / damped.sqrt() }
    }

    /// One of them.
    fn coefficient<const ROW: usize>(&self, follows_work: bool) -> Slope<N> {
        let [q, v] = self.sums::<ROW>();
        let power = if follows_work { self.power::<ROW>() } else { Work::default() };
        Slope { q: self.h * q, v: self.h * v, power: Work::default().plus(self.h, power) }
    }
}

impl<const N: usize> Trial<N> for Stages<N> {
    const KIND: Kind = Kind::Eighth;
    type Shared = ();
    /// With the memory and growth by 3 at most a quarter of the rejections of the classical controller remain.
    const CONTROLLER: StepSizeController = StepSizeController {
        exponent: 1.0 / 8.0 - 0.75 * 0.02,
        memory: 0.02,
        accepted: [0.3, 3.0],
        rejected: [0.3, 0.85],
        failed: 0.3,
    };

    fn prepare<const M: usize>(_: &impl System<N, M>, _: &Settings, _: &State<N, M>) -> Option<()> {
        Some(())
    }

    #[inline(never)]
    fn new<const M: usize>(system: &impl System<N, M>, (): &(), regularization: f64, from: &State<N, M>, h: f64) -> Self {
        let mut stages = Self { slopes: [Slope::NONE; ALL], q: from.q, v: from.v, h, last: from.q, end: [from.q, from.v] };
        stages.slopes[0] = Slope { q: from.v, v: from.a, power: from.power };
        macro_rules! evaluate {
            ($stage:literal) => {
                let [q, v] = stages.at::<$stage>();
                stages.slopes[$stage] = Slope::at(system, regularization, &q, &v);
                stages.last = q;
            };
        }
        for_each!(evaluate: 1 2 3 4 5 6 7 8 9 10 11);
        stages.end = stages.at::<END>();
        stages
    }

    #[inline(always)]
    fn land<const M: usize, S: System<N, M> + Passage<N>>(
        &mut self,
        system: &S,
        settings: &Settings,
        allowed: &Allowed,
        kept: Option<(EnergyBalance, f64)>,
    ) -> (f64, Result<Landing<N, M>, StepError>) {
        let end = self.end;
        let error = self.error(allowed, &end[1]);
        let arrival = if error <= 1.0 { settings.project_and_evaluate(system, end, kept) } else { Err(StepError::NotFinite) };
        let land = |(iterations, arrival)| {
            let work = if system.follows_work() { Work::default().plus(self.h, self.mean_power()) } else { Work::default() };
            Landing { iterations, arrival, work }
        };
        (error, arrival.map(land))
    }

    fn extremes(&self) -> [Vector<N>; 2] {
        extremes_of(&self.slopes[..STAGES])
    }

    /// By the difference between the last stage and the end of the step, which stand at the same time.
    fn fastest_rate<const M: usize>(&self, end: &State<N, M>) -> f64 {
        let last = &self.slopes[STAGES - 1];
        rate_between([end.q - self.last, end.v - last.q, end.a - last.v])
    }

    /// Three more stages, after the derivatives at the end of the step.
    #[cold]
    fn dense<const M: usize>(
        &mut self,
        system: &impl System<N, M>,
        regularization: f64,
        [_, end]: [&State<N, M>; 2],
    ) -> [Slope<N>; 4] {
        self.slopes[END] = Slope { q: end.v, v: end.a, power: end.power };
        macro_rules! evaluate {
            ($stage:literal) => {
                let [q, v] = self.at::<$stage>();
                self.slopes[$stage] = Slope::at(system, regularization, &q, &v);
            };
        }
        for_each!(evaluate: 13 14 15);
        let follows_work = system.follows_work();
        [
            self.coefficient::<AT_DENSE>(follows_work),
            self.coefficient::<{ AT_DENSE + 1 }>(follows_work),
            self.coefficient::<{ AT_DENSE + 2 }>(follows_work),
            self.coefficient::<{ AT_DENSE + 3 }>(follows_work),
        ]
    }
}
