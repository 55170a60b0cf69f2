//! Tsit5, an explicit method of order 5 with six evaluations: for inputs that are held so shortly that no more is needed.
//!
//! Ch. Tsitouras, *Runge–Kutta pairs of order 5(4) satisfying only the first column simplifying assumption*, Computers and Mathematics
//! with Applications 62 (2011). The error estimate takes the derivative at the end of the step, on the constraints, which the next step
//! needs anyway.

use super::hermite::{self, Knowing};
use super::trial::{Allowed, Landing, Slope, Trial, extremes_of, for_each, rate_between};
use super::{Kind, Settings};
use crate::integrator::controller::StepSizeController;
use crate::integrator::{EnergyBalance, Passage, State, StepError, System, Work};
use crate::vector::Vector;

/// Stages of a step, and the place of its end.
const STAGES: usize = 6;

/// Where each stage is evaluated; the last row is the end of the step.
const AT: [[f64; STAGES]; STAGES + 1] = [
    [0.0; STAGES],
    [0.161, 0.0, 0.0, 0.0, 0.0, 0.0],
    [-0.008480655492356989, 0.335480655492357, 0.0, 0.0, 0.0, 0.0],
    [2.8971530571054935, -6.359448489975075, 4.3622954328695815, 0.0, 0.0, 0.0],
    [5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525, 0.0, 0.0],
    [5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383, 0.0],
    [0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081, 2.324710524099774],
];

/// The embedded value of order 4 minus the new one, by stages and the derivative at the end.
const ERROR: [f64; STAGES + 1] = [
    -0.001780011052225777,
    -0.0008164344596567469,
    0.007880878010261995,
    -0.1447110071732629,
    0.5823571654525552,
    -0.45808210592918697,
    1.0 / 66.0,
];

/// A step from a state, stage by stage.
pub(super) struct Tsit5<const N: usize> {
    slopes: [Slope<N>; STAGES],
    start: [Vector<N>; 2],
    /// The step, s.
    h: f64,
    /// Where the last stage is evaluated, at the end of the step as well.
    last: Vector<N>,
}

impl<const N: usize> Tsit5<N> {
    /// q and q̇ at the place of a row.
    #[inline(always)]
    fn at<const ROW: usize>(&self) -> [Vector<N>; 2] {
        let (mut q, mut v) = (Vector::ZERO, Vector::ZERO);
        macro_rules! add {
            ($stage:literal) => {
                if const { AT[ROW][$stage] != 0.0 } {
                    q += const { AT[ROW][$stage] } * self.slopes[$stage].q;
                    v += const { AT[ROW][$stage] } * self.slopes[$stage].v;
                }
            };
        }
        for_each!(add: 0 1 2 3 4 5);
        [self.start[0] + self.h * q, self.start[1] + self.h * v]
    }

    /// Mean power by some weights of the stages.
    fn power(&self, weights: &[f64; STAGES]) -> Work {
        self.slopes.iter().zip(weights).fold(Work::default(), |sum, (slope, weight)| sum.plus(*weight, slope.power))
    }
}

impl<const N: usize> Trial<N> for Tsit5<N> {
    const KIND: Kind = Kind::Fifth;
    type Shared = ();
    const CONTROLLER: StepSizeController = StepSizeController {
        exponent: 1.0 / 5.0 - 0.75 * 0.04,
        memory: 0.04,
        accepted: [0.3, 5.0],
        rejected: [0.2, 0.85],
        failed: 0.3,
    };

    fn prepare<const M: usize>(_: &impl System<N, M>, _: &Settings, _: &State<N, M>) -> Option<()> {
        Some(())
    }

    #[inline(never)]
    fn new<const M: usize>(system: &impl System<N, M>, (): &(), regularization: f64, from: &State<N, M>, h: f64) -> Self {
        let mut step = Self { slopes: [Slope::NONE; STAGES], start: [from.q, from.v], h, last: from.q };
        step.slopes[0] = Slope { q: from.v, v: from.a, power: from.power };
        macro_rules! evaluate {
            ($stage:literal) => {
                let [q, v] = step.at::<$stage>();
                step.slopes[$stage] = Slope::at(system, regularization, &q, &v);
                step.last = q;
            };
        }
        for_each!(evaluate: 1 2 3 4 5);
        step
    }

    fn land<const M: usize, S: System<N, M> + Passage<N>>(
        &mut self,
        system: &S,
        settings: &Settings,
        allowed: &Allowed,
        kept: Option<(EnergyBalance, f64)>,
    ) -> (f64, Result<Landing<N, M>, StepError>) {
        let end = self.at::<STAGES>();
        let (iterations, arrival) = match settings.project_and_evaluate(system, end, kept) {
            Ok(landed) => landed,
            Err(cause) => return (f64::NAN, Err(cause)),
        };
        let [mut q, mut v] = [arrival.v, arrival.a].map(|slope| ERROR[STAGES] * slope);
        for (slope, weight) in self.slopes.iter().zip(&ERROR) {
            q += *weight * slope.q;
            v += *weight * slope.v;
        }
        let work = || {
            let mut weights = [0.0; STAGES];
            weights.copy_from_slice(&ERROR[..STAGES]);
            self.power(&weights).plus(ERROR[STAGES], arrival.power)
        };
        let error = self.h * allowed.mean_square([q, v], [&self.start[1], &end[1]], work).sqrt();
        if error.is_nan() || error > 1.0 {
            return (error, Err(StepError::NotFinite));
        }
        let follows = system.follows_work();
        let work = if follows { Work::default().plus(self.h, self.power(&AT[STAGES])) } else { Work::default() };
        (error, Ok(Landing { iterations, arrival, work }))
    }

    fn extremes(&self) -> [Vector<N>; 2] {
        extremes_of(&self.slopes)
    }

    /// By the difference between the last stage and the end of the step, which stand at the same time.
    fn fastest_rate<const M: usize>(&self, end: &State<N, M>) -> f64 {
        let last = &self.slopes[STAGES - 1];
        rate_between([end.q - self.last, end.v - last.q, end.a - last.v])
    }

    fn dense<const M: usize>(&mut self, _: &impl System<N, M>, _: f64, ends: [&State<N, M>; 2]) -> [Slope<N>; 4] {
        hermite::coefficients(ends, self.h, Knowing::Accelerations)
    }
}
