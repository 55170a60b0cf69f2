//! The unknowns of a conserving step, by Newton's method: Λ and ν in turn where forces let it, or all at once.

use super::equations::{Evaluation, Step, Unknowns};
use crate::integrator::{Counters, Discrete, NewtonSettings, SecantFactor};

/// Largest |M⁻¹f| per second of step of one that has converged, m/s and rad/s: what is left does work, in proportion to it.
const OFFSET: f64 = 1e-9;
/// Largest |Φ| of it, in parts of the system's size.
const ROUND_OFF: f64 = 8.0 * f64::EPSILON;
/// Largest |J₁w|/2 per second of step, in parts of the system's size per second.
const RATE: f64 = 5e-12;
/// Most |M⁻¹f| after none, one and two iterations: where it is larger, the whole tangent takes less work.
const PROMISING: [f64; 3] = [f64::INFINITY, 3e-3, 1e-7];
/// After these the matrix is factorised anew each time, and |M⁻¹f| has to fall to this part.
const CONTRACTION: f64 = 0.05;
/// The whole tangent's last correction of an angle, rad; one that does not fall any more and is below the second; one that is left when
/// no more iterations are allowed: round-off next to a vertex.
const LAST_CORRECTION: f64 = 1e-13;
const STAGNATION: f64 = 1e-12;
const LARGEST_LEFT: f64 = 1e-10;
/// A link that turns farther in one step, rad, is on its way to no root.
const LARGEST_TURN: f64 = 6.0;

/// Iterations that a step may still take.
pub(super) struct Allowance<'a> {
    pub(super) left: u32,
    pub(super) counters: &'a mut Counters,
}

impl Allowance<'_> {
    /// Takes one, if there is one.
    #[inline(always)]
    fn take(&mut self) -> Option<()> {
        self.left = self.left.checked_sub(1)?;
        self.counters.iterations += 1;
        Some(())
    }
}

/// Λ and ν in turn: ν by a linear equation for given d, Newton's method on d and Λ. Contracts by (hω)² per iteration.
#[inline(always)]
pub(super) fn alternate<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    x: &mut Unknowns<N, M>,
    regularization: f64,
    most: u32,
    allowance: &mut Allowance<'_>,
) -> Result<Evaluation<S, N, M>, f64> {
    let system = step.system;
    let size = system.length_scale();
    let bound = ROUND_OFF * size;
    let rate_bound = bound.max(RATE * step.h * size);
    let mut before = f64::INFINITY;
    let mut factor: Option<S::Factor> = None;
    for iteration in 0..=most {
        let secant = step.secant(&x.d);
        let mut z = step.mean_motion(&secant, x);
        let mut rate = f64::INFINITY;
        if let Some(factor) = &factor {
            let left = system.phi_q_times(S::end(&secant), &(z - (0.5 * step.h) * step.v));
            rate = left.max_norm();
            let nu = factor.dual(&left);
            x.nu += nu;
            z = z - system.apply_inverse_mass(&system.mean_transposed_times(&secant, &nu));
        }
        let found = step.evaluate(secant, z, x);
        let Evaluation { secant, pull, v, offset, force, phi } = &found;
        let left = offset.max_norm();
        if left < OFFSET * step.h && phi.max_norm() < bound && rate < rate_bound {
            return Ok(found);
        }
        let promising = PROMISING.get(iteration as usize).copied().unwrap_or(CONTRACTION * before);
        if left > promising || iteration == most || allowance.take().is_none() {
            return Err(left);
        }
        before = left;
        if iteration as usize >= PROMISING.len() {
            factor = None;
        }
        let factor =
            factor.get_or_insert_with(|| system.factor_secant(&step.chord(secant, &x.d, v), (&x.lambda, pull), regularization));
        let (d, lambda) = factor.solve(&-*force, &-*phi);
        x.d += d;
        x.lambda += lambda;
        if !(x.d.is_finite() && system.angle_norm(&x.d) < LARGEST_TURN) {
            break;
        }
    }
    Err(f64::INFINITY)
}

/// All unknowns at once, with the whole tangent. Stops at a last correction of an angle, or where round-off lets it go no further.
#[inline(never)]
pub(super) fn whole<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    x: &mut Unknowns<N, M>,
    settings: NewtonSettings,
    (most, last_correction): (u32, f64),
    allowance: &mut Allowance<'_>,
) -> Option<()> {
    let system = step.system;
    let mut last = f64::INFINITY;
    for _ in 0..most {
        allowance.take()?;
        let secant = step.secant(&x.d);
        let z = step.mean_motion(&secant, x);
        let Evaluation { secant, v, force, phi, .. } = step.evaluate(secant, z, x);
        let rate = system.phi_q_times(S::end(&secant), &(step.h * v));
        let chord = step.chord(&secant, &x.d, &v);
        let (d, [lambda, nu]) = system.newton(&chord, [&x.lambda, &x.nu], (&force, &phi, &rate), settings);
        x.d += d;
        x.lambda += lambda;
        x.nu += nu;
        let correction = system.angle_norm(&d);
        let finite = x.d.is_finite() && x.lambda.is_finite() && x.nu.is_finite();
        if !(finite && system.angle_norm(&x.d) < LARGEST_TURN) {
            return None;
        }
        if correction < last_correction || correction < STAGNATION && correction >= 0.25 * last {
            return Some(());
        }
        last = correction;
    }
    (last < LARGEST_LEFT).then_some(())
}

/// Where unknowns that have been found lead.
pub(super) fn evaluated<const N: usize, const M: usize, S: Discrete<N, M>>(
    step: &Step<'_, S, N, M>,
    x: &Unknowns<N, M>,
) -> Evaluation<S, N, M> {
    let secant = step.secant(&x.d);
    let z = step.mean_motion(&secant, x);
    step.evaluate(secant, z, x)
}

/// As far as round-off lets it.
pub(super) const TO_ROUND_OFF: (u32, f64) = (10, LAST_CORRECTION);
