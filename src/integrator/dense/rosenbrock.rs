//! Rosenbrock methods: linearly implicit steps for loads so stiff that stability would limit explicit steps. One matrix serves all stages
//! of a step, without iteration.
//!
//! With z = (q, q̇), ż = f(z) and J = ∂f/∂z each stage solves
//!
//! ```text
//! (1/(hγ) − J) uᵢ = f(z₀ + Σ aᵢⱼ uⱼ) + Σ cᵢⱼ/h uⱼ        J = [0 1; K C],  K = ∂q̈/∂q,  C = ∂q̈/∂q̇
//! ```
//!
//! The first row gives u_q = hγ (r_q + u_v), which leaves one equation per coordinate: (1/(hγ) − C − hγ K) u_v = r_v + hγ K r_q.
//!
//! Work is another component of z, with the power P as its rate. Its row P′ of J appears only in products with the u. The end of the step
//! needs only one such product: w = h Σ bᵢ Pᵢ + h P′·Σ bᵢ uᵢ, with bᵢ from the tableau.

mod tableau;

use std::marker::PhantomData;

use super::stiff_metric::StiffMetric;
use super::trial::{ErrorWeights, Origin, StageDerivative, Trial, for_each};
use super::{Scheme, Settings};
use crate::integrator::dense_output::Interpolant;
use crate::integrator::{AccelerationTangents, State, System, Work};
use crate::matrix::{Inverse, combination};
use crate::vector::Vector;
use tableau::{MAX_STAGES, Tableau};
pub(super) use tableau::{Rodas4, Rodas5p};

/// Stages of one step.
pub(super) struct Rosenbrock<T, const N: usize> {
    u: [[Vector<N>; 2]; MAX_STAGES],
    power: [Work; MAX_STAGES],
    start: [Vector<N>; 2],
    /// Step length, s.
    h: f64,
    /// Inverse matrix (1/(hγ) − C − hγ K)⁻¹, s.
    inverse: Inverse<N>,
    /// Fastest rate of the tangents, 1/s.
    fastest_rate: f64,
    tableau: PhantomData<T>,
}

/// Tangents at the beginning of a step, and their fastest rate.
pub(super) struct Linearization<const N: usize> {
    tangents: AccelerationTangents<N>,
    pub(super) fastest_rate: f64,
}

impl<const N: usize> Linearization<N> {
    /// Tangents at a state with its pose. `None` if they are unknown; then no implicit step begins there.
    #[inline(never)]
    pub(super) fn about<const M: usize, S: System<N, M>>(
        system: &S,
        settings: &Settings,
        (from, pose): (&State<N, M>, &S::Pose),
    ) -> Option<Self> {
        let tangents = system.acceleration_tangents(from, pose, settings.regularization)?;
        let size = |columns: &[Vector<N>; N]| columns.iter().map(|column| column.dot(column)).sum::<f64>().sqrt();
        // Larger root of ρ² = ρ |C| + |K|: decay rate of a damper, or frequency of a spring.
        let (stiffness, damping) = (size(&tangents.by_q), size(&tangents.by_v));
        let fastest_rate = 0.5 * (damping + (damping * damping + 4.0 * stiffness).sqrt());
        Some(Self { tangents, fastest_rate })
    }
}

/// Step of the central difference of the power along a direction, relative to the direction. Truncation and round-off are below 1e-9 of the
/// result.
const DIFFERENCE_STEP: f64 = 1e-4;

impl<T: Tableau, const N: usize> Rosenbrock<T, N> {
    /// Computes the stages of a step of `h` seconds.
    pub(super) fn new<const M: usize, S: System<N, M>>(
        system: &S,
        linearization: &Linearization<N>,
        (from, origin): (&State<N, M>, &Origin<'_, S::Pose, N>),
        h: f64,
    ) -> Self {
        let Linearization { tangents, fastest_rate } = linearization;
        let part = h * T::GAMMA;
        let columns = std::array::from_fn(|j| (1.0 / part) * Vector::unit(j) - tangents.by_v[j] - part * tangents.by_q[j]);
        let mut step = Self {
            u: [[Vector::ZERO; 2]; MAX_STAGES],
            power: [from.power; MAX_STAGES],
            start: [from.q, from.v],
            h,
            inverse: Inverse::new(columns, f64::EPSILON / part),
            fastest_rate: *fastest_rate,
            tableau: PhantomData,
        };
        step.u[0] = step.solve(tangents, [from.v, from.a]);
        let per_step = 1.0 / h;
        macro_rules! evaluate {
            ($stage:literal) => {
                if const { $stage < T::STAGES } {
                    let [q, v] = step.at::<$stage>();
                    let mut slope = StageDerivative { q: v, ..StageDerivative::NONE };
                    slope.evaluate_acceleration(system, origin, &(q - from.q));
                    let [before_q, before_v] = step.earlier_stages::<$stage>();
                    step.u[$stage] = step.solve(tangents, [v + per_step * before_q, slope.v + per_step * before_v]);
                    step.power[$stage] = slope.power;
                }
            };
        }
        for_each!(evaluate: 1 2 3 4 5 6 7);
        step
    }

    /// Coordinates and rates of a stage: z₀ + Σ coefficient · u, with a row of [`Tableau::A`].
    fn at<const ROW: usize>(&self) -> [Vector<N>; 2] {
        self.row_sum(self.start, |stage| T::A[ROW][stage])
    }

    /// Contribution Σ coefficient · u of earlier stages to the right-hand side, with a row of [`Tableau::C`].
    fn earlier_stages<const ROW: usize>(&self) -> [Vector<N>; 2] {
        self.row_sum([Vector::ZERO; 2], |stage| T::C[ROW][stage])
    }

    /// Sum from + Σ coefficient · u over the stages; the compiler omits zero coefficients.
    #[inline(always)]
    fn row_sum(&self, [mut q, mut v]: [Vector<N>; 2], coefficient: impl Fn(usize) -> f64) -> [Vector<N>; 2] {
        macro_rules! add {
            ($stage:literal) => {
                if coefficient($stage) != 0.0 {
                    let [u_q, u_v] = &self.u[$stage];
                    q += coefficient($stage) * *u_q;
                    v += coefficient($stage) * *u_v;
                }
            };
        }
        for_each!(add: 0 1 2 3 4 5 6 7);
        [q, v]
    }

    /// Solution u of a stage for its right-hand side.
    fn solve(&self, tangents: &AccelerationTangents<N>, [q, v]: [Vector<N>; 2]) -> [Vector<N>; 2] {
        let part = self.h * T::GAMMA;
        let v = self.inverse.times(&(v + part * combination(&tangents.by_q, &q)));
        [part * (q + v), v]
    }

    /// Work of the step for given weights of the stages, J.
    fn work_by<const M: usize>(&self, system: &impl System<N, M>, weights: &[f64; MAX_STAGES]) -> Work {
        let (mut mean, mut direction) = (Work::default(), [Vector::ZERO; 2]);
        for ((weight, power), u) in weights.iter().zip(&self.power).zip(&self.u) {
            mean = mean.plus(*weight, *power);
            direction = [direction[0] + *weight * u[0], direction[1] + *weight * u[1]];
        }
        let power_at = |part: f64| {
            let [q, v] = [0, 1].map(|i| self.start[i] + part * direction[i]);
            system.forces(&q, &system.pose(&q), &v).1
        };
        let along = power_at(DIFFERENCE_STEP).plus(-1.0, power_at(-DIFFERENCE_STEP));
        Work::default().plus(self.h, mean.plus(0.5 / DIFFERENCE_STEP, along))
    }
}

impl<T: Tableau, const N: usize> Trial<N> for Rosenbrock<T, N> {
    const SCHEME: Scheme = T::SCHEME;

    fn complete<const M: usize, S: System<N, M>>(
        &mut self,
        system: &S,
        _: &Origin<'_, S::Pose, N>,
        weights: &ErrorWeights,
    ) -> (f64, [Vector<N>; 2]) {
        let end = self.at::<MAX_STAGES>();
        let judged = if weights.work.is_some() { self.work_by(system, const { &T::QUADRATURE_ERROR }) } else { Work::default() };
        (weights.mean_square(self.u[T::STAGES - 1], [&self.start[1], &end[1]], || judged).sqrt(), end)
    }

    fn work<const M: usize>(&self, system: &impl System<N, M>) -> Work {
        self.work_by(system, const { &T::QUADRATURE })
    }

    fn stiff_metric(&self) -> Option<StiffMetric<'_, N>> {
        Some(StiffMetric { inverse: &self.inverse, h: self.h })
    }

    fn fastest_rate<const M: usize>(&self, _: &State<N, M>) -> f64 {
        self.fastest_rate
    }

    fn dense<const M: usize>(&self, _: &impl System<N, M>, _: f64, ends: [&State<N, M>; 2]) -> [StageDerivative<N>; 4] {
        let mut middle = [0.5 * (ends[0].q + ends[1].q), 0.5 * (ends[0].v + ends[1].v)];
        for (weight, u) in const { T::MIDDLE }.iter().zip(&self.u) {
            middle = [middle[0] + *weight * u[0], middle[1] + *weight * u[1]];
        }
        let ([from, to], h) = (ends, self.h);
        let middle = [middle[0], h * middle[1]];
        StageDerivative::of_positions(Interpolant::through_middle([from.q, to.q], [h * from.v, h * to.v], middle))
    }
}
