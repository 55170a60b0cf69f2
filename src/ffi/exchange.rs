//! Functions for model exchange (FMI 2.0.4, section 3.2).

use super::function::functions;
use super::types::{fmi2Boolean, fmi2EventInfo, fmi2False, fmi2Real, size_t};
use crate::simulation::STATES;
use crate::variables::EVENT_INDICATORS;

functions! {
    /// Sets the time, s (section 3.2.1).
    fmi2SetTime(time: fmi2Real) |instance| instance.set_time(time)?;
    /// Sets the states (section 3.2.1); discarded, with the instance unchanged, where theta and omega are no coordinates.
    fmi2SetContinuousStates(x: [in fmi2Real; nx], nx: size_t) |instance| instance.set_continuous_states(x)?;
    /// Begins an event (section 3.2.2).
    fmi2EnterEventMode() |instance| instance.enter_event_mode();
    /// Puts parameters that were set into force (section 3.2.2); one call is enough.
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
    /// Accepts a step of the master's integrator (section 3.2.2); neither an event nor the end follows from it.
    fmi2CompletedIntegratorStep(
        _noSetFMUStatePriorToCurrentPoint: fmi2Boolean,
        enterEventMode: [out fmi2Boolean],
        terminateSimulation: [out fmi2Boolean]
    ) |instance| {
        instance.completed_integrator_step()?;
        enterEventMode.write(fmi2False);
        terminateSimulation.write(fmi2False);
    };
    /// Derivatives of the states with respect to time (section 3.2.2).
    fmi2GetDerivatives(derivatives: [out fmi2Real; nx = STATES], nx: size_t) |instance|
        derivatives.write_copy_of_slice(&instance.state_derivatives()?);
    /// Event indicators: a sign change is an event (section 3.2.2).
    fmi2GetEventIndicators(eventIndicators: [out fmi2Real; ni = EVENT_INDICATORS], ni: size_t) |instance|
        eventIndicators.write_copy_of_slice(&instance.event_indicators()?);
    /// The states (section 3.2.2).
    fmi2GetContinuousStates(x: [out fmi2Real; nx = STATES], nx: size_t) |instance|
        x.write_copy_of_slice(&instance.continuous_states()?);
    /// Nominal values of the states, 1 rad and 1 rad/s (section 3.2.2).
    fmi2GetNominalsOfContinuousStates(x_nominal: [out fmi2Real; nx = STATES], nx: size_t) |_instance|
        x_nominal.write_copy_of_slice(&[1.0; STATES]);
}
