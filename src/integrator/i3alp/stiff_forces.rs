//! Where forces change steeply with the motion: what the angles of a sub-step do not tell about it, and the work of drives.

use super::Settings;
use crate::integrator::{Events, Extremes, Implicit, State, StepEnd, TangentPoint, Work};
use crate::vector::Vector;

/// A rate may be off by what an angle may, times this and its own magnitude, 1/s.
pub(super) const RATE: f64 = 100.0;
/// Round-off of the balance of energy, in that of the energy scale and in that of the work of the joints' forces along the size of the machine.
const OF_ENERGIES: f64 = 256.0;
const OF_WORK: f64 = 4.0;
/// A motion is as good as exact where rates are off by this part of the tolerance.
const EXACT: f64 = 1e-4;

/// Where forces change steeply: what the angles do not tell, in their unit. The error of the rates, from the change of q̈ that the last step
/// did not foretell, counts in units of [`RATE`] + |q̇|; what the balance of energy is off in the step, in units of the energy scale: a
/// step across a kink leaves the motion almost right, and its work not. Infinite where the step may have overlooked a touch.
#[cold]
pub(super) fn steep_error<const N: usize, const M: usize, S: Implicit<N, M> + Events<N>>(
    system: &S,
    settings: &Settings,
    from: &State<N, M>,
    h: f64,
    (pose, to): (&S::Pose, &StepEnd<N, M>),
) -> f64 {
    if system.may_make_contact() && may_overlook(system, settings, [&[from.q, from.v, from.a], &[to.q, to.v, to.a]], h) {
        return f64::INFINITY;
    }
    let bend = to.a - from.a - h * from.jerk;
    let mut rates = rate_error(system, h, &bend, &to.v);
    if rates > settings.error_tolerance {
        // What decays much faster than a step, and rings, is seen as the step's own matrix lets it through (Hairer and Wanner, section IV.8).
        let at = TangentPoint { q: &to.q, pose, v: &to.v, lambda: &to.lambda, h };
        let inertia = system.mass_times(pose, &bend);
        rates = system
            .solve_tangent_out_of_line(&at, settings.regularization, (&inertia, &Vector::ZERO))
            .map_or(rates, |(bend, _)| rate_error(system, h, &bend, &to.v));
    }
    let external_work = |work: Work| work.input - work.dissipated;
    let before = system.energy(&from.q, &system.pose(&from.q), &from.v);
    let done = h / 2.0 * (external_work(from.power) + external_work(to.power)) + drive_work(system, h, from, to);
    let balance = system.energy(&to.q, pose, &to.v) - before - done;
    let off = before - settings.energy_at_start - external_work(from.work);
    // A place is known within round-off, and a force does work along it: all that is left where the motion is as good as exact.
    let place = if rates < EXACT * settings.error_tolerance { system.length_scale() } else { 0.0 };
    let noise = f64::EPSILON * (OF_ENERGIES * settings.energy_scale + OF_WORK * place * to.lambda.max_norm());
    let allowed = settings.error_tolerance * settings.energy_scale * strictness(settings, off, balance);
    rates.max(settings.error_tolerance * balance.abs() / allowed.max(noise))
}

/// What drives put in beyond the trapezoidal rule for their power, J: the mean of their forces Q at both ends times the way is
/// h/2 (P₀ + P₁) − h/4 (Q₁ − Q₀)·(q̇₁ − q̇₀), which is what the rule for the motion does with a stiff drive: of a linear one nothing is lost
/// or gained.
pub(super) fn drive_work<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    h: f64,
    from: &State<N, M>,
    to: &StepEnd<N, M>,
) -> f64 {
    let (Some(before), Some(after)) = (system.drives(&from.q, &from.v), system.drives(&to.q, &to.v)) else { return 0.0 };
    -h / 4.0 * (after - before).dot(&(to.v - from.v))
}

/// By how much less a step may add to what the balance of energy is off already, J: thousands of bounces in a row add up.
fn strictness(settings: &Settings, off: f64, balance: f64) -> f64 {
    /// The balance may be off by this part of the energy scale, times the error tolerance: what steps add up to by themselves falls as its
    /// power of 2/3 only.
    const BUDGET: f64 = 2000.0;
    const LEAST: f64 = 0.02;
    if off * balance <= 0.0 {
        return 1.0;
    }
    (1.0 - off.abs() / (BUDGET * settings.energy_scale * settings.error_tolerance)).max(LEAST)
}

/// The error of the rates from a change of q̈ that was not foretold, in units of [`RATE`] + |q̇|, as an angle, rad.
pub(super) fn rate_error<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    h: f64,
    bend: &Vector<N>,
    v: &Vector<N>,
) -> f64 {
    h / 12.0 * system.error_norm(bend) / (RATE + system.error_norm(v))
}

/// Whether between two states, given by q, q̇ and q̈, h seconds apart, something may have touched more deeply than they show.
fn may_overlook<const N: usize>(system: &impl Events<N>, settings: &Settings, [from, to]: [&[Vector<N>; 3]; 2], h: f64) -> bool {
    /// By how much rates and accelerations on the way may exceed those at its ends.
    const MARGIN: f64 = 1.5;
    let [before, after] = [from, to].map(|[q, v, _]| system.guard_values(q, v));
    let [rates, accelerations] = [1, 2].map(|order| Vector::from_fn(|i| MARGIN * from[order][i].abs().max(to[order][i].abs())));
    let extremes = Extremes { rates, accelerations, higher: None };
    !system.stays_within([&before, &after], h, &extremes, settings.error_tolerance)
}
