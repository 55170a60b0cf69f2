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
mod step;
mod tableau;

use borsh::{BorshDeserialize, BorshSerialize};

use super::{Counters, Failure, Power, State, System};
use controller::Controller;
use stages::Slope;

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

/// Sums of macro steps are rounded by this part of a step, or less.
const ROUNDED: f64 = 64.0 * f64::EPSILON;

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
    /// The controller at its beginning, for when the step is redone.
    before: Controller,
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
            before: Controller::default(),
        }
    }

    /// One macro step of h seconds within the running step; false, and nothing has changed, if that ends before.
    #[inline(always)]
    pub fn pass(&mut self, h: f64) -> bool {
        let (left, rounded) = (self.length - self.elapsed, ROUNDED * self.length);
        // At its very end even the shortest step goes past it.
        if left == 0.0 || h > left + rounded {
            return false;
        }
        // What ends with the step but for round-off ends with it.
        self.elapsed = if h < left - rounded { self.elapsed + h } else { self.length };
        self.start.counters.steps += 1;
        self.end.counters.steps += 1;
        true
    }

    /// One macro step of h seconds. In `ahead` seconds somebody looks, or never while a step is under way: it is interpolated only then.
    /// No step that is made goes farther than `limit` seconds. On failure the run is undefined: the caller keeps a copy.
    #[inline(always)]
    pub fn advance(
        &mut self,
        system: &impl System<N, M>,
        settings: &Settings,
        h: f64,
        [mut ahead, mut limit]: [f64; 2],
    ) -> Result<(), Failure> {
        let mut rest = h;
        for _ in 0..MOST_SUBSTEPS {
            if self.pass(rest) {
                return Ok(());
            }
            let left = self.length - self.elapsed;
            (rest, ahead, limit) = (rest - left, ahead - left, limit - left);
            self.step(system, settings, limit, ahead)?;
        }
        Err(Failure::TooManySubsteps { most: MOST_SUBSTEPS, substep: self.length, error: self.end.error_estimate })
    }

    /// Ends the running step at the present time, because what was held from here on will change: the step is redone, up to here and no
    /// further. `system` is that of the step. On failure the run is undefined.
    pub fn cut(&mut self, system: &impl System<N, M>, settings: &Settings) -> Result<(), Failure> {
        let mut rest = self.elapsed;
        if rest < self.length {
            let Counters { rejected, iterations, .. } = self.end.counters;
            self.controller = self.before;
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
            state.q = std::array::from_fn(|i| state.q[i] + shift[i]);
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

    /// Coordinates, rates and work at the present time, on the constraints: inside the step the interpolant projected, or as it is where
    /// the projection does not converge.
    #[inline(always)]
    pub fn sample<S: System<N, M>>(&self, system: &S, settings: &Settings) -> Sample<N, S::Pose> {
        let Self { start, end, .. } = self;
        if self.elapsed == self.length {
            return Sample { q: end.q, v: end.v, pose: system.pose(&end.q), work: end.work, modes: end.modes };
        }
        let part = self.elapsed / self.length;
        let interpolated = |from: f64, to: f64, [rate, rate_to]: [f64; 2], higher: [f64; 4]| {
            interpolated(part, [from, to], [self.length * rate, self.length * rate_to], higher)
        };
        let q = std::array::from_fn(|i| interpolated(start.q[i], end.q[i], [start.v[i], end.v[i]], self.dense.map(|d| d.q[i])));
        let v = if self.on_ray {
            std::array::from_fn(|i| start.v[i] + part * (end.v[i] - start.v[i]))
        } else {
            std::array::from_fn(|i| interpolated(start.v[i], end.v[i], [start.a[i], end.a[i]], self.dense.map(|d| d.v[i])))
        };
        let work = if system.follows_work() {
            let of = |part: fn(&Power) -> f64| {
                let [from, to] = [&start.work, &end.work].map(part);
                interpolated(from, to, self.power.each_ref().map(part), self.dense.each_ref().map(|d| part(&d.power)))
            };
            Power { input: of(|work| work.input), dissipated: of(|work| work.dissipated) }
        } else {
            start.work
        };
        let (mut on_q, mut on_v) = (q, v);
        let projected = if self.on_ray { None } else { settings.project(system, &mut on_q, &mut on_v).ok() };
        let (q, v, pose) = projected.map_or_else(|| (q, v, system.pose(&q)), |(_, pose, _)| (on_q, on_v, pose));
        let modes = system.modes(&pose);
        Sample { q, v, pose, work, modes }
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
