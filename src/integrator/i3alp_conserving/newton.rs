//! The unknowns of a conserving step, by Newton's method: Λ and ν in turn with the loops cut, or all at once.

use super::equations::{Evaluation, Step, Unknowns};
use crate::integrator::{Counters, CutStep, Discrete};

/// Largest |M⁻¹f| per second of step of one that has converged, m/s and rad/s: what is left does work, in proportion to it.
const OFFSET: f64 = 1e-9;
/// The same with the loops cut, where the rates take up what is left.
const CUT_OFFSET: f64 = 5e-11;
/// Largest |Φ| of it, in parts of the system's size.
const ROUND_OFF: f64 = 8.0 * f64::EPSILON;
/// Largest |J₁w|/2 per second of step, in parts of the system's size per second.
const RATE: f64 = 5e-12;
/// Where |M⁻¹f| is larger than this, m and rad, after Λ and ν were looked for in turn, they have led nowhere.
const NEARBY: f64 = 1e-3;
/// Most |M⁻¹f| after none, one and two iterations: where it is larger, the whole tangent takes less work.
const PROMISING: [f64; 3] = [f64::INFINITY, 3e-3, 1e-7];
/// After these the matrix is factorised anew each time, and |M⁻¹f| has to fall to this part.
const CONTRACTION: f64 = 0.05;
/// The whole tangent goes to round-off: to a correction of an angle below the first, or to one below the second that does not fall any
/// more, rad.
const LAST_CORRECTION: f64 = 1e-13;
const STAGNATION: f64 = 1e-10;
/// A link that turns farther in one step, rad, is on its way to no root.
const LARGEST_TURN: f64 = 6.0;

/// What a step that has converged may leave of its equations.
pub(super) struct Bounds {
    offset: f64,
    phi: f64,
    rate: f64,
}

impl Bounds {
    #[inline(always)]
    pub(super) fn new<const N: usize, const M: usize>(system: &impl Discrete<N, M>, h: f64) -> Self {
        let size = system.length_scale();
        Self { offset: OFFSET * h, phi: ROUND_OFF * size, rate: size * ROUND_OFF.max(RATE * h) }
    }

    /// With the loops cut.
    #[inline(always)]
    pub(super) fn cut<const N: usize, const M: usize>(system: &impl Discrete<N, M>, h: f64) -> Self {
        Self { offset: CUT_OFFSET * h, ..Self::new(system, h) }
    }

    /// By the largest elements of M⁻¹f, Φ and J₁w/2.
    #[inline(always)]
    fn are_met(&self, offset: f64, phi: f64, rate: f64) -> bool {
        offset < self.offset && phi < self.phi && rate < self.rate
    }
}

/// Iterations that a step may still take.
pub(super) struct Allowance<'a> {
    pub(super) left: u32,
    /// Iterations counted when the step began.
    pub(super) begun: u64,
    pub(super) counters: &'a mut Counters,
}

impl Allowance<'_> {
    /// Iterations that the step has taken.
    pub(super) fn spent(&self) -> u32 {
        (self.counters.iterations - self.begun) as u32
    }

    /// Takes one, if there is one.
    #[inline(always)]
    fn take(&mut self) -> Option<()> {
        self.left = self.left.checked_sub(1)?;
        self.counters.iterations += 1;
        Some(())
    }
}

/// Λ and ν in turn, with the loops cut: ν by a linear equation for given d, Newton's method on d and Λ. Contracts by (hω)² per iteration.
/// What is found there goes to `arrive`; where that is too little: the unknowns it has come to, unless they lead nowhere.
#[inline(always)]
pub(super) fn staggered_newton<const N: usize, const M: usize, C: CutStep<N, M>, T>(
    cut: &C,
    mut x: C::Unknowns,
    bounds: &Bounds,
    (regularization, most): (f64, u32),
    arrive: impl FnOnce(&C::Motion, u32) -> T,
) -> Result<T, (Option<C::Unknowns>, u32)> {
    let mut before = f64::INFINITY;
    let mut factor: Option<C::Factor> = None;
    for iteration in 0..=most {
        let motion = cut.motion(&x, regularization);
        let balance = cut.balance(&motion);
        let [offset, gap, rate] = cut.left(&motion, &balance);
        if bounds.are_met(offset, gap, rate) {
            let factor = factor.get_or_insert_with(|| cut.factor(&motion, &balance, regularization));
            return Ok(arrive(&cut.with_rates(&motion, &balance, factor), iteration));
        }
        let promising = PROMISING.get(iteration as usize).copied().unwrap_or(CONTRACTION * before);
        if offset > promising || iteration == most {
            return Err(((offset < NEARBY).then(|| C::unknowns(&motion)), iteration));
        }
        before = offset;
        if iteration as usize >= PROMISING.len() {
            factor = None;
        }
        let factor = factor.get_or_insert_with(|| cut.factor(&motion, &balance, regularization));
        x = cut.improved(&motion, &balance, factor);
        if C::turn(&x) >= LARGEST_TURN {
            return Err((None, iteration + 1));
        }
    }
    Err((None, most))
}

/// Until when the whole tangent is used.
#[derive(Clone, Copy)]
pub(super) enum Until {
    /// The equations are solved.
    Solved,
    /// A correction of an angle is below this, rad: on the way to another step's root.
    Corrected(f64),
}

/// All unknowns at once, with the whole tangent.
#[inline(never)]
pub(super) fn full_newton<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    x: &mut Unknowns<N, M>,
    regularization: f64,
    (most, until): (u32, Until),
    allowance: &mut Allowance<'_>,
) -> Option<Evaluation<S, N, M>> {
    let system = step.system;
    let bounds = Bounds::new(system, step.h);
    let (mut correction, mut before) = (f64::INFINITY, f64::INFINITY);
    for iteration in 0..=most {
        let secant = step.secant(&x.d);
        let z = step.mean_motion(&secant, x);
        let found = step.evaluate(secant, z, x);
        let Evaluation { secant, v, offset, force, phi, .. } = &found;
        let rate = system.phi_q_times(S::end(secant), &(step.h * *v));
        let no_further = correction < LAST_CORRECTION || correction < STAGNATION && correction >= 0.25 * before;
        let done = match until {
            Until::Solved => no_further && bounds.are_met(offset.max_norm(), phi.max_norm(), 0.5 * rate.max_norm()),
            Until::Corrected(bound) => correction < bound || no_further,
        };
        if iteration > 0 && done {
            return Some(found);
        }
        if iteration == most {
            return None;
        }
        allowance.take()?;
        let chord = step.chord(secant, &x.d, v);
        let (d, [lambda, nu]) = system.newton(&chord, [&x.lambda, &x.nu], (force, phi, &rate), regularization);
        x.d += d;
        x.lambda += lambda;
        x.nu += nu;
        (before, correction) = (correction, system.error_norm(&d));
        let finite = x.d.is_finite() && x.lambda.is_finite() && x.nu.is_finite();
        if !(finite && system.error_norm(&x.d) < LARGEST_TURN) {
            return None;
        }
    }
    None
}
