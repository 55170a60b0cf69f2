//! Entry of every call on an instance: null component, order of calls, panics, log.

use std::any::Any;
use std::ffi::CString;
use std::panic::{AssertUnwindSafe, catch_unwind};

use super::types::{fmi2CallbackFunctions, fmi2Component, fmi2Error, fmi2Fatal, fmi2Status};
use crate::fmi::{Call, CallError, Instance, Kind, Message, Status};

/// Target of an fmi2Component.
pub(super) struct Component {
    pub(super) instance: Instance,
    /// Name of the instance, passed back to the logger.
    name: CString,
    callbacks: fmi2CallbackFunctions,
    /// True after a panic: the instance may be half-changed and can only be freed.
    poisoned: bool,
}

impl Component {
    pub(super) fn new(kind: Kind, name: CString, callbacks: fmi2CallbackFunctions, logging_on: bool) -> Self {
        Self { instance: Instance::new(kind, logging_on), name, callbacks, poisoned: false }
    }

    /// Sends a message to the master's logger, if it has one.
    fn send(name: &CString, callbacks: &fmi2CallbackFunctions, message: &Message) {
        let Some(logger) = callbacks.logger else {
            return;
        };
        // The logger treats the text as a printf format, so % is doubled. A zero byte would end the text.
        let text = message.text.replace('%', "%%").replace('\0', " ");
        let (Ok(text), Ok(category)) = (CString::new(text), CString::new(message.status.category().name())) else {
            return;
        };
        // SAFETY: the caller of fmi2Instantiate vouches for the logger. All strings outlive the call, and no argument is missing because
        // the text contains no format specification.
        unsafe {
            logger(callbacks.componentEnvironment, name.as_ptr(), message.status as fmi2Status, category.as_ptr(), text.as_ptr());
        }
    }

    /// Sends the messages queued in the instance's log.
    #[cold]
    pub(super) fn send_all(&mut self) {
        for message in self.instance.log.drain() {
            Self::send(&self.name, &self.callbacks, &message);
        }
    }

    /// Logs the refusal of a call and returns its status.
    #[cold]
    #[inline(never)]
    fn refuse(&mut self, call: Call, rejection: &CallError) -> Status {
        self.instance.log.push(rejection.status, || format!("{call:?}: {}", rejection.message));
        rejection.status
    }

    /// Logs a panic, after which the instance may be half-changed.
    #[cold]
    #[inline(never)]
    fn poison(&mut self, call: Call, panic: &(dyn Any + Send)) -> Status {
        self.poisoned = true;
        self.instance.log.push(Status::Fatal, || {
            format!("{call:?}: defect of the library, the instance can only be freed: {}", panic_text(panic))
        });
        Status::Fatal
    }
}

/// Runs `body` on the instance behind `component` and returns a status. A call that is not allowed in the current state, or that fails, is
/// logged under its name. A panic is caught and poisons the instance.
///
/// # Safety
/// The contract of [`crate::ffi`]: `component` is null or a live instance that no other thread is using.
pub(super) unsafe fn guard(
    component: fmi2Component,
    call: Call,
    body: impl FnOnce(&mut Instance) -> Result<(), CallError>,
) -> fmi2Status {
    // SAFETY: the caller vouches for the pointer unless it is null.
    let Some(component) = (unsafe { component.cast::<Component>().as_mut() }) else {
        return fmi2Error;
    };
    if component.poisoned {
        return fmi2Fatal;
    }
    let instance = &mut component.instance;
    // Unwind safe: after a panic only the instance's log is used, and it contains only whole messages.
    let status =
        match catch_unwind(AssertUnwindSafe(|| call.require(instance.kind(), instance.stage()).and_then(|()| body(instance)))) {
            Ok(Ok(())) => Status::Ok,
            Ok(Err(rejection)) => component.refuse(call, &rejection),
            Err(panic) => component.poison(call, &*panic),
        };
    if !component.instance.log.is_empty() {
        component.send_all();
    }
    status as fmi2Status
}

/// Text of a panic.
pub(super) fn panic_text(panic: &(dyn Any + Send)) -> &str {
    match (panic.downcast_ref::<&str>(), panic.downcast_ref::<String>()) {
        (Some(text), _) => text,
        (None, Some(text)) => text,
        (None, None) => "no text",
    }
}

#[cfg(test)]
mod tests {
    use std::ffi::{CStr, c_void};
    use std::ptr::null_mut;

    use super::super::{fmi2ComponentEnvironment, fmi2FreeInstance, fmi2GetVersion, fmi2OK, fmi2Reset, fmi2String};
    use super::*;

    /// A logger that collects `category: message` in the Vec that its environment points to.
    unsafe extern "C" fn record(
        environment: fmi2ComponentEnvironment,
        _name: fmi2String,
        _status: fmi2Status,
        category: fmi2String,
        message: fmi2String,
    ) {
        // SAFETY: the tests pass a live Vec<String>, and this library passes strings.
        unsafe {
            let lines = &mut *environment.cast::<Vec<String>>();
            let text = |pointer| CStr::from_ptr(pointer).to_string_lossy();
            lines.push(format!("{}: {}", text(category), text(message)));
        }
    }

    fn component(lines: &mut Vec<String>) -> fmi2Component {
        let record = record as *const c_void;
        let callbacks = fmi2CallbackFunctions {
            // SAFETY: in the usual calling conventions a function that ignores further arguments can be called as a variadic function;
            // masters written in C with five parameters do so.
            logger: Some(unsafe { std::mem::transmute::<*const c_void, super::super::fmi2CallbackLogger>(record) }),
            allocateMemory: None,
            freeMemory: None,
            stepFinished: None,
            componentEnvironment: std::ptr::from_mut(lines).cast(),
        };
        Box::into_raw(Box::new(Component::new(Kind::CoSimulation, c"test".to_owned(), callbacks, false))).cast()
    }

    #[test]
    fn a_panic_becomes_fatal_and_poisons_this_instance_only() {
        let (mut lines, mut other_lines) = (Vec::new(), Vec::new());
        let (broken, other) = (component(&mut lines), component(&mut other_lines));
        // SAFETY: both components are live, and freed once.
        unsafe {
            assert_eq!(guard(broken, Call::fmi2Reset, |_| panic!("on purpose, 100 %")), fmi2Fatal);
            assert_eq!(fmi2Reset(broken), fmi2Fatal);
            assert_eq!(fmi2Reset(other), fmi2OK);
            fmi2FreeInstance(broken);
            fmi2FreeInstance(other);
        }
        let expected = "logStatusFatal: fmi2Reset: defect of the library, the instance can only be freed: on purpose, 100 %%";
        assert_eq!(lines, [expected]);
        assert_eq!(other_lines, [""; 0]);
    }

    #[test]
    fn a_null_component_is_refused() {
        // SAFETY: null is checked.
        unsafe {
            assert_eq!(guard(null_mut(), Call::fmi2DoStep, |_| Ok(())), fmi2Error);
            fmi2FreeInstance(null_mut());
            assert_eq!(CStr::from_ptr(fmi2GetVersion()), c"2.0");
        }
    }
}
