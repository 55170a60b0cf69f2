//! DOP853: the explicit Runge–Kutta method of order 8 of Dormand and Prince, with error control and dense output, on the index-1 form
//! of a [`System`]; projection onto the constraints after every accepted step.
//!
//! Steps are as long as the local error allows, wherever communication points are. The running step may pass one: there the state is
//! that of the step's interpolant, of order 7, projected. The step, which has been made with the inputs held, is thrown away if they
//! change at that point, and redone up to it ([`Running::cut`]). So the state of a run is the running step: both its ends, the
//! interpolant's coefficients and the time into it.
//!
//! E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary Differential Equations I*, 2nd ed., sections II.5 and II.6.

mod controller;
mod stages;
mod tableau;

use borsh::{BorshDeserialize, BorshSerialize};

use super::equilibrium::equilibrium_at;
use super::projection::{self, Projection};
use super::vertex::{self, Gate, Verdict};
use super::{Counters, Failure, Power, State, System};
use controller::Controller;
use stages::{Slope, Stages};

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Local error allowed per step: of each coordinate this, of its rate this times (10/s + |q̇|); root of the mean square.
    pub error_tolerance: f64,
    /// The first step tried, s.
    pub first_step: f64,
    /// Most Newton iterations of a projection.
    pub max_iterations: u32,
    /// e of the saddle-point systems, 1/kg (in the units of Φ_q M⁻¹ Φ_qᵀ): so small that it is seen only where that loses rank.
    pub softness: f64,
}

/// More accepted steps than this in one macro step end it with a status: a call never hangs.
const MOST_SUBSTEPS: u32 = 100_000;
/// A step below this, s, that is rejected is not made shorter.
const SHORTEST: f64 = 1e-15;
/// No step is longer than this, s: where nothing moves the error sets no limit.
const LONGEST: f64 = 10.0;
/// Projections aim at a violation of this part of the system's size.
const ROUND_OFF: f64 = 8.0 * f64::EPSILON;
/// The error is far below what [`Gate::miss`] could hide, at any tolerance.
const GATE: Gate = Gate { ball: 1e-4, miss: 1e-7 };

/// A run: the step that is under way.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Running<const N: usize, const M: usize> {
    /// The last accepted state that time has passed: the beginning of the running step.
    start: State<N, M>,
    /// Its end.
    end: State<N, M>,
    /// s.
    length: f64,
    /// Time into the running step, s, never beyond its end.
    elapsed: f64,
    /// Power at both ends, W.
    power: [Power; 2],
    /// The higher coefficients of the interpolant; 0 where it was not needed.
    dense: [Slope<N>; 4],
    /// Whether the step is a straight motion close to a vertex, where nothing may be projected.
    on_ray: bool,
    controller: Controller,
}

/// What holds at the present time, between the ends of the running step.
#[derive(Clone, Copy, Debug)]
pub struct Sample<const N: usize, P> {
    /// Coordinates.
    pub q: [f64; N],
    /// Their rates.
    pub v: [f64; N],
    /// [`System::pose`] there.
    pub pose: P,
    /// Work since the start, J.
    pub work: Power,
    /// Changed [`System::modes`] since the beginning of the running step count.
    modes: u8,
}

impl<const N: usize, const M: usize> Running<N, M> {
    /// Begins with q and q̇, which meet the constraints.
    pub fn start(system: &impl System<N, M>, q: [f64; N], v: [f64; N], settings: &Settings) -> Self {
        let state = State::start(system, q, v, settings.softness);
        Self {
            start: state,
            end: state,
            length: 0.0,
            elapsed: 0.0,
            power: [Power::default(); 2],
            dense: [Slope::NONE; 4],
            on_ray: false,
            controller: Controller::default(),
        }
    }

    /// One macro step of h seconds, of `ahead` seconds until somebody looks: the running step is interpolated only then. On failure the
    /// run is undefined: the caller keeps a copy.
    #[inline(always)]
    pub fn advance(&mut self, system: &impl System<N, M>, settings: &Settings, h: f64, ahead: f64) -> Result<(), Failure> {
        let (mut rest, mut ahead) = (h, ahead);
        for _ in 0..MOST_SUBSTEPS {
            let left = self.length - self.elapsed;
            if rest <= left {
                self.elapsed += rest;
                self.start.counters.steps += 1;
                self.end.counters.steps += 1;
                return Ok(());
            }
            (rest, ahead) = (rest - left, ahead - left);
            self.step(system, settings, f64::INFINITY, ahead)?;
        }
        Err(Failure::TooManySubsteps { most: MOST_SUBSTEPS, substep: self.length, error: self.end.error_estimate })
    }

    /// Ends the running step at the present time, because what was held from here on will change: the step is redone, up to here and no
    /// further. `system` is that of the step. On failure the run is undefined.
    pub fn cut(&mut self, system: &impl System<N, M>, settings: &Settings) -> Result<(), Failure> {
        let mut rest = self.elapsed;
        if rest < self.length {
            let Counters { rejected, iterations, .. } = self.end.counters;
            self.end = self.start;
            self.end.counters.rejected = rejected + 1;
            self.end.counters.iterations = iterations;
            let mut substeps = 0;
            while rest > 0.0 {
                if substeps == MOST_SUBSTEPS {
                    return Err(Failure::TooManySubsteps { most: substeps, substep: self.length, error: self.end.error_estimate });
                }
                substeps += 1;
                self.step(system, settings, rest, f64::INFINITY)?;
                rest -= self.length;
            }
        }
        self.start = self.end;
        (self.length, self.elapsed) = (0.0, 0.0);
        Ok(())
    }

    /// The forces have changed at once, after a [`cut`](Self::cut), which put in some energy, J.
    pub fn restart(&mut self, system: &impl System<N, M>, settings: &Settings, put_in: f64) {
        self.end.restart(system, settings.softness);
        self.end.work.input += put_in;
        self.start = self.end;
    }

    /// Moves the origin of the coordinates: by `shift`, which the system does not notice (whole turns of angles).
    pub fn shift(&mut self, shift: &[f64; N]) {
        for state in [&mut self.start, &mut self.end] {
            state.q = add(&state.q, shift);
        }
    }

    /// Coordinates at the beginning of the running step.
    pub fn origin(&self) -> &[f64; N] {
        &self.start.q
    }

    /// Whether steps have been limited by stability instead of accuracy: an implicit method would do better.
    pub fn is_stiff(&self) -> bool {
        self.controller.stiff
    }

    /// Coordinates, rates and work at the present time, on the constraints.
    #[inline(always)]
    pub fn sample<S: System<N, M>>(&self, system: &S, settings: &Settings) -> Result<Sample<N, S::Pose>, Failure> {
        let Self { start, end, .. } = self;
        if self.elapsed == self.length {
            return Ok(Sample { q: end.q, v: end.v, pose: system.pose(&end.q), work: end.work, modes: end.modes });
        }
        let part = self.elapsed / self.length;
        let interpolated = |from: f64, to: f64, [rate, rate_to]: [f64; 2], higher: [f64; 4]| {
            interpolated(part, [from, to], [self.length * rate, self.length * rate_to], higher)
        };
        let mut q = std::array::from_fn(|i| interpolated(start.q[i], end.q[i], [start.v[i], end.v[i]], self.dense.map(|d| d.q[i])));
        let mut v = if self.on_ray {
            std::array::from_fn(|i| start.v[i] + part * (end.v[i] - start.v[i]))
        } else {
            std::array::from_fn(|i| interpolated(start.v[i], end.v[i], [start.a[i], end.a[i]], self.dense.map(|d| d.v[i])))
        };
        let [first, last] = self.power;
        let mut work = Power::default();
        if system.follows_work() {
            work = Power {
                input: interpolated(start.work.input, end.work.input, [first.input, last.input], self.dense.map(|d| d.power.input)),
                dissipated: interpolated(
                    start.work.dissipated,
                    end.work.dissipated,
                    [first.dissipated, last.dissipated],
                    self.dense.map(|d| d.power.dissipated),
                ),
            };
        }
        let pose = if self.on_ray { system.pose(&q) } else { settings.project(system, &mut q, &mut v)?.1 };
        let modes = system.modes(&pose);
        Ok(Sample { q, v, pose, work, modes })
    }

    /// Writes into a state of the same system in any coordinates what does not depend on the coordinates.
    pub fn record<const A: usize, const B: usize, P>(&self, sample: &Sample<N, P>, to: &mut State<A, B>) {
        // What the step has done counts when time has passed its end; that it started from rest in a vertex, at once.
        let passed = if self.elapsed == self.length { &self.end } else { &self.start };
        to.modes = passed.modes;
        to.counters = Counters { launches: self.end.counters.launches, ..passed.counters };
        to.observe_modes(sample.modes);
        to.work = sample.work;
        to.substep = self.end.substep;
        to.error_estimate = self.end.error_estimate;
        to.alternatives = self.end.alternatives;
        to.on_ray = self.on_ray;
    }

    /// The next step: its beginning is the end of the running one. No longer than `limit` s; interpolated if somebody looks `ahead`
    /// seconds after its beginning and that is inside.
    fn step(&mut self, system: &impl System<N, M>, settings: &Settings, limit: f64, ahead: f64) -> Result<(), Failure> {
        self.start = self.end;
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
        match vertex::verdict(system, &GATE, &mut self.end, ride, settings.softness) {
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
            let iterations = if error <= 1.0 { settle(system, settings, &mut self.end, q, v) } else { Err(Failure::NotFinite) };
            if let Ok((iterations, at_end)) = iterations {
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
    if !(q.iter().chain(&v).chain(&a).sum::<f64>()).is_finite() {
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
    fn project<const N: usize, const M: usize, S: System<N, M>>(
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
        *v = add(v, &projection::velocity(system, &pose, &mass, v));
        Ok((iterations, pose, mass))
    }
}

/// The interpolant at a part of the step, from the values and the derivatives (times the step) at its ends and the higher coefficients.
#[inline(always)]
fn interpolated(part: f64, [from, to]: [f64; 2], [rate, rate_to]: [f64; 2], higher: [f64; 4]) -> f64 {
    let rest = 1.0 - part;
    let difference = to - from;
    let second = rate - difference;
    let third = difference - rate_to - second;
    let [d, e, f, g] = higher;
    from + part * (difference + rest * (second + part * (third + rest * (d + part * (e + rest * (f + part * g))))))
}

fn add<const N: usize>(x: &[f64; N], y: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|i| x[i] + y[i])
}
