//! A run by the explicit method, whose steps go past the communication points: the running step in the link angles, and the state in
//! the twelve coordinates that it gives at the end of a call.

use std::f64::consts::TAU;

use super::angles::{ANGLES, ByAngles, CLOSURES, LINKS, angles_of};
use super::model::Stepper;
use super::system::{FiveBar, General};
use super::{Inputs, Model, State, StepFailure};
use crate::integrator::dop853::{Running, Settings};
use crate::integrator::{self, Failure, System, equilibrium_at};
use crate::mechanism::{COORDINATES, MULTIPLIERS, Pose};

/// The run that begins with a state.
pub(super) fn start(model: &Model, settings: &Settings, state: &State) -> Running<ANGLES, CLOSURES> {
    let five_bar = FiveBar::<General>::new(model, &state.inputs, &state.turns);
    Running::start(&ByAngles::new(&five_bar), angles_of(&state.core.q), angles_of(&state.core.v), settings)
}

/// Before model or inputs change: what runs past the present time is thrown away, and the present state is the end of a step. On
/// failure the state is undefined.
pub(super) fn stop(model: &Model, state: &mut State) -> Result<(), Failure> {
    let State { core, running: Some(running), turns, inputs, .. } = state else { return Ok(()) };
    let Stepper::Dop853(settings) = &model.stepper else { return Ok(()) };
    let five_bar = FiveBar::<General>::new(model, inputs, turns);
    let system = ByAngles::new(&five_bar);
    running.cut(&system, settings)?;
    look(&system, settings, running, core).map(drop)
}

/// After they have changed, which put in some energy, J.
pub(super) fn resume(model: &Model, state: &mut State, put_in: f64) {
    let State { running: Some(running), turns, inputs, .. } = state else { return };
    let Stepper::Dop853(settings) = &model.stepper else { return };
    let five_bar = FiveBar::<General>::new(model, inputs, turns);
    running.restart(&ByAngles::new(&five_bar), settings, put_in);
}

/// `steps` macro steps of `h` seconds with `inputs` held; `beyond`: whether a step may run past their end. On failure the state is as
/// before.
pub(super) fn run(
    model: &Model,
    settings: &Settings,
    state: &mut State,
    inputs: &Inputs,
    h: f64,
    steps: u64,
    beyond: bool,
) -> Result<(), StepFailure> {
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
        resume(model, state, 0.0);
    }
    let State { core, running: Some(running), turns, .. } = state else { unreachable!("the method has a running step") };
    for step in 0..steps {
        let five_bar = FiveBar::<General>::new(model, inputs, turns);
        let rest = (steps - step) as f64 * h;
        let ahead_and_limit = if beyond { [rest, f64::INFINITY] } else { [f64::INFINITY, rest] };
        running.advance(&ByAngles::new(&five_bar), settings, h, ahead_and_limit).map_err(at(step))?;
        unwind(running, turns);
    }
    let five_bar = FiveBar::<General>::new(model, inputs, turns);
    let pose = look(&ByAngles::new(&five_bar), settings, running, core).map_err(at(steps))?;
    (core.a, core.lambda) = equilibrium_at(&five_bar, &core.q, &pose, &core.v, &five_bar.factor_mass(&pose, model.softness));
    Ok(())
}

/// The present state in the twelve coordinates, but for q̈ and λ; the pose there.
#[inline(always)]
fn look(
    system: &ByAngles<'_, General>,
    settings: &Settings,
    running: &Running<ANGLES, CLOSURES>,
    core: &mut integrator::State<COORDINATES, MULTIPLIERS>,
) -> Result<Pose, Failure> {
    let sample = running.sample(system, settings)?;
    running.record(&sample, core);
    (core.q, core.v) = system.coordinates(&sample.pose, &sample.q, &sample.v);
    Ok(sample.pose)
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
