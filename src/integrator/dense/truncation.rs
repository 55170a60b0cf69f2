//! A step that ends at a border on its own interpolant: the part before the border is the step, where the interpolant is the motion.
//!
//! An interpolant is the motion of forces that differ by its defect: the difference between its derivative and what the equations make of
//! its values (W. H. Enright, *A new error-control for initial value solvers*, Applied Mathematics and Computation 31, 1989). What the
//! defect adds up to on the way to the border is judged like the error of a step.

use super::events::EventWindow;
use super::sample::worked;
use super::trial::{StageDerivative, StepResult, larger};
use super::{DenseStep, Scheme, Settings};
use crate::integrator::state::StepEnd;
use crate::integrator::{Events, Passage, System, Work};
use crate::vector::Vector;

/// The defect may add up to so many errors that are allowed.
const GREATEST_DEFECT: f64 = 0.1;
/// So many corrections bring the end to the border, or none.
const MOST_CORRECTIONS: u32 = 4;

/// A place of the interpolant on the constraints: iterations of the projection, q and q̇, pose and mass factor.
type Candidate<const N: usize, P, F> = (u32, [Vector<N>; 2], P, F);

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Ends the step at a border that its interpolant crosses after so many seconds; false, and nothing has changed, if that is not as good as
    /// a step up to there.
    #[inline(never)]
    pub(super) fn cut<S>(&mut self, system: &S, settings: &Settings, mut when: f64) -> bool
    where
        S: System<N, M> + Passage<N> + Events<N, Mode = K>,
    {
        for _ in 0..MOST_CORRECTIONS {
            let Some(place) = self.place(system, settings, when) else { return false };
            let [q, v] = place.1;
            // The acceleration is the interpolant's: it is for the way that is left only.
            let a = (1.0 / self.length) * self.velocities().rate_at(when / self.length);
            match EventWindow::of(system, settings, [&q, &v, &a], self.length) {
                EventWindow::Within => return self.cut_at(system, settings, when, place),
                EventWindow::Off(Some(later)) if 0.0 < when + later && when + later < self.length => when += later,
                EventWindow::Off(_) => return false,
            }
        }
        false
    }

    /// The same at exactly this time.
    pub(super) fn cut_again<S>(&mut self, system: &S, settings: &Settings, when: f64) -> bool
    where
        S: System<N, M> + Passage<N> + Events<N, Mode = K>,
    {
        self.place(system, settings, when).is_some_and(|place| self.cut_at(system, settings, when, place))
    }

    /// What the interpolant says so many seconds from the beginning, on the constraints.
    fn place<S: System<N, M> + Passage<N>>(
        &self,
        system: &S,
        settings: &Settings,
        when: f64,
    ) -> Option<Candidate<N, S::Pose, S::Mass>> {
        if self.scheme != Scheme::Dop853 || self.energy_target(system, self.length).is_some() {
            return None;
        }
        let [mut q, mut v] = self.moved(when / self.length);
        let (iterations, pose, mass) = settings.project(system, &mut q, &mut v).ok()?;
        Some((iterations, [q, v], pose, mass))
    }

    fn cut_at<S>(
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
        let (positions, velocities, work) = (self.positions(), self.velocities(), self.works());
        let slip = |part: f64| part * (positions.rate_at(part) - self.length * velocities.at(part));
        let defects = [
            larger(&larger(&Vector::ZERO, &slip(part)), &slip(0.5 * part)),
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
        let (q, v, w) = (positions.cut(part), velocities.cut(part), work.cut(part));
        let mut gained = worked(&work, part);
        gained.input -= self.start.work.input;
        gained.dissipated -= self.start.work.dissipated;
        let tried = self.length;
        self.retract();
        self.accept(&StepResult { iterations, end_state, work: gained }, when, Scheme::Dop853);
        self.dense = std::array::from_fn(|k| StageDerivative { q: q[k], v: v[k], power: Work::of_pair(w[k]) });
        self.cut_from = tried;
        true
    }
}
