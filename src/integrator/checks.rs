//! Checks of each step against properties that every correct step has, whatever the method: the balance of energy, the signs of the
//! singularity determinants, and the branch of the closure. `docs/checks.md` describes correct steps, and the margin of the bounds.

use super::{State, StepError, System, Work};
use crate::vector::Vector;

/// Admissible imbalance of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Imbalance {
    /// Relative to the energies.
    part: f64,
    /// Energy, J, that is always added to the energies, because errors of the forces remain if little moves.
    always: f64,
}

impl Imbalance {
    /// For steps with rates as accurate as angles, from the error tolerance, rad, and the energy scale, J.
    pub(super) fn of_tolerance(tolerance: f64, energy_scale: f64) -> Self {
        Self { part: 1e3 * tolerance.max(LEAST_TOLERANCE), always: energy_scale }
    }

    /// For steps of third order with rates less accurate than angles, from the error tolerance, rad, and the energy scale, J. The exponent,
    /// 3/4, is between the order 2/3 of the rates and 1, as measured.
    pub(super) fn of_third_order(tolerance: f64, energy_scale: f64) -> Self {
        let tolerance = tolerance.max(LEAST_TOLERANCE);
        Self { part: 3e3 * (tolerance * tolerance.sqrt()).sqrt(), always: energy_scale }
    }

    /// For steps that conserve energy, from the energy scale, J.
    pub(super) fn of_conserving(energy_scale: f64) -> Self {
        Self { part: 1e-6, always: energy_scale }
    }

    /// For steps without error control, from the energy scale, J.
    pub(super) fn of_fixed_steps(energy_scale: f64) -> Self {
        Self { part: 1e-2, always: energy_scale }
    }
}

/// Error tolerance, rad, below which the balance of a step is only round-off.
const LEAST_TOLERANCE: f64 = 1e-11;
/// Round-off, in machine epsilons: of energies and work relative to their sizes, and of sines far from a loss of rank.
const ROUND_OFF: f64 = 1e3;
/// Round-off of a sine, in machine epsilons, times the distance from a loss of rank of the constraints: the condition number of Φ_q grows
/// as 1 / distance. Observed values are up to 10; the same margin as for local errors near a vertex.
const ROUND_OFF_AT_DISTANCE: f64 = 64.0;
/// Largest distance from a singularity at which a sign may change, in displacements of a link that follow from the rates and accelerations
/// at both ends of the step. Two links turn, and the motion inside a long step is unknown.
const REACH: f64 = 8.0;

/// The quantities of a motion that checks compare.
#[derive(Clone, Copy, Debug)]
pub(super) struct Checked<'a, const N: usize> {
    /// Coordinates, m and rad.
    pub(super) q: &'a Vector<N>,
    /// Velocities, m/s and rad/s.
    pub(super) v: &'a Vector<N>,
    /// Accelerations, m/s² and rad/s²; 0 for methods that do not store them.
    pub(super) a: &'a Vector<N>,
    /// Kinetic plus potential energy, J.
    pub(super) energy: f64,
    /// Work since the start, J.
    pub(super) work: Work,
    /// Signs of the singularity determinants, see [`System::configuration_signs`].
    pub(super) configuration_signs: u8,
    /// Last branch that a state of the motion determined, see [`System::branch`].
    pub(super) branch: Option<u8>,
}

/// Quantities at the beginning of a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beginning {
    energy: f64,
    work: Work,
    configuration_signs: u8,
    branch: Option<u8>,
    /// Largest rate, rad/s, and acceleration, rad/s², of a link.
    rates: [f64; 2],
}

impl Beginning {
    /// Records the beginning of a step.
    #[inline(always)]
    pub(super) fn of<const N: usize, const M: usize>(system: &impl System<N, M>, from: &Checked<'_, N>) -> Self {
        let &Checked { v, a, energy, work, configuration_signs, branch, .. } = from;
        let rates = [system.error_norm(v), system.error_norm(a)];
        Self { energy, work, configuration_signs, branch, rates }
    }

    /// Refuses a step of `h` seconds that ends at `to` if its energy is out of balance, a sign changed away from its singularity, or the
    /// branch of the closure changed.
    #[inline(always)]
    pub(super) fn check<const N: usize, const M: usize>(
        &self,
        system: &impl System<N, M>,
        Imbalance { part, always }: Imbalance,
        to: &Checked<'_, N>,
        h: f64,
    ) -> Result<(), StepError> {
        let done = to.work.net() - self.work.net();
        let off = to.energy - self.energy - done;
        let is_balanced = off.abs() <= part * (to.energy.abs() + always);
        if !is_balanced {
            check_imbalance(to, off, part * (to.energy.abs() + done.abs() + always))?;
        }
        if to.configuration_signs != self.configuration_signs {
            check_signs(system, to, to.configuration_signs ^ self.configuration_signs, (self.rates, h))?;
        }
        // If the end determines no branch, the branch of the beginning is kept.
        if to.branch == self.branch || self.branch.is_none() { Ok(()) } else { Err(StepError::BranchChange) }
    }
}

/// Makes a step of fixed length and counts it if it fails the checks. The step is not refused, because steps of fixed length serve to
/// compare errors.
pub fn count_breaches<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    energy_scale: impl FnOnce() -> f64,
    state: &mut State<N, M>,
    h: f64,
    step: impl FnOnce(&mut State<N, M>) -> Result<(), StepError>,
) -> Result<(), StepError> {
    let beginning = state.checked().map(|from| Beginning::of(system, &from));
    step(state)?;
    let (Some(beginning), Some(to)) = (beginning, state.checked()) else { return Ok(()) };
    let checked = beginning.check(system, Imbalance::of_fixed_steps(energy_scale()), &to, h);
    state.counters.breaches += u64::from(checked.is_err());
    Ok(())
}

/// Refuses an imbalance `off`, J, that exceeds the admissible imbalance by more than round-off, and an energy that is not finite.
#[cold]
#[inline(never)]
fn check_imbalance<const N: usize>(to: &Checked<'_, N>, off: f64, admissible: f64) -> Result<(), StepError> {
    let sizes = to.energy.abs() + to.work.input.abs() + to.work.dissipated.abs();
    let admissible = admissible + ROUND_OFF * f64::EPSILON * sizes;
    if off.abs() <= admissible {
        return Ok(());
    }
    Err(if off.is_finite() && admissible.is_finite() { StepError::Imbalance { off, admissible } } else { StepError::NotFinite })
}

/// Refuses `changed` signs, one bit each, if the posture is farther from their singularity than it can have moved in `h` seconds, judged by
/// rates and accelerations at both ends. On a branch that is singular everywhere (folded legs), round-off alone changes signs.
#[cold]
#[inline(never)]
fn check_signs<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    to: &Checked<'_, N>,
    changed: u8,
    ([rate, acceleration], h): ([f64; 2], f64),
) -> Result<(), StepError> {
    let displacement = h * (rate + system.error_norm(to.v) + h * (acceleration + system.error_norm(to.a)));
    let sines = system.determinants(&system.pose(to.q));
    let distance = sines.into_iter().fold(0.0, |largest: f64, sine| largest.max(sine.abs()));
    let round_off = f64::max(ROUND_OFF, ROUND_OFF_AT_DISTANCE / distance) * f64::EPSILON;
    let admissible = REACH * displacement + round_off;
    for (determinant, sine) in sines.into_iter().enumerate() {
        if changed >> determinant & 1 == 1 && sine.abs() > admissible {
            return Err(StepError::SignWithoutSingularity { determinant, sine, admissible });
        }
    }
    Ok(())
}
