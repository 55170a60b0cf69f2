//! A scene made ready: constant [`Model`], active effects and [`State`]; advances by internal steps.
//!
//! Knows nothing of time, communication points and variables: a run is autonomous but for its inputs, which are held over each macro
//! step.

pub mod angles;
pub mod coupled;
pub mod dense;
mod explicit;
mod lu;
pub mod model;
mod signal;
pub mod system;
pub mod two_leg;
mod variation;

use std::cell::OnceCell;
use std::f64::consts::TAU;
use std::fmt;

use borsh::{BorshDeserialize, BorshSerialize};

use crate::integrator::dop853::Running;
use crate::integrator::{self, Failure, Kkt, Power, System, i3alp, i3alp_printed, rk4};
use crate::mechanism::constraints::largest;
use crate::mechanism::coordinates::{THETA, largest_angle};
use crate::mechanism::{self, COORDINATES, Coordinates, MULTIPLIERS, Multipliers, Pose, Refusal, closure};

pub use crate::effects::Inputs;
use crate::effects::{self, Situation};
pub use crate::integrator::Counters;
use angles::{ANGLES, CLOSURES};
use model::Stepper;
pub use model::{Method, Model, Parameters, Settings, Solve};
pub use signal::{ORDERS, Signal};
use system::{Bare, FiveBar, General, LinearSolve};
pub use variation::{Direction, Variation};

/// Everything that changes during a run. A copy is a complete snapshot.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct State {
    /// Coordinates, velocities, accelerations, multipliers, predictor, sub-step memory, work, counters.
    pub core: integrator::State<COORDINATES, MULTIPLIERS>,
    /// Of [`Method::Dop853`], whose steps run past the communication points: the step that is under way, in the link angles.
    pub running: Option<Running<ANGLES, CLOSURES>>,
    /// Whole turns by which the angles of links 1 to 4 are larger than those in q: there they stay within some turns, so that their
    /// round-off does not grow while a link spins.
    pub turns: [i64; 4],
    /// The inputs to which q̈ and λ belong.
    pub inputs: Inputs,
    /// Of [`Method::Dop853`]: for how many macro steps the inputs before them were held, 0 at first, and these so far.
    pub held: [u64; 2],
    /// Kinetic plus potential energy at the start, J.
    pub energy_at_start: f64,
}

/// Why [`Simulation::advance`] gave up. The state is as it was before the call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepFailure {
    /// How far the call had come, s after its beginning.
    pub elapsed: f64,
    /// Why it went no further.
    pub cause: Failure,
}

impl fmt::Display for StepFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} s into the call, {}", self.elapsed, self.cause)
    }
}

impl std::error::Error for StepFailure {}

/// A scene made ready. A clone goes on by itself, to the same bits.
#[derive(Clone, Debug)]
pub struct Simulation {
    parameters: Parameters,
    model: Model,
    /// Of [`Method::Dop853`] out of date but for the running step: see `present`.
    state: State,
    /// Of [`Method::Dop853`]: the state at the present time, since somebody has looked.
    present: OnceCell<State>,
}

impl Simulation {
    /// Checks the parameters, closes the loop, fixes the list of effects and the linear solve, finds q̈ and λ of the start.
    pub fn new(parameters: &Parameters, inputs: &Inputs) -> Result<Self, Refusal> {
        let model = Model::new(parameters)?;
        let (q, v) = mechanism::close(&model.mechanism.geometry, &parameters.start)?;
        Self::started(parameters, model, q, v, inputs)
    }

    /// The same from the angles (rad) and rates (rad/s) of all four links instead of `parameters.start`: also where the proximal
    /// links alone leave the posture open (coinciding elbows). Refused unless they close the loop.
    pub fn at(parameters: &Parameters, inputs: &Inputs, theta: [f64; 4], omega: [f64; 4]) -> Result<Self, Refusal> {
        let model = Model::new(parameters)?;
        let (q, v) = closure::assemble(&model.mechanism.geometry, theta, omega);
        let simulation = Self::started(parameters, model, q, v, inputs)?;
        let (mechanism, core) = (&simulation.model.mechanism, &simulation.state.core);
        let pose = mechanism.pose(&core.q);
        let (gap, tear) = (largest(&mechanism.phi(&core.q, &pose)), largest(&pose.phi_q_times(&core.v)));
        let speed = parameters.geometry.links.iter().zip(omega).map(|(link, omega)| (link.length * omega).abs()).sum::<f64>();
        if gap > closure::IN_LINE * simulation.model.size {
            return Err(Refusal(format!("link angles {theta:?} rad do not close the loop: the legs end {gap:e} m apart.")));
        }
        if tear > closure::IN_LINE * speed {
            return Err(Refusal(format!("link rates {omega:?} rad/s tear the loop apart at {tear:e} m/s.")));
        }
        Ok(simulation)
    }

    /// The same from a state of a simulation with these parameters and that linear solve; refused if it is of another method.
    pub fn restored(parameters: &Parameters, solve: Solve, state: State) -> Result<Self, Refusal> {
        let model = Model { solve, ..Model::new(parameters)? };
        if matches!(model.stepper, Stepper::Dop853(_)) != state.running.is_some() {
            let method = parameters.settings.method;
            return Err(Refusal(format!("the state belongs to another solver.method than {method:?}, which is set in it.")));
        }
        Ok(Self::in_state(parameters, model, state))
    }

    fn started(parameters: &Parameters, model: Model, q: Coordinates, v: Coordinates, inputs: &Inputs) -> Result<Self, Refusal> {
        let (inputs, turns) = (model.heard(inputs), [0; 4]);
        let core = integrator::State::start(&FiveBar::<General>::new(&model, &inputs, &turns), q, v, model.softness);
        let mut state = State { core, running: None, turns, inputs, held: [0; 2], energy_at_start: 0.0 };
        state.unwind();
        if let Stepper::Dop853(settings) = &model.stepper {
            state.running = Some(explicit::start(&model, settings, &state));
        }
        state.energy_at_start = state.kinetic_energy(&model) + state.potential_energy(&model);
        if !state.core.a.iter().chain(&state.core.lambda).all(|x| x.is_finite()) || !state.energy_at_start.is_finite() {
            return Err(Refusal(
                "the scene has accelerations or energies that are not finite: one of link[i].*, base.distance, init.*, gravity.g, tau[i], \
                 tip.f* is too large or too small for double precision."
                    .into(),
            ));
        }
        Ok(Self::in_state(parameters, model, state))
    }

    fn in_state(parameters: &Parameters, model: Model, state: State) -> Self {
        Self { parameters: parameters.clone(), model, state, present: seen(&state) }
    }

    /// `steps` macro steps of `h` seconds with `inputs` held.
    ///
    /// On failure the state is as it was before the call. Allocates nothing.
    pub fn advance(&mut self, inputs: &Inputs, h: f64, steps: u64) -> Result<(), StepFailure> {
        run(&self.model, &mut self.state, inputs, h, steps, true)?;
        self.moved();
        Ok(())
    }

    /// The same with inputs that change: each macro step holds what they are in its middle, so that the impulse of a ramp is exact and
    /// the whole of second order in h.
    #[inline(always)]
    pub fn advance_along(&mut self, signal: &Signal, h: f64, steps: u64) -> Result<(), StepFailure> {
        if signal.is_held() {
            return self.advance(&signal.value, h, steps);
        }
        let before = self.state;
        for step in 0..steps {
            let begin = step as f64 * h;
            run(&self.model, &mut self.state, &signal.at(begin + h / 2.0), h, 1, false).map_err(|failure| {
                self.state = before;
                StepFailure { elapsed: begin + failure.elapsed, ..failure }
            })?;
        }
        self.moved();
        Ok(())
    }

    /// What somebody has seen is past.
    #[inline(always)]
    fn moved(&mut self) {
        self.present.take();
    }

    /// What it runs with.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The constant part.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Everything that changes; q̈ and λ belong to the inputs of the last step.
    pub fn state(&self) -> &State {
        match &self.state.running {
            Some(running) => self.present.get_or_init(|| explicit::present(&self.model, &self.state, running)),
            None => &self.state,
        }
    }

    /// The same, without keeping what had to be worked out: a simulation that is only stored stays as it is.
    pub fn stored_state(&self) -> State {
        match (&self.state.running, self.present.get()) {
            (Some(running), None) => explicit::present(&self.model, &self.state, running),
            (Some(_), Some(present)) => *present,
            (None, _) => self.state,
        }
    }

    /// The present state with the q̈ and λ that belong to other inputs: what observers answer for. `None` where the inputs are the same.
    pub fn state_for(&self, inputs: &Inputs) -> Option<State> {
        (!self.model.hears_the_same(&self.state.inputs, inputs)).then(|| {
            let mut state = *self.state();
            state.hold(&self.model, &self.model.heard(inputs));
            state
        })
    }

    /// Gives the active effects new parameters from now on; what that adds to the potential energy counts as input. Which effects
    /// are active, and the masses, stay. On refusal nothing has changed.
    pub fn tune(&mut self, parameters: &effects::Parameters) -> Result<(), Refusal> {
        let mut model = self.model.clone();
        if model.tune(parameters)? {
            let mut state = self.state;
            explicit::stop(&self.model, &mut state).map_err(|failure| {
                Refusal(format!("the step that is under way could not be redone up to the present time: {failure}."))
            })?;
            if let Some(running) = &state.running {
                state = explicit::present(&self.model, &state, running);
            }
            let put_in = state.potential_energy(&model) - state.potential_energy(&self.model);
            state.core.work.input += put_in;
            state.restart(&model);
            explicit::resume(&model, &mut state, put_in);
            self.parameters.effects = parameters.clone();
            (self.model, self.state, self.present) = (model, state, seen(&state));
        }
        Ok(())
    }

    /// Whether the loads are too stiff for an explicit method: its steps have been limited by stability instead of accuracy.
    pub fn is_stiff(&self) -> bool {
        self.state.running.as_ref().is_some_and(Running::is_stiff)
    }

    /// Names of the active effects, e.g. `gravity`.
    pub fn active_effects(&self) -> &[&'static str] {
        &self.model.effect_names
    }
}

/// What somebody who looks at a state sees, where that has to be worked out otherwise.
fn seen(state: &State) -> OnceCell<State> {
    if state.running.is_some() { OnceCell::from(*state) } else { OnceCell::new() }
}

impl State {
    /// Kinetic energy, J.
    pub fn kinetic_energy(&self, model: &Model) -> f64 {
        let momentum = model.mechanism.mass_times(&self.core.v);
        momentum.iter().zip(&self.core.v).map(|(p, v)| p * v).sum::<f64>() / 2.0
    }

    /// Potential energy of the active effects, J; the held loads count as work instead.
    pub fn potential_energy(&self, model: &Model) -> f64 {
        self.at(model, |at| model.potential(at))
    }

    /// What effects answer for the present state.
    pub fn at<T>(&self, model: &Model, answer: impl FnOnce(&Situation) -> T) -> T {
        let State { core, inputs, turns, .. } = self;
        let pose = model.mechanism.pose(&core.q);
        answer(&Situation { q: &core.q, v: &core.v, pose: &pose, inputs, turns })
    }

    /// Absolute angles of links 1 to 4, rad, not wrapped.
    pub fn angles(&self) -> [f64; 4] {
        std::array::from_fn(|link| self.core.q[THETA[link]] + self.turns[link] as f64 * TAU)
    }

    /// Moves whole turns of the angles from q into `turns`, where they are more than two.
    #[inline(always)]
    fn unwind(&mut self) {
        if largest_angle(&self.core.q) <= 2.0 * TAU {
            return;
        }
        for (turns, i) in self.turns.iter_mut().zip(THETA) {
            let angle = &mut self.core.q[i];
            if angle.abs() > 2.0 * TAU {
                let whole = (*angle / TAU).round();
                *angle -= whole * TAU;
                *turns = turns.saturating_add(whole as i64);
            }
        }
    }

    /// Holds other inputs from now on: q̈, λ and the predictor start anew.
    #[inline(never)]
    fn hold(&mut self, model: &Model, inputs: &Inputs) {
        self.inputs = *inputs;
        self.restart(model);
    }

    /// Solves M x + Φ_qᵀ y = b, Φ_q x − e y = c at the present pose.
    fn solved(&self, model: &Model, pose: &Pose, b: &Coordinates, c: &Multipliers) -> (Coordinates, Multipliers) {
        let State { inputs, turns, .. } = self;
        FiveBar::<General>::new(model, inputs, turns).factor_mass(pose, model.softness).solve(b, c)
    }

    /// The forces have changed at once: q̈, λ and the predictor start anew.
    fn restart(&mut self, model: &Model) {
        let State { core, inputs, turns, .. } = self;
        core.restart(&FiveBar::<General>::new(model, inputs, turns), model.softness);
    }
}

/// `beyond`: whether a step may run past the end of the call, as long as nothing changes there. On failure the state is as before.
#[inline(always)]
fn run(model: &Model, state: &mut State, inputs: &Inputs, h: f64, steps: u64, beyond: bool) -> Result<(), StepFailure> {
    // What a real-time user asks: a single step costs no copy, and is compiled without the loop.
    if steps == 1
        && model.solve == Solve::Bare
        && let Stepper::I3alp(settings) = &model.stepper
        && !settings.adaptive
        && model.hears_the_same(&state.inputs, inputs)
    {
        return single(model, settings, state, h);
    }
    many(model, state, inputs, h, steps, beyond)
}

/// The same by any method.
#[inline(never)]
fn many(model: &Model, state: &mut State, inputs: &Inputs, h: f64, steps: u64, beyond: bool) -> Result<(), StepFailure> {
    // The default method has compiled forms for the bare mechanism of their own; each more would take its place in the library.
    let inputs = &model.heard(inputs);
    match (&model.stepper, model.solve) {
        (Stepper::I3alp(settings), Solve::Bare) if settings.adaptive => {
            macro_steps::<Bare>(model, state, inputs, h, steps, |system, core, power| {
                i3alp::advance(system, settings, core, h, power)
            })
        }
        (Stepper::I3alp(settings), Solve::Bare) => macro_steps::<Bare>(model, state, inputs, h, steps, |system, core, power| {
            i3alp::fixed(system, settings, core, h, power)
        }),
        (Stepper::I3alp(settings), _) => macro_steps::<General>(model, state, inputs, h, steps, |system, core, power| {
            i3alp::advance(system, settings, core, h, power)
        }),
        (Stepper::I3alpPrinted(settings), _) => macro_steps::<General>(model, state, inputs, h, steps, |system, core, power| {
            i3alp_printed::advance(system, settings, core, h, power)
        }),
        (Stepper::Rk4(settings), _) => macro_steps::<General>(model, state, inputs, h, steps, |system, core, power| {
            rk4::advance(system, settings, core, h, power)
        }),
        (Stepper::Dop853(settings), _) => explicit::run(model, settings, state, inputs, h, steps, beyond),
    }
}

/// One strictly fixed step of the bare mechanism under the inputs that it has.
#[inline(never)]
fn single(model: &Model, settings: &i3alp::Settings, state: &mut State, h: f64) -> Result<(), StepFailure> {
    let State { core, turns, inputs, .. } = state;
    let system = FiveBar::<Bare>::new(model, inputs, turns);
    let mut power = if system.follows_work() { system.power_of(core) } else { Power::default() };
    i3alp::fixed(&system, settings, core, h, &mut power).map_err(|cause| StepFailure { elapsed: 0.0, cause })?;
    state.unwind();
    Ok(())
}

/// By a method whose steps end with the macro steps.
#[inline(never)]
fn macro_steps<L: LinearSolve>(
    model: &Model,
    state: &mut State,
    inputs: &Inputs,
    h: f64,
    steps: u64,
    advance: impl Fn(&FiveBar<'_, L>, &mut integrator::State<COORDINATES, MULTIPLIERS>, &mut Power) -> Result<(), Failure>,
) -> Result<(), StepFailure> {
    let before = (state.core, state.turns, state.inputs);
    if state.inputs != *inputs {
        state.hold(model, inputs);
    }
    let turns_at_start = state.turns;
    let system = FiveBar::<L>::new(model, inputs, &turns_at_start);
    let mut power = if system.follows_work() { system.power_of(&state.core) } else { Power::default() };
    for step in 0..steps {
        let State { core, turns, .. } = state;
        if let Err(cause) = advance(&system.with_turns(turns), core, &mut power) {
            (state.core, state.turns, state.inputs) = before;
            return Err(StepFailure { elapsed: step as f64 * h, cause });
        }
        state.unwind();
    }
    Ok(())
}
