//! Functions for model exchange (FMI 2.0.4, section 3.2): the master integrates the states theta and omega.
//!
//! The system is autonomous and has no time events. The master ends a step where an event indicator changes sign, so that forces are smooth
//! within a step. Tunable parameters are set at events and take effect with fmi2NewDiscreteStates. At a direct singularity (distal links in
//! line) theta and omega are not coordinates: such states are discarded.

use super::computed::real;
use super::snapshot::Scene;
use super::values::{check_computed, check_finite};
use super::{CallError, Instance, Stage};
use crate::mechanism::SceneError;
use crate::observers::{INDICATORS, Observed};
use crate::simulation::{STATES, Simulation};
use crate::variables::{CONTINUOUS_STATES, EVENT_INDICATORS};

const _: () = assert!(INDICATORS == EVENT_INDICATORS, "numberOfEventIndicators of the model description differs from INDICATORS");

impl Instance {
    /// fmi2SetTime, s; refuses a time that is not finite.
    pub fn set_time(&mut self, time: f64) -> Result<(), CallError> {
        let Some(clock) = &mut self.now.clock else { unreachable!("initialisation has made it") };
        clock.set(time)
    }

    /// fmi2EnterEventMode.
    pub fn enter_event_mode(&mut self) {
        self.change().stage = Stage::EventMode;
    }

    /// fmi2NewDiscreteStates: applies parameters that were set, or refuses them. Returns whether the continuous states have changed.
    pub fn new_discrete_states(&mut self) -> Result<bool, CallError> {
        if !self.now.is_tuned {
            return Ok(false);
        }
        let before = self.continuous_states()?;
        let effects = self.now.parameters.effects.clone();
        self.simulation().tune(&effects)?;
        self.change().is_tuned = false;
        Ok(self.continuous_states()? != before)
    }

    /// fmi2EnterContinuousTimeMode: refused if parameters have been set and fmi2NewDiscreteStates has not been called.
    pub fn enter_continuous_time_mode(&mut self) -> Result<(), CallError> {
        if self.now.is_tuned {
            return Err(CallError::error("parameters have been set: fmi2NewDiscreteStates must be called before."));
        }
        self.change().stage = Stage::ContinuousTimeMode;
        Ok(())
    }

    /// fmi2CompletedIntegratorStep: refused at a time past stopTime.
    pub fn completed_integrator_step(&mut self) -> Result<(), CallError> {
        let Some(clock) = &self.now.clock else { unreachable!("initialisation has made it") };
        clock.check_end()?;
        let (time, inputs) = (clock.point(), self.now.signal.value);
        self.simulation().complete(&inputs);
        self.warn(time);
        Ok(())
    }

    /// fmi2SetContinuousStates: refuses a wrong number of states and states that are not finite. States at a direct singularity are
    /// discarded, and the instance is unchanged.
    pub fn set_continuous_states(&mut self, states: &[f64]) -> Result<(), CallError> {
        let Ok(states) = <[f64; STATES]>::try_from(states) else {
            return Err(CallError::error(format!("nx is {}, must be {STATES}.", states.len())));
        };
        for ((name, _), value) in CONTINUOUS_STATES.into_iter().zip(states) {
            check_finite(value, || format!("{name} is {value}"))?;
        }
        self.simulation().set_states(states).map_err(no_coordinates)
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
        for ((name, _), value) in CONTINUOUS_STATES.into_iter().zip(derivatives) {
            check_computed(|| format!("der({name})"), value)?;
        }
        Ok(derivatives)
    }

    /// fmi2GetEventIndicators: discarded unless all are finite.
    pub fn event_indicators(&mut self) -> Result<[f64; INDICATORS], CallError> {
        let indicators = self.observe()?.indicators();
        for (i, value) in indicators.into_iter().enumerate() {
            check_computed(|| format!("event indicator {}", i + 1), value)?;
        }
        Ok(indicators)
    }

    /// Mutable access to the simulation; clears cached observations.
    fn simulation(&mut self) -> &mut Simulation {
        let Some(Scene::Ready(simulation)) = &mut self.change().scene else { unreachable!("initialisation has made it") };
        simulation
    }
}

/// Continuous states (order 0) or their time derivatives of this order.
fn motion(of: &Observed<'_, f64>, order: usize) -> [f64; STATES] {
    CONTINUOUS_STATES.map(|(name, state)| real(of, state, order).unwrap_or_else(|| unreachable!("{name} is an angle or a rate")))
}

fn no_coordinates(SceneError(why): SceneError) -> CallError {
    CallError::discard(format!("{}; use co-simulation, which passes direct singularities.", why.trim_end_matches('.')))
}
