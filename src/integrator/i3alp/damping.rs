//! Where friction or a drive is so stiff that rates decay within a small part of a sub-step, its end is damped.
//!
//! The trapezoidal rule turns what decays at a rate ρ ≫ 1/h by R = (1 − z/2)/(1 + z/2) → −1, z = hρ: it rings, and with it the accelerations,
//! which are ρ times the rates. With P = (M + h/2 C + h²/4 K)⁻¹ M, which is 1/(1 + z/2) there, the rates at the end become
//!
//! ```text
//! q̇ + h/2 P (1 − P)³ q̈      so that R becomes R (1 − (1 − P)⁴) → −8/z → 0
//! ```
//!
//! and of what is slow, z → 0, they change by z⁴/16, below the error of the rule, z³/12: the order stays what it is. Sub-steps are damped only
//! where what they did not foretell of q̈ is stiff.

use super::Settings;
use super::stiff_forces::rate_error;
use crate::integrator::{Implicit, State, StepEnd, TangentPoint};
use crate::vector::Vector;

/// How often 1 − P is applied.
const POWER: u32 = 3;
/// Of the tolerance, the error of the rates from which on it is looked whether they ring.
const NOTICED: f64 = 0.01;
/// The part of a change of q̈ that P lets through where it is stiff: z > 8.
const STIFF: f64 = 0.2;

/// The end of a sub-step, damped where it is stiff.
#[cold]
#[inline(never)]
pub(super) fn damped<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    settings: &Settings,
    from: &State<N, M>,
    h: f64,
    (pose, mass): (&S::Pose, &S::Mass),
    end: StepEnd<N, M>,
) -> StepEnd<N, M> {
    let bend = end.a - from.a - h * from.jerk;
    if system.holds() || rate_error(system, h, &bend, &end.v) <= NOTICED * settings.error_tolerance {
        return end;
    }
    let at = TangentPoint { q: &end.q, pose, v: &end.v, lambda: &end.lambda, h };
    let let_through = |x: &Vector<N>| {
        system
            .solve_tangent_out_of_line(&at, settings.regularization, (&system.mass_times(pose, x), &Vector::ZERO))
            .ok()
            .map(|(x, _)| x)
    };
    // What is not stiff rings within the error.
    if let_through(&bend).is_none_or(|through| system.error_norm(&through) > STIFF * system.error_norm(&bend)) {
        return end;
    }
    let mut rest = end.a;
    for _ in 0..POWER {
        let Some(through) = let_through(&rest) else { return end };
        rest = rest - through;
    }
    let Some(change) = let_through(&rest) else { return end };
    let damped = StepEnd::in_balance(system, [end.q, end.v + h / 2.0 * change], pose, mass);
    // Beyond the turn of a force its slope says too much.
    if system.error_norm(&damped.a) <= system.error_norm(&end.a) { damped } else { end }
}
