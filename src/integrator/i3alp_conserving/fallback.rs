//! Fallback stages for a conserving step that plain Newton iteration does not solve: homotopies to the same root, at the full step length.
//!
//! | stage | method |
//! | --- | --- |
//! | 1 | full tangent, from the first guess by equilibrium at the beginning |
//! | 2 | homotopy in the law of friction and servos: softened, then hardened again |
//! | 3 | homotopy in the step length: roots at h/8, 2h/8, … h |
//! | 4 | smaller regularisation e |
//! | 5 | homotopies in the step length with smaller e, and with more stages |
//! | 6 | first guess from the end of two to sixteen shorter steps |
//! | last | no root, close to vertices: end from rates or equilibrium, projected, with its velocity scaled to the energy |
//!
//! With `max_work` = 0 the first stage is the only one.

use super::Settings;
use super::newton::{IterationBudget, NewtonLimits, ResidualBounds, StopRule, full_newton};
use crate::integrator::{CutStep, Discrete, Passage, Projection, StepError, StepIncrement, velocity_correction};
use crate::vector::Vector;

/// Largest factor on the regularisation rates of friction. The softest law's root is found from the first guess by equilibrium.
const LARGEST_SOFTENING: f64 = 1e7;
/// Smallest and largest factor by which the regularisation rates fall from one root to the next.
const HARDENING_FACTORS: [f64; 2] = [1.05, 30.0];
/// Smaller regularisations to try, relative to e.
const SMALLER_REGULARIZATIONS: [f64; 2] = [1e-5, 1e-7];
/// Further homotopies in the step length: number of stages, and regularisation relative to e.
const FINER_CONTINUATIONS: [(u32, f64); 4] = [(8, 1e-5), (32, 1.0), (32, 1e-5), (128, 1e-5)];
/// Numbers of shorter steps; their end is tried as a first guess.
const SHORTER_STEP_COUNTS: [u32; 4] = [2, 4, 8, 16];
/// Limits for a root of the step itself.
const TO_ROOT: NewtonLimits = NewtonLimits { iterations: 10, stop_rule: StopRule::Solved };
/// Limits for the intermediate roots of a homotopy.
const TO_INTERMEDIATE_ROOT: NewtonLimits = NewtonLimits { iterations: 10, stop_rule: StopRule::Corrected(1e-8) };
/// Largest number of iterations per softening.
const SOFTENED_ITERATIONS: u32 = 15;
/// Largest number of iterations of a projection in the energy-only stage.
const MOST_PROJECTIONS: u32 = 30;
/// Factor that shortens the increment of the energy-only stage if projection or energy fails.
const SHORTENING: f64 = 0.25;
/// Largest number of such shortenings.
const MOST_SHORTENINGS: i32 = 20;
/// Regularisation of projections in the energy-only stage, relative to e: S is nearly singular close to a vertex.
const VERTEX_REGULARIZATION: f64 = 1e-4;
/// Admissible velocity violation in the energy-only stage, relative to the velocity times the system's size.
const RATE_VIOLATION: f64 = 64.0 * f64::EPSILON;

/// A step: its beginning and its length.
pub(super) struct Step<'a, S: Discrete<N, M, K>, const N: usize, const M: usize, const K: usize> {
    pub(super) system: &'a S,
    /// Coordinates q₀, m and rad.
    pub(super) q: Vector<N>,
    /// Velocities q̇₀, m/s and rad/s.
    pub(super) v: Vector<N>,
    /// Pose at q₀.
    pose: S::Pose,
    /// Length, s.
    pub(super) h: f64,
}

/// End of a step.
pub(super) struct ConservingEnd<S, const N: usize, const K: usize> {
    /// Unknowns with the loops cut; `None` if no root was found and the end only conserves the energy.
    pub(super) x: Option<Vector<K>>,
    /// Increment d = q₁ − q₀, m and rad.
    pub(super) d: Vector<N>,
    /// Velocity at which the forces acted, m/s and rad/s; for a root it is the velocity at the end.
    pub(super) acting: Vector<N>,
    /// Velocity q̇₁ at the end, m/s and rad/s.
    pub(super) v: Vector<N>,
    /// Discrete derivatives at d.
    pub(super) secant: S,
}

/// Increment of a step of `h` seconds with constant acceleration.
fn increment<const N: usize>(v: &Vector<N>, a: &Vector<N>, h: f64) -> Vector<N> {
    h * (*v + (0.5 * h) * *a)
}

/// Accelerations q̈ and multipliers λ in equilibrium at the beginning of a step.
#[derive(Clone, Copy)]
pub(super) struct Rest<'a, const N: usize, const M: usize> {
    pub(super) a: &'a Vector<N>,
    pub(super) lambda: &'a Vector<M>,
}

/// First guess of the unknowns for a step of `h` seconds, from q̈ and λ in equilibrium at its beginning.
pub(super) fn from_equilibrium<const N: usize, const M: usize, const K: usize, S: Discrete<N, M, K>>(
    v: &Vector<N>,
    Rest { a, lambda }: Rest<'_, N, M>,
    h: f64,
) -> Vector<K> {
    <S::Cut<'_>>::unknowns_of(&increment(v, a, h), &((0.5 * h * h) * *lambda))
}

impl<'a, S, const N: usize, const M: usize, const K: usize> Step<'a, S, N, M, K>
where
    S: Discrete<N, M, K>,
{
    /// Step of `h` seconds from q₀ and q̇₀.
    pub(super) fn new(system: &'a S, [q, v]: [&Vector<N>; 2], h: f64) -> Self {
        Self { system, q: *q, v: *v, pose: system.pose(q), h }
    }

    /// Increment of the step in the form that forces are evaluated on.
    pub(super) fn increment<'b>(&'b self, secant: &'b S::Secant, [d, v]: [&'b Vector<N>; 2]) -> StepIncrement<'b, S::Secant, N> {
        StepIncrement { q: &self.q, d, v, h: self.h, softening: 1.0, secant }
    }

    /// Root of the equations for a length `h`, s, and softened laws, by full Newton iteration. `x` is the first guess and becomes the
    /// unknowns of the root.
    pub(super) fn root(
        &self,
        h: f64,
        softening: f64,
        x: &mut Vector<K>,
        regularization: f64,
        limits: NewtonLimits,
        budget: &mut IterationBudget<'_>,
    ) -> Option<ConservingEnd<S::Secant, N, K>> {
        let cut = self.system.cut(&self.pose, [&self.q, &self.v], h, softening);
        let motion = full_newton(&cut, x, &ResidualBounds::new(self.system, h), regularization, limits, budget)?;
        let [d, v] = cut.end(&motion);
        Some(ConservingEnd { x: Some(*x), d, acting: v, v, secant: *<S::Cut<'_>>::secant(&motion) })
    }

    /// Root from the first of the stages 1 to 6 that finds one.
    fn by_stages(
        &self,
        settings: &Settings,
        rest: Rest<'_, N, M>,
        budget: &mut IterationBudget<'_>,
    ) -> Option<ConservingEnd<S::Secant, N, K>> {
        let with = |part: f64| part * settings.regularization;
        let start = from_equilibrium::<N, M, K, S>(&self.v, rest, self.h);
        let by_full_newton =
            |part: f64, budget: &mut IterationBudget<'_>| self.root(self.h, 1.0, &mut { start }, with(part), TO_ROOT, budget);
        if let Some(root) = by_full_newton(1.0, budget) {
            return Some(root);
        }
        if settings.max_work == 0 {
            return None;
        }
        budget.counters.rescued += 1;
        (!self.system.is_conservative())
            .then(|| self.harden_friction(start, with(1.0), budget))
            .flatten()
            .or_else(|| self.continue_in_step_length(with(1.0), rest, 8, budget))
            .or_else(|| SMALLER_REGULARIZATIONS.into_iter().find_map(|part| by_full_newton(part, budget)))
            .or_else(|| {
                FINER_CONTINUATIONS
                    .into_iter()
                    .find_map(|(stages, part)| self.continue_in_step_length(with(part), rest, stages, budget))
            })
            .or_else(|| {
                SHORTER_STEP_COUNTS
                    .into_iter()
                    .find_map(|parts| self.by_shorter_steps(with(SMALLER_REGULARIZATIONS[0]), rest, parts, budget))
            })
    }

    /// Stage 6: first guess from `parts` shorter steps, which may lead to another root than a homotopy that ends in a fold.
    fn by_shorter_steps(
        &self,
        regularization: f64,
        rest: Rest<'_, N, M>,
        parts: u32,
        budget: &mut IterationBudget<'_>,
    ) -> Option<ConservingEnd<S::Secant, N, K>> {
        let h = self.h / f64::from(parts);
        let mut x = from_equilibrium::<N, M, K, S>(&self.v, rest, h);
        let (mut q, mut v, mut mean) = (self.q, self.v, Vector::ZERO);
        for _ in 0..parts {
            let end = Step::new(self.system, [&q, &v], h).root(h, 1.0, &mut x, regularization, TO_ROOT, budget)?;
            (q, v) = (q + end.d, end.v);
            mean += x / f64::from(parts);
        }
        let mut x = <S::Cut<'_>>::lengthened(&mean, f64::from(parts));
        self.root(self.h, 1.0, &mut x, regularization, TO_ROOT, budget)
    }

    /// Stage 2: with softened friction a root is easy to find; from there the law is hardened in steps.
    fn harden_friction(
        &self,
        mut x: Vector<K>,
        regularization: f64,
        budget: &mut IterationBudget<'_>,
    ) -> Option<ConservingEnd<S::Secant, N, K>> {
        let [least, most] = HARDENING_FACTORS;
        let to_intermediate_root = TO_INTERMEDIATE_ROOT.stop_rule;
        let mut root = |softening: f64, x: &mut Vector<K>, stop_rule| {
            let limits = NewtonLimits { iterations: SOFTENED_ITERATIONS, stop_rule };
            self.root(self.h, softening, x, regularization, limits, budget)
        };
        root(LARGEST_SOFTENING, &mut x, to_intermediate_root)?;
        let (mut softening, mut ratio) = (LARGEST_SOFTENING, most);
        while ratio > least {
            let next = (softening / ratio).max(1.0);
            let stop_rule = if next > 1.0 { to_intermediate_root } else { StopRule::Solved };
            let mut there = x;
            match root(next, &mut there, stop_rule) {
                Some(root) if next == 1.0 => return Some(root),
                Some(_) => (softening, x) = (next, there),
                None => ratio = ratio.sqrt(),
            }
        }
        None
    }

    /// Stages 3 and 5: continues the root from a step of h/stages to a step of h.
    fn continue_in_step_length(
        &self,
        regularization: f64,
        rest: Rest<'_, N, M>,
        stages: u32,
        budget: &mut IterationBudget<'_>,
    ) -> Option<ConservingEnd<S::Secant, N, K>> {
        let (mut before, mut x, mut end) = (Vector::ZERO, Vector::ZERO, None);
        for stage in 1..=stages {
            let h = self.h * f64::from(stage) / f64::from(stages);
            let next = match stage {
                1 => from_equilibrium::<N, M, K, S>(&self.v, rest, h),
                2 => <S::Cut<'_>>::lengthened(&x, 2.0),
                _ => 2.0 * x - before,
            };
            (before, x) = (x, next);
            let limits = if stage < stages { TO_INTERMEDIATE_ROOT } else { TO_ROOT };
            end = Some(self.root(h, 1.0, &mut x, regularization, limits, budget)?);
        }
        end
    }
}

impl<S, const N: usize, const M: usize, const K: usize> Step<'_, S, N, M, K>
where
    S: Discrete<N, M, K> + Passage<N>,
{
    /// Returns the end of the step by stages 1 to 6 or, if they find no root, by the last stage. Fails if no stage succeeds.
    pub(super) fn recover(
        &self,
        settings: &Settings,
        rest: Rest<'_, N, M>,
        budget: &mut IterationBudget<'_>,
    ) -> Result<ConservingEnd<S::Secant, N, K>, StepError> {
        match self.by_stages(settings, rest, budget) {
            Some(root) => Ok(root),
            None if settings.max_work == 0 => Err(StepError::NoRootWithin { iterations: budget.spent() }),
            None => self.keep_energy_only(settings, rest.a, budget),
        }
    }

    /// Last stage: an increment from rates or equilibrium, shortened if necessary, is projected onto the position constraints. Its mean
    /// velocity is projected and scaled so that the kinetic energy changes by the work of the forces.
    fn keep_energy_only(
        &self,
        settings: &Settings,
        acceleration: &Vector<N>,
        budget: &mut IterationBudget<'_>,
    ) -> Result<ConservingEnd<S::Secant, N, K>, StepError> {
        // Dampers and drives at the beginning do not represent the step, so the rates are tried first.
        let by_rates = (!self.system.is_conservative() && self.v.max_norm() > 0.0).then(|| self.h * self.v);
        let starts = [by_rates, Some(increment(&self.v, acceleration, self.h))];
        let projected = starts.into_iter().flatten().find_map(|increment| {
            (0..MOST_SHORTENINGS).find_map(|times| self.project_end(settings, SHORTENING.powi(times) * increment, budget))
        });
        budget.counters.fallbacks += u64::from(projected.is_some());
        projected.ok_or(StepError::FallbackFailed)
    }

    /// Projects an increment, m and rad, and scales its velocity to the energy. `None` if rates of this size cannot lead so far.
    fn project_end(
        &self,
        settings: &Settings,
        increment: Vector<N>,
        budget: &mut IterationBudget<'_>,
    ) -> Option<ConservingEnd<S::Secant, N, K>> {
        let &Step { system, q, v: v0, h, .. } = self;
        let mut end = q + increment;
        let projection = Projection::to_round_off(system.length_scale(), settings.equilibrium, MOST_PROJECTIONS);
        let (iterations, pose) = projection.position(system, &mut end).ok()?;
        budget.counters.iterations += u64::from(iterations);
        let d = end - q;
        let mass = system.factor_mass(&pose, VERTEX_REGULARIZATION * settings.equilibrium);
        let mut v = d / h;
        let is_closed =
            |v: &Vector<N>| system.phi_q_times(&pose, v).max_norm() <= RATE_VIOLATION * v.max_norm() * system.length_scale();
        // Close to a vertex one correction leaves a residual of Φ_q v. Later steps assume Φ_q v = 0, so the correction is repeated.
        for _ in 0..MOST_PROJECTIONS {
            v += velocity_correction(system, &pose, &mass, &v);
            if is_closed(&v) {
                break;
            }
        }
        let kinetic = |v: &Vector<N>| 0.5 * system.mass_times(&pose, v).dot(v);
        let secant = system.secant(&self.pose, &d);
        let external_work = system.mean_forces(&self.increment(&secant, [&d, &v])).dot(&d);
        let (wanted, got) = (kinetic(&v0) + external_work, kinetic(&v));
        if !(is_closed(&v) && wanted > 0.0 && got > 0.0) {
            return None;
        }
        let scaled = (wanted / got).sqrt() * v;
        // Next to a vertex equilibrium may require any acceleration, and a long increment may be projected onto another assembly.
        let reach = h * (system.error_norm(&v0) + system.error_norm(&scaled));
        (scaled.is_finite() && system.error_norm(&d) <= reach).then_some(ConservingEnd { x: None, d, acting: v, v: scaled, secant })
    }
}
