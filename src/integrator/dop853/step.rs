//! One accepted step: passage of a vertex, stages, error control, projection.

use std::borrow::Borrow;

use super::events::Border;
use super::stages::{Allowed, RATE, Slope, Stages};
use super::{DenseStep, Horizon, Settings};
use crate::integrator::controller::{LEAST_LOG_ERROR, StepSizeController, is_cut_short, next_step};
use crate::integrator::{
    Approach, Arrival, EnergyBalance, Kinked, Passage, PassageLimits, Projection, StepError, System, velocity_correction,
};
use crate::vector::Vector;

/// A step below this, s, that is rejected is not made shorter.
const SHORTEST: f64 = 1e-15;
/// No step is longer than this, s: where nothing moves the error sets no limit.
pub(super) const LONGEST: f64 = 10.0;
/// A step is interpolated if the next output is within this part of it, a little more than the whole: sums of macro steps are rounded.
const WITH_ROUNDING: f64 = 1.000_001;
/// An interpolant whose rates differ from the derivatives of its coordinates by more than so many tolerances is none; those of good steps
/// differ by 60 at most.
const GREATEST_DEFECT: f64 = 1e3;
/// Round-off of a difference of coordinates, rad.
const ROUND_OFF: f64 = 64.0 * f64::EPSILON;
/// With the memory and growth by 3 at most a quarter of the rejections of the classical controller remain.
const CONTROLLER: StepSizeController = StepSizeController {
    exponent: 1.0 / 8.0 - 0.75 * 0.02,
    memory: 0.02,
    accepted: [0.3, 3.0],
    rejected: [0.3, 0.85],
    failed: 0.3,
};

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// The next step: its beginning is the end of the one under way.
    #[inline(never)]
    pub(super) fn step<S: System<N, M> + Passage<N> + Kinked<N, Sides = K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        horizon: Horizon,
    ) -> Result<(), StepError> {
        self.begin();
        let (longest, near) = match system.approach(&settings.passage(), &self.start.departure(horizon.limit.min(LONGEST))) {
            Approach::Clear => (horizon.limit, false),
            Approach::Limited(limits) => (horizon.limit.min(limits.longest), true),
            Approach::Passed(transit) => {
                self.end.pass_through(system, &transit, settings.regularization)?;
                (self.length, self.straight) = (transit.duration, true);
                self.sides_behind = system.sides_of(&self.end.q, &self.end.v);
                return Ok(());
            }
        };
        let wanted = if self.start.substep.is_finite() { self.start.substep } else { settings.first_step };
        let mut h = wanted.min(longest).min(LONGEST);
        let mut rejected = false;
        self.settle(system, settings);
        let mut on_sides = system.on(self.sides);
        if on_sides.borrow().is_at_rest() {
            self.length = longest.min(LONGEST);
            self.end = self.start;
            self.end.counters.substeps += 1;
            return Ok(());
        }
        let mut tries = 0;
        loop {
            let on: &S = on_sides.borrow();
            let kept = if near { on.energy_to_keep(&self.start.q, &self.start.v) } else { None };
            let mut stages = Stages::new(on, settings.regularization, &self.start, h);
            let end = stages.end;
            let error = stages.error(&settings.allowed_of(on), &end[1]);
            let arrival = if error <= 1.0 {
                settings.project_and_evaluate(on, end, kept.map(|energy| (energy, h)))
            } else {
                Err(StepError::NotFinite)
            };
            if let Ok((iterations, arrival)) = arrival {
                self.accept(on, &stages, (iterations, arrival));
                if system.has_kinks() {
                    match self.border(on, settings, &mut stages, tries) {
                        Border::Clear => {}
                        Border::AtEnd => self.sides_behind = on.behind(&self.end.q, &self.end.v, settings.error_tolerance),
                        Border::Before(when) => {
                            self.retract();
                            self.end.counters.rejected += 1;
                            tries += 1;
                            if when < SHORTEST {
                                self.turn(system, settings);
                                on_sides = system.on(self.sides);
                            } else {
                                h = when.min(longest);
                            }
                            continue;
                        }
                    }
                }
                let interpolated = horizon.output < WITH_ROUNDING * h;
                // Where a kink was near, the search for it has left the coefficients.
                if interpolated && !(on.has_kinks() && self.dense != [Slope::NONE; 4]) {
                    self.dense = stages.dense(on, settings.regularization, &self.end);
                }
                self.end.error_estimate = error * settings.error_tolerance;
                self.adapt(error, wanted, rejected);
                if self.memory.stiffness.is_due(self.end.counters.substeps) {
                    self.memory.stiffness.check(h * stages.fastest_rate(&self.end));
                }
                return Ok(());
            }
            self.end.counters.rejected += 1;
            rejected = true;
            if h < SHORTEST {
                return Err(StepError::StepTooShort { substep: h, error: error * settings.error_tolerance });
            }
            h *= CONTROLLER.reduction(error);
        }
    }

    /// Time has passed the end of the step.
    fn begin(&mut self) {
        self.start = self.end;
        self.before = self.memory;
        self.elapsed = 0.0;
        self.dense = [Slope::NONE; 4];
        self.straight = false;
    }

    /// The step has reached its end.
    #[inline]
    fn accept(&mut self, system: &impl System<N, M>, stages: &Stages<N>, (iterations, arrival): (u32, Arrival<N, M>)) {
        self.length = stages.h;
        self.end.arrive(arrival);
        self.end.counters.iterations += u64::from(iterations);
        if system.follows_work() {
            self.end.work = self.end.work.plus(stages.h, stages.mean_power());
        }
    }

    /// Whether the interpolant is of one piece: its rates are the derivatives of its coordinates. Stages may miss what the further ones
    /// of the interpolant meet.
    #[cold]
    pub(super) fn interpolates_well(&self, settings: &Settings) -> bool {
        let (positions, velocities) = (self.positions(), self.velocities());
        [0.125, 0.5, 0.875].into_iter().all(|part| {
            let v = velocities.at(part);
            let defect = positions.rate_at(part) - self.length * v;
            (0..N).all(|i| {
                let allowed = GREATEST_DEFECT * settings.error_tolerance * (RATE + v[i].abs()) * self.length;
                defect[i].abs() <= allowed + ROUND_OFF * (1.0 + self.end.q[i].abs())
            })
        })
    }

    /// The step to come, from the error of this one.
    #[inline]
    fn adapt(&mut self, error: f64, wanted: f64, rejected: bool) {
        let growth = CONTROLLER.growth(error, self.memory.log_error);
        let growth = if rejected { growth.min(1.0) } else { growth };
        // A step that was rejected is as long as its error allows, not cut short.
        let wanted = if rejected { self.length } else { wanted };
        self.end.substep = next_step(self.length, growth, wanted);
        if !is_cut_short(self.length, wanted) {
            self.memory.log_error = libm::log(error).max(LEAST_LOG_ERROR);
        }
    }
}

impl Settings {
    /// What a step may be off. The work of forces with kinks is as large as they are, and the motion does not tell how well it is
    /// known.
    #[inline]
    fn allowed_of<const N: usize>(&self, system: &impl Kinked<N>) -> Allowed {
        Allowed { coordinate: self.error_tolerance, work: system.has_kinks().then_some(self.error_tolerance * self.energy_scale) }
    }

    /// The error is far below what the impact parameter could hide, at any tolerance.
    pub(super) fn passage(&self) -> PassageLimits {
        PassageLimits { radius: 1e-4, impact_parameter: 1e-7, longest_with_dissipation: self.first_step }
    }

    /// Puts the end of a step onto the constraints: the iterations spent, and what holds there. The energy that was at its beginning, so
    /// many seconds before, is kept where there is any.
    #[inline]
    pub(super) fn project_and_evaluate<const N: usize, const M: usize, S: System<N, M> + Passage<N>>(
        &self,
        system: &S,
        [mut q, mut v]: [Vector<N>; 2],
        kept: Option<(EnergyBalance, f64)>,
    ) -> Result<(u32, Arrival<N, M>), StepError> {
        let (iterations, pose, mass) = self.project(system, &mut q, &mut v)?;
        if let Some((energy, h)) = &kept {
            v = system.energy_scale(energy, &q, &v, *h)? * v;
        }
        Ok((iterations, Arrival::in_balance(system, [q, v], &pose, &mass).finite()?))
    }

    /// Puts q and q̇ onto the constraints, but not so close to a vertex that round-off would be divided by nothing: the iterations
    /// spent, with pose and mass factor.
    #[inline]
    pub(super) fn project<const N: usize, const M: usize, S: System<N, M> + Passage<N>>(
        &self,
        system: &S,
        q: &mut Vector<N>,
        v: &mut Vector<N>,
    ) -> Result<(u32, S::Pose, S::Mass), StepError> {
        if !system.can_project(q) {
            let pose = system.pose(q);
            let mass = system.factor_mass(&pose, self.regularization);
            return Ok((0, pose, mass));
        }
        let projection = Projection::to_round_off(system.length_scale(), self.regularization, self.max_iterations);
        let (iterations, pose) = projection.position(system, q)?;
        let mass = system.factor_mass(&pose, self.regularization);
        *v += velocity_correction(system, &pose, &mass, v);
        if system.holds() {
            *v = system.let_hold(*q, *v);
        }
        Ok((iterations, pose, mass))
    }
}
