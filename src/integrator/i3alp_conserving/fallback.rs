//! What a step does whose equations plain Newton's method does not solve: other ways to the same root, at the full step.
//!
//! | rung | way |
//! | --- | --- |
//! | 1 | the whole tangent, from what equilibrium at the beginning predicts |
//! | 2 | friction and servos made soft and hardened again, each root the start of the next |
//! | 3 | continuation: roots at h/8, 2h/8, … h |
//! | 4 | a smaller e |
//! | 5 | continuations with a smaller e, and finer ones |
//! | 6 | from where two to sixteen shorter steps lead |
//! | last | no root, which happens close to vertices: what the rates or equilibrium predict, projected and scaled to the energy |
//!
//! Without an allowance for a rescue the first rung is the only one.

use super::Settings;
use super::equations::{Evaluation, Step, Unknowns};
use super::newton::{Allowance, Until, full_newton};
use crate::integrator::{Discrete, Passage, Projection, StepError, velocity_correction};
use crate::vector::Vector;

/// Factor on the rates at which friction turns where its law is softest, and by which it hardens at a time: less where that is too much.
const SOFTEST: f64 = 1e7;
const HARDENING: [f64; 2] = [1.05, 30.0];
/// Parts of e.
const SMALLER: [f64; 2] = [1e-5, 1e-7];
/// Stages of the finer continuations and their part of e.
const FINER: [(u32, f64); 4] = [(8, 1e-5), (32, 1.0), (32, 1e-5), (128, 1e-5)];
/// Shorter steps whose end is a first guess.
const SHORTER: [u32; 4] = [2, 4, 8, 16];
/// Most iterations to a root, and at the stages on the way there.
const SOLVED: (u32, Until) = (10, Until::Solved);
const ON_THE_WAY: (u32, Until) = (10, Until::Corrected(1e-8));
/// Most iterations of each softening.
const SOFTENED: u32 = 15;
/// Most iterations of a projection by the last rung.
const MOST_PROJECTIONS: u32 = 30;
/// By which its way is shortened where that is not enough, and how often.
const SHORTENED: f64 = 0.25;
const MOST_SHORTENINGS: i32 = 20;
/// Part of e of its projections, and of the rates what they may leave.
const CLOSE_TO_VERTEX: f64 = 1e-4;
const CLOSED: f64 = 64.0 * f64::EPSILON;

/// What the ladder has found.
pub(super) enum Recovered<S: Discrete<N, M>, const N: usize, const M: usize> {
    /// A root, and where it leads.
    Root(Unknowns<N, M>, Evaluation<S, N, M>),
    /// None: where the last rung leads.
    Scaled {
        /// q₁ − q₀.
        d: Vector<N>,
        /// The rates with which forces have acted.
        acting: Vector<N>,
        /// q̇₁.
        v: Vector<N>,
    },
}

/// Unknowns that solve the equations, and where they lead.
type Root<S, const N: usize, const M: usize> = (Unknowns<N, M>, Evaluation<S, N, M>);

/// The unknowns that equilibrium at the beginning of a step predicts for one of h seconds, with these q̈ and λ.
pub(super) fn from_equilibrium<const N: usize, const M: usize>(
    v: &Vector<N>,
    (a, lambda): (&Vector<N>, &Vector<M>),
    h: f64,
) -> Unknowns<N, M> {
    Unknowns { d: h * (*v + (0.5 * h) * *a), lambda: (0.5 * h * h) * *lambda, nu: Vector::ZERO }
}

/// Up the ladder.
#[cold]
#[inline(never)]
pub(super) fn recover_by_stages<const N: usize, const M: usize, S: Discrete<N, M> + Passage<N>>(
    step: &Step<'_, S, N, M>,
    settings: &Settings,
    rest: (&Vector<N>, &Vector<M>),
    allowance: &mut Allowance<'_>,
) -> Result<Recovered<S, N, M>, StepError> {
    match root(step, settings, rest, allowance) {
        Some((x, end)) => Ok(Recovered::Root(x, end)),
        None if settings.max_work == 0 => Err(StepError::NoRootWithin { iterations: allowance.spent() }),
        None => keep_energy_only(step, settings, rest, allowance),
    }
}

fn root<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    settings: &Settings,
    rest: (&Vector<N>, &Vector<M>),
    allowance: &mut Allowance<'_>,
) -> Option<Root<S, N, M>> {
    let with = |part: f64| part * settings.regularization;
    let start = from_equilibrium(&step.v, rest, step.h);
    let at_once = |part: f64, allowance: &mut Allowance<'_>| {
        let mut x = start;
        full_newton(step, &mut x, with(part), SOLVED, allowance).map(|end| (x, end))
    };
    if let Some(root) = at_once(1.0, allowance) {
        return Some(root);
    }
    if settings.max_work == 0 {
        return None;
    }
    allowance.counters.rescued += 1;
    (!step.system.is_conservative())
        .then(|| hardened(step, start, with(1.0), allowance))
        .flatten()
        .or_else(|| continued(step, with(1.0), rest, 8, allowance))
        .or_else(|| SMALLER.into_iter().find_map(|part| at_once(part, allowance)))
        .or_else(|| FINER.into_iter().find_map(|(stages, part)| continued(step, with(part), rest, stages, allowance)))
        .or_else(|| SHORTER.into_iter().find_map(|parts| by_shorter_steps(step, with(SMALLER[0]), rest, parts, allowance)))
}

/// From where this many shorter steps lead: another root than those that a growing step follows, which may have come to a fold.
fn by_shorter_steps<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    regularization: f64,
    (a, lambda): (&Vector<N>, &Vector<M>),
    parts: u32,
    allowance: &mut Allowance<'_>,
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
        let end = full_newton(&shorter, &mut x, regularization, SOLVED, allowance)?;
        (q, v) = (q + x.d, end.v);
        sum.d += x.d;
        sum.lambda += f64::from(parts) * x.lambda;
    }
    full_newton(step, &mut sum, regularization, SOLVED, allowance).map(|end| (sum, end))
}

/// Friction that turns at larger rates has a root that is easy to find; from there the law hardens.
fn hardened<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    mut x: Unknowns<N, M>,
    regularization: f64,
    allowance: &mut Allowance<'_>,
) -> Option<Root<S, N, M>> {
    let [least, most] = HARDENING;
    let (_, on_the_way) = ON_THE_WAY;
    full_newton(&step.softened(SOFTEST), &mut x, regularization, (SOFTENED, on_the_way), allowance)?;
    let (mut softening, mut ratio) = (SOFTEST, most);
    while ratio > least {
        let next = (softening / ratio).max(1.0);
        let until = if next > 1.0 { on_the_way } else { Until::Solved };
        let mut there = x;
        match full_newton(&step.softened(next), &mut there, regularization, (SOFTENED, until), allowance) {
            Some(end) if next == 1.0 => return Some((there, end)),
            Some(_) => (softening, x) = (next, there),
            None => ratio = ratio.sqrt(),
        }
    }
    None
}

/// The root is followed from that of a step of h/stages, which is small, to that of h.
fn continued<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    regularization: f64,
    rest: (&Vector<N>, &Vector<M>),
    stages: u32,
    allowance: &mut Allowance<'_>,
) -> Option<Root<S, N, M>> {
    let mut before = Unknowns { d: Vector::ZERO, lambda: Vector::ZERO, nu: Vector::ZERO };
    let (mut x, mut end) = (before, None);
    for stage in 1..=stages {
        let h = step.h * f64::from(stage) / f64::from(stages);
        let next = match stage {
            1 => from_equilibrium(&step.v, rest, h),
            // d grows with h, the multipliers with its square.
            2 => Unknowns { d: 2.0 * x.d, lambda: 4.0 * x.lambda, nu: 4.0 * x.nu },
            _ => Unknowns { d: 2.0 * x.d - before.d, lambda: 2.0 * x.lambda - before.lambda, nu: 2.0 * x.nu - before.nu },
        };
        (before, x) = (x, next);
        let until = if stage < stages { ON_THE_WAY } else { SOLVED };
        end = Some(full_newton(&step.shortened(h), &mut x, regularization, until, allowance)?);
    }
    end.map(|end| (x, end))
}

/// Where the equations have no root: as far as the rates or equilibrium predict, or a part of it, projected onto the positions; the mean
/// rate of that way, projected and scaled so that the energy is kept: what the forces have put in on it is known.
fn keep_energy_only<const N: usize, const M: usize, S: Discrete<N, M> + Passage<N>>(
    step: &Step<'_, S, N, M>,
    settings: &Settings,
    rest: (&Vector<N>, &Vector<M>),
    allowance: &mut Allowance<'_>,
) -> Result<Recovered<S, N, M>, StepError> {
    // What dampers and drives do at the beginning says nothing about the rest of the step, unless the rates lead nowhere.
    let by_rates = (!step.system.is_conservative() && step.v.max_norm() > 0.0).then(|| step.h * step.v);
    let starts = [by_rates, Some(from_equilibrium(&step.v, rest, step.h).d)];
    let landed = starts
        .into_iter()
        .flatten()
        .find_map(|way| (0..MOST_SHORTENINGS).find_map(|times| landing(step, settings, SHORTENED.powi(times) * way, allowance)));
    allowance.counters.fallbacks += u64::from(landed.is_some());
    landed.ok_or(StepError::FallbackFailed)
}

/// Where this way leads.
fn landing<const N: usize, const M: usize, S: Discrete<N, M> + Passage<N>>(
    step: &Step<'_, S, N, M>,
    settings: &Settings,
    way: Vector<N>,
    allowance: &mut Allowance<'_>,
) -> Option<Recovered<S, N, M>> {
    let &Step { system, q, v: v0, h, .. } = step;
    let mut end = q + way;
    let projection = Projection::to_round_off(system.length_scale(), settings.equilibrium, MOST_PROJECTIONS);
    let (iterations, pose) = projection.position(system, &mut end).ok()?;
    allowance.counters.iterations += u64::from(iterations);
    let d = end - q;
    let mass = system.factor_mass(&pose, CLOSE_TO_VERTEX * settings.equilibrium);
    let mut v = d / h;
    let is_closed = |v: &Vector<N>| system.phi_q_times(&pose, v).max_norm() <= CLOSED * v.max_norm() * system.length_scale();
    // Close to a vertex each leaves some of it, and the steps to come take for granted that nothing is left.
    for _ in 0..MOST_PROJECTIONS {
        v += velocity_correction(system, &pose, &mass, &v);
        if is_closed(&v) {
            break;
        }
    }
    let kinetic = |v: &Vector<N>| 0.5 * system.mass_times(&pose, v).dot(v);
    let secant = step.secant(&d);
    let external_work = system.mean_forces(&step.chord(&secant, &d, &v)).dot(&d);
    let (wanted, got) = (kinetic(&v0) + external_work, kinetic(&v));
    if !(is_closed(&v) && wanted > 0.0 && got > 0.0) {
        return None;
    }
    let scaled = (wanted / got).sqrt() * v;
    scaled.is_finite().then_some(Recovered::Scaled { d, acting: v, v: scaled })
}
