//! The stages of one step, and what is summed from them.

use borsh::{BorshDeserialize, BorshSerialize};

use super::tableau::{ALL, AT_DENSE, AT_ERROR_3, AT_ERROR_5, COEFFICIENTS, END, STAGES};
use crate::integrator::equilibrium::equilibrium_under;
use crate::integrator::{State, System, Work};
use crate::vector::Vector;

/// The derivatives of q, q̇ and the work, or a sum of such.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Slope<const N: usize> {
    pub(super) q: Vector<N>,
    pub(super) v: Vector<N>,
    pub(super) power: Work,
}

impl<const N: usize> Slope<N> {
    pub(super) const NONE: Self = Self { q: Vector::ZERO, v: Vector::ZERO, power: Work { input: 0.0, dissipated: 0.0 } };

    /// One piece of code for all stages: written out for each of them it would not fit into what a processor keeps decoded.
    #[inline(never)]
    fn at<const M: usize, S: System<N, M>>(system: &S, regularization: f64, q: &Vector<N>, v: &Vector<N>) -> Self {
        let pose = &system.pose(q);
        let (forces, power) = system.forces_and_power(q, pose, v);
        let (a, _) = equilibrium_under(system, &forces, (q, pose, v), &system.factor_mass(pose, regularization));
        Self { q: *v, v: a, power }
    }
}

/// What the local error of a step may be.
pub(super) struct Allowed {
    /// Of a coordinate.
    pub(super) coordinate: f64,
    /// Of the work, J, where it is judged.
    pub(super) work: Option<f64>,
}

/// A rate may be off by what a coordinate may, times this and its own magnitude, 1/s.
pub(super) const RATE: f64 = 10.0;

/// A step from a state, stage by stage.
pub(super) struct Stages<const N: usize> {
    slopes: [Slope<N>; ALL],
    q: Vector<N>,
    v: Vector<N>,
    /// The step, s.
    pub(super) h: f64,
    /// Where the last stage is evaluated: at the end of the step as well, but of lower order.
    last: Vector<N>,
    /// q and q̇ at the end of the step, of order 8.
    pub(super) end: [Vector<N>; 2],
}

/// Does something for each stage, without a loop at run time: stages and their coefficients are constants.
macro_rules! for_each {
    ($do:ident: $($stage:literal)*) => {
        $($do!($stage);)*
    };
}

impl<const N: usize> Stages<N> {
    /// All stages of a step of h seconds.
    #[inline(never)]
    pub(super) fn new<const M: usize>(system: &impl System<N, M>, regularization: f64, from: &State<N, M>, h: f64) -> Self {
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
    pub(super) fn mean_power(&self) -> Work {
        self.power::<END>()
    }

    /// Estimated error in units of what is allowed: of the coordinates, of their rates (10/s + |q̇| times that) and of the work; root of
    /// the mean square. The estimate of order 5 is damped by that of order 3 (Hairer, Nørsett, Wanner, section II.5, eq. 5.17).
    #[inline(always)]
    pub(super) fn error(&self, allowed: &Allowed, v_end: &Vector<N>) -> f64 {
        let rates = Vector::<N>::from_fn(|i| 1.0 / (RATE + self.v[i].abs().max(v_end[i].abs())));
        let scale = 1.0 / (2.0 * N as f64 * allowed.coordinate * allowed.coordinate);
        let norm = |[q, v]: [Vector<N>; 2], power: Option<Work>| {
            let v = Vector::<N>::from_fn(|i| v[i] * rates[i]);
            let mean = (q.dot(&q) + v.dot(&v)) * scale;
            let Some((work, Work { input, dissipated })) = allowed.work.zip(power) else { return mean };
            mean + (input * input + dissipated * dissipated) / (work * work)
        };
        let fifth = norm(self.sums::<AT_ERROR_5>(), allowed.work.map(|_| self.power::<AT_ERROR_5>()));
        let third = norm(self.sums::<AT_ERROR_3>(), allowed.work.map(|_| self.power::<AT_ERROR_3>()));
        let damped = fifth + 0.01 * third;
        // Both are 0 where nothing moves.
        if damped == 0.0 { 0.0 } else { self.h * fifth / damped.sqrt() }
    }

    /// The greatest magnitudes of q̇ and q̈ that the stages have seen.
    pub(super) fn extremes(&self) -> [Vector<N>; 2] {
        let mut extremes = [Vector::ZERO; 2];
        for slope in &self.slopes[..STAGES] {
            extremes =
                [(extremes[0], slope.q), (extremes[1], slope.v)].map(|(most, x)| Vector::from_fn(|i| most[i].max(x[i].abs())));
        }
        extremes
    }

    /// The fastest rate of change, 1/s, that the difference between the last stage and the end of the step shows: the r of
    /// r² |Δq| + r |Δq̇| = |Δq̈|, which is the frequency of a spring and the decay of a damper.
    pub(super) fn fastest_rate<const M: usize>(&self, end: &State<N, M>) -> f64 {
        let last = &self.slopes[STAGES - 1];
        let (dq, dv, da) = ((end.q - self.last).norm(), (end.v - last.q).norm(), (end.a - last.v).norm());
        let both = dv + (dv * dv + 4.0 * dq * da).sqrt();
        if both > 0.0 { 2.0 * da / both } else { 0.0 }
    }

    /// The higher coefficients of the dense output: three more stages, after the derivatives at the end of the step.
    #[cold]
    pub(super) fn dense<const M: usize>(
        &mut self,
        system: &impl System<N, M>,
        regularization: f64,
        end: &State<N, M>,
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

    /// One of them.
    fn coefficient<const ROW: usize>(&self, follows_work: bool) -> Slope<N> {
        let [q, v] = self.sums::<ROW>();
        let power = if follows_work { self.power::<ROW>() } else { Work::default() };
        Slope { q: self.h * q, v: self.h * v, power: Work::default().plus(self.h, power) }
    }
}
