//! A simulation that tracks a measured machine: a run, and the estimator that corrects it.

use std::f64::consts::TAU;

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};

use super::commands::Delay;
use super::learned::Perturbed;
use super::linearised::{FollowedScene, by_true_angles, with_unknown_force};
use super::macro_steps::MacroSteps;
use super::settings::sticking_law;
use super::{Inputs, Model, Parameters, Run, Signal, Simulation, State, StepFailure};
use crate::copies::clone_by_fields;
use crate::effects;
use crate::estimator::error_state::{DRY, LENGTHS, Learned, MASSES};
use crate::estimator::{self, Cause, Estimator, Fault, LinkState, MEASURED, Machine, Measured, Status};
use crate::mechanism::SceneError;

/// A simulation with an estimator. A clone continues independently, with the same bits.
#[derive(Debug)]
pub struct Following {
    /// Parameters as the master has set them.
    parameters: Parameters,
    /// Simulation of the machine with its learned parameters.
    simulation: Simulation,
    believed: Machine,
    /// Boxed: larger than the rest together.
    estimate: Box<Estimate>,
}

clone_by_fields!(Following { parameters, simulation, believed, estimate });

/// Changing part of the estimator and of its connection to the run.
#[derive(Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Estimate {
    estimator: Estimator,
    /// Inputs set by the master; the run has them plus the estimated unknown force.
    inputs: Inputs,
    /// Whole turns of the motor links beyond their encoder readings, updated while both encoders are trusted.
    beyond: [i64; 2],
    /// Faults reported so far: one bit per kind for each encoder.
    reported: [u8; 2],
}

clone_by_fields!(Estimate { estimator, inputs, beyond, reported });

impl Estimate {
    /// Estimate at a start. Not inlined, because it needs much stack.
    #[inline(never)]
    fn new(believed: &Machine, inputs: &Inputs) -> Box<Self> {
        Box::new(Self { estimator: Estimator::new(believed), inputs: *inputs, beyond: [0; 2], reported: [0; 2] })
    }
}

impl Following {
    /// Simulation at its start, before the first sample. Refuses parameters without `estimator.enabled`, and friction that sticks.
    pub fn new(parameters: &Parameters, inputs: &Inputs) -> Result<Self, SceneError> {
        if !parameters.estimator.enabled {
            return Err(SceneError("estimator.enabled = false is not allowed if a machine is followed: it must be true.".into()));
        }
        parameters.estimator.check(parameters.settings.step_size)?;
        if let Some(name) = sticking_law(&parameters.effects) {
            return Err(SceneError(format!(
                "{name} = stick is not allowed with estimator.enabled = true, which propagates its covariance through \
                 smooth laws: it must be smooth."
            )));
        }
        let simulation = Simulation::new(parameters, inputs)?;
        let believed = machine_of(parameters);
        let estimate = Estimate::new(&believed, inputs);
        Ok(Self { parameters: parameters.clone(), simulation, believed, estimate })
    }

    /// Continues a stored run, as [`Simulation::restored`]. Refused unless the estimate is possible.
    pub fn restored(parameters: &Parameters, run: Run, estimate: Box<Estimate>) -> Result<Self, SceneError> {
        Model::new(parameters)?;
        let mut machine = parameters.clone();
        let mut believed = machine_of(parameters);
        if let Some(learned) = estimate.estimator.learned() {
            machine.learn(parameters, &learned);
            believed.learn(&learned);
        }
        let simulation = Simulation::continued(&machine, Box::new(Model::within_bounds(&machine)?), run)?;
        estimate.estimator.check(&believed, &simulation.run.motion(&simulation.model)).map_err(|what| SceneError(what.into()))?;
        if !estimate.inputs.are_finite() {
            return Err(SceneError("an input of its estimator is not finite".into()));
        }
        Ok(Self { parameters: parameters.clone(), simulation, believed, estimate })
    }

    /// Measurement update by the samples that are new at time `now`, s, on the encoders' clock.
    pub fn correct(&mut self, measured: &Measured, now: f64) {
        let Self { parameters, simulation, believed, estimate } = self;
        let Estimate { estimator, inputs, beyond, .. } = &mut **estimate;
        let Simulation { model, run, parameters: machine } = simulation;
        let (before, at) = (estimator.learned(), run.motion(model));
        let corrected = estimator.correct(believed, &at, measured, now);
        for (i, link) in MEASURED.into_iter().enumerate() {
            if corrected.is_some() && estimator.has_restarted() {
                // A lost estimate may have miscounted turns: the last trusted count is used.
                run.turns[link] = beyond[i];
            } else if estimator.is_settled() {
                beyond[i] = run.turns[link].saturating_add(((at.theta[link] - measured.theta[i]) / TAU).round() as i64);
            }
        }
        let learned = estimator.learned();
        if let Some(motion) = corrected.or_else(|| (learned != before).then_some(at)) {
            let inputs = by_true_angles(model, inputs, learned.as_ref());
            let inputs = with_unknown_force(&inputs, &estimator.belief().force);
            let energy = run.leave(model, &at, &inputs);
            if let Some(learned) = learned {
                machine.learn(parameters, &learned);
                // Learned parameters within their bounds can be simulated, and by the same method.
                if let Ok(learned) = Model::within_bounds(machine) {
                    **model = learned;
                    let _ = run.configure(model);
                }
            }
            run.resume_at(model, &motion, &inputs, energy);
        }
    }

    /// Advances by `steps` macro steps of h seconds with inputs that change. A failure leaves the value undefined: the caller keeps a copy.
    pub fn advance_along(&mut self, signal: &Signal, h: f64, steps: u64) -> Result<(), StepFailure> {
        let Some(mut commands) = self.simulation.run.commands.take() else {
            let one = MacroSteps { h, count: 1, open_ended: signal.is_held(), change: f64::INFINITY };
            return signal.over((h, steps), |inputs| self.step(inputs, one));
        };
        let Some(delay) = Delay::of(&self.simulation.model) else { unreachable!("the run has commands") };
        let taken = commands.over(delay, signal, (h, steps), &mut |inputs, steps| {
            (0..steps.count).try_for_each(|k| {
                self.step(inputs, MacroSteps { count: 1, ..steps }).map_err(|failure| failure.after(k as f64 * steps.h))
            })
        });
        self.simulation.run.commands = Some(commands);
        taken
    }

    /// Time update by one macro step: motion, then covariance.
    #[inline(never)]
    fn step(&mut self, inputs: &Inputs, one: MacroSteps) -> Result<(), StepFailure> {
        let Self { parameters, simulation: Simulation { model, run, parameters: machine }, believed, estimate } = self;
        let before = std::mem::replace(&mut estimate.inputs, *inputs);
        let (turns, from) = (run.turns, run.motion(model));
        let learned = estimate.estimator.learned();
        let [before, inputs] = &[&before, inputs].map(|inputs| by_true_angles(model, inputs, learned.as_ref()));
        run.advance_apart(model, &with_unknown_force(inputs, &estimate.estimator.belief().force), one)?;
        let perturbed = estimate.estimator.asks_for_parameters().then(|| Perturbed::new(machine, parameters.learns_lengths()));
        let scene = FollowedScene { model, inputs: *inputs, before, turns: &turns, learned: perturbed.as_ref() };
        estimate.estimator.predict(believed, &scene, [&from, &run.motion(model)], one.h);
        Ok(())
    }

    /// Simulation of the machine with its learned parameters; its inputs include the unknown force.
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// Changing part of the estimation, for a stored state.
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    /// Parameters in force, as the master has set them.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Present state, with the q̈ and λ that belong to `inputs` plus the unknown force; servo references are converted to true angles.
    pub fn state_for(&self, inputs: &Inputs) -> State {
        self.simulation.run.state(&self.simulation.model, &self.acting(inputs, 0.0))
    }

    /// Inputs that act `later` seconds from now if the master leaves them at `inputs`, plus the unknown force; servo references are converted
    /// to true angles.
    fn acting(&self, inputs: &Inputs, later: f64) -> Inputs {
        let (estimator, Simulation { model, run, .. }) = (&self.estimate.estimator, &self.simulation);
        let inputs = match run.commands.as_ref().zip(Delay::of(model)) {
            None => *inputs,
            Some((commands, delay)) => commands.expected(delay, inputs, later),
        };
        with_unknown_force(&by_true_angles(model, &inputs, estimator.learned().as_ref()), &estimator.belief().force)
    }

    /// Sets other tunable parameters of effects and estimator; see [`Simulation::tune`]. A failure leaves the value undefined: the caller
    /// keeps a copy.
    pub fn tune(&mut self, effects: &effects::Parameters, estimator: &estimator::Parameters) -> Result<(), SceneError> {
        estimator.check(self.parameters().settings.step_size)?;
        let tuned = Parameters { effects: effects.clone(), estimator: estimator.clone(), ..self.parameters.clone() };
        // Only the master's parameters can be refused, not learned values within their bounds.
        Model::new(&tuned)?;
        self.estimate.estimator.begin_anew_where_tuned(&self.believed, tuned.prior().as_ref());
        let mut machine = tuned.clone();
        // A payload that joins changes the masses.
        self.believed = machine_of(&tuned);
        if let Some(learned) = self.estimate.estimator.learned() {
            machine.learn(&tuned, &learned);
            self.believed.learn(&learned);
        }
        self.simulation.tune_within_bounds(machine)?;
        self.parameters = tuned;
        Ok(())
    }

    /// Present estimate of angles and rates of links 1 to 4.
    pub fn motion(&self) -> LinkState {
        self.simulation.run.motion(&self.simulation.model)
    }

    /// Motor torques equivalent to the unknown force, N·m, and their standard deviations; `None` if no motor torques are equivalent to it.
    pub fn motor_torques(&self) -> Option<([f64; 2], [f64; 2])> {
        self.estimate.estimator.motor_torques(&self.believed, &self.motion())
    }

    /// Normalised estimation error squared (NEES) against the true angles, rad, and rates, rad/s, of links 1 to 4; 4 on average if the
    /// covariance is consistent.
    pub fn nees(&self, theta: &[f64; 4], omega: &[f64; 4]) -> f64 {
        self.estimate.estimator.nees(&self.believed, &self.motion(), &LinkState::new(*theta, *omega))
    }

    /// Learned values and their standard deviations, in the order of [`estimator::error_state`]: masses, kg, friction, N·m·s/rad, factor of
    /// dry friction, lengths, m, encoder biases, rad. If nothing is learned, the parameters in force.
    pub fn learned(&self) -> [Learned; 2] {
        let estimator = &self.estimate.estimator;
        let (values, sigma) = (estimator.learned().unwrap_or_else(|| self.parameters().known()), estimator.learned_sigma());
        let natural = Learned::from_fn(|i, _| self.natural(i, values[i]));
        [natural, Learned::from_fn(|i, _| if MASSES.contains(&i) || i == DRY { sigma[i] * natural[i] } else { sigma[i] })]
    }

    /// Converts a parameter from the unit of the filter to the reported unit.
    fn natural(&self, i: usize, value: f64) -> f64 {
        match i {
            _ if MASSES.contains(&i) => self.parameters().geometry.links[i].mass * libm::exp(value),
            DRY => libm::exp(value),
            _ if LENGTHS.contains(&i) => self.believed.length(i - LENGTHS.start) + value,
            _ => value,
        }
    }

    /// The machine as the estimator believes it to be.
    pub fn believed(&self) -> &Machine {
        &self.believed
    }

    /// Standard deviations of the angles, rad, and rates, rad/s, of links 1 to 4.
    pub fn sigmas(&self) -> [[f64; 4]; 2] {
        self.estimate.estimator.sigmas(&self.believed, &self.motion()).map(Into::into)
    }

    /// Covariance of the tip position, m²: xx, xy, yy.
    pub fn tip_covariance(&self) -> [f64; 3] {
        let covariance = self.estimate.estimator.tip_covariance(&self.believed, &self.motion());
        [covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]]
    }

    /// Radius about the estimated tip, m, that contains the true tip with a probability of 95 %.
    pub fn tip_radius(&self) -> f64 {
        self.estimate.estimator.tip_radius(&self.believed, &self.motion())
    }

    /// Probability of a direct singularity within the horizon if the master leaves its inputs at `inputs`, plus the unknown force. Commands
    /// that wait for `servo.delay` act at their times.
    pub fn singularity_probability(&self, inputs: &Inputs) -> f64 {
        let (Simulation { model, run, parameters }, now) = (&self.simulation, self.acting(inputs, 0.0));
        let scene = |later: f64| {
            let inputs = if run.commands.is_some() { self.acting(inputs, later) } else { now };
            FollowedScene { model, inputs, before: &now, turns: &run.turns, learned: None }
        };
        let step = parameters.settings.step_size;
        self.estimate.estimator.singularity_probability(&self.believed, &self.motion(), scene, step)
    }

    /// Most probable cause of a deviation from the model, and its probability.
    pub fn cause(&self) -> (Cause, f64) {
        self.estimate.estimator.cause(&self.believed)
    }

    /// The estimator.
    pub fn estimator(&self) -> &Estimator {
        &self.estimate.estimator
    }

    /// Quality of the estimate.
    pub fn status(&self) -> Status {
        self.estimate.estimator.status()
    }

    /// Faults of encoders that have not been reported yet: encoder index and fault, [`Fault::None`] for an encoder that has become silent.
    pub fn take_reports(&mut self) -> ArrayVec<(usize, Fault), 2> {
        let Estimate { estimator, reported, .. } = &mut *self.estimate;
        let mut news = ArrayVec::new();
        for (i, reported) in reported.iter_mut().enumerate() {
            let (silent, fault) = estimator.encoder(i);
            let bit = 1 << fault as u8;
            // An encoder that has never sent a sample is not connected, so it is not silent.
            if *reported & bit == 0 && (fault != Fault::None || silent && estimator.has_received(i)) {
                *reported |= bit;
                news.push((i, fault));
            }
        }
        news
    }

    /// Learned parameters that have been moved to a bound since the last call, in the order of [`estimator::error_state`]: index, value and
    /// both bounds, in the units of [`learned`](Self::learned). Each is reported once, and again only after all values have been within
    /// their bounds for 1 s.
    pub fn take_bounds(&mut self) -> Vec<(usize, f64, [f64; 2])> {
        let reached: Vec<(usize, [f64; 2])> = self.estimate.estimator.take_bounds(&self.believed).collect();
        let in_units = |(i, bounds): (usize, [f64; 2])| (i, self.learned()[0][i], bounds.map(|bound| self.natural(i, bound)));
        reached.into_iter().map(in_units).collect()
    }
}

/// Machine of a scene, before anything is learned.
fn machine_of(parameters: &Parameters) -> Machine {
    let geometry = parameters.effects.with_added_masses(&parameters.geometry);
    Machine::new(&geometry, &parameters.estimator, parameters.prior())
}
