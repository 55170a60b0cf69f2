//! Newton's method for a conserving step: staggered, with Λ and ν solved alternately in cut loops; or full, with all unknowns and the whole
//! tangent.

use crate::integrator::convergence::{Convergence, LastCorrection};
use crate::integrator::{Counters, CutStep, System};
use crate::vector::Vector;

/// Admissible |M⁻¹f| per second of step in the full iteration, m/s and rad/s: a residual of the momentum does proportional work.
const OFFSET: f64 = 1e-9;
/// Admissible |M⁻¹f| per second of step in the staggered iteration, m/s and rad/s: its last increment transfers the residual to the rates.
const CUT_OFFSET: f64 = 5e-11;
/// Admissible |Φ|, relative to the size of the system.
const ROUND_OFF: f64 = 8.0 * f64::EPSILON;
/// Admissible |J₁w|/2 per second of step, relative to the size of the system, 1/s.
const RATE_BOUND: f64 = 5e-12;
/// Largest |M⁻¹f|, m and rad, at which a failed staggered iteration still gives a first guess for the full iteration.
const LARGEST_OFFSET_OF_GUESS: f64 = 1e-3;
/// Largest |M⁻¹f|, m and rad, after 0, 1 and 2 staggered iterations. Above it the full iteration takes less work.
const LARGEST_OFFSETS: [f64; 3] = [f64::INFINITY, 3e-3, 1e-7];
/// Required contraction of |M⁻¹f| per staggered iteration after those in [`LARGEST_OFFSETS`]; each factorises again.
const CONTRACTION: f64 = 0.05;
/// Correction of an angle, rad, below which the full iteration is at round-off.
const LAST_CORRECTION: f64 = 1e-13;
/// Correction of an angle, rad, below which the full iteration ends once corrections no longer fall.
const STAGNATION: f64 = 1e-10;
/// Largest rotation of a link in one step, rad; an iteration that exceeds it has diverged.
const LARGEST_ROTATION: f64 = 6.0;

/// Admissible residuals of a step.
pub(super) struct ResidualBounds {
    offset: f64,
    phi: f64,
    rate: f64,
}

impl ResidualBounds {
    pub(super) fn new<const N: usize, const M: usize>(system: &impl System<N, M>, h: f64) -> Self {
        let size = system.length_scale();
        Self { offset: OFFSET * h, phi: ROUND_OFF * size, rate: size * ROUND_OFF.max(RATE_BOUND * h) }
    }

    /// Bounds for the staggered iteration.
    pub(super) fn cut<const N: usize, const M: usize>(system: &impl System<N, M>, h: f64) -> Self {
        Self { offset: CUT_OFFSET * h, ..Self::new(system, h) }
    }

    /// Largest element of M⁻¹f, Φ and J₁w/2, each relative to its bound.
    fn violation(&self, [offset, phi, rate]: [f64; 3]) -> f64 {
        // The sum is NaN if any term is NaN; a maximum would not be.
        let most = (offset / self.offset).max(phi / self.phi).max(rate / self.rate);
        if (offset + phi + rate).is_nan() { f64::NAN } else { most }
    }
}

/// Budget of Newton iterations of a step.
pub(super) struct IterationBudget<'a> {
    pub(super) left: u32,
    /// Iteration count when the step began.
    pub(super) begun: u64,
    pub(super) counters: &'a mut Counters,
}

impl IterationBudget<'_> {
    /// Number of iterations that the step has taken.
    pub(super) fn spent(&self) -> u32 {
        (self.counters.iterations - self.begun) as u32
    }

    /// Takes one iteration from the budget; `None` if it is exhausted.
    fn take(&mut self) -> Option<()> {
        self.left = self.left.checked_sub(1)?;
        self.counters.iterations += 1;
        Some(())
    }
}

/// Staggered iteration with cut loops: ν follows from a linear equation for given d; Newton's method solves for d and Λ. It contracts by
/// (hω)² per iteration. The solution is passed to `accept_root`. On failure the result is the last iterate, unless it has diverged, and the
/// number of iterations.
pub(super) fn staggered_newton<const N: usize, const M: usize, const K: usize, C: CutStep<N, M, K>, T>(
    cut: &C,
    mut x: Vector<K>,
    bounds: &ResidualBounds,
    regularization: f64,
    most: u32,
    accept_root: impl FnOnce(&C::Motion, u32) -> T,
) -> Result<T, (Option<Vector<K>>, u32)> {
    let mut convergence = Convergence::new(1.0, 0.0, LastCorrection::ANY);
    let mut before = f64::INFINITY;
    let mut factor: Option<C::Factor> = None;
    for iteration in 0..=most {
        let motion = cut.motion(&x, regularization);
        let balance = cut.balance(&motion);
        let residuals = cut.residuals(&motion, &balance);
        if convergence.is_met(bounds.violation(residuals)) {
            let factor = factor.get_or_insert_with(|| cut.factor(&motion, &balance, regularization));
            return Ok(accept_root(&cut.with_rates(&motion, &balance, factor), iteration));
        }
        let [offset, ..] = residuals;
        let promising = LARGEST_OFFSETS.get(iteration as usize).copied().unwrap_or(CONTRACTION * before);
        if offset > promising || iteration == most {
            return Err(((offset < LARGEST_OFFSET_OF_GUESS).then(|| C::unknowns(&motion)), iteration));
        }
        before = offset;
        if iteration as usize >= LARGEST_OFFSETS.len() {
            factor = None;
        }
        let factor = factor.get_or_insert_with(|| cut.factor(&motion, &balance, regularization));
        x = cut.newton_update(&motion, &balance, factor);
        if C::rotation_norm(&x) >= LARGEST_ROTATION {
            return Err((None, iteration + 1));
        }
    }
    Err((None, most))
}

/// Stopping rule of the full iteration.
#[derive(Clone, Copy)]
pub(super) enum StopRule {
    /// All residuals are admissible.
    Solved,
    /// Angle corrections are below this bound, rad; for intermediate roots of a homotopy.
    Corrected(f64),
}

/// Limits of the full iteration.
#[derive(Clone, Copy)]
pub(super) struct NewtonLimits {
    /// Largest number of iterations.
    pub(super) iterations: u32,
    /// When the iteration ends.
    pub(super) stop_rule: StopRule,
}

/// Full iteration on all unknowns at once, with the whole tangent. `x` is the first guess and becomes the unknowns of the root.
#[inline(never)]
pub(super) fn full_newton<const N: usize, const M: usize, const K: usize, C: CutStep<N, M, K>>(
    cut: &C,
    x: &mut Vector<K>,
    bounds: &ResidualBounds,
    regularization: f64,
    limits: NewtonLimits,
    budget: &mut IterationBudget<'_>,
) -> Option<C::Motion> {
    let (tolerance, small) = match limits.stop_rule {
        StopRule::Solved => (1.0, LAST_CORRECTION),
        StopRule::Corrected(bound) => (f64::INFINITY, bound),
    };
    let mut convergence = Convergence::new(tolerance, 0.0, LastCorrection { small, stagnant: STAGNATION });
    loop {
        let motion = cut.free_motion(x);
        let balance = cut.balance(&motion);
        if convergence.is_met(bounds.violation(cut.residuals(&motion, &balance))) {
            return Some(motion);
        }
        if convergence.iterations == limits.iterations {
            return None;
        }
        budget.take()?;
        let change = cut.whole_correction(&motion, &balance, regularization);
        *x += change;
        convergence.corrected(C::rotation_norm(&change));
        if !(x.is_finite() && C::rotation_norm(x) < LARGEST_ROTATION) {
            return None;
        }
    }
}
