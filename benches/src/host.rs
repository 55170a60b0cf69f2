//! A master: calls the exported functions through pointers that the optimiser knows nothing about, as across the border of a shared
//! library.

#![allow(unsafe_code, reason = "it calls the C functions of the library with pointers of its own")]

use std::ffi::CString;
use std::hint::black_box;
use std::ptr::{null, null_mut};

use anyhow::{Context, Result, ensure};
use fivebar::ffi::*;
use fivebar::variables::{GUID, Value, Variable};

type DoStep = unsafe extern "C" fn(fmi2Component, fmi2Real, fmi2Real, fmi2Boolean) -> fmi2Status;
type Get<T> = unsafe extern "C" fn(fmi2Component, *const fmi2ValueReference, usize, *mut T) -> fmi2Status;
type Set<T> = unsafe extern "C" fn(fmi2Component, *const fmi2ValueReference, usize, *const T) -> fmi2Status;
type Plain = unsafe extern "C" fn(fmi2Component) -> fmi2Status;

/// A stored state, or none yet: of the library, until [`Host::free`].
pub(crate) struct Stored(fmi2FMUstate);

impl Stored {
    /// None yet.
    pub(crate) const NONE: Self = Self(null_mut());
}

/// An instance that is ready to step from 0 s; freed when dropped.
pub(crate) struct Host {
    component: fmi2Component,
    point: f64,
    do_step: DoStep,
    get_real: Get<fmi2Real>,
    get_integer: Get<fmi2Integer>,
    set_real: Set<fmi2Real>,
    free: unsafe extern "C" fn(fmi2Component),
}

impl Host {
    /// From fmi2Instantiate to fmi2ExitInitializationMode, with variables set by reference.
    pub(crate) fn ready(values: &[(u32, Value)]) -> Result<Self> {
        let (name, guid) = (c"bench", CString::new(GUID)?);
        let callbacks = fmi2CallbackFunctions {
            logger: None,
            allocateMemory: None,
            freeMemory: None,
            stepFinished: None,
            componentEnvironment: null_mut(),
        };
        // SAFETY: all pointers outlive the call; there are no callbacks.
        let component =
            unsafe { fmi2Instantiate(name.as_ptr(), fmi2CoSimulation, guid.as_ptr(), null(), &callbacks, fmi2False, fmi2False) };
        ensure!(!component.is_null(), "fmi2Instantiate gave null");
        let host = Self {
            component,
            point: 0.0,
            do_step: black_box(fmi2DoStep),
            get_real: black_box(fmi2GetReal),
            get_integer: black_box(fmi2GetInteger),
            set_real: black_box(fmi2SetReal),
            free: black_box(fmi2FreeInstance),
        };
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
        host.plain(fmi2ExitInitializationMode);
        Ok(host)
    }

    fn plain(&self, call: Plain) {
        // SAFETY: the component is live.
        assert_eq!(unsafe { black_box(call)(self.component) }, fmi2OK, "a call of the life cycle");
    }

    /// Into initialization mode.
    fn begin(&self) {
        // SAFETY: the component is live.
        let status = unsafe { fmi2SetupExperiment(self.component, fmi2False, 0.0, 0.0, fmi2False, 0.0) };
        assert_eq!(status, fmi2OK, "fmi2SetupExperiment");
        self.plain(fmi2EnterInitializationMode);
    }

    /// Starts anew at 0 s with these Reals.
    pub(crate) fn again(&mut self, references: &[u32], values: &[f64]) {
        self.plain(fmi2Reset);
        self.begin();
        self.write(references, values);
        self.plain(fmi2ExitInitializationMode);
        self.point = 0.0;
    }

    /// Stores the state, over the one that is there or as a new one.
    pub(crate) fn store(&self, stored: &mut Stored) {
        // SAFETY: the component is live, the state is null or comes from this library.
        assert_eq!(unsafe { black_box(fmi2GetFMUstate)(self.component, &mut stored.0) }, fmi2OK, "fmi2GetFMUstate");
    }

    /// Back into a stored state.
    pub(crate) fn restore(&self, stored: &Stored) {
        // SAFETY: both are live.
        assert_eq!(unsafe { black_box(fmi2SetFMUstate)(self.component, stored.0) }, fmi2OK, "fmi2SetFMUstate");
    }

    /// Frees a stored state.
    pub(crate) fn free(&self, mut stored: Stored) {
        // SAFETY: both are live.
        assert_eq!(unsafe { black_box(fmi2FreeFMUstate)(self.component, &mut stored.0) }, fmi2OK, "fmi2FreeFMUstate");
    }

    /// The size of a stored state as bytes.
    pub(crate) fn size(&self, stored: &Stored) -> usize {
        let mut size = 0;
        // SAFETY: both are live, the place is ours.
        let status = unsafe { black_box(fmi2SerializedFMUstateSize)(self.component, stored.0, &mut size) };
        assert_eq!(status, fmi2OK, "fmi2SerializedFMUstateSize");
        size
    }

    /// A stored state as bytes, as many as there are.
    pub(crate) fn serialise(&self, stored: &Stored, bytes: &mut [u8]) {
        let place = bytes.as_mut_ptr().cast::<fmi2Byte>();
        // SAFETY: both are live, the place has the length given.
        let status = unsafe { black_box(fmi2SerializeFMUstate)(self.component, stored.0, place, bytes.len()) };
        assert_eq!(status, fmi2OK, "fmi2SerializeFMUstate");
    }

    /// A stored state from bytes.
    pub(crate) fn deserialise(&self, bytes: &[u8], stored: &mut Stored) {
        let place = bytes.as_ptr().cast::<fmi2Byte>();
        // SAFETY: both are live, the place has the length given.
        let status = unsafe { black_box(fmi2DeSerializeFMUstate)(self.component, place, bytes.len(), &mut stored.0) };
        assert_eq!(status, fmi2OK, "fmi2DeSerializeFMUstate");
    }

    /// How outputs change with inputs or states that change.
    pub(crate) fn directional_derivative(&self, unknowns: &[u32], knowns: &[u32], changes: &[f64], values: &mut [f64]) {
        assert_eq!((unknowns.len(), knowns.len()), (values.len(), changes.len()));
        // SAFETY: the component is live, the arrays have the lengths given.
        let status = unsafe {
            black_box(fmi2GetDirectionalDerivative)(
                self.component,
                unknowns.as_ptr(),
                unknowns.len(),
                knowns.as_ptr(),
                knowns.len(),
                changes.as_ptr(),
                values.as_mut_ptr(),
            )
        };
        assert_eq!(status, fmi2OK, "fmi2GetDirectionalDerivative");
    }

    /// First derivatives of inputs.
    pub(crate) fn input_rates(&self, references: &[u32], orders: &[i32], rates: &[f64]) {
        assert_eq!((references.len(), references.len()), (orders.len(), rates.len()));
        // SAFETY: the component is live, the arrays have the same length.
        let status = unsafe {
            black_box(fmi2SetRealInputDerivatives)(
                self.component,
                references.as_ptr(),
                references.len(),
                orders.as_ptr(),
                rates.as_ptr(),
            )
        };
        assert_eq!(status, fmi2OK, "fmi2SetRealInputDerivatives");
    }

    /// Derivatives of outputs.
    pub(crate) fn output_rates(&self, references: &[u32], orders: &[i32], rates: &mut [f64]) {
        assert_eq!((references.len(), references.len()), (orders.len(), rates.len()));
        // SAFETY: the component is live, the arrays have the same length.
        let status = unsafe {
            black_box(fmi2GetRealOutputDerivatives)(
                self.component,
                references.as_ptr(),
                references.len(),
                orders.as_ptr(),
                rates.as_mut_ptr(),
            )
        };
        assert_eq!(status, fmi2OK, "fmi2GetRealOutputDerivatives");
    }

    /// A communication step of `size` seconds.
    pub(crate) fn step(&mut self, size: f64) {
        // SAFETY: the component is live.
        let status = unsafe { (self.do_step)(self.component, self.point, size, fmi2True) };
        assert_eq!(status, fmi2OK, "fmi2DoStep at {} s", self.point);
        self.point += size;
    }

    /// Reads Reals.
    pub(crate) fn read(&self, references: &[u32], values: &mut [f64]) {
        assert_eq!(references.len(), values.len());
        // SAFETY: the component is live, the arrays have the same length.
        let status = unsafe { (self.get_real)(self.component, references.as_ptr(), references.len(), values.as_mut_ptr()) };
        assert_eq!(status, fmi2OK, "fmi2GetReal");
    }

    /// Sets Reals.
    pub(crate) fn write(&self, references: &[u32], values: &[f64]) {
        assert_eq!(references.len(), values.len());
        // SAFETY: the component is live, the arrays have the same length.
        let status = unsafe { (self.set_real)(self.component, references.as_ptr(), references.len(), values.as_ptr()) };
        assert_eq!(status, fmi2OK, "fmi2SetReal");
    }

    /// Reads an Integer.
    pub(crate) fn integer(&self, reference: u32) -> i32 {
        let mut value = 0;
        // SAFETY: the component is live, the place is ours.
        let status = unsafe { (self.get_integer)(self.component, &reference, 1, &mut value) };
        assert_eq!(status, fmi2OK, "fmi2GetInteger");
        value
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        // SAFETY: the component is live and not used again.
        unsafe { (self.free)(self.component) }
    }
}

/// The value reference of a variable.
pub(crate) fn reference(name: &str) -> Result<u32> {
    Ok(Variable::named(name).with_context(|| format!("there is no variable {name}"))?.reference)
}
