//! Functions for co-simulation (FMI 2.0.4, section 4.2.1).

use super::function::functions;
use super::types::{fmi2Boolean, fmi2Integer, fmi2Real, fmi2Status, fmi2StatusKind, fmi2String};

functions! {
    /// Makes one communication step (section 4.2.2). Stored states belong to the master, so the last argument is ignored.
    fmi2DoStep(
        currentCommunicationPoint: fmi2Real,
        communicationStepSize: fmi2Real,
        _noSetFMUStatePriorToCurrentPoint: fmi2Boolean
    ) |instance| instance.do_step(currentCommunicationPoint, communicationStepSize)?;
    /// Always refused: a step is never pending (section 4.2.2).
    fmi2CancelStep() |instance| instance.cancel_step()?;
    /// Returns the current communication point, for fmi2LastSuccessfulTime (section 4.2.3).
    fmi2GetRealStatus(s: fmi2StatusKind, value: [out fmi2Real]) |instance| value.write(instance.real_status(s)?);
    /// Returns false, for fmi2Terminated (section 4.2.3).
    fmi2GetBooleanStatus(s: fmi2StatusKind, value: [out fmi2Boolean]) |instance| value.write(instance.boolean_status(s)?.into());
    /// Returns fmi2Discard: there is no status of this type (section 4.2.3).
    fmi2GetStatus(s: fmi2StatusKind, _value: [raw *mut fmi2Status]) |instance| instance.other_status(s)?;
    /// Returns fmi2Discard: there is no status of this type (section 4.2.3).
    fmi2GetIntegerStatus(s: fmi2StatusKind, _value: [raw *mut fmi2Integer]) |instance| instance.other_status(s)?;
    /// Returns fmi2Discard: there is no status of this type (section 4.2.3).
    fmi2GetStringStatus(s: fmi2StatusKind, _value: [raw *mut fmi2String]) |instance| instance.other_status(s)?;
}
