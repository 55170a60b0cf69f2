//! A run by the explicit method, whose steps go past the communication points: the running step in the link angles, and the state in
//! the twelve coordinates that it gives where somebody looks.

use std::f64::consts::TAU;

use super::angles::{ANGLES, ByAngles, CLOSURES, LINKS, angles_of};
use super::model::Stepper;
use super::system::{FiveBar, General};
use super::{Inputs, Model, State, StepFailure};
use crate::integrator::dop853::{Running, Settings};
use crate::integrator::{Failure, System, equilibrium_at};

/// The run that begins with a state.
pub(super) fn start(model: &Model, settings: &Settings, state: &State) -> Running<ANGLES, CLOSURES> {
    let five_bar = FiveBar::<General>::new(model, &state.inputs, &state.turns);
    Running::start(&ByAngles::new(&five_bar), angles_of(&state.core.q), angles_of(&state.core.v), settings)
}

/// Before model or inputs change: what runs past the present time is thrown away, and the present state is the end of a step. On
/// failure the state is undefined.
pub(super) fn stop(model: &Model, state: &mut State) -> Result<(), Failure> {
    let State { running: Some(running), turns, inputs, .. } = state else { return Ok(()) };
    let Stepper::Dop853(settings) = &model.stepper else { return Ok(()) };
    let five_bar = FiveBar::<General>::new(model, inputs, turns);
    running.cut(&ByAngles::new(&five_bar), settings)
}

/// After they have changed, which put in some energy, J.
pub(super) fn resume(model: &Model, state: &mut State, put_in: f64) {
    let State { running: Some(running), turns, inputs, .. } = state else { return };
    let Stepper::Dop853(settings) = &model.stepper else { return };
    let five_bar = FiveBar::<General>::new(model, inputs, turns);
    running.restart(&ByAngles::new(&five_bar), settings, put_in);
}

/// `steps` macro steps of `h` seconds with `inputs` held; `beyond`: whether a step may run past their end. On failure the state is as
/// before. Afterwards its core is out of date, see [`present`].
pub(super) fn run(
    model: &Model,
    settings: &Settings,
    state: &mut State,
    inputs: &Inputs,
    h: f64,
    steps: u64,
    beyond: bool,
) -> Result<(), StepFailure> {
    // A call that ends inside the running step, as most do, costs no copy.
    if steps == 1
        && state.inputs == *inputs
        && let Some(running) = &mut state.running
        && running.pass(h)
    {
        state.held[1] += 1;
        return Ok(());
    }
    let before = *state;
    forward(model, settings, state, inputs, h, steps, beyond).inspect_err(|_| *state = before)
}

fn forward(
    model: &Model,
    settings: &Settings,
    state: &mut State,
    inputs: &Inputs,
    h: f64,
    steps: u64,
    beyond: bool,
) -> Result<(), StepFailure> {
    let at = |step: u64| move |cause| StepFailure { elapsed: step as f64 * h, cause };
    if state.inputs != *inputs {
        stop(model, state).map_err(at(0))?;
        state.inputs = *inputs;
        state.held = [state.held[1], 0];
        resume(model, state, 0.0);
    }
    let State { running: Some(running), turns, held: [before, now], .. } = state else {
        unreachable!("the method has a running step")
    };
    for step in 0..steps {
        if !running.pass(h) {
            let five_bar = FiveBar::<General>::new(model, inputs, turns);
            let rest = (steps - step) as f64 * h;
            // Inputs that have changed may change again after as many macro steps as before: to step past that would be in vain.
            let same = before.saturating_sub(*now);
            let limit = if !beyond {
                rest
            } else if same > 0 {
                same as f64 * h
            } else {
                f64::INFINITY
            };
            // Nobody looks into a step that ends with the call.
            let ahead = if limit > rest { rest } else { f64::INFINITY };
            running.advance(&ByAngles::new(&five_bar), settings, h, [ahead, limit]).map_err(at(step))?;
            unwind(running, turns);
        }
        *now += 1;
    }
    Ok(())
}

/// The present state in the twelve coordinates, with q̈ and λ from equilibrium: what the running step gives, worked out when somebody
/// looks. Nothing that is looked at is built upon.
pub(super) fn present(model: &Model, state: &State, running: &Running<ANGLES, CLOSURES>) -> State {
    let Stepper::Dop853(settings) = &model.stepper else { unreachable!("the method has a running step") };
    let five_bar = FiveBar::<General>::new(model, &state.inputs, &state.turns);
    let system = ByAngles::new(&five_bar);
    let sample = running.sample(&system, settings);
    let mut core = state.core;
    running.record(&sample, &mut core);
    (core.q, core.v) = system.coordinates(&sample.pose, &sample.q, &sample.v);
    let mass = five_bar.factor_mass(&sample.pose, model.softness);
    (core.a, core.lambda) = equilibrium_at(&five_bar, &core.q, &sample.pose, &core.v, &mass);
    State { core, ..*state }
}

/// Moves whole turns of the angles into `turns`, where they are more than two: as [`State::unwind`] does with q.
#[inline(always)]
fn unwind(running: &mut Running<ANGLES, CLOSURES>, turns: &mut [i64; 4]) {
    if running.origin().iter().all(|angle| angle.abs() <= 2.0 * TAU) {
        return;
    }
    let whole = running.origin().map(|angle| if angle.abs() > 2.0 * TAU { (angle / TAU).round() } else { 0.0 });
    running.shift(&whole.map(|whole| -whole * TAU));
    for (turns, i) in turns.iter_mut().zip(LINKS) {
        *turns = turns.saturating_add(whole[i] as i64);
    }
}
