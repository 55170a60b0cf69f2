//! Functions for model exchange (FMI 2.0.4, section 3.2): the master integrates the states theta and omega.
//!
//! The system is autonomous and has no events of its own: a master ends steps where an event indicator changes sign, so that forces
//! are smooth within a step. Tunable parameters are set at events and act from fmi2NewDiscreteStates on. At a direct singularity
//! (distal links in line) theta and omega are no coordinates: such states are discarded.

use super::computed::real;
use super::snapshot::Scene;
use super::values::check_computed;
use super::{CallError, Instance, Stage};
use crate::mechanism::SceneError;
use crate::observers::{INDICATORS, Observed};
use crate::simulation::{STATES, Simulation};
use crate::variables::{CONTINUOUS_STATES, DERIVATIVES, EVENT_INDICATORS, Value, Variable};

const _: () = assert!(INDICATORS == EVENT_INDICATORS, "numberOfEventIndicators of the model description is another one");

impl Instance {
    /// fmi2SetTime, s.
    pub fn set_time(&mut self, time: f64) -> Result<(), CallError> {
        let Some(clock) = &mut self.now.clock else { unreachable!("initialisation has made it") };
        clock.set(time)
    }

    /// fmi2EnterEventMode.
    pub fn enter_event_mode(&mut self) -> Result<(), CallError> {
        self.change().stage = Stage::EventMode;
        Ok(())
    }

    /// fmi2NewDiscreteStates: parameters that were set take effect. Whether continuous states have changed.
    pub fn new_discrete_states(&mut self) -> Result<bool, CallError> {
        let Some(parameters) = self.now.next.parameters.clone() else { return Ok(false) };
        let before = self.continuous_states()?;
        self.simulation().tune(&parameters.effects)?;
        self.change().next.parameters = None;
        Ok(self.continuous_states()? != before)
    }

    /// fmi2EnterContinuousTimeMode.
    pub fn enter_continuous_time_mode(&mut self) -> Result<(), CallError> {
        if self.now.next.parameters.is_some() {
            return Err(CallError::error("parameters have been set: fmi2NewDiscreteStates must be called before."));
        }
        self.change().stage = Stage::ContinuousTimeMode;
        Ok(())
    }

    /// fmi2CompletedIntegratorStep: refused at a time past stopTime.
    pub fn completed_integrator_step(&mut self) -> Result<(), CallError> {
        let Some(clock) = &self.now.clock else { unreachable!("initialisation has made it") };
        clock.check_end()?;
        let (time, inputs) = (clock.point(), self.now.inputs());
        self.simulation().complete(&inputs);
        self.warn(time);
        Ok(())
    }

    /// fmi2SetContinuousStates: discarded, with the instance unchanged, at a direct singularity.
    pub fn set_continuous_states(&mut self, states: &[f64]) -> Result<(), CallError> {
        match states.try_into() {
            Ok(states) => self.drive(states),
            Err(_) => Err(CallError::error(format!("nx is {}, must be {STATES}.", states.len()))),
        }
    }

    /// fmi2SetReal of continuous states, beyond the standard; pairs of other variables are skipped.
    pub(super) fn set_states(&mut self, pairs: &mut dyn Iterator<Item = (u32, Value)>) -> Result<(), CallError> {
        let mut states = None;
        for (reference, value) in pairs {
            let (Some(variable), Value::Real(value)) = (Variable::find(reference), value) else { continue };
            let Some(place) = variable.state() else { continue };
            let states = match &mut states {
                Some(states) => states,
                none => none.insert(self.continuous_states()?),
            };
            states[place] = value;
        }
        states.map_or(Ok(()), |states| self.drive(states))
    }

    /// fmi2GetContinuousStates: angles of the proximal links, rad, left and right, and their rates, rad/s.
    pub fn continuous_states(&mut self) -> Result<[f64; STATES], CallError> {
        Ok(motion(&self.observe()?, 0))
    }

    /// fmi2GetDerivatives: rates of the proximal links, rad/s, and their accelerations, rad/s²; discarded at a direct singularity.
    pub fn state_derivatives(&mut self) -> Result<[f64; STATES], CallError> {
        let observed = self.observe()?;
        observed.check_direct_singularity().map_err(no_coordinates)?;
        let derivatives = motion(&observed, 1);
        for (name, value) in DERIVATIVES.into_iter().zip(derivatives) {
            check_computed(|| name.to_owned(), value)?;
        }
        Ok(derivatives)
    }

    /// fmi2GetEventIndicators.
    pub fn event_indicators(&mut self) -> Result<[f64; INDICATORS], CallError> {
        let indicators = self.observe()?.indicators();
        for (i, value) in indicators.into_iter().enumerate() {
            check_computed(|| format!("event indicator {}", i + 1), value)?;
        }
        Ok(indicators)
    }

    fn drive(&mut self, states: [f64; STATES]) -> Result<(), CallError> {
        if let Some(value) = states.iter().find(|value| !value.is_finite()) {
            return Err(CallError::error(format!("a continuous state is {value}, must be finite.")));
        }
        self.simulation().set_states(states).map_err(no_coordinates)
    }

    /// Mutable access to the simulation; clears cached observations.
    fn simulation(&mut self) -> &mut Simulation {
        match &mut self.change().scene {
            Scene::Ready(simulation) => simulation,
            Scene::Draft(_) | Scene::Following(_) => unreachable!("initialisation has made it ready"),
        }
    }
}

/// The continuous states, or their time derivatives of an order.
fn motion(of: &Observed<'_, f64>, order: usize) -> [f64; STATES] {
    CONTINUOUS_STATES.map(|state| real(of, state, order).unwrap_or_else(|| unreachable!("{state:?} is an angle or a rate")))
}

fn no_coordinates(SceneError(why): SceneError) -> CallError {
    CallError::discard(format!("{}; use co-simulation, which passes direct singularities.", why.trim_end_matches('.')))
}
