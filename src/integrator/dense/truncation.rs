//! Truncation of a step at an event: the part of its interpolant before the event becomes the step.
//!
//! An interpolant solves equations with forces that differ by its defect, the difference between its derivative and the right-hand
//! side at its values (W. H. Enright, *A new error-control for initial value solvers*, Applied Mathematics and Computation 31,
//! 1989). The defect, integrated up to the event, is judged like the error of a step.

use super::events::EventWindow;
use super::sample::work_until;
use super::trial::{StageDerivative, StepResult, max_magnitude};
use super::{DenseStep, Scheme, Settings};
use crate::integrator::state::StepEnd;
use crate::integrator::{Events, Passage, System, Work};
use crate::vector::Vector;

/// Largest integrated defect, in units of the admissible error.
const GREATEST_DEFECT: f64 = 0.1;
/// Largest number of corrections that bring the end into the window of the event.
const MOST_CORRECTIONS: u32 = 4;

/// Projected state of the interpolant: iterations of the projection, q and q̇, pose and mass factor.
type Candidate<const N: usize, P, F> = (u32, [Vector<N>; 2], P, F);

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Ends the step at an event that its interpolant shows `when` seconds after the beginning; returns false and changes nothing
    /// if the result would be less accurate than a step up to there.
    #[inline(never)]
    pub(super) fn truncate<S>(&mut self, system: &S, settings: &Settings, mut when: f64) -> bool
    where
        S: System<N, M> + Passage<N> + Events<N, Mode = K>,
    {
        for _ in 0..MOST_CORRECTIONS {
            let Some(candidate) = self.candidate(system, settings, when) else { return false };
            let [q, v] = candidate.1;
            // The interpolant's acceleration suffices, since it is used for the remaining correction only.
            let a = (1.0 / self.length) * self.velocities().rate_at(when / self.length);
            match EventWindow::of(system, settings, [&q, &v, &a], self.length) {
                EventWindow::Within => return self.truncate_at(system, settings, when, candidate),
                EventWindow::Outside(Some(later)) if 0.0 < when + later && when + later < self.length => when += later,
                EventWindow::Outside(_) => return false,
            }
        }
        false
    }

    /// Ends the step at exactly `when` seconds after the beginning, as [`Self::truncate`] did before.
    pub(super) fn truncate_again<S>(&mut self, system: &S, settings: &Settings, when: f64) -> bool
    where
        S: System<N, M> + Passage<N> + Events<N, Mode = K>,
    {
        self.candidate(system, settings, when).is_some_and(|candidate| self.truncate_at(system, settings, when, candidate))
    }

    /// Projected interpolant `when` seconds after the beginning of the step.
    fn candidate<S: System<N, M> + Passage<N>>(
        &self,
        system: &S,
        settings: &Settings,
        when: f64,
    ) -> Option<Candidate<N, S::Pose, S::Mass>> {
        if self.scheme != Scheme::Dop853 || self.energy_target(system, self.length).is_some() {
            return None;
        }
        let [mut q, mut v] = self.interpolated_state(when / self.length);
        let (iterations, pose, mass) = settings.project(system, &mut q, &mut v).ok()?;
        Some((iterations, [q, v], pose, mass))
    }

    fn truncate_at<S>(
        &mut self,
        system: &S,
        settings: &Settings,
        when: f64,
        (iterations, state, pose, mass): Candidate<N, S::Pose, S::Mass>,
    ) -> bool
    where
        S: System<N, M> + Passage<N> + Events<N, Mode = K>,
    {
        let Ok(end_state) = StepEnd::in_balance(system, state, &pose, &mass).finite() else { return false };
        let part = when / self.length;
        let (positions, velocities, work) = (self.positions(), self.velocities(), self.work_interpolant());
        let slip = |part: f64| part * (positions.rate_at(part) - self.length * velocities.at(part));
        let defects = [
            max_magnitude(&max_magnitude(&Vector::ZERO, &slip(part)), &slip(0.5 * part)),
            part * (velocities.rate_at(part) - self.length * end_state.a),
        ];
        let power = || {
            let defect = part * (work.rate_at(part) - self.length * end_state.power.pair());
            Work::of_pair(defect)
        };
        let rates = [&self.start.v, &end_state.v];
        let sum = settings.error_weights(system).mean_square(defects, rates, power);
        if sum.is_nan() || sum > GREATEST_DEFECT * GREATEST_DEFECT {
            return false;
        }
        let (q, v, w) = (positions.truncate(part), velocities.truncate(part), work.truncate(part));
        let mut gained = work_until(&work, part);
        gained.input -= self.start.work.input;
        gained.dissipated -= self.start.work.dissipated;
        let tried = self.length;
        self.reset_to_start();
        self.accept(&StepResult { iterations, end_state, work: gained }, when, Scheme::Dop853);
        self.dense = std::array::from_fn(|k| StageDerivative { q: q[k], v: v[k], power: Work::of_pair(w[k]) });
        self.truncated_from = tried;
        true
    }
}
