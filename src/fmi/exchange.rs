//! Functions for model exchange (FMI 2.0.4, section 3.2): the master integrates the states theta and omega.
//!
//! The system does not depend on time and has no events of its own: a master ends steps where an indicator changes sign, so that each
//! step sees smooth forces, and sets tunable parameters at events, which act from fmi2NewDiscreteStates on. Where the distal links are in
//! line theta and omega are no coordinates: states there are discarded.

use super::snapshot::Scene;
use super::values::check_computed;
use super::{CallError, Instance, Stage};
use crate::mechanism::SceneError;
use crate::observers::{INDICATORS, Observed};
use crate::simulation::{STATES, Simulation};
use crate::variables::{EVENT_INDICATORS, RealComputed, Value, Variable, VariableId};

const _: () = assert!(INDICATORS == EVENT_INDICATORS, "numberOfEventIndicators of the model description is another one");

/// The links whose angles and rates are states.
const DRIVEN: [usize; 2] = [0, 3];

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

    /// fmi2NewDiscreteStates: parameters that have been set act from now on. Whether that changed continuous states.
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

    /// fmi2CompletedIntegratorStep: refused past stopTime.
    pub fn completed_integrator_step(&mut self) -> Result<(), CallError> {
        let Some(clock) = &self.now.clock else { unreachable!("initialisation has made it") };
        clock.check_end()?;
        let (time, inputs) = (clock.point(), self.now.inputs());
        self.simulation().complete(&inputs);
        self.warn(time);
        Ok(())
    }

    /// fmi2SetContinuousStates: discarded, with everything as before, where they are no coordinates.
    pub fn set_continuous_states(&mut self, states: &[f64]) -> Result<(), CallError> {
        match states.try_into() {
            Ok(states) => self.drive(states),
            Err(_) => Err(CallError::error(format!("nx is {}, must be {STATES}.", states.len()))),
        }
    }

    /// fmi2SetReal of continuous states, beyond the standard; other variables are left out.
    pub(super) fn set_states(&mut self, pairs: &mut dyn Iterator<Item = (u32, Value)>) -> Result<(), CallError> {
        let mut states = None;
        for (reference, value) in pairs {
            let (Some(variable), Value::Real(value)) = (Variable::find(reference), value) else { continue };
            let place = match variable.id {
                VariableId::RealComputed(RealComputed::Theta(i)) => i,
                VariableId::RealComputed(RealComputed::Omega(i)) => 2 + i,
                _ => continue,
            };
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

    /// fmi2GetDerivatives: their derivatives; discarded where they are no coordinates.
    pub fn state_derivatives(&mut self) -> Result<[f64; STATES], CallError> {
        let observed = self.observe()?;
        observed.check_direct_singularity().map_err(no_coordinates)?;
        let derivatives = motion(&observed, 1);
        for (name, value) in ["der(theta[1])", "der(theta[2])", "der(omega[1])", "der(omega[2])"].into_iter().zip(derivatives) {
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

    /// The simulation, about to change.
    fn simulation(&mut self) -> &mut Simulation {
        match &mut self.change().scene {
            Scene::Ready(simulation) => simulation,
            Scene::Draft(_) | Scene::Following(_) => unreachable!("initialisation has made it ready"),
        }
    }
}

/// Angles and rates, or their derivatives of an order.
fn motion(of: &Observed<'_, f64>, order: usize) -> [f64; STATES] {
    let [left, right] = DRIVEN;
    [of.angle(left, order), of.angle(right, order), of.angle(left, order + 1), of.angle(right, order + 1)]
}

fn no_coordinates(SceneError(why): SceneError) -> CallError {
    CallError::discard(format!("{}; use co-simulation, which passes direct singularities.", why.trim_end_matches('.')))
}
