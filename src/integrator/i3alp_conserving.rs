//! Energy-conserving step of fixed length: index-3 augmented Lagrangian on the energy–momentum rule. Discrete derivatives satisfy the
//! position and velocity constraints (Gonzalez 1996; García Orden and Ortega 2006; Gear, Leimkuhler, Gupta 1985).
//!
//! `docs/conserving.md` derives it. Unknowns are the increment d = q₁ − q₀, Λ = h²λ/2 with the joint forces λ, and the multipliers ν of the
//! velocity constraints. With z = d − M⁻¹J_cᵀν, the mean of h q̇₀ and h q̇₁:
//!
//! ```text
//! M (z − h q̇₀) + J_bᵀ Λ + ½ K_b(z)ᵀ ν = ½ h² Q̄       momentum
//! Φ(q₀ + d) = 0                                        positions
//! J₁ w = 0,   w = h q̇₁ = 2z − h q̇₀                    velocities
//! ```
//!
//! J_b d = ΔΦ = 0 and K_b(z) d = (J₁ − J₀) z, so constraint forces do no work at any h; Q̄ᵀd is the work of the applied forces. Energy, Φ
//! and Φ̇ are therefore conserved to round-off, and no local error is estimated. If plain Newton iteration does not solve a step, the
//! stages of `fallback.rs` follow.

mod fallback;
mod newton;

use borsh::{BorshDeserialize, BorshSerialize};

use super::checks::{Beginning, Checked, Imbalance};
use super::state::branch_if_checked;
use super::{
    Bounds, Counters, CutStep, Discrete, Inconsistency, Passage, Posed, State, StepError, StepIncrement, Transit, Work, equilibrium,
};
use crate::vector::Vector;
use fallback::{ConservingEnd, Rest, Step, from_equilibrium};
use newton::{IterationBudget, NewtonLimits, ResidualBounds, StopRule, staggered_newton};

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Settings {
    /// Largest number of Newton iterations in the first try.
    pub max_iterations: u32,
    /// Largest number of Newton iterations of one step including its fallback stages, except the energy-only stage. 0 allows no fallback
    /// other than a better first guess.
    pub max_work: u32,
    /// Regularisation e of the step's systems, 1/kg. It weights increments and does not move the root.
    pub regularization: f64,
    /// Regularisation e of equilibrium and projections, 1/kg.
    pub equilibrium: f64,
    /// Energy, J, that is always added to the motion's energy in the check of a step's balance.
    pub energy_scale: f64,
}

/// Shortest step solved by Newton's method, s; shorter ones use the Taylor series.
const SHORTEST: f64 = 1e-12;
/// Accelerations below this bound, m/s² and rad/s², are round-off.
const BALANCED: f64 = 1e-12;
/// Number of past steps that the extrapolation of the unknowns uses.
const HISTORY_LENGTH: usize = 6;
/// Number of past steps that a quadratic extrapolation uses.
const PARABOLA: usize = 3;

/// State of a run. Accelerations and joint forces are not part of it; they are computed from equilibrium when they are read.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct ConservingRun<const N: usize, const K: usize> {
    /// Coordinates, m and rad.
    pub q: Vector<N>,
    /// Velocities, m/s and rad/s.
    pub v: Vector<N>,
    /// Work since the start, J.
    pub work: Work,
    /// Energy at q and q̇, J; known after a checked step until anything else changes it.
    energy: Option<f64>,
    /// Signs of the singularity determinants at q, see [`super::System::configuration_signs`].
    pub configuration_signs: u8,
    /// Last branch that a checked state of the motion determined, see [`super::System::branch`].
    branch: Option<u8>,
    /// Counters since the start.
    pub counters: Counters,
    history: History<K>,
}

/// Loop-cut unknowns of past steps; the unknowns of the next step are extrapolated from them.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct History<const K: usize> {
    /// Length of these steps, s.
    h: f64,
    /// Number of steps stored.
    known: u8,
    /// Unknowns, latest step first.
    x: [Vector<K>; HISTORY_LENGTH],
}

impl<const K: usize> History<K> {
    const NONE: Self = Self { h: 0.0, known: 0, x: [Vector::ZERO; HISTORY_LENGTH] };

    /// Extrapolates with the polynomial of degree 5 through the last six steps of length `h`, or with a parabola through three.
    fn extrapolated(&self, h: f64) -> Option<Vector<K>> {
        let Self { known, x: [last, before, third, fourth, fifth, first], .. } = *self;
        match usize::from(known) {
            _ if self.h != h => None,
            HISTORY_LENGTH => Some(6.0 * (last + fifth) - 15.0 * (before + fourth) + 20.0 * third - first),
            PARABOLA.. => Some(3.0 * (last - before) + third),
            _ => None,
        }
    }

    fn remember(&mut self, h: f64, x: Vector<K>) {
        if self.h != h {
            *self = Self { h, ..Self::NONE };
        }
        self.known = (self.known + 1).min(HISTORY_LENGTH as u8);
        self.x = [x, self.x[0], self.x[1], self.x[2], self.x[3], self.x[4]];
    }
}

impl<const N: usize, const K: usize> ConservingRun<N, K> {
    /// Starts a run at q and q̇, which must satisfy the constraints.
    pub fn start<const M: usize, S: Discrete<N, M, K>>(system: &S, q: Vector<N>, v: Vector<N>) -> Self {
        let configuration_signs = system.configuration_signs(&system.pose(&q));
        let counters = Counters::default();
        let branch = branch_if_checked(system, &q, &v);
        Self { q, v, work: Work::default(), energy: None, configuration_signs, branch, counters, history: History::NONE }
    }

    /// Notes a discontinuity of the inputs. A discontinuity makes higher differences of the history useless, so a parabola is used until
    /// the history is full again.
    pub fn change(&mut self) {
        self.history.known = self.history.known.min(PARABOLA as u8);
        self.counters.restarts += 1;
    }

    /// Notes a discontinuity of the motion or the machine that did the given work, J, and clears the history.
    pub fn restart(&mut self, work: Work) {
        self.work += work;
        (self.energy, self.branch, self.history) = (None, None, History::NONE);
        self.counters.restarts += 1;
    }

    /// Full state with q̈, λ and power from equilibrium. The run does not use these values.
    pub fn state<const M: usize, S: Discrete<N, M, K> + Passage<N>>(&self, system: &S, regularization: f64) -> State<N, M> {
        let &Self { q, v, work, configuration_signs, counters, .. } = self;
        let mut state = State { work, counters, ..State::of_motion([q, v], configuration_signs) };
        state.balance(system, &system.pose(&state.q), regularization);
        state
    }

    /// Makes one step of `h` seconds. Fails if no fallback stage finds an end, a value is not finite or the step fails its checks; the run
    /// is then undefined, so the caller keeps a copy. `general` is the unspecialised form of `system`; a specialised form is compiled only
    /// for the first try.
    #[inline(never)]
    pub fn advance<const M: usize, S, G>(&mut self, system: &S, general: &G, settings: &Settings, h: f64) -> Result<(), StepError>
    where
        S: Discrete<N, M, K>,
        G: Discrete<N, M, K> + Passage<N>,
    {
        if h < SHORTEST {
            return self.taylor_step(general, settings, h);
        }
        if self.v.max_norm() == 0.0 {
            if self.is_in_balance(general, settings) {
                self.counters.substeps += 1;
                return Ok(());
            }
            // After rest the history contains no information about the branch.
            self.history = History::NONE;
        }
        let x = match self.history.extrapolated(h) {
            Some(x) => x,
            None => self.predicted_by_equilibrium(general, settings, h),
        };
        let begun = self.counters.iterations;
        let mut guess = Some(x);
        if system.allows_staggering() {
            let Self { q, v, .. } = *self;
            let pose = system.pose(&q);
            let cut = system.cut(&pose, [&q, &v], h, 1.0);
            let accept_root = |end: &_, iterations| {
                self.counters.iterations += u64::from(iterations);
                let [d, v] = cut.end(end);
                let over = StepIncrement { q: &q, d: &d, v: &v, h, softening: 1.0, secant: S::Cut::secant(end) };
                self.conclude(system, settings, &over, &v, Some(S::Cut::unknowns(end)))
            };
            match staggered_newton(
                &cut,
                x,
                &ResidualBounds::cut(system, h),
                settings.regularization,
                settings.max_iterations,
                accept_root,
            ) {
                Ok(arrived) => return arrived,
                Err((left, iterations)) => {
                    self.counters.iterations += u64::from(iterations);
                    guess = left;
                }
            }
        }
        let Self { q, v, .. } = *self;
        self.by_full_newton(&Step::new(general, [&q, &v], h), settings, begun, guess)
    }

    /// Whether a system at rest stays at rest. Newton's method would amplify round-off at a vertex.
    fn is_in_balance<const M: usize, S: Discrete<N, M, K> + Passage<N>>(&self, system: &S, settings: &Settings) -> bool {
        self.state(system, settings.equilibrium).a.max_norm() < BALANCED
    }

    /// First guess of the unknowns from equilibrium, for the start, after a discontinuity, and when h changes.
    fn predicted_by_equilibrium<const M: usize, S>(&mut self, system: &S, settings: &Settings, h: f64) -> Vector<K>
    where
        S: Discrete<N, M, K> + Passage<N>,
    {
        let (a, lambda, _) =
            equilibrium(system, Posed { q: &self.q, pose: &system.pose(&self.q), v: &self.v }, settings.equilibrium);
        let branch = system.acceleration_from_rest(&self.q, &self.v);
        self.counters.launches += u64::from(branch.is_some_and(|a| a.max_norm() > 0.0));
        from_equilibrium::<N, M, K, S>(&self.v, Rest { a: &branch.unwrap_or(a), lambda: &lambda }, h)
    }

    /// Full Newton iteration from the result of the staggered iteration; if it fails, the fallback stages.
    fn by_full_newton<const M: usize, S: Discrete<N, M, K> + Passage<N>>(
        &mut self,
        step: &Step<'_, S, N, M, K>,
        settings: &Settings,
        begun: u64,
        guess: Option<Vector<K>>,
    ) -> Result<(), StepError> {
        let &Settings { regularization, max_iterations, .. } = settings;
        let Some(mut x) = guess else { return self.recover(step, settings, begun) };
        let mut budget = IterationBudget { left: max_iterations, begun, counters: &mut self.counters };
        let limits = NewtonLimits { iterations: max_iterations, stop_rule: StopRule::Solved };
        match step.root(step.h, 1.0, &mut x, regularization, limits, &mut budget) {
            Some(root) => self.accept(step, settings, &root),
            None => self.recover(step, settings, begun),
        }
    }

    /// Runs the fallback stages within the remaining iterations of the step, which began at the iteration count `begun`.
    #[inline(never)]
    fn recover<const M: usize, S: Discrete<N, M, K> + Passage<N>>(
        &mut self,
        step: &Step<'_, S, N, M, K>,
        settings: &Settings,
        begun: u64,
    ) -> Result<(), StepError> {
        let &Settings { max_iterations, max_work, equilibrium: e, .. } = settings;
        let State { a, lambda, .. } = self.state(step.system, e);
        let mut budget = IterationBudget { left: max_iterations, begun, counters: &mut self.counters };
        if max_work > 0 {
            budget.left = max_work.saturating_sub(budget.spent());
        }
        let end = step.recover(settings, Rest { a: &a, lambda: &lambda }, &mut budget)?;
        self.accept(step, settings, &end)
    }

    /// Accepts the end of a step found by full Newton iteration or a fallback stage.
    fn accept<const M: usize, S: Discrete<N, M, K>>(
        &mut self,
        step: &Step<'_, S, N, M, K>,
        settings: &Settings,
        ConservingEnd { x, d, acting, v, secant }: &ConservingEnd<S::Secant, N, K>,
    ) -> Result<(), StepError> {
        self.conclude(step.system, settings, &step.increment(secant, [d, acting]), v, *x)
    }

    /// Ends the step at q₀ + d with velocity `v`. The work uses the rates in `over`, at which the forces were evaluated. If Newton's
    /// method found a root, its unknowns `x` enter the predictor's history; otherwise the history is cleared.
    fn conclude<const M: usize, S: Discrete<N, M, K>>(
        &mut self,
        system: &S,
        settings: &Settings,
        over: &StepIncrement<'_, S::Secant, N>,
        v: &Vector<N>,
        x: Option<Vector<K>>,
    ) -> Result<(), StepError> {
        let q = *over.q + *over.d;
        if !(q.is_finite() && v.is_finite() && x.is_none_or(|x| x.is_finite())) {
            return Err(StepError::NotFinite);
        }
        match x {
            Some(x) => self.history.remember(over.h, x),
            None => self.history = History::NONE,
        }
        let beginning = system.features().checks.then(|| {
            let energy = self.energy.unwrap_or_else(|| system.energy(&self.q, &system.pose(&self.q), &self.v));
            Beginning::of(system, &self.checked(energy))
        });
        if system.features().work {
            self.work = self.work.plus(1.0, system.work_over(over));
        }
        (self.q, self.v) = (q, *v);
        let end = S::end(over.secant);
        let configuration_signs = system.configuration_signs(end);
        self.counters.count_sign_changes(&mut self.configuration_signs, configuration_signs);
        self.counters.substeps += 1;
        let Some(beginning) = beginning else { return Ok(()) };
        let energy = system.energy(&self.q, end, &self.v);
        self.energy = Some(energy);
        self.branch = system.branch(&self.q, &self.v).or(self.branch);
        beginning.check(system, Imbalance::of_conserving(settings.energy_scale), &self.checked(energy), over.h)
    }

    /// The quantities that a step's checks compare, with the given energy, J.
    fn checked(&self, energy: f64) -> Checked<'_, N> {
        let &Self { ref q, ref v, work, configuration_signs, branch, .. } = self;
        Checked { q, v, a: &Vector::ZERO, energy, work, configuration_signs, branch }
    }

    /// Moves the run to the end of a transit past a bifurcation of the constraints, which the system has computed.
    #[cold]
    pub fn cross<const M: usize, S: Discrete<N, M, K>>(&mut self, system: &S, transit: &Transit<N>) -> Result<(), StepError> {
        let Transit { q, v, known, .. } = transit;
        if !(q.is_finite() && v.is_finite()) {
            return Err(StepError::NotFinite);
        }
        (self.q, self.v, self.energy, self.history) = (*q, *v, None, History::NONE);
        if let Some((_, work)) = known {
            self.work += *work;
        }
        self.branch = branch_if_checked(system, q, v).or(self.branch);
        self.counters.count_sign_changes(&mut self.configuration_signs, system.configuration_signs(&system.pose(q)));
        self.counters.substeps += 1;
        self.counters.rescued += 1;
        Ok(())
    }

    /// Takes a step so short that q̈ changes only by round-off.
    fn taylor_step<const M: usize, S: Discrete<N, M, K> + Passage<N>>(
        &mut self,
        system: &S,
        settings: &Settings,
        h: f64,
    ) -> Result<(), StepError> {
        let state = self.state(system, settings.equilibrium);
        (self.q, self.v) = (self.q + h * self.v, self.v + h * state.a);
        self.work = self.work.plus(h, state.power);
        self.energy = None;
        self.counters.substeps += 1;
        if self.q.is_finite() && self.v.is_finite() { Ok(()) } else { Err(StepError::NotFinite) }
    }

    /// Refuses a run with impossible numbers or an open loop. `regularization` is e of equilibrium, 1/kg.
    pub fn check<const M: usize, S: Discrete<N, M, K> + Passage<N>>(
        &self,
        system: &S,
        bounds: &Bounds,
        regularization: f64,
    ) -> Result<(), Inconsistency> {
        let History { h, known, x } = &self.history;
        if !(x.iter().all(|x| x.is_finite()) && *h >= 0.0 && h.is_finite() && usize::from(*known) <= HISTORY_LENGTH) {
            return Err("the stored values of its last steps are not finite");
        }
        if self.energy.is_some_and(|energy| !energy.is_finite()) {
            return Err("its energy is not finite");
        }
        State { branch: self.branch, ..self.state(system, regularization) }.check(system, bounds)
    }
}
