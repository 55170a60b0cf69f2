//! Inside the current step: its interpolant, the state at the present time with its work, and truncation at an event, after which the part
//! of the interpolant before the event is the step.
//!
//! An interpolant solves equations with forces that differ by its defect: its derivative minus the right-hand side at its values (W. H.
//! Enright, *A new error-control for initial value solvers*, Applied Mathematics and Computation 31, 1989). The defect, integrated up to
//! the event, is judged like the error of a step.

use super::scheme::Polynomials;
use super::trial::{ErrorWeights, StageDerivative, StepResult, project};
use super::{DenseStep, Settings};
use crate::integrator::dense_output::{Interpolant, max_magnitude};
use crate::integrator::events::separation_loss;
use crate::integrator::locator::{EventWindow, Path};
use crate::integrator::state::StepEnd;
use crate::integrator::{Counters, ERROR_RATE, Events, Mechanics, Passage, State, System, Work};
use crate::vector::Vector;

/// Largest integrated defect, in units of the admissible error.
const GREATEST_DEFECT: f64 = 0.1;
/// Largest number of corrections that move the end into the window of the event.
const MOST_CORRECTIONS: u32 = 4;

/// Longest stretch for a parabola of sticking friction, relative to a step of high order, in which a reaction may oscillate.
const LONGEST_PARABOLA: f64 = 0.25;
/// Admissible inconsistency between an interpolant's rates and its coordinates, in tolerances; it is at most 60 in good steps.
const LARGEST_INCONSISTENCY: f64 = 1e3;
/// Round-off of a difference of coordinates, rad.
const ROUND_OFF: f64 = 64.0 * f64::EPSILON;

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
    /// State at the present time, on the constraints. Inside the step it is the projected interpolant, or the interpolant itself if the
    /// projection does not converge.
    pub fn sample<S: Mechanics<N, M, Mode = K>>(&self, system: &S, settings: &Settings) -> Sample<N, S::Pose> {
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
        let (shown, polynomials) = self.shown(system, settings);
        let ([q, v], work) = shown.interpolated(polynomials, &*system.on(self.mode), settings);
        let (mut on_q, mut on_v, mut pose) = (q, v, system.pose(&q));
        let projected = if self.is_linear {
            None
        } else {
            project(settings, &*system.on(self.mode), None, &mut pose, [&mut on_q, &mut on_v]).ok()
        };
        let (q, v, pose) = projected.map_or_else(|| (q, v, system.pose(&q)), |_| (on_q, on_v, pose));
        let configuration_signs = system.configuration_signs(&pose);
        Sample { q, v, pose, work, configuration_signs }
    }

    /// The step with the dense output that the caller sees: its own or, if that contradicts itself, the quintic of both ends.
    fn shown<S: Events<N> + System<N, M>>(&self, system: &S, settings: &Settings) -> (Self, Polynomials) {
        if !system.features().stiff || self.is_linear || self.interpolant_is_consistent(settings) {
            return (*self, self.polynomials());
        }
        let (Self { start, end, .. }, h) = (self, self.length);
        let positions = Interpolant::between([[start.q, start.v, start.a], [end.q, end.v, end.a]], h);
        (Self { dense: StageDerivative::of_positions(positions), ..*self }, Polynomials::OfCoordinates)
    }

    /// Writes the parts of a sample that do not depend on the coordinates into a state, which may have other coordinates.
    pub fn record<const A: usize, const B: usize, P>(&self, sample: &Sample<N, P>, to: &mut State<A, B>) {
        // A step is counted once time has passed its end, a start from rest at a vertex immediately.
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

    /// Interpolant at the present time, not projected, and the work.
    fn interpolated<S: System<N, M> + Passage<N> + Events<N>>(
        &self,
        polynomials: Polynomials,
        system: &S,
        settings: &Settings,
    ) -> ([Vector<N>; 2], Work) {
        let Self { start, length, .. } = self;
        let part = self.elapsed / length;
        let [q, v] = self.interpolated_state(polynomials, part);
        let work = if system.features().work {
            let (mut end, ends_with) = (self.evaluated_end(system, settings), self.end.work.dissipated);
            // The loss of separated springs is known at every state.
            let mut lost = 0.0;
            if system.features().events {
                let from = system.guard_values(&start.q, &start.v);
                end.work.dissipated -= separation_loss(system, &from, [&end.q, &end.v]);
                lost = separation_loss(system, &from, [&q, &v]);
            }
            let mut higher = self.dense.map(|slope| slope.power.pair());
            if !polynomials.include_work() && !self.is_linear {
                higher[0] = work_coefficient(system, [start, &end], *length, &self.positions()).pair();
            }
            let mut work = work_until(&work_interpolant([start, &end], *length, higher), part);
            work.dissipated = (work.dissipated.min(end.work.dissipated) + lost).min(ends_with);
            work
        } else {
            start.work
        };
        ([q, v], work)
    }

    /// Interpolated q and q̇ at a fraction of the step.
    fn interpolated_state(&self, polynomials: Polynomials, part: f64) -> [Vector<N>; 2] {
        let Self { start, end, .. } = self;
        let q = self.positions().at(part);
        let v = if self.is_linear {
            start.v + part * (end.v - start.v)
        } else if polynomials.differentiate() {
            (1.0 / self.length) * self.positions().rate_at(part)
        } else {
            self.velocities().at(part)
        };
        [q, v]
    }

    /// Polynomials of the step's dense output.
    fn polynomials(&self) -> Polynomials {
        self.scheme.properties().polynomials
    }

    pub(super) fn positions(&self) -> Interpolant<N> {
        let Self { start, end, length, dense, .. } = self;
        Interpolant::new([start.q, end.q], [*length * start.v, *length * end.v], std::array::from_fn(|k| dense[k].q))
    }

    pub(super) fn velocities(&self) -> Interpolant<N> {
        let Self { start, end, length, dense, .. } = self;
        Interpolant::new([start.v, end.v], [*length * start.a, *length * end.a], std::array::from_fn(|k| dense[k].v))
    }

    /// Whether the rates of the interpolant are the derivatives of its coordinates within [`LARGEST_INCONSISTENCY`]. Stages may miss a
    /// force that the additional stages of the dense output meet. One polynomial for both is always consistent.
    pub(super) fn interpolant_is_consistent(&self, settings: &Settings) -> bool {
        if self.polynomials().differentiate() {
            return true;
        }
        let (positions, velocities) = (self.positions(), self.velocities());
        [0.125, 0.5, 0.875].into_iter().all(|part| {
            let v = velocities.at(part);
            let defect = positions.rate_at(part) - self.length * v;
            (0..N).all(|i| {
                let admissible = LARGEST_INCONSISTENCY * settings.error_tolerance * (ERROR_RATE + v[i].abs()) * self.length;
                defect[i].abs() <= admissible + ROUND_OFF * (1.0 + self.end.q[i].abs())
            })
        })
    }

    /// Motion over the step, for event location: coordinates relative to the beginning of the step. In short steps the round-off of
    /// coordinates would exceed all tolerances of the rates. The increment is then the integral of the rates, which agrees within this
    /// round-off.
    pub(super) fn path(&self) -> Path<N> {
        /// Nodes and weights of Gauss quadrature with four points, exact for the interpolant of the rates.
        const GAUSS: [[f64; 2]; 4] = [
            [0.069_431_844_202_973_71, 0.173_927_422_568_726_93],
            [0.330_009_478_207_571_87, 0.326_072_577_431_273_07],
            [0.669_990_521_792_428_1, 0.326_072_577_431_273_07],
            [0.930_568_155_797_026_3, 0.173_927_422_568_726_93],
        ];
        /// Round-off of a coordinate at both ends and of its projection, relative to 1 rad plus its magnitude.
        const ROUND_OFF: f64 = 4.0 * f64::EPSILON;
        let Self { start, end, length, .. } = self;
        let mut displacement = end.q - start.q;
        if !self.polynomials().differentiate() {
            let velocities = self.velocities();
            let integrated = GAUSS.iter().fold(Vector::ZERO, |sum, [part, weight]| sum + weight * length * velocities.at(*part));
            let is_round_off = |i: usize| (integrated[i] - displacement[i]).abs() <= ROUND_OFF * (1.0 + end.q[i].abs());
            displacement = Vector::from_fn(|i| if is_round_off(i) { integrated[i] } else { displacement[i] });
        }
        let rates = [*length * start.v, *length * end.v];
        let increment = Interpolant::new([Vector::ZERO, displacement], rates, self.dense.map(|slope| slope.q));
        Path { origin: start.q, increment, length: *length, longest_parabola: LONGEST_PARABOLA }
    }

    /// Ends the step at an event that its interpolant has `when` seconds after the beginning. If the result would be less accurate than a
    /// step up to this time, returns false and changes nothing.
    pub(super) fn truncate<S>(&mut self, system: &S, settings: &Settings, mut when: f64) -> bool
    where
        S: Mechanics<N, M, Mode = K>,
    {
        if !self.polynomials().can_be_truncated() || !system.can_project(&self.start.q) {
            return false;
        }
        for _ in 0..MOST_CORRECTIONS {
            let [mut q, mut v] = self.interpolated_state(self.polynomials(), when / self.length);
            let mut pose = system.pose(&q);
            let Ok((iterations, mass)) = project(settings, system, None, &mut pose, [&mut q, &mut v]) else { return false };
            // The interpolant's acceleration suffices, because only the remaining correction uses it.
            let a = (1.0 / self.length) * self.velocities().rate_at(when / self.length);
            match EventWindow::of(system, settings.error_tolerance, [&q, &v, &a], self.length) {
                EventWindow::Within => {
                    let end_state = StepEnd::in_balance(system, [q, v], &pose, &mass);
                    return end_state.is_finite() && self.truncate_at(system, settings, when, (iterations, end_state));
                }
                EventWindow::Outside(Some(later)) if 0.0 < when + later && when + later < self.length => when += later,
                EventWindow::Outside(_) => return false,
            }
        }
        false
    }

    /// Ends the step at a state of its interpolant, unless the integrated defect is too large. `iterations` is the number of iterations of
    /// the projection.
    fn truncate_at<S>(&mut self, system: &S, settings: &Settings, when: f64, (iterations, end_state): (u32, StepEnd<N, M>)) -> bool
    where
        S: Mechanics<N, M, Mode = K>,
    {
        let part = when / self.length;
        let (positions, velocities) = (self.positions(), self.velocities());
        let work = work_interpolant([&self.start, &self.end], self.length, self.dense.map(|slope| slope.power.pair()));
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
        let sum = ErrorWeights::of(settings, system.features()).mean_square(defects, rates, power);
        if sum.is_nan() || sum > GREATEST_DEFECT * GREATEST_DEFECT {
            return false;
        }
        let (q, v, w) = (positions.truncate(part), velocities.truncate(part), work.truncate(part));
        let mut gained = work_until(&work, part);
        gained.input -= self.start.work.input;
        gained.dissipated -= self.start.work.dissipated;
        let tried = self.length;
        self.reset_to_start();
        self.accept(&StepResult { iterations, end_state, work: gained }, when, self.scheme);
        self.dense = std::array::from_fn(|k| StageDerivative { q: q[k], v: v[k], power: Work::of_pair(w[k]) });
        self.truncated_from = tried;
        true
    }
}

/// Work up to a fraction of a step, J; the dissipated part never falls.
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

/// Inner nodes of the power: at this fraction of the step, and at 1 minus it.
const NODE: f64 = 0.211_324_865_405_187_1;

/// First higher coefficient of the work between states `h` seconds apart, J, from the interpolant of the coordinates and the power at two
/// inner nodes. It is computed only when the work is read.
fn work_coefficient<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    [from, to]: [&State<N, M>; 2],
    h: f64,
    positions: &Interpolant<N>,
) -> Work {
    let cubic = work_interpolant([from, to], h, [Vector::ZERO; 4]);
    let missing = |part: f64| {
        let (q, v) = (positions.at(part), (1.0 / h) * positions.rate_at(part));
        h * system.forces(&q, &system.pose(&q), &v).1.pair() - cubic.rate_at(part)
    };
    /// Derivative of θ²(1−θ)² at the first node; at the other node it has the opposite sign.
    const SLOPE: f64 = 2.0 * NODE * (1.0 - NODE) * (1.0 - 2.0 * NODE);
    let coefficient = (0.5 / SLOPE) * (missing(NODE) - missing(1.0 - NODE));
    Work::of_pair(coefficient)
}
