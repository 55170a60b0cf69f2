//! The default method: index-3 augmented Lagrangian with velocity and acceleration projections, in dual form.
//!
//! `docs/method.md` derives it from the paper's equations. With A₀ the tangent without penalty and e = 1/(αβ), the penalty step
//! (A₀ + αβ Φ_qᵀΦ_q) Δq = −f, λ* ← λ* + αΦ is the saddle-point system
//!
//! ```text
//! [ A₀   Φ_qᵀ ] [ Δq ]   [ β Q − M (β q̈ₙ + δ) ]
//! [ Φ_q   −e  ] [ βλ ] = [ −Φ − e β λ*         ]        β = h²/4
//! ```
//!
//! in which the unknown is the total multiplier: nothing large enters a diagonal, nothing winds up.

use super::equilibrium::equilibrium_at;
use super::projection::{self, Projection};
use super::system::local_error;
use super::vectors::{add, combine, finite, max_norm};
use super::vertex::{self, Care, Gate, Ledger, Verdict};
use super::{Counters, Failure, Implicit, Kkt, Power, State};

mod descent;

/// Settings of the method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Whether a macro step is divided into as many sub-steps as the local error asks.
    pub adaptive: bool,
    /// Local error allowed per sub-step, over the link angles, rad.
    pub error_tolerance: f64,
    /// Newton: constraint violation relative to the system's size, at h = 1 ms.
    pub tolerance: f64,
    /// Most Newton iterations per sub-step.
    pub max_iterations: u32,
    /// e = 1/(αβ) = 1/(κ m̄), 1/kg, for a penalty α of κ times m̄/β: the same at every h.
    pub softness: f64,
}

/// More sub-steps than this in one macro step, rejected ones included, end it with a status: a call never hangs.
const MOST_SUBSTEPS: u32 = 100_000;
/// The step at which [`Settings::tolerance`] holds, s. Multiplier noise is Φ/β, so the tolerance falls with h².
const TOLERANCE_STEP: f64 = 1e-3;
/// Over a step shorter than this, s, a change of q̈ is round-off and gives no jerk.
const SHORTEST_FOR_JERK: f64 = 1e-10;
/// A step shorter than this, s, moves on by its Taylor series, which is then exact: Newton would divide round-off by h².
const SHORTEST_FOR_NEWTON: f64 = 1e-12;
/// A last Newton correction below this leaves, by quadratic convergence, an error below round-off.
const LAST_CORRECTION: f64 = 1e-5;

/// What tries have cost, failed ones included.
#[derive(Clone, Copy, Default)]
struct Spent {
    iterations: u64,
    rescued: u64,
}

/// A sub-step that converged, not yet accepted.
struct Attempt<const N: usize, const M: usize> {
    q: [f64; N],
    v: [f64; N],
    a: [f64; N],
    lambda: [f64; M],
    error: f64,
    power: Power,
    modes: u8,
}

/// One step of h: predictor, Newton on positions and total multipliers, velocity projection, acceleration from equilibrium.
/// `energy` is that before it, where round-off next to a vertex would change it.
#[inline(always)]
fn attempt<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    settings: &Settings,
    state: &State<N, M>,
    h: f64,
    energy: Option<Ledger>,
    spent: &mut Spent,
) -> Result<Attempt<N, M>, Failure> {
    if h < SHORTEST_FOR_NEWTON {
        return Ok(Attempt::moved_on(&system.rare(), state, h));
    }

    let mut step = Step::predict(state, h, constraint_tolerance(settings, system.size(), h));
    let Found { q, pose, v } = match newton(system, settings, &mut step, &mut spent.iterations) {
        Ok(found) => found,
        Err(failure) => {
            let from_prediction = Step { delta: [0.0; N], lambda: state.lambda, ..step };
            let second = descent::descend(&system.rare(), settings, from_prediction, &mut spent.iterations);
            spent.rescued += u64::from(second.is_some());
            second.ok_or(failure)?
        }
    };

    // Project the velocity, then the acceleration and the multipliers from equilibrium: one factor serves both.
    let mass = system.factor_mass(&pose, settings.softness);
    let projection = projection::velocity(system, &pose, &mass, &v);
    let mut v = add(&v, &projection);
    if let Some(energy) = energy {
        v = vertex::with_energy(&system.rare(), &q, &pose, &v, energy, h)?;
    }
    let (a, lambda) = equilibrium_at(system, &q, &pose, &v, &mass);

    let error = local_error(system, h, [&state.a, &a], &projection);
    if !(error.is_finite() && finite(&a)) {
        return Err(Failure::NotFinite);
    }
    let power = if system.follows_work() { system.power(&q, &pose, &v) } else { Power::default() };
    Ok(Attempt { q, v, a, lambda, error, power, modes: system.modes(&pose) })
}

/// A step in the making: what it starts from and its two unknowns.
#[derive(Clone, Copy)]
struct Step<const N: usize, const M: usize> {
    h: f64,
    /// β = h²/4.
    beta: f64,
    /// Bound on max |Φ|, m.
    tolerance: f64,
    /// q + h q̇ + h²/2 q̈.
    predicted: [f64; N],
    /// q̇ + h q̈.
    v: [f64; N],
    /// β q̈.
    inertia: [f64; N],
    /// δ, the increment against the prediction.
    delta: [f64; N],
    /// λ, the total multipliers.
    lambda: [f64; M],
}

/// Where the unknowns of a step lead.
struct Found<const N: usize, P> {
    q: [f64; N],
    pose: P,
    /// q̇ of the trapezoidal rule.
    v: [f64; N],
}

impl<const N: usize, const M: usize> Step<N, M> {
    /// δ is the increment against q + h q̇ + h²/2 q̈: an unknown without the round-off of q̈ = 4/h² (q − …).
    #[inline(always)]
    fn predict(state: &State<N, M>, h: f64, tolerance: f64) -> Self {
        let beta = h * h / 4.0;
        Self {
            h,
            beta,
            tolerance,
            predicted: combine([&state.q, &state.v, &state.a], |[q, v, a]| q + h * (v + h / 2.0 * a)),
            v: combine([&state.v, &state.a], |[v, a]| v + h * a),
            inertia: combine([&state.a], |[a]| beta * a),
            delta: combine([&state.jerk], |[jerk]| beta * h * jerk),
            lambda: state.lambda,
        }
    }

    fn q(&self) -> [f64; N] {
        add(&self.predicted, &self.delta)
    }

    /// q̇ of the trapezoidal rule.
    fn velocity(&self) -> [f64; N] {
        let rate = 2.0 / self.h;
        combine([&self.v, &self.delta], |[v, delta]| v + rate * delta)
    }

    /// β q̈ + δ: β times q̈ of the trapezoidal rule.
    fn acceleration(&self) -> [f64; N] {
        add(&self.inertia, &self.delta)
    }
}

/// Newton's method on δ and λ.
#[inline(always)]
fn newton<const N: usize, const M: usize, S: Implicit<N, M>>(
    system: &S,
    settings: &Settings,
    step: &mut Step<N, M>,
    spent: &mut u64,
) -> Result<Found<N, S::Pose>, Failure> {
    let (softness, beta) = (settings.softness, step.beta);
    let mut q = step.q();
    let mut pose = system.pose(&q);
    let mut phi = system.phi(&q, &pose);
    let mut violation = max_norm(&phi);
    let mut iterations = 0;
    loop {
        iterations += 1;
        *spent += 1;
        let v = step.velocity();
        let force = system.forces(&q, &pose, &v);
        let inertia = system.mass_times(&pose, &step.acceleration());
        let b = combine([&force, &inertia], |[force, inertia]| beta * force - inertia);
        let c = combine([&phi, &step.lambda], |[phi, lambda]| -softness * beta * lambda - phi);
        // By reference: a factor may be large, and `?` would move it.
        let tangent = system.factor_tangent(&q, &pose, &v, &step.lambda, step.h, softness);
        let (correction, y) = tangent.as_ref().map_err(|failure| *failure)?.solve(&b, &c);
        step.lambda = combine([&y], |[y]| y / beta);
        step.delta = add(&step.delta, &correction);
        q = step.q();
        pose = system.pose(&q);
        phi = system.phi(&q, &pose);

        let previous = violation;
        violation = max_norm(&phi);
        let at_round_off = violation >= previous && violation < 64.0 * f64::EPSILON * system.size();
        let correction = max_norm(&correction);
        if (violation < step.tolerance || at_round_off) && correction < LAST_CORRECTION {
            return Ok(Found { q, pose, v: step.velocity() });
        }
        if iterations >= settings.max_iterations {
            return Err(Failure::NotConverged { iterations, violation, tolerance: step.tolerance, correction });
        }
    }
}

/// Newton's bound on max |Φ|, m: scaled with the machine and with h², never below round-off.
#[inline(always)]
fn constraint_tolerance(settings: &Settings, size: f64, h: f64) -> f64 {
    let scaled = settings.tolerance * (h / TOLERANCE_STEP) * (h / TOLERANCE_STEP);
    let round_off = 16.0 * f64::EPSILON;
    size * scaled.clamp(round_off.min(settings.tolerance), settings.tolerance)
}

impl Spent {
    fn count(self, counters: &mut Counters) {
        counters.iterations += self.iterations;
        counters.rescued += self.rescued;
    }
}

impl<const N: usize, const M: usize> Attempt<N, M> {
    /// The state after a step so short that q̈ and λ stay.
    #[cold]
    fn moved_on(system: &impl Implicit<N, M>, state: &State<N, M>, h: f64) -> Self {
        let q = std::array::from_fn(|i| state.q[i] + h * state.v[i]);
        let v = std::array::from_fn(|i| state.v[i] + h * state.a[i]);
        let pose = system.pose(&q);
        let power = if system.follows_work() { system.power(&q, &pose, &v) } else { Power::default() };
        Self { q, v, a: state.a, lambda: state.lambda, error: 0.0, power, modes: system.modes(&pose) }
    }

    /// Makes the attempt the new state. `power` is that at the beginning of the sub-step and becomes that at its end.
    #[inline(always)]
    fn accept(self, state: &mut State<N, M>, h: f64, power: &mut Power) {
        if h >= SHORTEST_FOR_JERK {
            state.jerk = combine([&state.a, &self.a], |[before, after]| (after - before) / h);
        }
        // Trapezoidal rule, of the order of the method.
        state.work = state.work.plus(h / 2.0, *power).plus(h / 2.0, self.power);
        *power = self.power;
        state.q = self.q;
        state.v = self.v;
        state.a = self.a;
        state.lambda = self.lambda;
        state.error_estimate = self.error;
        state.on_ray = false;
        state.observe_modes(self.modes);
        state.counters.substeps += 1;
    }
}

/// One macro step of `duration` seconds. On failure the state is undefined: the caller keeps a copy.
pub fn advance<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    settings: &Settings,
    state: &mut State<N, M>,
    duration: f64,
    power: &mut Power,
) -> Result<(), Failure> {
    divided(system, settings, state, duration, power)?;
    state.counters.steps += 1;
    Ok(())
}

/// The same at strictly fixed step, whatever the settings say: for who needs the last nanosecond, without the code around sub-steps.
/// On failure the state is as before.
#[inline(always)]
pub fn fixed<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    settings: &Settings,
    state: &mut State<N, M>,
    duration: f64,
    power: &mut Power,
) -> Result<(), Failure> {
    let mut spent = Spent::default();
    attempt(system, settings, state, duration, None, &mut spent)?.accept(state, duration, power);
    spent.count(&mut state.counters);
    state.counters.steps += 1;
    Ok(())
}

/// A macro step in equal parts, as many as the remembered sub-step asks, asked anew after each; at strictly fixed step in one.
fn divided<const N: usize, const M: usize>(
    system: &impl Implicit<N, M>,
    settings: &Settings,
    state: &mut State<N, M>,
    duration: f64,
    power: &mut Power,
) -> Result<(), Failure> {
    let gate = Gate::for_error_tolerance(settings.error_tolerance);
    let mut rest = duration;
    let (mut substep, mut error) = (duration, f64::INFINITY);
    for _ in 0..MOST_SUBSTEPS {
        let free = Care { longest: f64::INFINITY, round_off: 0.0, softness: settings.softness, energy: None };
        let verdict = match system.vertex(&state.q, &state.v) {
            Some(vertex) if settings.adaptive => vertex::near(&system.rare(), &gate, state, rest, settings.softness, vertex),
            _ => Verdict::Free,
        };
        let care = match verdict {
            Verdict::Free => free,
            Verdict::Near(care) => care,
            Verdict::Carry(ray) => {
                let Settings { softness, max_iterations, .. } = *settings;
                // To round-off: a violation over the small singular value there is an error of angles, which the next sub-step would
                // see however short it is.
                let projection =
                    Projection { softness, tolerance: constraint_tolerance(settings, system.size(), 0.0), max_iterations };
                if vertex::carry(&system.rare(), &ray, state, &projection, power)? {
                    if ray.duration() >= rest {
                        return Ok(());
                    }
                    rest -= ray.duration();
                    continue;
                }
                free
            }
        };
        let (tolerance, parts) = if settings.adaptive {
            let parts = (rest / state.substep.min(care.longest)).ceil().max(1.0);
            (settings.error_tolerance.max(care.round_off), parts)
        } else {
            (f64::INFINITY, 1.0)
        };
        let h = rest / parts;
        (substep, error) = (h, f64::INFINITY);
        let mut spent = Spent::default();
        let attempt = attempt(system, &Settings { softness: care.softness, ..*settings }, state, h, care.energy, &mut spent);
        spent.count(&mut state.counters);
        match attempt {
            Ok(attempt) if attempt.error <= tolerance => {
                if settings.adaptive {
                    let next = h * growth(tolerance, attempt.error).clamp(0.5, 2.0);
                    // A sub-step cut short by the end of its macro step or by a vertex says nothing against longer ones.
                    let cut_short = state.substep.is_finite() && h < 0.5 * state.substep;
                    state.substep = if cut_short { next.max(state.substep) } else { next };
                }
                attempt.accept(state, h, power);
                if parts == 1.0 {
                    return Ok(());
                }
                rest -= h;
            }
            Ok(attempt) => {
                error = attempt.error;
                state.substep = h * growth(tolerance, attempt.error).clamp(0.1, 0.7);
                state.counters.rejected += 1;
            }
            Err(failure) if !settings.adaptive => return Err(failure),
            Err(_) => {
                state.substep = 0.35 * h;
                state.counters.rejected += 1;
            }
        }
    }
    Err(Failure::TooManySubsteps { most: MOST_SUBSTEPS, substep, error })
}

/// By how much the sub-step may change so that its error, of third order, meets the tolerance with a margin.
fn growth(tolerance: f64, error: f64) -> f64 {
    0.85 * libm::cbrt(tolerance / error)
}
