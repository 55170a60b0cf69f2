//! One accepted step: gate, stages, error control, projection.

use super::controller::Controller;
use super::stages::{Slope, Stages};
use super::{Running, Settings};
use crate::integrator::equilibrium::equilibrium_at;
use crate::integrator::projection::{self, Projection};
use crate::integrator::vectors::finite;
use crate::integrator::vertex::{self, Gate, Verdict};
use crate::integrator::{Failure, Power, State, System};

/// A step below this, s, that is rejected is not made shorter.
const SHORTEST: f64 = 1e-15;
/// No step is longer than this, s: where nothing moves the error sets no limit.
const LONGEST: f64 = 10.0;
/// Projections aim at a violation of this part of the system's size.
const ROUND_OFF: f64 = 8.0 * f64::EPSILON;
/// The error is far below what [`Gate::miss`] could hide, at any tolerance.
const GATE: Gate = Gate { ball: 1e-4, miss: 1e-7 };

impl<const N: usize, const M: usize> Running<N, M> {
    /// The next step: its beginning is the end of the running one. No longer than `limit` s; interpolated if somebody looks `ahead`
    /// seconds after its beginning and that is inside.
    #[inline(never)]
    pub(super) fn step(&mut self, system: &impl System<N, M>, settings: &Settings, limit: f64, ahead: f64) -> Result<(), Failure> {
        self.start = self.end;
        self.before = self.controller;
        self.elapsed = 0.0;
        self.dense = [Slope::NONE; 4];
        self.on_ray = false;
        let mut longest = limit.min(LONGEST);
        let power = if system.follows_work() {
            system.power(&self.start.q, &system.pose(&self.start.q), &self.start.v)
        } else {
            Power::default()
        };

        // A ride along a ray knows friction at its end only: it may not be longer than the macro steps of the other methods.
        let ride = if system.conservative() { longest } else { longest.min(settings.first_step) };
        let near = |vertex| vertex::near(system, &GATE, &mut self.end, ride, settings.softness, vertex);
        match system.vertex(&self.start.q, &self.start.v).map_or(Verdict::Free, near) {
            Verdict::Free => {}
            Verdict::Near(care) => longest = longest.min(care.longest),
            Verdict::Carry(ray) => {
                let mut at_end = power;
                if vertex::carry(system, &ray, &mut self.end, &settings.projection(system), &mut at_end)? {
                    (self.length, self.power, self.on_ray) = (ray.duration(), [power, at_end], true);
                    return Ok(());
                }
            }
        }

        let wanted = if self.start.substep.is_finite() { self.start.substep } else { settings.first_step };
        let mut h = wanted.min(longest);
        // A step cut short by a vertex or a limit says nothing against longer ones.
        let mut cut_short = h < 0.5 * wanted;
        let mut rejected = false;
        loop {
            let mut stages = Stages::new(system, settings.softness, &self.start, power, h);
            let [q, v] = stages.end();
            let error = stages.error(settings.error_tolerance, &v);
            let settled = if error <= 1.0 { settle(system, settings, &mut self.end, q, v) } else { Err(Failure::NotFinite) };
            if let Ok((iterations, at_end)) = settled {
                self.length = h;
                self.power = [power, at_end];
                let end = &mut self.end;
                end.error_estimate = error * settings.error_tolerance;
                end.counters.substeps += 1;
                end.counters.iterations += u64::from(iterations);
                if system.follows_work() {
                    end.work = end.work.plus(h, stages.mean_power());
                }
                let mut controller = self.controller;
                let growth = controller.accepted(error);
                end.substep = h * if rejected { growth.min(1.0) } else { growth };
                if cut_short {
                    end.substep = end.substep.max(wanted);
                } else {
                    self.controller = controller;
                }
                if self.controller.looks(end.counters.substeps) {
                    self.controller.look(h * stages.fastest_rate([&end.q, &end.v, &end.a]));
                }
                // A little more than the step: sums of macro steps are rounded.
                if ahead < 1.000_001 * h {
                    self.dense = stages.dense(system, settings.softness, &self.end, at_end);
                }
                return Ok(());
            }
            self.end.counters.rejected += 1;
            (rejected, cut_short) = (true, false);
            if h < SHORTEST {
                return Err(Failure::StepTooShort { substep: h, error: error * settings.error_tolerance });
            }
            h *= Controller::rejected(error);
        }
    }
}

/// Makes q and q̇, put onto the constraints, the new state: the iterations spent, and the power there.
#[inline(always)]
fn settle<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    settings: &Settings,
    state: &mut State<N, M>,
    mut q: [f64; N],
    mut v: [f64; N],
) -> Result<(u32, Power), Failure> {
    let (iterations, pose, mass) = settings.project(system, &mut q, &mut v)?;
    let (a, lambda) = equilibrium_at(system, &q, &pose, &v, &mass);
    if !(finite(&q) && finite(&v) && finite(&a)) {
        return Err(Failure::NotFinite);
    }
    let power = if system.follows_work() { system.power(&q, &pose, &v) } else { Power::default() };
    (state.q, state.v, state.a, state.lambda) = (q, v, a, lambda);
    state.on_ray = false;
    state.observe_modes(system.modes(&pose));
    Ok((iterations, power))
}

impl Settings {
    fn projection<const N: usize, const M: usize>(&self, system: &impl System<N, M>) -> Projection {
        let &Self { softness, max_iterations, .. } = self;
        Projection { softness, tolerance: ROUND_OFF * system.size(), max_iterations }
    }

    /// Puts q and q̇ onto the constraints, but not so close to a vertex that round-off would be divided by nothing: the iterations
    /// spent, with pose and mass factor.
    #[inline(always)]
    pub(super) fn project<const N: usize, const M: usize, S: System<N, M>>(
        &self,
        system: &S,
        q: &mut [f64; N],
        v: &mut [f64; N],
    ) -> Result<(u32, S::Pose, S::Mass), Failure> {
        if vertex::too_close(system, q, v) {
            let pose = system.pose(q);
            let mass = system.factor_mass(&pose, self.softness);
            return Ok((0, pose, mass));
        }
        let (iterations, pose) = self.projection(system).position(system, q)?;
        let mass = system.factor_mass(&pose, self.softness);
        let correction = projection::velocity(system, &pose, &mass, v);
        *v = std::array::from_fn(|i| v[i] + correction[i]);
        Ok((iterations, pose, mass))
    }
}
