//! A run by the explicit method, whose steps go past the communication points: the running step in the link angles, and the state in
//! the twelve coordinates that it gives at the end of a call.

use std::f64::consts::TAU;

use super::angles::{ANGLES, ByAngles, CLOSURES, LINKS, angles_of};
use super::system::{FiveBar, LinearSolve, TwoLegged};
use super::{Inputs, Model, State, StepFailure};
use crate::integrator::dop853::{Running, Settings};
use crate::integrator::{System, equilibrium_at};

/// The run that begins with a state.
pub(super) fn start(model: &Model, settings: &Settings, state: &State) -> Running<ANGLES, CLOSURES> {
    // Which linear solve the twelve coordinates need does not matter here.
    let five_bar = FiveBar::<TwoLegged>::new(model, &state.inputs);
    Running::start(&ByAngles::new(&five_bar), angles_of(&state.core.q), angles_of(&state.core.v), settings)
}

/// `steps` macro steps of `h` seconds with `inputs` held. On failure the running step is as before, the rest undefined.
pub(super) fn run<L: LinearSolve>(
    model: &Model,
    settings: &Settings,
    state: &mut State,
    inputs: &Inputs,
    h: f64,
    steps: u64,
) -> Result<(), StepFailure> {
    let before = state.running;
    forward::<L>(model, settings, state, inputs, h, steps).inspect_err(|_| state.running = before)
}

fn forward<L: LinearSolve>(
    model: &Model,
    settings: &Settings,
    state: &mut State,
    inputs: &Inputs,
    h: f64,
    steps: u64,
) -> Result<(), StepFailure> {
    let at = |step: u64| move |cause| StepFailure { elapsed: step as f64 * h, cause };
    let five_bar = FiveBar::<L>::new(model, inputs);
    let system = ByAngles::new(&five_bar);
    let Some(running) = &mut state.running else { unreachable!("the method has a running step from the start") };

    if state.inputs != *inputs {
        let before = FiveBar::<L>::new(model, &state.inputs);
        running.cut(&ByAngles::new(&before), settings).map_err(at(0))?;
        running.restart(&system, settings);
        state.inputs = *inputs;
    }
    for step in 0..steps {
        running.advance(&system, settings, h, (steps - step) as f64 * h).map_err(at(step))?;
        unwind(running, &mut state.turns);
    }

    let sample = running.sample(&system, settings).map_err(at(steps))?;
    let core = &mut state.core;
    running.record(&sample, core);
    (core.q, core.v) = system.coordinates(&sample.pose, &sample.q, &sample.v);
    let mass = five_bar.factor_mass(&sample.pose, model.softness);
    (core.a, core.lambda) = equilibrium_at(&five_bar, &core.q, &sample.pose, &core.v, &mass);
    Ok(())
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
