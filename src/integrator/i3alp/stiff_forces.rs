//! Error control with stiff forces (friction, servos, stops, contact): errors of the rates and of the energy balance, which the link angles
//! do not reveal; and the work of drives (`docs/method.md`, section 5.6).

use super::Settings;
use crate::integrator::{Implicit, State, StepEnd, TangentPoint};
use crate::vector::Vector;

/// Rate added to |q̇| in the admissible error of a rate, 1/s: this sum times the error tolerance of an angle.
pub(super) const STIFF_RATE: f64 = 100.0;
/// Round-off of the energy balance, in machine epsilons of the energy scale.
const ENERGY_ROUND_OFF: f64 = 256.0;
/// Round-off of the energy balance, in machine epsilons of the largest joint force along the machine's length.
const WORK_ROUND_OFF: f64 = 4.0;
/// Ratio of rate error and tolerance below which the balance is limited by round-off of the positions.
const EXACT: f64 = 1e-4;

/// Local error with stiff forces, rad, and the [`drive_work`], J. The error is the larger of two: the rate error, in units of
/// [`STIFF_RATE`] + |q̇|, and the error of the energy balance, in units of the energy scale. A step across a discontinuity changes the
/// motion little but the work much. `separated` is the loss of separated springs, J.
#[cold]
pub(super) fn stiff_error<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    settings: &Settings,
    from: &State<N, M>,
    h: f64,
    (to, pose, separated): (&StepEnd<N, M>, &S::Pose, f64),
) -> (f64, f64) {
    let unpredicted = unpredicted(from, to, h);
    let mut rates = rate_error(system, h, &unpredicted, &to.v);
    if rates > settings.error_tolerance {
        // Oscillations of decaying components are filtered out (Hairer and Wanner II, section IV.8).
        let filtered = filtered(system, settings, h, (pose, to), &unpredicted);
        rates = filtered.map_or(rates, |filtered| rate_error(system, h, &filtered, &to.v));
    }
    let start_pose = system.pose(&from.q);
    let driven = drive_work(system, h, (from, &start_pose), (to, pose));
    let before = system.energy(&from.q, &start_pose, &from.v);
    let done = h / 2.0 * (from.power.net() + to.power.net()) + driven - separated;
    let balance = system.energy(&to.q, pose, &to.v) - before - done;
    let off = before - settings.energy_at_start - from.work.net();
    // Joint forces do work along the round-off of the positions. This work limits the balance if the motion is otherwise exact.
    let position_scale = if rates < EXACT * settings.error_tolerance { system.length_scale() } else { 0.0 };
    let noise = f64::EPSILON * (ENERGY_ROUND_OFF * settings.energy_scale + WORK_ROUND_OFF * position_scale * to.lambda.max_norm());
    let allowed = settings.error_tolerance * settings.energy_scale * balance_factor(settings, off, balance);
    (rates.max(settings.error_tolerance * balance.abs() / allowed.max(noise)), driven)
}

/// Change of q̈ over a step that the jerk did not predict.
pub(super) fn unpredicted<const N: usize, const M: usize>(from: &State<N, M>, to: &StepEnd<N, M>, h: f64) -> Vector<N> {
    to.a - from.a - h * from.jerk
}

/// Product (M + h/2 C + h²/4 K)⁻¹ M x with the tangents at the end of a step; it reduces fast components of x. `None` if the matrix is not
/// positive definite.
pub(super) fn filtered<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    settings: &Settings,
    h: f64,
    (pose, end): (&S::Pose, &StepEnd<N, M>),
    x: &Vector<N>,
) -> Option<Vector<N>> {
    let at = TangentPoint { q: &end.q, pose, v: &end.v, lambda: &end.lambda, h };
    system.solve_tangent(&at, settings.regularization, &system.mass_times(pose, x), &Vector::ZERO).ok().map(|(x, _)| x)
}

/// Work of drives beyond the trapezoidal rule for their power, J. The mean force (Q₀ + Q₁)/2 along the displacement does the work
/// h/2 (P₀ + P₁) − h/4 (Q₁ − Q₀)·(q̇₁ − q̇₀). This is consistent with the rule for the motion: a linear drive neither loses nor gains
/// energy.
fn drive_work<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    h: f64,
    (from, start_pose): (&State<N, M>, &S::Pose),
    (to, pose): (&StepEnd<N, M>, &S::Pose),
) -> f64 {
    let drive_forces = [(&from.q, start_pose, &from.v), (&to.q, pose, &to.v)].map(|(q, pose, v)| system.drive_forces(q, pose, v));
    let [Some(before), Some(after)] = drive_forces else { return 0.0 };
    -h / 4.0 * (after - before).dot(&(to.v - from.v))
}

/// Factor on the admissible error of the energy balance of one step. It falls as the accumulated error `off`, J, grows, because errors of
/// thousands of bounces add up.
fn balance_factor(settings: &Settings, off: f64, balance: f64) -> f64 {
    /// Admissible accumulated error of the energy, in units of energy scale times error tolerance. It is large because the sum of step
    /// errors falls only with the power 2/3 of the tolerance.
    const BUDGET: f64 = 2000.0;
    /// Smallest factor, so that the controller still accepts steps.
    const LEAST: f64 = 0.02;
    if off * balance <= 0.0 {
        return 1.0;
    }
    (1.0 - off.abs() / (BUDGET * settings.energy_scale * settings.error_tolerance)).max(LEAST)
}

/// Error of the rates from an unpredicted change of q̈, in units of [`STIFF_RATE`] + |q̇|, as an angle, rad.
pub(super) fn rate_error<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    h: f64,
    unpredicted: &Vector<N>,
    v: &Vector<N>,
) -> f64 {
    h / 12.0 * system.error_norm(unpredicted) / (STIFF_RATE + system.error_norm(v))
}
