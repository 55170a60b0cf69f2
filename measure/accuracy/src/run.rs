//! A run of a scene, in communication steps like a master's.

use std::rc::Rc;

use anyhow::{Result, anyhow, ensure};
use fivebar::observers;
use fivebar::simulation::{Inputs, Parameters, Simulation, StepFailure};
use hard_cases::Setting;

/// Communication step, s; longer if the internal step is longer.
pub const COMMUNICATION: f64 = 1e-3;

/// A scene and a method.
#[derive(Clone, Debug)]
pub struct Run {
    /// The simulation.
    pub simulation: Simulation,
    /// Inputs, constant over each communication step; the last entry applies to all later steps.
    inputs: Rc<[Inputs]>,
    /// Macro step, s.
    step: f64,
    /// Macro steps per communication step.
    steps: u64,
    /// Communication steps completed.
    done: u64,
}

impl Run {
    /// Starts a run. Refuses several entries of `inputs` with steps beyond 1 ms, because a master cannot change inputs during a step.
    pub fn new(parameters: &Parameters, inputs: &Rc<[Inputs]>, setting: Setting) -> Result<Self> {
        let mut parameters = parameters.clone();
        setting.apply(&mut parameters);
        let step = parameters.settings.step_size;
        let steps = (COMMUNICATION / step).round().max(1.0) as u64;
        ensure!(inputs.len() == 1 || step <= COMMUNICATION, "inputs change every 1 ms, and the step is {} ms", 1e3 * step);
        let simulation = Simulation::new(&parameters, &inputs[0]).map_err(|refusal| anyhow!("{}", refusal.0))?;
        Ok(Self { simulation, inputs: inputs.clone(), step, steps, done: 0 })
    }

    /// Length of a communication step, s.
    pub fn communication(&self) -> f64 {
        self.step * self.steps as f64
    }

    /// Current time, s.
    pub fn time(&self) -> f64 {
        self.communication() * self.done as f64
    }

    /// Makes one communication step.
    #[inline]
    pub fn advance(&mut self) -> Result<(), StepFailure> {
        let inputs = &self.inputs[self.inputs.len().min(self.done as usize + 1) - 1];
        self.simulation.advance(inputs, self.step, self.steps)?;
        self.done += 1;
        Ok(())
    }

    /// Runs to the communication point nearest to `time` s.
    pub fn to(&mut self, time: f64) -> Result<(), StepFailure> {
        let target = (time / self.communication()).round() as u64;
        while self.done < target {
            self.advance()?;
        }
        Ok(())
    }

    /// Position of the tip, m.
    pub fn tip(&self) -> [f64; 2] {
        observers::motion(self.simulation.model(), &self.simulation.state()).tip.into()
    }

    /// Residual of the energy balance, J.
    pub fn energy_error(&self) -> f64 {
        observers::energies(self.simulation.model(), &self.simulation.state()).error
    }
}
