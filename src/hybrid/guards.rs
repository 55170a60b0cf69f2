//! Guards: functions of the state with zeros where a force law changes its smooth branch. Guards belong to the kinks that effects declare
//! and to set-valued dry friction.

use arrayvec::ArrayVec;

use super::Extremes;
use super::friction::FrictionGuards;
use super::kink::{INDICATORS_PER_KINK, Kink};
use super::mode::{KINKS, Mode};
use crate::integrator::{Guards, Residuals};

/// Number of event indicators of all kinks.
pub const INDICATORS: usize = INDICATORS_PER_KINK * KINKS;

/// Kinks at a state.
pub type Kinks<'a> = ArrayVec<Kink<'a>, KINKS>;

/// Guard values at a state, in a mode.
pub struct GuardValues<'a> {
    mode: Mode,
    kinks: Kinks<'a>,
    friction_guards: FrictionGuards,
}

impl<'a> GuardValues<'a> {
    /// Guard values of kinks and friction at a state.
    pub fn new(mode: Mode, kinks: Kinks<'a>, friction_guards: FrictionGuards) -> Self {
        Self { mode, kinks, friction_guards }
    }

    /// The mode with all kinks in the phases of this state.
    pub fn with_present_phases(&self, mut mode: Mode) -> Mode {
        for kink in &self.kinks {
            mode.kinks[kink.place] = Some(kink.law.phase(kink.x, kink.rate));
        }
        mode
    }

    /// Event indicators, m or rad. Each changes sign at a discontinuity of a force law; 1 for kinks of effects that are off.
    pub fn indicators(&self) -> [f64; INDICATORS] {
        let mut indicators = [1.0; INDICATORS];
        for kink in &self.kinks {
            indicators.as_chunks_mut::<INDICATORS_PER_KINK>().0[kink.place] = kink.law.indicators(kink.x, kink.rate);
        }
        indicators
    }

    /// The mode after the transitions of all kinks with a passed border or, if no guard is passed, of the kink nearest to its border.
    pub fn next_mode(&self, tolerance: f64) -> Mode {
        let nearest = self.residuals(tolerance).largest.min(0.0);
        let mut next_mode = self.mode;
        for kink in &self.kinks {
            let (next, residual) = kink.deciding(&self.mode, tolerance);
            if residual >= nearest {
                next_mode.kinks[kink.place] = Some(next);
            }
        }
        next_mode
    }
}

impl Guards for GuardValues<'_> {
    type PathBounds = Extremes;

    /// The tolerance is an angle, rad. If the whole mechanism is at rest, no place breaks away by itself.
    fn residuals(&self, tolerance: f64) -> Residuals {
        let largest = self.kinks.iter().fold(f64::NEG_INFINITY, |most, kink| most.max(kink.deciding(&self.mode, tolerance).1));
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
        self.kinks.iter().map(|kink| kink.law.separation_energy(kink.phase(&self.mode), kink.x)).sum()
    }

    fn dwell_time(&self) -> f64 {
        let lasting = self.kinks.iter().map(|kink| kink.law.dwell_time(kink.phase(&self.mode), kink.x, kink.rate));
        lasting.fold(f64::INFINITY, f64::min)
    }

    /// True if all laws stay in their phases and slip keeps its direction.
    fn are_out_of_reach(&self, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        self.friction_guards.iter().all(|guard| guard.is_out_of_reach(duration, extremes, tolerance))
            && self.kinks.iter().all(|kink| kink.is_out_of_reach(&self.mode, duration, extremes, tolerance))
    }

    /// True if all laws stay in their phases and slip keeps its direction.
    fn stay_until(&self, to: &Self, duration: f64, extremes: &Extremes, tolerance: f64) -> bool {
        let mut slips = self.friction_guards.iter().zip(&to.friction_guards);
        let mut phases = self.kinks.iter().zip(&to.kinks);
        slips.all(|(from, to)| from.stays(to, duration, extremes, tolerance))
            && phases.all(|(from, to)| from.stays(to, &self.mode, duration, extremes, tolerance))
    }
}
