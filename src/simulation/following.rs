//! A simulation that follows a measured machine: a run, and the estimator that corrects it.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};

use super::five_bar::FiveBar;
use super::run::MacroSteps;
use super::settings::sticking_law;
use super::{Inputs, Parameters, Run, Signal, Simulation, State, StepFailure};
use crate::effects;
use crate::estimator::{self, Constants, Estimator, Fault, Measured, Status};
use crate::mechanism::SceneError;

/// A simulation with an estimator. A clone continues independently, equal to the bit.
#[derive(Clone, Debug)]
pub struct Following {
    simulation: Simulation,
    constants: Constants,
    estimate: Estimate,
}

/// Changing part of the estimation.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Estimate {
    estimator: Estimator,
    /// Inputs set by the master; the run holds them plus the estimated unknown force.
    inputs: Inputs,
    /// Faults reported so far, for each encoder a bit per kind.
    reported: [u8; 2],
}

/// Inputs plus the estimated unknown force: torques, N·m, and tip forces, N.
fn with_unknown_force(inputs: &Inputs, force: &[f64; 4]) -> Inputs {
    let [left, right, x, y] = *force;
    Inputs {
        tau: [inputs.tau[0] + left, inputs.tau[1] + right],
        tip_force: [inputs.tip_force[0] + x, inputs.tip_force[1] + y],
        ..*inputs
    }
}

impl Following {
    /// Simulation at its start, before the first sample.
    #[cold]
    pub fn new(parameters: &Parameters, inputs: &Inputs) -> Result<Self, SceneError> {
        parameters.estimator.check(parameters.settings.step_size)?;
        if let Some(name) = sticking_law(&parameters.effects) {
            return Err(SceneError(format!(
                "{name} = stick is not allowed with estimator.enabled = true, which propagates its covariance through \
                 smooth laws: it must be smooth."
            )));
        }
        let simulation = Simulation::new(parameters, inputs)?;
        let constants = Constants::new(&simulation.model.mechanism.geometry, &parameters.estimator);
        let (theta, omega) = simulation.run.motion(&simulation.model);
        let estimator = Estimator::new(&constants, theta, omega);
        Ok(Self { simulation, constants, estimate: Estimate { estimator, inputs: *inputs, reported: [0; 2] } })
    }

    /// Continues a stored run, see [`Simulation::restored`]. Refused unless the estimate is consistent with the motion.
    #[cold]
    pub fn restored(parameters: &Parameters, run: Run, estimate: Estimate) -> Result<Self, SceneError> {
        let simulation = Simulation::restored(parameters, run)?;
        let constants = Constants::new(&simulation.model.mechanism.geometry, &parameters.estimator);
        let (theta, omega) = simulation.run.motion(&simulation.model);
        estimate.estimator.check(&constants, &theta, &omega).map_err(|what| SceneError(what.into()))?;
        let held = with_unknown_force(&estimate.inputs, &estimate.estimator.track().force);
        if !estimate.inputs.are_finite() || held != *simulation.inputs() {
            return Err(SceneError("the inputs of its estimator are not those of its run".into()));
        }
        Ok(Self { simulation, constants, estimate })
    }

    /// Measurement update by the samples that are new at time `now`, s on the encoders' clock.
    pub fn correct(&mut self, measured: &Measured, now: f64) {
        let Self { simulation, constants, estimate: Estimate { estimator, inputs, .. } } = self;
        if estimator.correct(constants, measured, now) {
            let track = estimator.track();
            let motion = (track.theta, track.omega);
            simulation.run.resume_from(&simulation.model, motion, &with_unknown_force(inputs, &track.force));
        }
    }

    /// `steps` macro steps of h seconds with inputs that change. A failure leaves the value undefined: the caller keeps a copy.
    pub fn advance_along(&mut self, signal: &Signal, h: f64, steps: u64) -> Result<(), StepFailure> {
        let one = MacroSteps { h, count: 1, open_ended: signal.is_held() };
        for step in 0..steps {
            let begin = step as f64 * h;
            let inputs = if signal.is_held() { signal.value } else { signal.at(begin + h / 2.0) };
            self.step(&inputs, one).map_err(|failure| StepFailure { elapsed: begin + failure.elapsed, ..failure })?;
        }
        Ok(())
    }

    /// Time update by one macro step: motion, then covariance.
    fn step(&mut self, inputs: &Inputs, one: MacroSteps) -> Result<(), StepFailure> {
        let Self { simulation: Simulation { model, run, .. }, constants, estimate } = self;
        estimate.inputs = *inputs;
        let held = with_unknown_force(inputs, &estimate.estimator.track().force);
        let turns = run.turns;
        run.advance(model, &held, one)?;
        let (theta, omega) = run.motion(model);
        let [scene, known] = [&held, inputs].map(|inputs| FiveBar::<false>::new(model, inputs, &turns));
        estimate.estimator.predict(constants, [&scene, &known], (&theta, &omega), one.h);
        Ok(())
    }

    /// Simulation whose inputs include the unknown force.
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// Changing part of the estimation, for a stored state.
    pub fn estimate(&self) -> &Estimate {
        &self.estimate
    }

    /// Parameters in force.
    pub fn parameters(&self) -> &Parameters {
        self.simulation.parameters()
    }

    /// Inputs of the master that the last step held; before the first step those of the start.
    pub fn inputs(&self) -> &Inputs {
        &self.estimate.inputs
    }

    /// Present state, with the q̈ and λ that belong to `inputs` plus the unknown force.
    pub fn state_for(&self, inputs: &Inputs) -> State {
        self.simulation.state_for(&with_unknown_force(inputs, &self.estimate.estimator.track().force))
    }

    /// Sets other tunable parameters of effects and estimator; see [`Simulation::tune`].
    #[cold]
    pub fn tune(&mut self, effects: &effects::Parameters, estimator: &estimator::Parameters) -> Result<(), SceneError> {
        estimator.check(self.parameters().settings.step_size)?;
        self.simulation.tune(effects)?;
        self.simulation.tune_estimator(estimator);
        // A payload that joins changes the masses, and the rates by an impact.
        let Simulation { model, run, .. } = &self.simulation;
        self.constants = Constants::new(&model.mechanism.geometry, estimator);
        let (theta, omega) = run.motion(model);
        self.estimate.estimator.move_to(theta, omega);
        Ok(())
    }

    /// Motor torques equivalent to the unknown force, N·m, and their standard deviations; `None` where no motor torques are.
    pub fn motor_torques(&self) -> Option<([f64; 2], [f64; 2])> {
        self.estimate.estimator.motor_torques(&self.constants)
    }

    /// Normalised estimation error squared against the true angles, rad, and rates, rad/s, of links 1 to 4: 4 on average for a consistent
    /// covariance.
    pub fn nees(&self, theta: &[f64; 4], omega: &[f64; 4]) -> f64 {
        self.estimate.estimator.nees(&self.constants, theta, omega)
    }

    /// Standard deviations of the angles, rad, and rates, rad/s, of links 1 to 4.
    pub fn sigmas(&self) -> [[f64; 4]; 2] {
        self.estimate.estimator.sigmas(&self.constants)
    }

    /// Covariance of the tip position, m²: xx, xy, yy.
    pub fn tip_covariance(&self) -> [f64; 3] {
        self.estimate.estimator.tip_covariance(&self.constants)
    }

    /// Probability of a direct singularity within the horizon under held `held` inputs, the unknown force included: see
    /// [`state_for`](Self::state_for).
    pub fn singularity_probability(&self, held: &Inputs) -> f64 {
        let Simulation { model, run, parameters } = &self.simulation;
        let scene = FiveBar::<false>::new(model, held, &run.turns);
        self.estimate.estimator.singularity_probability(&self.constants, &scene, parameters.settings.step_size)
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
        let Estimate { estimator, reported, .. } = &mut self.estimate;
        let mut news = ArrayVec::new();
        for (i, reported) in reported.iter_mut().enumerate() {
            let (silent, fault) = estimator.encoder(i);
            let bit = 1 << fault as u8;
            // An encoder that has never sent a sample is not connected, hence not silent.
            if *reported & bit == 0 && (fault != Fault::None || silent && estimator.has_received(i)) {
                *reported |= bit;
                news.push((i, fault));
            }
        }
        news
    }
}

impl Estimate {
    /// The inputs of the master.
    pub fn inputs(&self) -> &Inputs {
        &self.inputs
    }
}
