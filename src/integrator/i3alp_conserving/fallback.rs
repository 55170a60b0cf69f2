//! Fallback stages of a conserving step that plain Newton iteration does not solve: homotopies to the same root, at the full step
//! length.
//!
//! | stage | method |
//! | --- | --- |
//! | 1 | full tangent, from the first guess by equilibrium at the beginning |
//! | 2 | homotopy in the law of friction and servos: softened, then hardened again |
//! | 3 | homotopy in the step length: roots at h/8, 2h/8, … h |
//! | 4 | smaller regularisation e |
//! | 5 | homotopies in the step length with smaller e, and with more stages |
//! | 6 | first guess from the end of two to sixteen shorter steps |
//! | last | no root, close to vertices: end by rates or equilibrium, projected, its velocity scaled to the energy |
//!
//! With `max_work` = 0 the first stage is the only one.

use super::Settings;
use super::equations::{Evaluation, Step, Unknowns};
use super::newton::{IterationBudget, StopRule, full_newton};
use crate::integrator::{Discrete, Passage, Projection, StepError, velocity_correction};
use crate::vector::Vector;

/// Largest factor on the regularisation rates of friction: the root of the softest law is found from the first guess of
/// equilibrium.
const LARGEST_SOFTENING: f64 = 1e7;
/// Smallest and largest factor by which the regularisation rates fall from one root to the next.
const HARDENING_FACTORS: [f64; 2] = [1.05, 30.0];
/// Smaller regularisations to try, relative to e.
const SMALLER_REGULARIZATIONS: [f64; 2] = [1e-5, 1e-7];
/// Further homotopies in the step length: number of stages, and regularisation relative to e.
const FINER_CONTINUATIONS: [(u32, f64); 4] = [(8, 1e-5), (32, 1.0), (32, 1e-5), (128, 1e-5)];
/// Numbers of shorter steps whose end is tried as a first guess.
const SHORTER_STEP_COUNTS: [u32; 4] = [2, 4, 8, 16];
/// Iteration limit and stopping rule for a root of the step itself.
const TO_ROOT: (u32, StopRule) = (10, StopRule::Solved);
/// Iteration limit and stopping rule for the intermediate roots of a homotopy.
const TO_INTERMEDIATE_ROOT: (u32, StopRule) = (10, StopRule::Corrected(1e-8));
/// Largest number of iterations per softening.
const SOFTENED_ITERATIONS: u32 = 15;
/// Largest number of iterations of a projection in the energy-only stage.
const MOST_PROJECTIONS: u32 = 30;
/// Factor by which the increment of the energy-only stage is shortened where projection or energy fail.
const SHORTENING: f64 = 0.25;
/// Largest number of such shortenings.
const MOST_SHORTENINGS: i32 = 20;
/// Regularisation of projections in the energy-only stage, relative to e: S is nearly singular close to a vertex.
const VERTEX_REGULARIZATION: f64 = 1e-4;
/// Admissible velocity violation in the energy-only stage, relative to the velocity times the system's size.
const RATE_VIOLATION: f64 = 64.0 * f64::EPSILON;

/// Result of the fallback stages.
pub(super) enum Recovered<S: Discrete<N, M>, const N: usize, const M: usize> {
    /// A root with its evaluation.
    Root(Unknowns<N, M>, Evaluation<S, N, M>),
    /// No root: an end that conserves the energy only.
    Scaled {
        /// Increment d = q₁ − q₀, m and rad.
        d: Vector<N>,
        /// Velocity at which forces have acted, m/s and rad/s.
        acting: Vector<N>,
        /// Velocity q̇₁ at the end, m/s and rad/s.
        v: Vector<N>,
    },
}

/// A root of the equations with its evaluation.
type Root<S, const N: usize, const M: usize> = (Unknowns<N, M>, Evaluation<S, N, M>);

/// First guess of the unknowns for a step of `h` seconds from equilibrium at its beginning, with these q̈ and λ.
pub(super) fn from_equilibrium<const N: usize, const M: usize>(
    v: &Vector<N>,
    (a, lambda): (&Vector<N>, &Vector<M>),
    h: f64,
) -> Unknowns<N, M> {
    Unknowns { d: h * (*v + (0.5 * h) * *a), lambda: (0.5 * h * h) * *lambda, nu: Vector::ZERO }
}

/// Runs the fallback stages in order until one succeeds.
#[cold]
#[inline(never)]
pub(super) fn recover_by_stages<const N: usize, const M: usize, S: Discrete<N, M> + Passage<N>>(
    step: &Step<'_, S, N, M>,
    settings: &Settings,
    rest: (&Vector<N>, &Vector<M>),
    budget: &mut IterationBudget<'_>,
) -> Result<Recovered<S, N, M>, StepError> {
    match root(step, settings, rest, budget) {
        Some((x, end)) => Ok(Recovered::Root(x, end)),
        None if settings.max_work == 0 => Err(StepError::NoRootWithin { iterations: budget.spent() }),
        None => keep_energy_only(step, settings, rest, budget),
    }
}

fn root<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    settings: &Settings,
    rest: (&Vector<N>, &Vector<M>),
    budget: &mut IterationBudget<'_>,
) -> Option<Root<S, N, M>> {
    let with = |part: f64| part * settings.regularization;
    let start = from_equilibrium(&step.v, rest, step.h);
    let by_full_newton = |part: f64, budget: &mut IterationBudget<'_>| {
        let mut x = start;
        full_newton(step, &mut x, with(part), TO_ROOT, budget).map(|end| (x, end))
    };
    if let Some(root) = by_full_newton(1.0, budget) {
        return Some(root);
    }
    if settings.max_work == 0 {
        return None;
    }
    budget.counters.rescued += 1;
    (!step.system.is_conservative())
        .then(|| harden_friction(step, start, with(1.0), budget))
        .flatten()
        .or_else(|| continue_in_step_length(step, with(1.0), rest, 8, budget))
        .or_else(|| SMALLER_REGULARIZATIONS.into_iter().find_map(|part| by_full_newton(part, budget)))
        .or_else(|| {
            FINER_CONTINUATIONS
                .into_iter()
                .find_map(|(stages, part)| continue_in_step_length(step, with(part), rest, stages, budget))
        })
        .or_else(|| {
            SHORTER_STEP_COUNTS
                .into_iter()
                .find_map(|parts| by_shorter_steps(step, with(SMALLER_REGULARIZATIONS[0]), rest, parts, budget))
        })
}

/// Stage 6: first guess from `parts` shorter steps, which may lead to another root than a homotopy that ends in a fold.
fn by_shorter_steps<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    regularization: f64,
    (a, lambda): (&Vector<N>, &Vector<M>),
    parts: u32,
    budget: &mut IterationBudget<'_>,
) -> Option<Root<S, N, M>> {
    let h = step.h / f64::from(parts);
    let mut x = from_equilibrium(&step.v, (a, lambda), h);
    let mut sum = Unknowns { d: Vector::ZERO, lambda: Vector::ZERO, nu: Vector::ZERO };
    let (mut q, mut v) = (step.q, step.v);
    for part in 0..parts {
        let shorter = Step::new(step.system, [&q, &v], h);
        if part > 0 {
            x.d = h * v;
        }
        let end = full_newton(&shorter, &mut x, regularization, TO_ROOT, budget)?;
        (q, v) = (q + x.d, end.v);
        sum.d += x.d;
        sum.lambda += f64::from(parts) * x.lambda;
    }
    full_newton(step, &mut sum, regularization, TO_ROOT, budget).map(|end| (sum, end))
}

/// Stage 2: softened friction has a root that is easy to find; from there the law is hardened in steps.
fn harden_friction<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    mut x: Unknowns<N, M>,
    regularization: f64,
    budget: &mut IterationBudget<'_>,
) -> Option<Root<S, N, M>> {
    let [least, most] = HARDENING_FACTORS;
    let (_, to_intermediate_root) = TO_INTERMEDIATE_ROOT;
    full_newton(&step.softened(LARGEST_SOFTENING), &mut x, regularization, (SOFTENED_ITERATIONS, to_intermediate_root), budget)?;
    let (mut softening, mut ratio) = (LARGEST_SOFTENING, most);
    while ratio > least {
        let next = (softening / ratio).max(1.0);
        let stop_rule = if next > 1.0 { to_intermediate_root } else { StopRule::Solved };
        let mut there = x;
        match full_newton(&step.softened(next), &mut there, regularization, (SOFTENED_ITERATIONS, stop_rule), budget) {
            Some(end) if next == 1.0 => return Some((there, end)),
            Some(_) => (softening, x) = (next, there),
            None => ratio = ratio.sqrt(),
        }
    }
    None
}

/// Stages 3 and 5: the root is continued from a step of h/stages to one of h.
fn continue_in_step_length<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    regularization: f64,
    rest: (&Vector<N>, &Vector<M>),
    stages: u32,
    budget: &mut IterationBudget<'_>,
) -> Option<Root<S, N, M>> {
    let mut before = Unknowns { d: Vector::ZERO, lambda: Vector::ZERO, nu: Vector::ZERO };
    let (mut x, mut end) = (before, None);
    for stage in 1..=stages {
        let h = step.h * f64::from(stage) / f64::from(stages);
        let next = match stage {
            1 => from_equilibrium(&step.v, rest, h),
            // The increment d grows with h, the multipliers with its square.
            2 => Unknowns { d: 2.0 * x.d, lambda: 4.0 * x.lambda, nu: 4.0 * x.nu },
            _ => Unknowns { d: 2.0 * x.d - before.d, lambda: 2.0 * x.lambda - before.lambda, nu: 2.0 * x.nu - before.nu },
        };
        (before, x) = (x, next);
        let stop_rule = if stage < stages { TO_INTERMEDIATE_ROOT } else { TO_ROOT };
        end = Some(full_newton(&step.shortened(h), &mut x, regularization, stop_rule, budget)?);
    }
    end.map(|end| (x, end))
}

/// Last stage: increment by rates or equilibrium, shortened if needed, projected onto the position constraints; its mean velocity,
/// projected and scaled so that the kinetic energy changes by the work of the forces.
fn keep_energy_only<const N: usize, const M: usize, S: Discrete<N, M> + Passage<N>>(
    step: &Step<'_, S, N, M>,
    settings: &Settings,
    rest: (&Vector<N>, &Vector<M>),
    budget: &mut IterationBudget<'_>,
) -> Result<Recovered<S, N, M>, StepError> {
    // Dampers and drives at the beginning do not represent the step, so the rates are tried first.
    let by_rates = (!step.system.is_conservative() && step.v.max_norm() > 0.0).then(|| step.h * step.v);
    let starts = [by_rates, Some(from_equilibrium(&step.v, rest, step.h).d)];
    let projected = starts.into_iter().flatten().find_map(|increment| {
        (0..MOST_SHORTENINGS).find_map(|times| project_end(step, settings, SHORTENING.powi(times) * increment, budget))
    });
    budget.counters.fallbacks += u64::from(projected.is_some());
    projected.ok_or(StepError::FallbackFailed)
}

/// Projects this increment, m and rad, and scales its velocity to the energy.
fn project_end<const N: usize, const M: usize, S: Discrete<N, M> + Passage<N>>(
    step: &Step<'_, S, N, M>,
    settings: &Settings,
    increment: Vector<N>,
    budget: &mut IterationBudget<'_>,
) -> Option<Recovered<S, N, M>> {
    let &Step { system, q, v: v0, h, .. } = step;
    let mut end = q + increment;
    let projection = Projection::to_round_off(system.length_scale(), settings.equilibrium, MOST_PROJECTIONS);
    let (iterations, pose) = projection.position(system, &mut end).ok()?;
    budget.counters.iterations += u64::from(iterations);
    let d = end - q;
    let mass = system.factor_mass(&pose, VERTEX_REGULARIZATION * settings.equilibrium);
    let mut v = d / h;
    let is_closed =
        |v: &Vector<N>| system.phi_q_times(&pose, v).max_norm() <= RATE_VIOLATION * v.max_norm() * system.length_scale();
    // Close to a vertex one correction leaves a residual, while later steps assume none.
    for _ in 0..MOST_PROJECTIONS {
        v += velocity_correction(system, &pose, &mass, &v);
        if is_closed(&v) {
            break;
        }
    }
    let kinetic = |v: &Vector<N>| 0.5 * system.mass_times(&pose, v).dot(v);
    let secant = step.secant(&d);
    let external_work = system.mean_forces(&step.increment(&secant, &d, &v)).dot(&d);
    let (wanted, got) = (kinetic(&v0) + external_work, kinetic(&v));
    if !(is_closed(&v) && wanted > 0.0 && got > 0.0) {
        return None;
    }
    let scaled = (wanted / got).sqrt() * v;
    scaled.is_finite().then_some(Recovered::Scaled { d, acting: v, v: scaled })
}
