//! A small master: calls the exported functions in this process like a C program, and records the log.

#![allow(unsafe_code, reason = "it calls the C functions of the library with pointers of its own")]

use std::ffi::{CStr, CString, c_void};
use std::ptr::{null, null_mut};

use fivebar::ffi::*;
use fivebar::variables::{GUID, Method, Variable};

/// Start values of an estimator for a machine with exact lengths and encoders.
pub(super) const EXACT: [(&str, f64); 3] =
    [("estimator.sigma0.length", 0.0), ("estimator.sigma0.offset", 0.0), ("estimator.sigma0.eccentricity", 0.0)];

/// A line received by the logger.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Line {
    pub(super) instance: String,
    pub(super) status: fmi2Status,
    pub(super) category: String,
    pub(super) text: String,
}

/// Arguments of fmi2Instantiate.
pub(super) struct Instantiation<'a> {
    pub(super) name: Option<&'a str>,
    pub(super) kind: fmi2Type,
    pub(super) guid: &'a str,
    pub(super) logging_on: bool,
}

impl Default for Instantiation<'_> {
    fn default() -> Self {
        Self { name: Some("machine"), kind: fmi2CoSimulation, guid: GUID, logging_on: false }
    }
}

/// An instance with its log; freed when dropped.
pub(super) struct Host {
    pub(super) component: fmi2Component,
    /// Lines of the logger; the component environment points to them.
    lines: *mut Vec<Line>,
}

unsafe extern "C" fn record(
    environment: fmi2ComponentEnvironment,
    instance: fmi2String,
    status: fmi2Status,
    category: fmi2String,
    text: fmi2String,
) {
    // SAFETY: the environment is the `lines` of a live host, and the library passes strings.
    unsafe {
        let string = |pointer| CStr::from_ptr(pointer).to_str().expect("UTF-8").to_owned();
        let line = Line { instance: string(instance), status, category: string(category), text: string(text) };
        (*environment.cast::<Vec<Line>>()).push(line);
    }
}

/// The recorder as the variadic function required by the standard.
fn logger() -> fmi2CallbackLogger {
    // SAFETY: under the tested calling conventions a function that ignores further arguments can be called as a variadic one; loggers of
    // masters often have five parameters.
    unsafe { std::mem::transmute::<*const c_void, fmi2CallbackLogger>(record as *const c_void) }
}

impl Host {
    /// Instantiates; if refused, returns the log lines.
    pub(super) fn instantiate(with: Instantiation<'_>) -> Result<Self, Vec<Line>> {
        let lines = Box::into_raw(Box::new(Vec::new()));
        let callbacks = fmi2CallbackFunctions {
            logger: Some(logger()),
            allocateMemory: None,
            freeMemory: None,
            stepFinished: None,
            componentEnvironment: lines.cast(),
        };
        let name = with.name.map(|name| CString::new(name).expect("no zero byte"));
        let guid = CString::new(with.guid).expect("no zero byte");
        let name = name.as_ref().map_or(null(), |name| name.as_ptr());
        // SAFETY: all pointers outlive the call, the logger and its lines outlive the instance.
        let component =
            unsafe { fmi2Instantiate(name, with.kind, guid.as_ptr(), null(), &callbacks, fmi2False, with.logging_on.into()) };
        if component.is_null() {
            // SAFETY: made above, with no other owner.
            return Err(*unsafe { Box::from_raw(lines) });
        }
        Ok(Self { component, lines })
    }

    /// A fresh instance.
    pub(super) fn new() -> Self {
        Self::instantiate(Instantiation::default()).unwrap_or_else(|lines| panic!("{lines:?}"))
    }

    /// An instance in initialization mode, starting at `start` s, with a stop time if given.
    pub(super) fn initializing(start: f64, stop: Option<f64>) -> Self {
        let host = Self::new();
        assert_eq!(host.setup(None, start, stop), fmi2OK);
        assert_eq!(host.call(fmi2EnterInitializationMode), fmi2OK);
        host
    }

    /// An instance ready to step from 0 s, with Real values set by name.
    pub(super) fn ready(values: &[(&str, f64)]) -> Self {
        let host = Self::initializing(0.0, None);
        for (name, value) in values {
            assert_eq!(host.set_real(&[reference(name)], &[*value]), fmi2OK, "{name}: {:?}", host.take());
        }
        assert_eq!(host.call(fmi2ExitInitializationMode), fmi2OK, "{:?}", host.take());
        host
    }

    /// The lines since the last call of this function.
    pub(super) fn take(&self) -> Vec<Line> {
        // SAFETY: the pointer lives as long as the host, and the logger runs only within calls.
        std::mem::take(unsafe { &mut *self.lines })
    }

    /// The text of the single line since the last call.
    pub(super) fn line(&self) -> String {
        let [line] = <[Line; 1]>::try_from(self.take()).expect("exactly one line");
        line.text
    }

    /// Calls a function of the instance alone.
    pub(super) fn call(&self, function: unsafe extern "C" fn(fmi2Component) -> fmi2Status) -> fmi2Status {
        // SAFETY: the component is live.
        unsafe { function(self.component) }
    }

    pub(super) fn setup(&self, tolerance: Option<f64>, start: f64, stop: Option<f64>) -> fmi2Status {
        let defined = |value: Option<f64>| (value.is_some().into(), value.unwrap_or(f64::NAN));
        let ((tolerance_defined, tolerance), (stop_defined, stop)) = (defined(tolerance), defined(stop));
        // SAFETY: the component is live.
        unsafe { fmi2SetupExperiment(self.component, tolerance_defined, tolerance, start, stop_defined, stop) }
    }

    pub(super) fn set_debug_logging(&self, on: bool, categories: &[&str]) -> fmi2Status {
        let names: Vec<CString> = categories.iter().map(|name| CString::new(*name).expect("no zero byte")).collect();
        let pointers: Vec<fmi2String> = names.iter().map(|name| name.as_ptr()).collect();
        // SAFETY: the component is live, the names outlive the call.
        unsafe { fmi2SetDebugLogging(self.component, on.into(), pointers.len(), pointers.as_ptr()) }
    }

    pub(super) fn get_real(&self, references: &[u32], values: &mut [f64]) -> fmi2Status {
        assert_eq!(references.len(), values.len());
        // SAFETY: the component is live, the arrays have the same length.
        unsafe { fmi2GetReal(self.component, references.as_ptr(), references.len(), values.as_mut_ptr()) }
    }

    pub(super) fn set_real(&self, references: &[u32], values: &[f64]) -> fmi2Status {
        assert_eq!(references.len(), values.len());
        // SAFETY: the component is live, the arrays have the same length.
        unsafe { fmi2SetReal(self.component, references.as_ptr(), references.len(), values.as_ptr()) }
    }

    pub(super) fn get_integer(&self, references: &[u32], values: &mut [i32]) -> fmi2Status {
        assert_eq!(references.len(), values.len());
        // SAFETY: the component is live, the arrays have the same length.
        unsafe { fmi2GetInteger(self.component, references.as_ptr(), references.len(), values.as_mut_ptr()) }
    }

    pub(super) fn set_integer(&self, references: &[u32], values: &[i32]) -> fmi2Status {
        assert_eq!(references.len(), values.len());
        // SAFETY: the component is live, the arrays have the same length.
        unsafe { fmi2SetInteger(self.component, references.as_ptr(), references.len(), values.as_ptr()) }
    }

    pub(super) fn get_boolean(&self, references: &[u32], values: &mut [i32]) -> fmi2Status {
        assert_eq!(references.len(), values.len());
        // SAFETY: the component is live, the arrays have the same length.
        unsafe { fmi2GetBoolean(self.component, references.as_ptr(), references.len(), values.as_mut_ptr()) }
    }

    pub(super) fn set_boolean(&self, references: &[u32], values: &[i32]) -> fmi2Status {
        assert_eq!(references.len(), values.len());
        // SAFETY: the component is live, the arrays have the same length.
        unsafe { fmi2SetBoolean(self.component, references.as_ptr(), references.len(), values.as_ptr()) }
    }

    pub(super) fn do_step(&self, point: f64, size: f64) -> fmi2Status {
        // SAFETY: the component is live.
        unsafe { fmi2DoStep(self.component, point, size, fmi2True) }
    }

    /// `count` steps of `size` seconds from 0 s.
    pub(super) fn run(&self, size: f64, count: u32) {
        for step in 0..count {
            assert_eq!(self.do_step(f64::from(step) * size, size), fmi2OK, "{:?}", self.take());
        }
    }

    pub(super) fn real_status(&self, kind: fmi2StatusKind) -> (fmi2Status, f64) {
        let mut value = f64::NAN;
        // SAFETY: the component is live, the place is ours.
        (unsafe { fmi2GetRealStatus(self.component, kind, &mut value) }, value)
    }

    pub(super) fn boolean_status(&self, kind: fmi2StatusKind) -> (fmi2Status, i32) {
        let mut value = -1;
        // SAFETY: the component is live, the place is ours.
        (unsafe { fmi2GetBooleanStatus(self.component, kind, &mut value) }, value)
    }

    /// The statuses of fmi2GetStatus, fmi2GetIntegerStatus and fmi2GetStringStatus.
    pub(super) fn other_statuses(&self, kind: fmi2StatusKind) -> [fmi2Status; 3] {
        let (mut status, mut integer, mut string) = (-1, -1, null());
        // SAFETY: the component is live, the places are ours.
        unsafe {
            [
                fmi2GetStatus(self.component, kind, &mut status),
                fmi2GetIntegerStatus(self.component, kind, &mut integer),
                fmi2GetStringStatus(self.component, kind, &mut string),
            ]
        }
    }

    /// Sets derivatives of inputs: (reference, order, value).
    pub(super) fn set_input_derivatives(&self, derivatives: &[(u32, i32, f64)]) -> fmi2Status {
        let references: Vec<u32> = derivatives.iter().map(|derivative| derivative.0).collect();
        let orders: Vec<i32> = derivatives.iter().map(|derivative| derivative.1).collect();
        let values: Vec<f64> = derivatives.iter().map(|derivative| derivative.2).collect();
        // SAFETY: the component is live, the arrays have the same length.
        unsafe {
            fmi2SetRealInputDerivatives(self.component, references.as_ptr(), references.len(), orders.as_ptr(), values.as_ptr())
        }
    }

    /// Reads a derivative of an output.
    pub(super) fn output_derivative(&self, reference: u32, order: i32) -> (fmi2Status, f64) {
        let mut value = f64::NAN;
        // SAFETY: the component is live, the places are ours.
        (unsafe { fmi2GetRealOutputDerivatives(self.component, &reference, 1, &order, &mut value) }, value)
    }

    /// Directional derivative of unknowns for changes of knowns: (reference, change).
    pub(super) fn directional_derivative(&self, unknowns: &[u32], knowns: &[(u32, f64)], values: &mut [f64]) -> fmi2Status {
        assert_eq!(unknowns.len(), values.len());
        let references: Vec<u32> = knowns.iter().map(|known| known.0).collect();
        let changes: Vec<f64> = knowns.iter().map(|known| known.1).collect();
        // SAFETY: the component is live, the arrays have the lengths passed.
        unsafe {
            fmi2GetDirectionalDerivative(
                self.component,
                unknowns.as_ptr(),
                unknowns.len(),
                references.as_ptr(),
                references.len(),
                changes.as_ptr(),
                values.as_mut_ptr(),
            )
        }
    }

    /// fmi2GetFMUstate into null, or over an existing state.
    pub(super) fn get_state(&self, state: &mut fmi2FMUstate) -> fmi2Status {
        // SAFETY: the component is live; tests pass null or a live state.
        unsafe { fmi2GetFMUstate(self.component, state) }
    }

    /// A new stored state.
    pub(super) fn state(&self) -> fmi2FMUstate {
        let mut state = null_mut();
        assert_eq!(self.get_state(&mut state), fmi2OK);
        state
    }

    pub(super) fn set_state(&self, state: fmi2FMUstate) -> fmi2Status {
        // SAFETY: as above.
        unsafe { fmi2SetFMUstate(self.component, state) }
    }

    pub(super) fn free_state(&self, state: &mut fmi2FMUstate) -> fmi2Status {
        // SAFETY: as above; the function makes the pointer null.
        unsafe { fmi2FreeFMUstate(self.component, state) }
    }

    /// Size of a state in bytes.
    pub(super) fn serialized_size(&self, state: fmi2FMUstate) -> (fmi2Status, usize) {
        let mut size = 0;
        // SAFETY: as above, the place is ours.
        (unsafe { fmi2SerializedFMUstateSize(self.component, state, &mut size) }, size)
    }

    /// A state as bytes, in a buffer of this size.
    pub(super) fn serialize(&self, state: fmi2FMUstate, size: usize) -> (fmi2Status, Vec<u8>) {
        let mut bytes = vec![0; size];
        // SAFETY: as above, the buffer has the size that is passed.
        let status = unsafe { fmi2SerializeFMUstate(self.component, state, bytes.as_mut_ptr().cast(), size) };
        (status, bytes)
    }

    pub(super) fn deserialize(&self, bytes: &[u8], state: &mut fmi2FMUstate) -> fmi2Status {
        // SAFETY: as above.
        unsafe { fmi2DeSerializeFMUstate(self.component, bytes.as_ptr().cast(), bytes.len(), state) }
    }

    /// Calls the state functions with null pointers.
    pub(super) fn null_states(&self) -> Vec<fmi2Status> {
        let (c, mut size) = (self.component, 0);
        // SAFETY: the component is live; the unit must refuse these null pointers.
        unsafe {
            vec![
                fmi2GetFMUstate(c, null_mut()),
                fmi2SetFMUstate(c, null_mut()),
                fmi2SerializedFMUstateSize(c, null_mut(), &mut size),
                fmi2SerializeFMUstate(c, null_mut(), null_mut(), 0),
                fmi2DeSerializeFMUstate(c, null(), 8, null_mut()),
            ]
        }
    }

    /// Calls getters and setters of every type with null arrays of this length.
    pub(super) fn null_arrays(&self, length: usize) -> Vec<fmi2Status> {
        let c = self.component;
        // SAFETY: the component is live; the unit must refuse these null pointers.
        unsafe {
            vec![
                fmi2GetReal(c, null(), length, null_mut()),
                fmi2GetInteger(c, null(), length, null_mut()),
                fmi2GetBoolean(c, null(), length, null_mut()),
                fmi2GetString(c, null(), length, null_mut()),
                fmi2SetReal(c, null(), length, null()),
                fmi2SetInteger(c, null(), length, null()),
                fmi2SetBoolean(c, null(), length, null()),
                fmi2SetString(c, null(), length, null()),
            ]
        }
    }

    /// Calls fmi2GetReal and fmi2SetReal with references but without values, and status functions with null.
    pub(super) fn null_values(&self) -> Vec<fmi2Status> {
        let (c, reference) = (self.component, 100);
        // SAFETY: the component is live; the unit must refuse these null pointers.
        unsafe {
            vec![
                fmi2GetReal(c, &reference, 1, null_mut()),
                fmi2SetReal(c, &reference, 1, null()),
                fmi2GetRealStatus(c, 2, null_mut()),
                fmi2GetBooleanStatus(c, 3, null_mut()),
                fmi2SetDebugLogging(c, fmi2True, 1, null()),
            ]
        }
    }

    /// Calls the functions of derivatives with null arrays of this length.
    pub(super) fn null_derivatives(&self, length: usize) -> [fmi2Status; 3] {
        let c = self.component;
        // SAFETY: the component is live; the unit must refuse these null pointers.
        unsafe {
            [
                fmi2SetRealInputDerivatives(c, null(), length, null(), null()),
                fmi2GetRealOutputDerivatives(c, null(), length, null(), null_mut()),
                fmi2GetDirectionalDerivative(c, null(), length, null(), length, null(), null_mut()),
            ]
        }
    }

    pub(super) fn set_time(&self, time: f64) -> fmi2Status {
        // SAFETY: the component is live.
        unsafe { fmi2SetTime(self.component, time) }
    }

    pub(super) fn set_states(&self, states: &[f64]) -> fmi2Status {
        // SAFETY: the component is live, the array is ours.
        unsafe { fmi2SetContinuousStates(self.component, states.as_ptr(), states.len()) }
    }

    /// Status, and whether states have changed; checks that nothing else is requested.
    pub(super) fn new_discrete_states(&self) -> (fmi2Status, bool) {
        let mut info = fmi2EventInfo {
            newDiscreteStatesNeeded: fmi2False,
            terminateSimulation: fmi2False,
            nominalsOfContinuousStatesChanged: fmi2False,
            valuesOfContinuousStatesChanged: fmi2False,
            nextEventTimeDefined: fmi2False,
            nextEventTime: 0.0,
        };
        let nothing = info;
        // SAFETY: the component is live, the place is ours.
        let status = unsafe { fmi2NewDiscreteStates(self.component, &mut info) };
        let changed = std::mem::replace(&mut info.valuesOfContinuousStatesChanged, fmi2False);
        assert_eq!(info, nothing);
        (status, changed != fmi2False)
    }

    pub(super) fn completed_step(&self) -> fmi2Status {
        let (mut event, mut end) = (fmi2True, fmi2True);
        // SAFETY: the component is live, the places are ours.
        let status = unsafe { fmi2CompletedIntegratorStep(self.component, fmi2True, &mut event, &mut end) };
        assert!(status != fmi2OK || (event, end) == (fmi2False, fmi2False));
        status
    }

    /// Calls a function that fills an array.
    pub(super) fn array<const N: usize>(
        &self,
        function: unsafe extern "C" fn(fmi2Component, *mut fmi2Real, usize) -> fmi2Status,
    ) -> Result<[f64; N], fmi2Status> {
        let mut values = [f64::NAN; N];
        // SAFETY: the component is live, the array is ours.
        let status = unsafe { function(self.component, values.as_mut_ptr(), N) };
        if status == fmi2OK { Ok(values) } else { Err(status) }
    }

    /// Calls fmi2GetString and fmi2SetString with this reference.
    pub(super) fn strings(&self, reference: u32) -> [fmi2Status; 2] {
        let mut value = c"".as_ptr();
        // SAFETY: the component is live, the place is ours.
        unsafe { [fmi2GetString(self.component, &reference, 1, &mut value), fmi2SetString(self.component, &reference, 1, &value)] }
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        // SAFETY: the component is live and not used again; afterwards nothing writes to the lines.
        unsafe {
            fmi2FreeInstance(self.component);
            drop(Box::from_raw(self.lines));
        }
    }
}

/// fmi2Instantiate with null callbacks, and with callbacks that are all null; frees the second component.
pub(super) fn instantiate_without_callbacks() -> (bool, bool) {
    let guid = CString::new(GUID).expect("no zero byte");
    let nothing = fmi2CallbackFunctions {
        logger: None,
        allocateMemory: None,
        freeMemory: None,
        stepFinished: None,
        componentEnvironment: null_mut(),
    };
    // SAFETY: the test is about null; the component is freed once.
    unsafe {
        let make = |functions| {
            fmi2Instantiate(c"machine".as_ptr(), fmi2CoSimulation, guid.as_ptr(), null(), functions, fmi2False, fmi2True)
        };
        let (first, second) = (make(null()), make(&nothing));
        // A refused call; its log line has no receiver.
        let refused = second.is_null() || fmi2DoStep(second, 0.0, 1.0, fmi2True) == fmi2Error;
        fmi2FreeInstance(second);
        (!first.is_null(), !second.is_null() && refused)
    }
}

/// Version and platform, which need no instance.
pub(super) fn version_and_platform() -> (String, String) {
    // SAFETY: both strings are static.
    let string = |pointer| unsafe { CStr::from_ptr(pointer) }.to_str().expect("ASCII").to_owned();
    (string(fmi2GetVersion()), string(fmi2GetTypesPlatform()))
}

/// Numbers of the methods.
pub(crate) fn methods() -> impl Iterator<Item = i32> {
    Method::LIST.iter().map(|method| *method as i32)
}

/// The value reference of a variable.
pub(super) fn reference(name: &str) -> u32 {
    Variable::named(name).unwrap_or_else(|| panic!("there is no variable {name}")).reference
}
