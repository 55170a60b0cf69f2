//! State at the present time inside the current step: projected interpolant, and work.

use std::borrow::Borrow;

use super::interpolant::Interpolant;
use super::{DenseStep, Scheme, Settings, hermite};
use crate::integrator::{Counters, Events, Passage, State, System, Work};
use crate::vector::Vector;

/// State at the present time inside the current step.
#[derive(Clone, Copy, Debug)]
pub struct Sample<const N: usize, P> {
    /// Coordinates, m and rad.
    pub q: Vector<N>,
    /// Velocities, m/s and rad/s.
    pub v: Vector<N>,
    /// Pose at q.
    pub pose: P,
    /// Work since the start, J.
    pub work: Work,
    /// Signs of the singularity determinants at q, see [`System::configuration_signs`].
    pub(super) configuration_signs: u8,
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// State at the present time on the constraints: inside the step the projected interpolant, or the interpolant itself where the
    /// projection does not converge.
    #[inline]
    pub fn sample<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &self,
        system: &S,
        settings: &Settings,
    ) -> Sample<N, S::Pose> {
        let Self { end, .. } = self;
        if self.elapsed == self.length {
            return Sample {
                q: end.q,
                v: end.v,
                pose: system.pose(&end.q),
                work: end.work,
                configuration_signs: end.configuration_signs,
            };
        }
        if !self.shows_interpolant(system, settings) {
            let mut redone = *self;
            if redone.truncate_and_redo(system, settings).is_ok() {
                return redone.sample(system, settings);
            }
        }
        let ([q, v], work) = self.interpolated(system.on(self.mode).borrow(), settings);
        let (mut on_q, mut on_v) = (q, v);
        let projected =
            if self.is_linear { None } else { settings.project(system.on(self.mode).borrow(), &mut on_q, &mut on_v).ok() };
        let (q, v, pose) = projected.map_or_else(|| (q, v, system.pose(&q)), |(_, pose, _)| (on_q, on_v, pose));
        let configuration_signs = system.configuration_signs(&pose);
        Sample { q, v, pose, work, configuration_signs }
    }

    /// Whether the interpolant is accurate enough to be shown.
    #[inline]
    fn shows_interpolant<S: Events<N> + System<N, M>>(&self, system: &S, settings: &Settings) -> bool {
        !system.has_stiff_forces() || self.is_linear || self.interpolant_is_consistent(settings)
    }

    /// Dissipated work up to the present time inside the step, as far as it has been shown, J.
    pub(super) fn dissipated<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(&self, system: &S, settings: &Settings) -> f64 {
        let Self { start, end, .. } = self;
        if end.work.dissipated > start.work.dissipated && self.shows_interpolant(system, settings) {
            self.interpolated(system.on(self.mode).borrow(), settings).1.dissipated
        } else {
            start.work.dissipated
        }
    }

    /// Writes the parts of a sample that do not depend on the coordinates into a state, whose coordinates may be others.
    pub fn record<const A: usize, const B: usize, P>(&self, sample: &Sample<N, P>, to: &mut State<A, B>) {
        // Counters of the step count once time has passed its end; a start from rest in a vertex counts at once.
        let passed = if self.elapsed == self.length { &self.end } else { &self.start };
        to.configuration_signs = passed.configuration_signs;
        to.counters = Counters { launches: self.end.counters.launches, ..passed.counters };
        to.count_sign_changes(sample.configuration_signs);
        to.work = sample.work;
        to.substep = self.end.substep;
        to.error_estimate = self.end.error_estimate;
        to.alternatives = self.end.alternatives;
        to.on_ray = self.is_linear;
    }

    /// Interpolant at the present time, not projected, with the work.
    #[inline]
    fn interpolated<S: System<N, M> + Passage<N> + Events<N>>(&self, system: &S, settings: &Settings) -> ([Vector<N>; 2], Work) {
        let Self { start, length, .. } = self;
        let part = self.elapsed / length;
        let [q, v] = self.interpolated_state(part);
        let work = if system.follows_work() {
            let (mut end, ends_with) = (self.evaluated_end(system, settings), self.end.work.dissipated);
            // The loss of separated springs is known at every state.
            let mut separation_energy = 0.0;
            if system.has_events() {
                end.work.dissipated -= self.separation_energy(system, [&end.q, &end.v]);
                separation_energy = self.separation_energy(system, [&q, &v]);
            }
            let mut higher = self.dense.map(|slope| slope.power.pair());
            if self.scheme != Scheme::Dop853 && !self.is_linear {
                higher[0] = hermite::work_coefficient(system, [start, &end], *length, &self.positions()).pair();
            }
            let mut work = work_until(&work_interpolant([start, &end], *length, higher), part);
            work.dissipated = (work.dissipated.min(end.work.dissipated) + separation_energy).min(ends_with);
            work
        } else {
            start.work
        };
        ([q, v], work)
    }

    /// Interpolant of the work of a DOP853 step, J.
    pub(super) fn work_interpolant(&self) -> Interpolant<2> {
        work_interpolant([&self.start, &self.end], self.length, self.dense.map(|slope| slope.power.pair()))
    }

    /// Interpolated q and q̇ at a part of the step.
    #[inline]
    pub(super) fn interpolated_state(&self, part: f64) -> [Vector<N>; 2] {
        let Self { start, end, .. } = self;
        let q = self.positions().at(part);
        let v = match self.scheme {
            _ if self.is_linear => start.v + part * (end.v - start.v),
            Scheme::Dop853 => self.velocities().at(part),
            // One polynomial serves for coordinates and rates.
            Scheme::Tsit5 | Scheme::Rodas4 | Scheme::Rodas5p => (1.0 / self.length) * self.positions().rate_at(part),
        };
        [q, v]
    }

    #[inline]
    pub(super) fn positions(&self) -> Interpolant<N> {
        let Self { start, end, length, dense, .. } = self;
        Interpolant::new([start.q, end.q], [*length * start.v, *length * end.v], std::array::from_fn(|k| dense[k].q))
    }

    #[inline]
    pub(super) fn velocities(&self) -> Interpolant<N> {
        let Self { start, end, length, dense, .. } = self;
        Interpolant::new([start.v, end.v], [*length * start.a, *length * end.a], std::array::from_fn(|k| dense[k].v))
    }
}

/// Work up to a part of a step, J; the dissipated part never falls.
pub(super) fn work_until(work_interpolant: &Interpolant<2>, part: f64) -> Work {
    Work { input: work_interpolant.at(part)[0], dissipated: work_interpolant.running_maximum(1, part) }
}

/// Interpolant of the work between two states `length` seconds apart, J.
fn work_interpolant<const N: usize, const M: usize>(
    [start, end]: [&State<N, M>; 2],
    length: f64,
    higher: [Vector<2>; 4],
) -> Interpolant<2> {
    let rates = [&start.power, &end.power].map(|power| length * power.pair());
    Interpolant::new([start.work.pair(), end.work.pair()], rates, higher)
}
