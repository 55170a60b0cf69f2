//! A master: calls the exported functions through pointers that are opaque to the optimiser, like calls into a shared library.

#![allow(unsafe_code, reason = "it calls the C functions of the library with pointers of its own")]

use std::ffi::CString;
use std::hint::black_box;
use std::ptr::{null, null_mut};

use anyhow::{Context, Result, ensure};
use fivebar::ffi::*;
use fivebar::variables::{GUID, Value, Variable};

/// Calls a C function of a host's component through an opaque pointer; panics unless it returns fmi2OK.
macro_rules! done {
    ($host:ident, $function:ident($($argument:expr),*)) => {{
        let call = black_box::<unsafe extern "C" fn(fmi2Component $(, its_type!($argument))*) -> fmi2Status>($function);
        assert_eq!(call($host.component $(, $argument)*), fmi2OK, "{} at {} s", stringify!($function), $host.point);
    }};
}

/// The type of an argument, inferred from the function.
macro_rules! its_type {
    ($argument:expr) => {
        _
    };
}

/// A stored state of the library, or null; valid until [`Host::free`].
pub(crate) struct Stored(fmi2FMUstate);

impl Stored {
    /// No state.
    pub(crate) const NONE: Self = Self(null_mut());
}

/// Callbacks of a master that has none.
pub(crate) const NO_CALLBACKS: fmi2CallbackFunctions = fmi2CallbackFunctions {
    logger: None,
    allocateMemory: None,
    freeMemory: None,
    stepFinished: None,
    componentEnvironment: null_mut(),
};

/// An instance ready to step from 0 s; freed when dropped.
pub(crate) struct Host {
    component: fmi2Component,
    point: f64,
}

impl Host {
    /// An instance after fmi2ExitInitializationMode, with variables set by reference.
    pub(crate) fn ready(values: &[(u32, Value)]) -> Result<Self> {
        let (name, guid) = (c"bench", CString::new(GUID)?);
        // SAFETY: all pointers outlive the call; there are no callbacks.
        let component =
            unsafe { fmi2Instantiate(name.as_ptr(), fmi2CoSimulation, guid.as_ptr(), null(), &NO_CALLBACKS, fmi2False, fmi2False) };
        ensure!(!component.is_null(), "fmi2Instantiate gave null");
        let host = Self { component, point: 0.0 };
        host.begin();
        for &(reference, value) in values {
            // SAFETY: the component is live, the places hold one value each.
            let status = unsafe {
                match value {
                    Value::Real(x) => fmi2SetReal(component, &reference, 1, &x),
                    Value::Integer(n) => fmi2SetInteger(component, &reference, 1, &n),
                    Value::Boolean(b) => fmi2SetBoolean(component, &reference, 1, &fmi2Boolean::from(b)),
                }
            };
            ensure!(status == fmi2OK, "value reference {reference} cannot be set to {value}");
        }
        host.end();
        Ok(host)
    }

    /// Enters initialization mode.
    fn begin(&self) {
        // SAFETY: the component is live.
        unsafe {
            done!(self, fmi2SetupExperiment(fmi2False, 0.0, 0.0, fmi2False, 0.0));
            done!(self, fmi2EnterInitializationMode());
        }
    }

    /// Leaves initialization mode.
    fn end(&self) {
        // SAFETY: the component is live.
        unsafe { done!(self, fmi2ExitInitializationMode()) }
    }

    /// Restarts at 0 s with these Reals.
    pub(crate) fn again(&mut self, references: &[u32], values: &[f64]) {
        // SAFETY: the component is live.
        unsafe { done!(self, fmi2Reset()) }
        self.begin();
        self.write(references, values);
        self.end();
        self.point = 0.0;
    }

    /// Stores the state, replacing the given one or as a new one.
    pub(crate) fn store(&self, stored: &mut Stored) {
        // SAFETY: the component is live, the state is null or comes from this library.
        unsafe { done!(self, fmi2GetFMUstate(&mut stored.0)) }
    }

    /// Restores a stored state.
    pub(crate) fn restore(&self, stored: &Stored) {
        // SAFETY: both are live.
        unsafe { done!(self, fmi2SetFMUstate(stored.0)) }
    }

    /// Frees a stored state.
    pub(crate) fn free(&self, mut stored: Stored) {
        // SAFETY: both are live.
        unsafe { done!(self, fmi2FreeFMUstate(&mut stored.0)) }
    }

    /// Size of a stored state in bytes.
    pub(crate) fn size(&self, stored: &Stored) -> usize {
        let mut size = 0;
        // SAFETY: both are live, the place is ours.
        unsafe { done!(self, fmi2SerializedFMUstateSize(stored.0, &mut size)) }
        size
    }

    /// Writes a stored state into bytes of its size.
    pub(crate) fn serialise(&self, stored: &Stored, bytes: &mut [u8]) {
        let place = bytes.as_mut_ptr().cast::<fmi2Byte>();
        // SAFETY: both are live, the place has the length given.
        unsafe { done!(self, fmi2SerializeFMUstate(stored.0, place, bytes.len())) }
    }

    /// Reads a stored state from bytes.
    pub(crate) fn deserialise(&self, bytes: &[u8], stored: &mut Stored) {
        let place = bytes.as_ptr().cast::<fmi2Byte>();
        // SAFETY: both are live, the place has the length given.
        unsafe { done!(self, fmi2DeSerializeFMUstate(place, bytes.len(), &mut stored.0)) }
    }

    /// Directional derivative of the unknowns for given changes of inputs or states.
    pub(crate) fn directional_derivative(&self, unknowns: &[u32], knowns: &[u32], changes: &[f64], values: &mut [f64]) {
        assert_eq!((unknowns.len(), knowns.len()), (values.len(), changes.len()));
        // SAFETY: the component is live, the arrays have the lengths given.
        unsafe {
            done!(
                self,
                fmi2GetDirectionalDerivative(
                    unknowns.as_ptr(),
                    unknowns.len(),
                    knowns.as_ptr(),
                    knowns.len(),
                    changes.as_ptr(),
                    values.as_mut_ptr()
                )
            )
        }
    }

    /// Sets first derivatives of inputs.
    pub(crate) fn input_rates(&self, references: &[u32], orders: &[i32], rates: &[f64]) {
        assert_eq!((references.len(), references.len()), (orders.len(), rates.len()));
        // SAFETY: the component is live, the arrays have the same length.
        unsafe { done!(self, fmi2SetRealInputDerivatives(references.as_ptr(), references.len(), orders.as_ptr(), rates.as_ptr())) }
    }

    /// Reads derivatives of outputs.
    pub(crate) fn output_rates(&self, references: &[u32], orders: &[i32], rates: &mut [f64]) {
        assert_eq!((references.len(), references.len()), (orders.len(), rates.len()));
        // SAFETY: the component is live, the arrays have the same length.
        unsafe {
            done!(self, fmi2GetRealOutputDerivatives(references.as_ptr(), references.len(), orders.as_ptr(), rates.as_mut_ptr()))
        }
    }

    /// Makes a communication step of `size` seconds.
    pub(crate) fn step(&mut self, size: f64) {
        // SAFETY: the component is live.
        unsafe { done!(self, fmi2DoStep(self.point, size, fmi2True)) }
        self.point += size;
    }

    /// Reads Reals.
    pub(crate) fn read(&self, references: &[u32], values: &mut [f64]) {
        assert_eq!(references.len(), values.len());
        // SAFETY: the component is live, the arrays have the same length.
        unsafe { done!(self, fmi2GetReal(references.as_ptr(), references.len(), values.as_mut_ptr())) }
    }

    /// Sets Reals.
    pub(crate) fn write(&self, references: &[u32], values: &[f64]) {
        assert_eq!(references.len(), values.len());
        // SAFETY: the component is live, the arrays have the same length.
        unsafe { done!(self, fmi2SetReal(references.as_ptr(), references.len(), values.as_ptr())) }
    }

    /// Reads an Integer.
    pub(crate) fn integer(&self, reference: u32) -> i32 {
        let mut value = 0;
        // SAFETY: the component is live, the place is ours.
        unsafe { done!(self, fmi2GetInteger(&reference, 1, &mut value)) }
        value
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        // SAFETY: the component is live and not used again.
        unsafe { black_box::<unsafe extern "C" fn(_)>(fmi2FreeInstance)(self.component) }
    }
}

/// The value reference of a variable.
pub(crate) fn reference(name: &str) -> Result<u32> {
    Ok(Variable::named(name).with_context(|| format!("there is no variable {name}"))?.reference)
}
