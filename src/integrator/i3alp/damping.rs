//! Damping at the end of a stiff sub-step, if rates decay within a small part of the sub-step (friction, drives).
//!
//! The trapezoidal rule multiplies a component with decay rate ρ by R = (1 − z/2)/(1 + z/2), with z = hρ. For z ≫ 1, R → −1: the rates
//! oscillate, and so do the accelerations, which are ρ times the rates. Let P = (M + h/2 C + h²/4 K)⁻¹ M, which is 1/(1 + z/2) for the
//! component. The rates at the end become
//!
//! ```text
//! q̇ + h/2 P (1 − P)³ q̈      so that R becomes R (1 − (1 − P)⁴) → −8/z → 0
//! ```
//!
//! Slow components, z → 0, change by z⁴/16. This is below the error of the rule, z³/12, so the order is kept. Sub-steps are damped only if
//! the unpredicted change of q̈ is stiff. `docs/method.md`, section 5.6.

use super::Settings;
use super::stiff_forces::{filtered, rate_error, unpredicted};
use crate::integrator::{Implicit, State, StepEnd, Stuck};
use crate::vector::Vector;

/// Exponent of 1 − P.
const DAMPING_EXPONENT: u32 = 3;
/// Error of the rates above which stiffness is examined, relative to the tolerance.
const EXAMINED_ERROR: f64 = 0.01;
/// Ratio |P x|/|x| below which a change x of q̈ counts as stiff: z > 8.
const STIFF_RATIO: f64 = 0.2;

/// Damped end of a sub-step that replaces `end` if the unpredicted change of q̈ is stiff; otherwise `None`.
#[cold]
pub(super) fn damped<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    settings: &Settings,
    from: &State<N, M>,
    h: f64,
    (pose, mass): (&S::Pose, &S::Mass),
    end: &StepEnd<N, M>,
) -> Option<StepEnd<N, M>> {
    let unpredicted = unpredicted(from, end, h);
    if system.stuck() != Stuck::Nothing || rate_error(system, h, &unpredicted, &end.v) <= EXAMINED_ERROR * settings.error_tolerance
    {
        return None;
    }
    let filter = |x: &Vector<N>| filtered(system, settings, h, (pose, end), x);
    // Oscillations of non-stiff components are within the error.
    if system.error_norm(&filter(&unpredicted)?) > STIFF_RATIO * system.error_norm(&unpredicted) {
        return None;
    }
    let mut rest = end.a;
    for _ in 0..DAMPING_EXPONENT {
        rest = rest - filter(&rest)?;
    }
    let damped = StepEnd::in_balance(system, [end.q, end.v + h / 2.0 * filter(&rest)?], pose, mass);
    // Beyond the saturation of a force its tangent overestimates the correction, which is then discarded.
    (system.error_norm(&damped.a) <= system.error_norm(&end.a)).then_some(damped)
}
