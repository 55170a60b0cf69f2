//! Checks of each step against what no right step breaks, whatever the method: the balance of energy, the signs of the singularity
//! determinants, and the branch of the closure. `docs/checks.md` says what right steps show, and how far beyond that the bounds are.

use super::{State, StepError, System, Work};
use crate::vector::Vector;

/// Admissible imbalance of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Imbalance {
    /// As a part of the energies.
    part: f64,
    /// Energy that always counts, J: errors of the forces remain where little moves.
    always: f64,
}

impl Imbalance {
    /// Of steps whose rates are as accurate as their angles, at an error tolerance, rad, and energy scale, J.
    pub(super) fn of_tolerance(tolerance: f64, energy_scale: f64) -> Self {
        Self { part: 1e3 * tolerance.max(LEAST_TOLERANCE), always: energy_scale }
    }

    /// Of steps whose rates are less accurate than their angles, of third order: between the order 2/3 of the rates and 1, as measured; at
    /// an error tolerance, rad, and energy scale, J.
    pub(super) fn of_third_order(tolerance: f64, energy_scale: f64) -> Self {
        let tolerance = tolerance.max(LEAST_TOLERANCE);
        Self { part: 3e3 * (tolerance * tolerance.sqrt()).sqrt(), always: energy_scale }
    }

    /// Of steps that keep the energy, by the energy scale, J.
    pub(super) fn of_conserving(energy_scale: f64) -> Self {
        Self { part: 1e-6, always: energy_scale }
    }

    /// Of steps whose error nothing controls, by the energy scale, J.
    pub(super) fn of_fixed_steps(energy_scale: f64) -> Self {
        Self { part: 1e-2, always: energy_scale }
    }
}

/// Error tolerance, rad, below which the balance of a step is round-off.
const LEAST_TOLERANCE: f64 = 1e-11;
/// Round-off of energies and work, in machine epsilons of their sizes; of sines, in machine epsilons.
const ROUND_OFF: f64 = 1e3;
/// Distance from a singularity at which a sign may change, in displacements of a link that rates and accelerations at both ends of the
/// step allow: two links turn, and between its ends a long step is not known.
const REACH: f64 = 8.0;

/// A motion, as far as a step is checked.
#[derive(Clone, Copy, Debug)]
pub(super) struct Checked<'a, const N: usize> {
    /// Coordinates, m and rad.
    pub(super) q: &'a Vector<N>,
    /// Velocities, m/s and rad/s.
    pub(super) v: &'a Vector<N>,
    /// Accelerations, m/s² and rad/s²; 0 of methods that do not keep them.
    pub(super) a: &'a Vector<N>,
    /// Kinetic plus potential energy, J.
    pub(super) energy: f64,
    /// Work since the start, J.
    pub(super) work: Work,
    /// Signs of the singularity determinants, see [`System::configuration_signs`].
    pub(super) configuration_signs: u8,
}

/// What is noted of the beginning of a step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Books {
    energy: f64,
    work: Work,
    configuration_signs: u8,
    branch: Option<u8>,
    /// Largest rate, rad/s, and acceleration, rad/s², of a link.
    rates: [f64; 2],
}

impl Books {
    /// Notes the beginning of a step.
    #[inline(always)]
    pub(super) fn open<const N: usize, const M: usize>(system: &impl System<N, M>, from: &Checked<'_, N>) -> Self {
        let &Checked { q, v, a, energy, work, configuration_signs } = from;
        let rates = [system.error_norm(v), system.error_norm(a)];
        Self { energy, work, configuration_signs, branch: system.branch(q, v), rates }
    }

    /// Refuses a step of `h` seconds to `to` that no right step could be.
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
        match self.branch {
            Some(branch) => check_branch(system, to, branch),
            None => Ok(()),
        }
    }
}

/// Makes a step of fixed length, and counts it if it fails the checks. It is not refused: such steps are made to compare their errors.
pub fn count_breaches<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    energy_scale: impl FnOnce() -> f64,
    (state, h): (&mut State<N, M>, f64),
    step: impl FnOnce(&mut State<N, M>) -> Result<(), StepError>,
) -> Result<(), StepError> {
    let books = state.checked().map(|from| Books::open(system, &from));
    step(state)?;
    let (Some(books), Some(to)) = (books, state.checked()) else { return Ok(()) };
    let checked = books.check(system, Imbalance::of_fixed_steps(energy_scale()), &to, h);
    state.counters.breaches += u64::from(checked.is_err());
    Ok(())
}

/// Refuses an imbalance of more than round-off beyond the admissible one, J.
#[cold]
#[inline(never)]
fn check_imbalance<const N: usize>(to: &Checked<'_, N>, off: f64, admissible: f64) -> Result<(), StepError> {
    let sizes = to.energy.abs() + to.work.input.abs() + to.work.dissipated.abs();
    let admissible = admissible + ROUND_OFF * f64::EPSILON * sizes;
    if off.abs() <= admissible { Ok(()) } else { Err(StepError::Imbalance { off, admissible }) }
}

/// Refuses the `changed` signs, one bit each, if the posture is farther from their singularity than rates and accelerations at both ends of
/// the `h` seconds lead. On a branch that is singular all along (folded legs) round-off alone changes signs.
#[cold]
#[inline(never)]
fn check_signs<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    to: &Checked<'_, N>,
    changed: u8,
    ([rate, acceleration], h): ([f64; 2], f64),
) -> Result<(), StepError> {
    let displacement = h * (rate + system.error_norm(to.v) + h * (acceleration + system.error_norm(to.a)));
    let admissible = REACH * displacement + ROUND_OFF * f64::EPSILON;
    for (determinant, sine) in system.determinants(&system.pose(to.q)).into_iter().enumerate() {
        if changed >> determinant & 1 == 1 && sine.abs() > admissible {
            return Err(StepError::SignWithoutSingularity { determinant, sine, admissible });
        }
    }
    Ok(())
}

/// Refuses a motion on another branch.
#[cold]
#[inline(never)]
fn check_branch<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    to: &Checked<'_, N>,
    branch: u8,
) -> Result<(), StepError> {
    if system.branch(to.q, to.v).is_none_or(|after| after == branch) { Ok(()) } else { Err(StepError::BranchChange) }
}
