//! `cargo xtask test`: the checks, step by step; stops at the first failure.

mod python;
mod rust;
mod steps;

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{bench, format, page, paths, process};
use anyhow::{Result, bail};
use cargo_metadata::Message;
use python::Tests;
use std::path::{Path, PathBuf};
use std::thread::{self, ScopedJoinHandle};
use steps::Steps;

/// Extent of the checks. Each level contains the ones before it.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
pub(crate) enum Level {
    /// Checks that need only Rust and Python.
    Usual,
    /// Also checks that need Debian packages; CI runs this level.
    Full,
    /// Also long tests, all platforms and the live page.
    Nightly,
}

/// Parts that only `--full` runs, for the last line of the short form.
const LEFT_OUT: &str = "`--full`, as CI runs it: browsers, mosquitto, masters other than FMPy, a forced panic, a foreign locale, memory and threads \
     under valgrind, instructions per step; `--nightly`: tests that are too long for every run";

/// Programs that `--full` needs, with their Debian packages.
const FULL_NEEDS: [(&str, &str); 7] = [
    ("chromium", "chromium"),
    ("chromedriver", "chromium-driver"),
    ("/usr/sbin/mosquitto", "mosquitto"),
    ("openssl", "openssl"),
    ("/usr/lib/x86_64-linux-gnu/libtbb.so.12", "libtbb12"),
    ("valgrind", "valgrind"),
    ("/usr/share/i18n/locales/de_DE", "locales"),
];

/// Version of the master fmi-sim, and the packages that its build needs.
const FMI_SIM: (&str, [(&str, &str); 1]) = ("0.7.0", [("/usr/lib/llvm-14/lib/libclang.so", "libclang-14-dev")]);

/// Programs that `--platforms` needs in addition to the build's.
const PLATFORMS_NEEDS: [(&str, &str); 2] = [("wine", "wine"), ("qemu-aarch64", "qemu-user")];

/// Programs that `--page` needs in addition to the build's.
const PAGE_NEEDS: [(&str, &str); 3] = [("chromium", "chromium"), ("chromedriver", "chromium-driver"), ("node", "nodejs")];

/// Scene and name of the unit of one's own that the Python tests use.
const OWN: (&str, &str) = ("tests/data/own_machine.json", "OwnMachine");

/// The Rust tests of the C functions that run under valgrind: a short sample, and all.
const C_TESTS: (&str, &str) = ("fmi_lifecycle", "fmi_");

/// Runs a level.
pub(crate) fn test(level: Level) -> Result<()> {
    let (full, nightly) = (level >= Level::Full, level == Level::Nightly);
    if full {
        process::need("cargo xtask test --full", ".ci/setup", &FULL_NEEDS)?;
    }
    if nightly {
        process::need("cargo xtask test --nightly", ".ci/setup-platforms", &PLATFORMS_NEEDS)?;
        process::need("cargo xtask test --nightly", ".ci/setup-page", &PAGE_NEEDS)?;
    }
    // Python packages are fetched in parallel, because the network is slow. A failed step waits for them, so that none is half installed.
    thread::scope(|scope| {
        let packages = match level {
            Level::Usual => Packages::Usual,
            Level::Full => Packages::Full,
            Level::Nightly => Packages::Nightly,
        };
        checked(level, scope.spawn(move || venv::python(packages).map(drop)))
    })?;
    if nightly {
        platforms()?;
        page()?;
    }
    if !full {
        println!("left out here: {LEFT_OUT}");
    }
    Ok(())
}

/// The steps of a level; `environment` makes the Python environment.
fn checked(level: Level, environment: ScopedJoinHandle<'_, Result<()>>) -> Result<()> {
    let (full, nightly) = (level >= Level::Full, level == Level::Nightly);
    let mut steps = Steps::begin();
    // Linking optimised programs uses one core, so other steps run beside it.
    let packed = process::start("package", process::program(std::env::current_exe()?).arg("package"))?;
    let instructions = if full { Some(process::start("instructions", &mut bench::instructions())?) } else { None };
    steps.run("format", || format::format(true))?;
    steps.run("lints", || {
        process::run(
            process::cargo().args(["clippy", "--quiet", "--locked", "--workspace", "--all-targets"]).args(["--", "-D", "warnings"]),
        )
    })?;
    steps.run("Rust documentation", || {
        process::run(
            process::cargo().args(["doc", "--quiet", "--locked", "--workspace", "--no-deps"]).env("RUSTDOCFLAGS", "-D warnings"),
        )
    })?;
    let programs = steps.run("build of the Rust tests", rust::build)?;
    let times = steps.run("Rust tests", || rust::run(&programs, nightly))?;
    steps.add(times);
    steps.run("Python environment (the rest)", || environment.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))?;
    steps.run("lints of Python", || python::lints(full))?;
    steps.run("package (the rest)", || packed.finish())?;
    let fmu = paths::fmu("FiveBar");
    steps.run("package, own machine", || own(&fmu))?;
    let mut tests = Tests::Usual;
    if full {
        let panicking = steps.run("panicking build", panicking)?;
        let filter = if nightly { C_TESTS.1 } else { C_TESTS.0 };
        steps.run("memory of the C functions", || process::run(&mut rust::memory(&programs, &[filter])?))?;
        tests = if nightly { Tests::Nightly { panicking } } else { Tests::Full { panicking } };
    }
    let times = steps.run("Python tests", || python::pytest(&fmu, &paths::fmu(OWN.1), &tests))?;
    steps.add(times);
    if let Some(instructions) = instructions {
        steps.run("instructions (the rest)", || instructions.finish())?;
        // No time is judged: only whether both libraries run each scene.
        steps.run("a build beside itself", || bench::pair(&fmu, &fmu, "by automatic", true))?;
    }
    steps.show();
    Ok(())
}

/// Writes the unit of one's own for the Python tests, beside the plain one.
fn own(plain: &Path) -> Result<()> {
    package::package_own(plain, &paths::in_root(OWN.0), None)
}

/// Packs for all platforms, and compares each library with the one tested by [`test()`].
pub(crate) fn platforms() -> Result<()> {
    process::need("cargo xtask test --platforms", ".ci/setup-platforms", &PLATFORMS_NEEDS)?;
    let mut steps = Steps::begin();
    let here = steps.run("package", || package::package(Scope::Here))?;
    steps.run("package, own machine", || own(&here))?;
    let fmu = steps.run("package, all platforms", || package::package(Scope::All))?;
    steps.run("package, own machine, all platforms", || own(&fmu))?;
    let times = steps.run("Python tests", || python::pytest(&fmu, &paths::fmu_for_all_platforms(OWN.1), &Tests::Platforms))?;
    steps.add(times);
    steps.show();
    Ok(())
}

/// Makes the live page, compares its bits with the library tested by [`test()`], and opens it in a browser.
pub(crate) fn page() -> Result<()> {
    process::need("cargo xtask test --page", ".ci/setup-page", &PAGE_NEEDS)?;
    let mut steps = Steps::begin();
    let fmu = steps.run("package", || package::package(Scope::Here))?;
    steps.run("page", page::page)?;
    let times = steps.run("Python tests", || python::pytest(&fmu, &paths::fmu(OWN.1), &Tests::Page))?;
    steps.add(times);
    steps.show();
    Ok(())
}

/// Builds fmi-sim, a master in Rust without shared code, and drives the packed unit with it.
pub(crate) fn fmi_sim() -> Result<()> {
    let (version, needs) = FMI_SIM;
    process::need("cargo xtask test --fmi-sim", ".ci/setup-fmi-sim", &needs)?;
    let mut steps = Steps::begin();
    steps.run("fmi-sim", || {
        let install = ["install", "fmi-sim", "--version", version, "--locked", "--quiet", "--root"];
        process::run(process::cargo().args(install).arg(paths::fmi_sim()))
    })?;
    let fmu = steps.run("package", || package::package(Scope::Here))?;
    steps.run("package, own machine", || own(&fmu))?;
    let times = steps.run("Python tests", || python::pytest(&fmu, &paths::fmu(OWN.1), &Tests::FmiSim))?;
    steps.add(times);
    steps.show();
    Ok(())
}

/// Builds a library in which fmi2CancelStep panics; returns its file. Dependencies are shared with the Rust tests. The library itself is
/// not optimised, because a panic at the C border does not depend on it.
fn panicking() -> Result<PathBuf> {
    let build = ["rustc", "--quiet", "--locked", "--lib", "--crate-type", "cdylib", process::MESSAGES];
    let messages =
        process::run_for_output(process::cargo().args(build).args(["--", "--cfg", "forced_panic", "-C", "opt-level=0"]))?;
    for message in Message::parse_stream(messages.as_bytes()) {
        if let Message::CompilerArtifact(artifact) = message?
            && let Some(library) = artifact.filenames.iter().find(|file| file.extension() == Some(std::env::consts::DLL_EXTENSION))
            && artifact.target.name == "fivebar"
        {
            return Ok(library.into());
        }
    }
    bail!("cargo built no library that panics")
}
