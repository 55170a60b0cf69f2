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
    /// From fmi2Instantiate to fmi2ExitInitializationMode, with variables set by name.
    pub(crate) fn ready(values: &[(&str, Value)]) -> Result<Self> {
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
        let plain = |call: Plain| {
            // SAFETY: the component is live.
            let status = unsafe { black_box(call)(component) };
            ensure!(status == fmi2OK, "a call of initialisation gave status {status}");
            Ok(())
        };
        // SAFETY: the component is live.
        ensure!(unsafe { fmi2SetupExperiment(component, fmi2False, 0.0, 0.0, fmi2False, 0.0) } == fmi2OK, "fmi2SetupExperiment");
        plain(fmi2EnterInitializationMode)?;
        for (name, value) in values {
            let reference = reference(name)?;
            // SAFETY: the component is live, the places hold one value each.
            let status = unsafe {
                match *value {
                    Value::Real(x) => fmi2SetReal(component, &reference, 1, &x),
                    Value::Integer(n) => fmi2SetInteger(component, &reference, 1, &n),
                    Value::Boolean(b) => fmi2SetBoolean(component, &reference, 1, &fmi2Boolean::from(b)),
                }
            };
            ensure!(status == fmi2OK, "{name} cannot be set to {value}");
        }
        plain(fmi2ExitInitializationMode)?;
        Ok(host)
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
