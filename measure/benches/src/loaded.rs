//! Another build of the library, loaded from an unpacked .fmu, and instances of it. Variables are found by the names in its own
//! `modelDescription.xml`, because value references may be missing in an earlier build.

#![allow(unsafe_code, reason = "it loads a library and calls its C functions")]

use std::collections::HashMap;
use std::env::consts::DLL_EXTENSION;
use std::ffi::CString;
use std::fs;
use std::path::{Path, PathBuf};
use std::ptr::null;

use anyhow::{Context, Result, ensure};
use fivebar::ffi::*;
use libloading::Library;
use roxmltree::Document;
use scenes::Value;

use crate::host::NO_CALLBACKS;

type SetNumbers<T> = unsafe extern "C" fn(fmi2Component, *const fmi2ValueReference, size_t, *const T) -> fmi2Status;
type Plain = unsafe extern "C" fn(fmi2Component) -> fmi2Status;

/// The C functions that a run needs.
struct Functions {
    instantiate: unsafe extern "C" fn(
        fmi2String,
        fmi2Type,
        fmi2String,
        fmi2String,
        *const fmi2CallbackFunctions,
        fmi2Boolean,
        fmi2Boolean,
    ) -> fmi2Component,
    set_up: unsafe extern "C" fn(fmi2Component, fmi2Boolean, fmi2Real, fmi2Real, fmi2Boolean, fmi2Real) -> fmi2Status,
    enter: Plain,
    exit: Plain,
    set_real: SetNumbers<fmi2Real>,
    set_integer: SetNumbers<fmi2Integer>,
    set_boolean: SetNumbers<fmi2Boolean>,
    step: unsafe extern "C" fn(fmi2Component, fmi2Real, fmi2Real, fmi2Boolean) -> fmi2Status,
    free: unsafe extern "C" fn(fmi2Component),
}

/// A loaded build.
pub(crate) struct Loaded {
    functions: Functions,
    guid: CString,
    references: HashMap<String, fmi2ValueReference>,
    /// Keeps the functions loaded.
    _library: Library,
}

impl Loaded {
    /// Loads the library from the folder of an unpacked .fmu with a library for this machine alone.
    pub(crate) fn open(folder: &Path) -> Result<Self> {
        let description = folder.join("modelDescription.xml");
        let text = fs::read_to_string(&description).with_context(|| format!("{} cannot be read", description.display()))?;
        let document = Document::parse(&text).with_context(|| description.display().to_string())?;
        let variables = document.descendants().filter(|node| node.has_tag_name("ScalarVariable"));
        let reference = |node: roxmltree::Node<'_, '_>| {
            Some((node.attribute("name")?.to_owned(), node.attribute("valueReference")?.parse().ok()?))
        };
        let guid = document.root_element().attribute("guid").context("modelDescription.xml has no GUID")?;
        let file = library(folder)?;
        // SAFETY: the library is a build of this repository; loading it runs no code of its own.
        let library = unsafe { Library::new(&file) }.with_context(|| format!("{} cannot be loaded", file.display()))?;
        /// The function of this name; its type is the field's.
        macro_rules! function {
            ($name:literal) => {
                // SAFETY: FMI 2.0 gives the function of this name this type.
                *unsafe { library.get($name) }.with_context(|| format!("{} has not all functions of FMI", file.display()))?
            };
        }
        let functions = Functions {
            instantiate: function!(c"fmi2Instantiate"),
            set_up: function!(c"fmi2SetupExperiment"),
            enter: function!(c"fmi2EnterInitializationMode"),
            exit: function!(c"fmi2ExitInitializationMode"),
            set_real: function!(c"fmi2SetReal"),
            set_integer: function!(c"fmi2SetInteger"),
            set_boolean: function!(c"fmi2SetBoolean"),
            step: function!(c"fmi2DoStep"),
            free: function!(c"fmi2FreeInstance"),
        };
        Ok(Self { functions, guid: CString::new(guid)?, references: variables.filter_map(reference).collect(), _library: library })
    }

    /// The value reference of a variable; fails if this build has no such variable.
    pub(crate) fn reference(&self, name: &str) -> Result<fmi2ValueReference> {
        self.references.get(name).copied().with_context(|| format!("it has no variable {name}"))
    }

    /// An instance after fmi2ExitInitializationMode, with variables set by reference.
    pub(crate) fn ready(&self, values: &[(fmi2ValueReference, Value)]) -> Result<Guest<'_>> {
        let (instantiate, guid) = (self.functions.instantiate, self.guid.as_ptr());
        // SAFETY: all pointers outlive the call; there are no callbacks.
        let component =
            unsafe { instantiate(c"pair".as_ptr(), fmi2CoSimulation, guid, null(), &NO_CALLBACKS, fmi2False, fmi2False) };
        ensure!(!component.is_null(), "fmi2Instantiate gave null");
        let mut guest = Guest { functions: &self.functions, component, point: 0.0 };
        guest.initialise(values)?;
        Ok(guest)
    }
}

/// The file of the library in an unpacked .fmu.
fn library(folder: &Path) -> Result<PathBuf> {
    let binaries = folder.join("binaries");
    let platforms = fs::read_dir(&binaries).with_context(|| format!("{} cannot be read", binaries.display()))?;
    let platforms: Vec<PathBuf> = platforms.map(|entry| Ok(entry?.path())).collect::<Result<_>>()?;
    let [platform] = &platforms[..] else {
        anyhow::bail!("{} has {} platforms, and one is needed: the one of this machine", binaries.display(), platforms.len());
    };
    Ok(platform.join("FiveBar").with_extension(DLL_EXTENSION))
}

/// An instance of a loaded build; freed when dropped.
pub(crate) struct Guest<'a> {
    functions: &'a Functions,
    component: fmi2Component,
    point: f64,
}

impl Guest<'_> {
    fn initialise(&mut self, values: &[(fmi2ValueReference, Value)]) -> Result<()> {
        let (functions, component) = (self.functions, self.component);
        // SAFETY: the component is live, the places hold one value each.
        unsafe {
            passed("fmi2SetupExperiment", (functions.set_up)(component, fmi2False, 0.0, 0.0, fmi2False, 0.0))?;
            passed("fmi2EnterInitializationMode", (functions.enter)(component))?;
            for (reference, value) in values {
                let status = value.fold(
                    |x| (functions.set_real)(component, reference, 1, &x),
                    |n| (functions.set_integer)(component, reference, 1, &n),
                    |b| (functions.set_boolean)(component, reference, 1, &fmi2Boolean::from(b)),
                );
                passed("a start value", status)?;
            }
            passed("fmi2ExitInitializationMode", (functions.exit)(component))
        }
    }

    /// Makes a communication step of `size` seconds.
    pub(crate) fn step(&mut self, size: f64) -> Result<()> {
        // SAFETY: the component is live.
        passed("fmi2DoStep", unsafe { (self.functions.step)(self.component, self.point, size, fmi2True) })?;
        self.point += size;
        Ok(())
    }

    /// Sets Reals.
    pub(crate) fn write(&mut self, references: &[fmi2ValueReference], values: &[f64]) -> Result<()> {
        assert_eq!(references.len(), values.len());
        // SAFETY: the component is live, the arrays have the same length.
        passed("fmi2SetReal", unsafe {
            (self.functions.set_real)(self.component, references.as_ptr(), references.len(), values.as_ptr())
        })
    }
}

impl Drop for Guest<'_> {
    fn drop(&mut self) {
        // SAFETY: the component is live and not used again.
        unsafe { (self.functions.free)(self.component) }
    }
}

/// Fails if the status of a call is worse than a warning.
fn passed(call: &str, status: fmi2Status) -> Result<()> {
    ensure!(status == fmi2OK || status == fmi2Warning, "{call} was refused with status {status}");
    Ok(())
}
