//! Functions for model exchange (FMI 2.0.4, section 3.2).

use super::function::functions;
use super::types::{fmi2Boolean, fmi2EventInfo, fmi2False, fmi2Real, size_t};
use crate::simulation::STATES;
use crate::variables::EVENT_INDICATORS;

functions! {
    /// Sets the time, s (section 3.2.1).
    fmi2SetTime(time: fmi2Real) |instance| instance.set_time(time)?;
    /// Sets the states (section 3.2.1). At a direct singularity theta and omega are no coordinates: fmi2Discard, and the instance is
    /// unchanged.
    fmi2SetContinuousStates(x: [in fmi2Real; nx], nx: size_t) |instance| instance.set_continuous_states(x)?;
    /// Begins an event (section 3.2.2).
    fmi2EnterEventMode() |instance| instance.enter_event_mode();
    /// Applies parameters that were set (section 3.2.2); one call is enough.
    fmi2NewDiscreteStates(fmi2eventInfo: [out fmi2EventInfo]) |instance| {
        fmi2eventInfo.write(fmi2EventInfo {
            newDiscreteStatesNeeded: fmi2False,
            terminateSimulation: fmi2False,
            nominalsOfContinuousStatesChanged: fmi2False,
            valuesOfContinuousStatesChanged: instance.new_discrete_states()?.into(),
            nextEventTimeDefined: fmi2False,
            nextEventTime: 0.0,
        });
    };
    /// Ends an event (section 3.2.2).
    fmi2EnterContinuousTimeMode() |instance| instance.enter_continuous_time_mode()?;
    /// Accepts a step of the master's integrator (section 3.2.2). It requests neither an event nor the end of the simulation.
    fmi2CompletedIntegratorStep(
        _noSetFMUStatePriorToCurrentPoint: fmi2Boolean,
        enterEventMode: [out fmi2Boolean],
        terminateSimulation: [out fmi2Boolean]
    ) |instance| {
        instance.completed_integrator_step()?;
        enterEventMode.write(fmi2False);
        terminateSimulation.write(fmi2False);
    };
    /// Reads the derivatives of the states with respect to time (section 3.2.2).
    fmi2GetDerivatives(derivatives: [out fmi2Real; nx = STATES], nx: size_t) |instance|
        derivatives.write_copy_of_slice(&instance.state_derivatives()?);
    /// Reads the event indicators; a sign change is an event (section 3.2.2).
    fmi2GetEventIndicators(eventIndicators: [out fmi2Real; ni = EVENT_INDICATORS], ni: size_t) |instance|
        eventIndicators.write_copy_of_slice(&instance.event_indicators()?);
    /// Reads the states (section 3.2.2).
    fmi2GetContinuousStates(x: [out fmi2Real; nx = STATES], nx: size_t) |instance|
        x.write_copy_of_slice(&instance.continuous_states()?);
    /// Reads the nominal values of the states, 1 rad and 1 rad/s (section 3.2.2).
    fmi2GetNominalsOfContinuousStates(x_nominal: [out fmi2Real; nx = STATES], nx: size_t) |_instance|
        x_nominal.write_copy_of_slice(&[1.0; STATES]);
}
