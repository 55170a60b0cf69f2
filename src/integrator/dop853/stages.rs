//! The stages of one step, and what is summed from them.

use borsh::{BorshDeserialize, BorshSerialize};

use super::tableau::{A, ALL, DENSE, END, ERROR_3, ERROR_5, Row, STAGES};
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

    #[inline(always)]
    fn at<const M: usize, S: System<N, M>>(system: &S, regularization: f64, q: &Vector<N>, v: &Vector<N>) -> Self {
        let pose = system.pose(q);
        let (forces, power) = system.forces_and_power(q, &pose, v);
        let (a, _) = equilibrium_under(system, &forces, (q, &pose, v), &system.factor_mass(&pose, regularization));
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
}

impl<const N: usize> Stages<N> {
    /// All stages of a step of h seconds.
    #[inline(never)]
    pub(super) fn new<const M: usize>(system: &impl System<N, M>, regularization: f64, from: &State<N, M>, h: f64) -> Self {
        let mut stages = Self { slopes: [Slope::NONE; ALL], q: from.q, v: from.v, h, last: from.q };
        stages.slopes[0] = Slope { q: from.v, v: from.a, power: from.power };
        for (stage, row) in A.iter().enumerate().take(STAGES).skip(1) {
            let [q, v] = stages.at(row);
            stages.slopes[stage] = Slope::at(system, regularization, &q, &v);
            stages.last = q;
        }
        stages
    }

    /// Σ coefficient · slope over q and q̇.
    #[inline(always)]
    fn sum(&self, row: Row) -> [Vector<N>; 2] {
        let (mut q, mut v) = (Vector::ZERO, Vector::ZERO);
        for &(stage, coefficient) in row {
            // The remainder changes nothing and is cheaper than a check.
            let slope = &self.slopes[stage % ALL];
            q += coefficient * slope.q;
            v += coefficient * slope.v;
        }
        [q, v]
    }

    /// The same over the power.
    fn power(&self, row: Row) -> Work {
        row.iter().fold(Work::default(), |sum, &(stage, coefficient)| sum.plus(coefficient, self.slopes[stage].power))
    }

    /// q and q̇ at the place of a row.
    #[inline(always)]
    fn at(&self, row: Row) -> [Vector<N>; 2] {
        let [q, v] = self.sum(row);
        [self.q + self.h * q, self.v + self.h * v]
    }

    /// q and q̇ at the end of the step, of order 8.
    #[inline(always)]
    pub(super) fn end(&self) -> [Vector<N>; 2] {
        self.at(A[END])
    }

    /// Mean power over the step, of order 8.
    pub(super) fn mean_power(&self) -> Work {
        self.power(A[END])
    }

    /// Estimated error in units of what is allowed: of the coordinates, of their rates (10/s + |q̇| times that) and of the work; root of
    /// the mean square. The estimate of order 5 is damped by that of order 3 (Hairer, Nørsett, Wanner, section II.5, eq. 5.17).
    #[inline(always)]
    pub(super) fn error(&self, allowed: &Allowed, v_end: &Vector<N>) -> f64 {
        let norm = |row: Row| {
            let [q, v] = self.sum(row);
            let mut sum = 0.0;
            for i in 0..N {
                let rate = v[i] / (RATE + self.v[i].abs().max(v_end[i].abs()));
                sum += q[i] * q[i] + rate * rate;
            }
            let mean = sum / (2.0 * N as f64 * allowed.coordinate * allowed.coordinate);
            let Some(work) = allowed.work else { return mean };
            let Work { input, dissipated } = self.power(row);
            mean + (input * input + dissipated * dissipated) / (work * work)
        };
        let (fifth, third) = (norm(ERROR_5), norm(ERROR_3));
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
        for (stage, row) in A.iter().enumerate().skip(END + 1) {
            let [q, v] = self.at(row);
            self.slopes[stage] = Slope::at(system, regularization, &q, &v);
        }
        DENSE.map(|row| {
            let [q, v] = self.sum(row);
            let power = if system.follows_work() { self.power(row) } else { Work::default() };
            Slope { q: self.h * q, v: self.h * v, power: Work::default().plus(self.h, power) }
        })
    }
}
