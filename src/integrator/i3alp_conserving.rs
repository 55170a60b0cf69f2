//! The strictly fixed step that conserves: index-3 augmented Lagrangian on the energy–momentum rule, with both levels of the constraints
//! met by discrete derivatives.
//!
//! `docs/conserving.md` derives it. Unknowns are the increments d = q₁ − q₀, Λ = h²λ/2 of the joint forces and ν, which holds the
//! velocities; with z = d − M⁻¹J_cᵀν, the mean of h q̇₀ and h q̇₁:
//!
//! ```text
//! M (z − h q̇₀) + J_bᵀ Λ + ½ K_b(z)ᵀ ν = ½ h² Q̄       momentum
//! Φ(q₀ + d) = 0                                        positions
//! J₁ w = 0,   w = h q̇₁ = 2z − h q̇₀                    velocities
//! ```
//!
//! J_b d = ΔΦ = 0 and K_b(z) d = (J₁ − J₀) z make the constraints' forces do no work, whatever the step; Q̄ᵀd is what potentials lose.
//! So energy, Φ and Φ̇ are kept to round-off, and no local error is estimated: the step is h. One that plain Newton's method does not
//! solve climbs the ladder of `fallback.rs`.

mod equations;
mod fallback;
mod newton;

use borsh::{BorshDeserialize, BorshSerialize};

use super::{Counters, CutStep, Discrete, Inconsistency, Passage, State, StepError, StepIncrement, Work, equilibrium};
use crate::vector::Vector;
use equations::{Evaluation, Step, Unknowns};
use fallback::{Recovered, from_equilibrium, recover_by_stages};
use newton::{Allowance, Bounds, Until, full_newton, staggered_newton};

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Most Newton iterations of the first try.
    pub max_iterations: u32,
    /// Most Newton iterations of one step and its rescue but the last rung; 0: no rescue but a better first guess.
    pub max_work: u32,
    /// e of the step's systems, 1/kg: it weighs increments, and moves no root.
    pub regularization: f64,
    /// e of equilibrium and projections, 1/kg.
    pub equilibrium: f64,
}

/// A step shorter than this, s, moves on by its Taylor series.
const SHORTEST: f64 = 1e-12;
/// Accelerations below this, m/s² and rad/s², are round-off.
const BALANCED: f64 = 1e-12;
/// Steps that the extrapolation of the unknowns looks back on.
const REMEMBERED: usize = 6;
/// Those that a parabola takes.
const PARABOLA: usize = 3;

/// A run: accelerations and joint forces are no part of it, they follow from equilibrium when they are asked for.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct ConservingRun<const N: usize, const K: usize> {
    /// Coordinates, m and rad.
    pub q: Vector<N>,
    /// Velocities, m/s and rad/s.
    pub v: Vector<N>,
    /// Work since the start, J.
    pub work: Work,
    /// [`super::System::configuration_signs`] of q.
    pub configuration_signs: u8,
    /// Counters since the start.
    pub counters: Counters,
    memory: Memory<K>,
}

/// The unknowns of the last steps, with the loops cut, from which those of the next are extrapolated.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Memory<const K: usize> {
    /// The length of these steps, s.
    h: f64,
    /// How many there are.
    known: u8,
    /// The latest first.
    x: [Vector<K>; REMEMBERED],
}

impl<const K: usize> Memory<K> {
    const NONE: Self = Self { h: 0.0, known: 0, x: [Vector::ZERO; REMEMBERED] };

    /// By the polynomial of the fifth degree through the last steps of the same length, or by a parabola where fewer are known.
    #[inline(always)]
    fn extrapolated(&self, h: f64) -> Option<Vector<K>> {
        let Self { known, x: [last, before, third, fourth, fifth, first], .. } = *self;
        match usize::from(known) {
            _ if self.h != h => None,
            REMEMBERED => Some(6.0 * (last + fifth) - 15.0 * (before + fourth) + 20.0 * third - first),
            PARABOLA.. => Some(3.0 * (last - before) + third),
            _ => None,
        }
    }

    #[inline(always)]
    fn remember(&mut self, h: f64, x: Vector<K>) {
        if self.h != h {
            *self = Self { h, ..Self::NONE };
        }
        self.known = (self.known + 1).min(REMEMBERED as u8);
        self.x = [x, self.x[0], self.x[1], self.x[2], self.x[3], self.x[4]];
    }
}

impl<const N: usize, const K: usize> ConservingRun<N, K> {
    /// Begins with q and q̇, which meet the constraints.
    pub fn start<const M: usize, S: Discrete<N, M>>(system: &S, q: Vector<N>, v: Vector<N>) -> Self {
        let configuration_signs = system.configuration_signs(&system.pose(&q));
        Self { q, v, work: Work::default(), configuration_signs, counters: Counters::default(), memory: Memory::NONE }
    }

    /// The inputs have changed at once, and with them second differences of the motion: what looks at higher ones would be farther off.
    pub fn change(&mut self) {
        self.memory.known = self.memory.known.min(PARABOLA as u8);
        self.counters.restarts += 1;
    }

    /// The motion or the machine has changed at once, which did some work: what was extrapolated does not hold any more.
    pub fn restart(&mut self, work: Work) {
        self.work += work;
        self.memory = Memory::NONE;
        self.counters.restarts += 1;
    }

    /// The state, with q̈, λ and power from equilibrium. Nothing of it is fed back.
    pub fn state<const M: usize, S: Discrete<N, M> + Passage<N>>(&self, system: &S, regularization: f64) -> State<N, M> {
        let &Self { q, v, work, configuration_signs, counters, .. } = self;
        let mut state = State {
            q,
            v,
            a: Vector::ZERO,
            lambda: Vector::ZERO,
            jerk: Vector::ZERO,
            substep: f64::INFINITY,
            error_estimate: 0.0,
            work,
            power: Work::default(),
            configuration_signs,
            on_ray: false,
            alternatives: 0,
            counters,
        };
        state.balance(system, &system.pose(&state.q), regularization);
        state
    }

    /// One step of h seconds. On failure the run is undefined: the caller keeps a copy. `general` is the same system, for what is rare:
    /// a form of its own that `system` may have is compiled for the first try only.
    #[inline(never)]
    pub fn advance<const M: usize, S, G>(
        &mut self,
        (system, general): (&S, &G),
        settings: &Settings,
        h: f64,
    ) -> Result<(), StepError>
    where
        S: Discrete<N, M, CutUnknowns = Vector<K>>,
        G: Discrete<N, M, CutUnknowns = Vector<K>> + Passage<N>,
    {
        if h < SHORTEST {
            return self.taylor_step(general, settings, h);
        }
        if self.v.max_norm() == 0.0 {
            if self.is_in_balance(general, settings) {
                self.counters.substeps += 1;
                return Ok(());
            }
            // Where it was says nothing about its branch.
            self.memory = Memory::NONE;
        }
        let x = match self.memory.extrapolated(h) {
            Some(x) => x,
            None => self.predicted_by_equilibrium(general, settings, h),
        };
        let begun = self.counters.iterations;
        let mut nearby = Some(x);
        if system.alternates() {
            let Self { q, v, .. } = *self;
            let pose = system.pose_in_place(&q);
            let cut = system.cut(&pose, [&q, &v], h);
            let arrive = |end: &_, iterations| {
                self.counters.iterations += u64::from(iterations);
                let ([d, v], secant) = (cut.end(end), cut.secant(end));
                let over = StepIncrement { q: &q, d: &d, v: &v, h, softening: 1.0, secant: &secant };
                self.arrive(system, &over, S::Cut::unknowns(end))
            };
            match staggered_newton(&cut, x, &Bounds::cut(system, h), (settings.regularization, settings.max_iterations), arrive) {
                Ok(arrived) => return arrived,
                Err((left, iterations)) => {
                    self.counters.iterations += u64::from(iterations);
                    nearby = left;
                }
            }
        }
        let Self { q, v, .. } = *self;
        self.at_once(&Step::new(general, [&q, &v], h), settings, (begun, nearby))
    }

    /// Whether the system, at rest, stays there: what Newton's method makes of round-off would drive it from a vertex.
    #[cold]
    #[inline(never)]
    fn is_in_balance<const M: usize, S: Discrete<N, M> + Passage<N>>(&self, system: &S, settings: &Settings) -> bool {
        let (a, _) = equilibrium(system, &self.q, &self.v, settings.equilibrium);
        system.acceleration_from_rest(&self.q, &self.v).unwrap_or(a).max_norm() < BALANCED
    }

    /// What equilibrium predicts: at the start, after a change, and where the step has another length.
    #[cold]
    #[inline(never)]
    fn predicted_by_equilibrium<const M: usize, S>(&mut self, system: &S, settings: &Settings, h: f64) -> Vector<K>
    where
        S: Discrete<N, M, CutUnknowns = Vector<K>> + Passage<N>,
    {
        let (a, lambda) = equilibrium(system, &self.q, &self.v, settings.equilibrium);
        let branch = system.acceleration_from_rest(&self.q, &self.v);
        self.counters.launches += u64::from(branch.is_some_and(|a| a.max_norm() > 0.0));
        let Unknowns { d, lambda, nu } = from_equilibrium(&self.v, (&branch.unwrap_or(a), &lambda), h);
        system.cut_unknowns(&d, [&lambda, &nu])
    }

    /// By the whole tangent from where Λ and ν in turn have come to, or up the ladder.
    #[inline(never)]
    fn at_once<const M: usize, S: Discrete<N, M, CutUnknowns = Vector<K>> + Passage<N>>(
        &mut self,
        step: &Step<'_, S, N, M>,
        settings: &Settings,
        (begun, nearby): (u64, Option<Vector<K>>),
    ) -> Result<(), StepError> {
        let &Settings { regularization, max_iterations, .. } = settings;
        let Some(x) = nearby else { return self.recover(step, settings, begun) };
        let cut = step.system.cut(&step.pose, [&step.q, &step.v], step.h);
        let motion = cut.motion(&x, regularization);
        let ([d, _], [lambda, nu]) = (cut.end(&motion), cut.multipliers(&motion));
        let (mut x, mut allowance) =
            (Unknowns { d, lambda, nu }, Allowance { left: max_iterations, begun, counters: &mut self.counters });
        match full_newton(step, &mut x, regularization, (max_iterations, Until::Solved), &mut allowance) {
            Some(end) => self.arrive_at(step, &x, &end),
            None => self.recover(step, settings, begun),
        }
    }

    /// Up the ladder, with what the step, begun at this number of iterations, may still take.
    #[cold]
    #[inline(never)]
    fn recover<const M: usize, S: Discrete<N, M, CutUnknowns = Vector<K>> + Passage<N>>(
        &mut self,
        step: &Step<'_, S, N, M>,
        settings: &Settings,
        begun: u64,
    ) -> Result<(), StepError> {
        let &Settings { max_iterations, max_work, equilibrium: e, .. } = settings;
        let (a, lambda) = equilibrium(step.system, &self.q, &self.v, e);
        let a = step.system.acceleration_from_rest(&self.q, &self.v).unwrap_or(a);
        let mut allowance = Allowance { left: max_iterations, begun, counters: &mut self.counters };
        if max_work > 0 {
            allowance.left = max_work.saturating_sub(allowance.spent());
        }
        match recover_by_stages(step, settings, (&a, &lambda), &mut allowance)? {
            Recovered::Root(x, end) => self.arrive_at(step, &x, &end),
            Recovered::Scaled { d, acting, v } => {
                self.memory = Memory::NONE;
                self.conclude(step.system, &step.chord(&step.secant(&d), &d, &acting), &v)
            }
        }
    }

    /// At a root of all unknowns.
    fn arrive_at<const M: usize, S: Discrete<N, M, CutUnknowns = Vector<K>>>(
        &mut self,
        step: &Step<'_, S, N, M>,
        Unknowns { d, lambda, nu }: &Unknowns<N, M>,
        end: &Evaluation<S, N, M>,
    ) -> Result<(), StepError> {
        let x = step.system.cut_unknowns(d, [lambda, nu]);
        self.arrive(step.system, &step.chord(&end.secant, d, &end.v), x)
    }

    /// At a root, whose unknowns are remembered.
    #[inline(always)]
    fn arrive<const M: usize, S: Discrete<N, M>>(
        &mut self,
        system: &S,
        over: &StepIncrement<'_, S::Secant, N>,
        x: Vector<K>,
    ) -> Result<(), StepError> {
        if !x.is_finite() {
            return Err(StepError::NotFinite);
        }
        self.memory.remember(over.h, x);
        self.conclude(system, over, over.v)
    }

    /// The run goes on from q₀ + d over the chord, with the rates at which forces have acted, and those at the end.
    #[inline(always)]
    fn conclude<const M: usize, S: Discrete<N, M>>(
        &mut self,
        system: &S,
        over: &StepIncrement<'_, S::Secant, N>,
        v: &Vector<N>,
    ) -> Result<(), StepError> {
        let q = *over.q + *over.d;
        if !(q.is_finite() && v.is_finite()) {
            return Err(StepError::NotFinite);
        }
        if system.follows_work() {
            self.work = self.work.plus(1.0, system.work_over(over));
        }
        (self.q, self.v) = (q, *v);
        let configuration_signs = system.configuration_signs(S::end(over.secant));
        if configuration_signs != self.configuration_signs {
            self.counters.count_sign_changes(self.configuration_signs, configuration_signs);
            self.configuration_signs = configuration_signs;
        }
        self.counters.substeps += 1;
        Ok(())
    }

    /// A step so short that q̈ stays but for round-off.
    #[cold]
    fn taylor_step<const M: usize, S: Discrete<N, M> + Passage<N>>(
        &mut self,
        system: &S,
        settings: &Settings,
        h: f64,
    ) -> Result<(), StepError> {
        let state = self.state(system, settings.equilibrium);
        (self.q, self.v) = (self.q + h * self.v, self.v + h * state.a);
        self.work = self.work.plus(h, state.power);
        self.counters.substeps += 1;
        if self.q.is_finite() && self.v.is_finite() { Ok(()) } else { Err(StepError::NotFinite) }
    }

    /// Refuses a run that is none of this system.
    #[cold]
    pub fn check<const M: usize, S: Discrete<N, M> + Passage<N>>(
        &self,
        system: &S,
        bounds: &super::Bounds,
    ) -> Result<(), Inconsistency> {
        let Memory { h, known, x } = &self.memory;
        if !(x.iter().all(|x| x.is_finite()) && *h >= 0.0 && h.is_finite() && usize::from(*known) <= REMEMBERED) {
            return Err("the stored values of its last steps are not finite");
        }
        self.state(system, bounds.regularizations[0]).check(system, &super::Bounds { in_balance: false, ..*bounds })
    }

    /// The sum of all that it remembers of its last steps: a number that a change of any of it changes.
    pub fn remembered(&self) -> f64 {
        let Memory { h, x, .. } = &self.memory;
        h + x.iter().flat_map(|x| x.iter().enumerate()).map(|(i, x)| x.abs() * (i + 1) as f64).sum::<f64>()
    }
}
