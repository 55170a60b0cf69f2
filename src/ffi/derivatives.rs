//! Derivatives of outputs with respect to inputs and continuous states (FMI 2.0.4, section 2.1.9), and of inputs and outputs with respect
//! to time (section 4.2.1).

use super::function::functions;
use super::types::{fmi2Integer, fmi2Real, fmi2ValueReference, size_t};

functions! {
    /// Computes changes of the unknowns for changes `dvKnown` of the knowns (section 2.1.9).
    fmi2GetDirectionalDerivative(
        vUnknown_ref: [in fmi2ValueReference; nUnknown],
        nUnknown: size_t,
        vKnown_ref: [in fmi2ValueReference; nKnown],
        nKnown: size_t,
        dvKnown: [in fmi2Real; nKnown],
        dvUnknown: [out fmi2Real; nUnknown]
    ) |instance| {
        let knowns = vKnown_ref.iter().copied().zip(dvKnown.iter().copied());
        dvUnknown.write_copy_of_slice(&instance.directional_derivative(vUnknown_ref, knowns)?);
    };
    /// Sets all derivatives of inputs, or none if it refuses one (section 4.2.1).
    fmi2SetRealInputDerivatives(
        vr: [in fmi2ValueReference; nvr],
        nvr: size_t,
        order: [in fmi2Integer; nvr],
        value: [in fmi2Real; nvr]
    ) |instance| {
        let triples = vr.iter().zip(order).zip(value).map(|((reference, order), value)| (*reference, *order, *value));
        instance.set_input_derivatives(triples)?;
    };
    /// Reads derivatives of outputs at the current communication point (section 4.2.1).
    fmi2GetRealOutputDerivatives(
        vr: [in fmi2ValueReference; nvr],
        nvr: size_t,
        order: [in fmi2Integer; nvr],
        value: [out fmi2Real; nvr]
    ) |instance| value.write_copy_of_slice(&instance.output_derivatives(vr, order)?);
}
