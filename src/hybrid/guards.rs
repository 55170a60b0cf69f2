//! Guards: functions of the state with zeros where a force law changes its smooth branch. They belong to the unilateral springs of stops
//! and contact (penetration, ramp, push) and to set-valued dry friction. Smooth friction and servos have no guards.

use arrayvec::ArrayVec;

use super::Extremes;
use super::friction::FrictionGuards;
use super::mode::{INDICATORS, Mode, Phase, SPRINGS};
use super::unilateral::UnilateralGuard;
use crate::integrator::{Guards, Residuals};

/// Unilateral springs at a state.
pub type UnilateralGuards<'a> = ArrayVec<UnilateralGuard<'a>, SPRINGS>;

/// Guard values at a state, in a mode.
pub struct GuardValues<'a> {
    mode: Mode,
    springs: UnilateralGuards<'a>,
    friction_guards: FrictionGuards,
}

impl<'a> GuardValues<'a> {
    /// Guard values of springs and friction at a state.
    pub fn new(mode: Mode, springs: UnilateralGuards<'a>, friction_guards: FrictionGuards) -> Self {
        Self { mode, springs, friction_guards }
    }

    /// The mode with all springs in the phases of this state.
    pub fn with_present_phases(&self, mut mode: Mode) -> Mode {
        for guard in &self.springs {
            mode.springs[guard.place] = Some(guard.spring.phase(guard.depth, guard.rate));
        }
        mode
    }

    /// Event indicators, m or rad. Each changes sign at a discontinuity of a force law; 1 for absent springs.
    pub fn indicators(&self) -> [f64; INDICATORS] {
        let mut indicators = [1.0; INDICATORS];
        for guard in &self.springs {
            indicators[3 * guard.place..][..3].copy_from_slice(&guard.spring.indicators(guard.depth, guard.rate));
        }
        indicators
    }

    /// The mode after the transitions of all springs with a passed guard or, if no guard is passed, of the spring nearest to its guard.
    pub fn next_mode(&self, tolerance: f64) -> Mode {
        let nearest = self.residuals(tolerance).largest.min(0.0);
        let mut next_mode = self.mode;
        for guard in &self.springs {
            let (phase_guard, residual) = guard.deciding(&self.mode, tolerance);
            if residual >= nearest {
                next_mode.springs[guard.place] = Some(guard.spring.phase_past(phase_guard, guard.depth));
            }
        }
        next_mode
    }
}

impl Guards for GuardValues<'_> {
    type PathBounds = Extremes;

    /// The tolerance is an angle, rad. If the whole mechanism is at rest, no place breaks away by itself.
    fn residuals(&self, tolerance: f64) -> Residuals {
        let largest = self.springs.iter().fold(f64::NEG_INFINITY, |most, guard| most.max(guard.deciding(&self.mode, tolerance).1));
        self.friction_guards.iter().fold(Residuals { largest, breakaway: f64::NEG_INFINITY }, |most, guard| {
            let residual = guard.guard_residual(tolerance);
            let sticks = !self.mode.stick_slip.at_rest() && guard.state.sticks();
            Residuals {
                largest: most.largest.max(residual).max(guard.carried_residual(tolerance)),
                breakaway: if sticks { most.breakaway.max(residual) } else { most.breakaway },
            }
        })
    }

    fn separation_energy(&self) -> f64 {
        let free = self.springs.iter().filter(|guard| guard.depth > 0.0 && guard.phase(&self.mode) == Phase::Free);
        free.map(|guard| guard.spring.potential(Phase::Free, guard.depth)).sum()
    }

    /// Time for which springs on their ramps stay there.
    fn dwell_time(&self) -> f64 {
        let lasting = self.springs.iter().map(|guard| guard.spring.dwell_time(guard.phase(&self.mode), guard.depth, guard.rate));
        lasting.fold(f64::INFINITY, f64::min)
    }

    /// True if springs stay in their phases and slip keeps its direction.
    fn are_out_of_reach(&self, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        self.friction_guards.iter().all(|guard| guard.is_out_of_reach(duration, extremes, tolerance))
            && self.springs.iter().all(|guard| guard.is_out_of_reach(&self.mode, duration, extremes, tolerance))
    }

    /// True if springs stay in their phases and slip keeps its direction.
    fn stay_until(&self, to: &Self, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let mut slips = self.friction_guards.iter().zip(&to.friction_guards);
        let mut phases = self.springs.iter().zip(&to.springs);
        slips.all(|(from, to)| from.stays(to, duration, extremes, tolerance))
            && phases.all(|(from, to)| from.stays(to, &self.mode, duration, extremes, tolerance))
    }
}
