//! `cargo xtask test`: everything that CI checks, step by step; the first failure ends it.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{bench, format, page, paths, process};
use anyhow::{Context, Result, bail, ensure};
use cargo_metadata::Message;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

/// Parts that `--full` adds, for the last line of the short form.
const LEFT_OUT: &str = "the pages in a real browser, the twin on mosquitto and its processes killed, masters other than FMPy, a forced \
     panic, a foreign locale, and with valgrind memory errors, leaks, races and instructions per step";

/// Programs that `--full` needs, and the Debian package of each.
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

/// Programs that `--platforms` needs on top of those that build.
const PLATFORMS_NEEDS: [(&str, &str); 2] = [("wine", "wine"), ("qemu-aarch64", "qemu-user")];

/// Programs that `--page` needs on top of those that build the page.
const PAGE_NEEDS: [(&str, &str); 3] = [("chromium", "chromium"), ("chromedriver", "chromium-driver"), ("node", "nodejs")];

/// The scene of a unit of one's own, which the Python tests look at, and the unit's name.
const OWN: (&str, &str) = ("tests/data/own_machine.json", "OwnMachine");

/// The Rust tests that go through the C functions; the same names are run once more under valgrind.
const C_TESTS: (&str, &str) = ("integration", "fmi_");

/// Runs the checks that need Rust and Python only; with `full` also those that need Debian packages.
pub(crate) fn test(full: bool) -> Result<()> {
    if full {
        process::need("cargo xtask test --full", ".ci/setup", &FULL_NEEDS)?;
    }
    // Python packages are fetched meanwhile: the network has its own pace.
    let environment = thread::spawn(move || venv::python(if full { Packages::Full } else { Packages::Usual }).map(drop));
    // Optimised programs are linked by one core: the rest goes on beside them.
    let instructions = if full { Some(process::start("instructions", &mut bench::instructions())?) } else { None };
    let packed = process::start("package", process::program(std::env::current_exe()?).arg("package"))?;
    let mut steps = Steps::default();
    steps.run("format", || format::format(true))?;
    steps.run("lints", || {
        process::run(process::cargo().args(["clippy", "--locked", "--workspace", "--all-targets"]).args(["--", "-D", "warnings"]))
    })?;
    // Valgrind has one core busy: all that follows goes on beside it.
    let memory =
        if full { Some(steps.run("program of the memory checks", || process::start("memory", &mut valgrind()?))?) } else { None };
    // Examples are built by the lints alone: built in full they take a quarter of a minute.
    steps.run("Rust tests", || {
        process::run(process::cargo().args(["test", "--locked", "--workspace", "--lib", "--bins", "--tests"]))?;
        process::run(process::cargo().args(["test", "--locked", "--workspace", "--doc"]))
    })?;
    steps.run("Rust documentation", || {
        process::run(process::cargo().args(["doc", "--locked", "--workspace", "--no-deps"]).env("RUSTDOCFLAGS", "-D warnings"))
    })?;
    steps.run("package (the rest)", || packed.finish())?;
    if let Some(instructions) = instructions {
        steps.run("instructions (the rest)", || instructions.finish())?;
    }
    steps.run("Python environment (the rest)", || environment.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))?;
    let fmu = paths::fmu("FiveBar");
    steps.run("package, own machine", || own(&fmu))?;
    let tests = if full { Tests::Full { panicking: steps.run("panicking build", panicking)? } } else { Tests::Usual };
    if let Some(memory) = memory {
        steps.run("memory (the rest)", || memory.finish())?;
    }
    steps.run("Python tests", || pytest(&fmu, &paths::fmu(OWN.1), &tests))?;
    steps.summary();
    if !full {
        println!("left out here, part of `cargo xtask test --full`: {LEFT_OUT}");
    }
    Ok(())
}

/// Writes the unit of one's own that the Python tests look at, beside the plain one.
fn own(plain: &Path) -> Result<()> {
    package::package_own(plain, &paths::in_root(OWN.0), None)
}

/// Packs for all platforms, and runs each library against the one that [`test()`] judges.
pub(crate) fn platforms() -> Result<()> {
    process::need("cargo xtask test --platforms", ".ci/setup-platforms", &PLATFORMS_NEEDS)?;
    let mut steps = Steps::default();
    let here = steps.run("package", || package::package(Scope::Here))?;
    steps.run("package, own machine", || own(&here))?;
    let fmu = steps.run("package, all platforms", || package::package(Scope::All))?;
    steps.run("package, own machine, all platforms", || own(&fmu))?;
    steps.run("Python tests", || pytest(&fmu, &paths::fmu_for_all_platforms(OWN.1), &Tests::Platforms))?;
    steps.summary();
    Ok(())
}

/// Makes the live page, compares its bits with those of the library that [`test()`] judges, and opens it in a browser.
pub(crate) fn page() -> Result<()> {
    process::need("cargo xtask test --page", ".ci/setup-page", &PAGE_NEEDS)?;
    let mut steps = Steps::default();
    let fmu = steps.run("package", || package::package(Scope::Here))?;
    steps.run("page", page::page)?;
    steps.run("Python tests", || pytest(&fmu, &paths::fmu(OWN.1), &Tests::Page))?;
    steps.summary();
    Ok(())
}

/// Builds fmi-sim, a master in Rust that shares no code with this library, and lets it drive the packed unit.
pub(crate) fn fmi_sim() -> Result<()> {
    let (version, needs) = FMI_SIM;
    process::need("cargo xtask test --fmi-sim", ".ci/setup-fmi-sim", &needs)?;
    let mut steps = Steps::default();
    steps.run("fmi-sim", || {
        let install = ["install", "fmi-sim", "--version", version, "--locked", "--quiet", "--root"];
        process::run(process::cargo().args(install).arg(paths::fmi_sim()))
    })?;
    let fmu = steps.run("package", || package::package(Scope::Here))?;
    steps.run("package, own machine", || own(&fmu))?;
    steps.run("Python tests", || pytest(&fmu, &paths::fmu(OWN.1), &Tests::FmiSim))?;
    steps.summary();
    Ok(())
}

/// The steps done so far, with their times.
#[derive(Default)]
struct Steps {
    done: Vec<(&'static str, Duration)>,
}

impl Steps {
    fn run<T>(&mut self, name: &'static str, step: impl FnOnce() -> Result<T>) -> Result<T> {
        println!("\n== {name} ==");
        let start = Instant::now();
        let result = step();
        let time = start.elapsed();
        match result {
            Ok(value) => {
                println!("== {name}: {:.1} s ==", time.as_secs_f64());
                self.done.push((name, time));
                Ok(value)
            }
            Err(error) => {
                self.summary();
                println!("  {name:30} FAILED after {:.1} s", time.as_secs_f64());
                Err(error.context(format!("step `{name}` failed")))
            }
        }
    }

    fn summary(&self) {
        println!("\n== summary ==");
        for (name, time) in &self.done {
            println!("  {name:30} ok {:7.1} s", time.as_secs_f64());
        }
    }
}

/// The tests that go through the C functions, under valgrind's memory checker.
fn valgrind() -> Result<Command> {
    let (target, filter) = C_TESTS;
    let executable = test_executable(target)?;
    let names = process::output(process::program(&executable).args([filter, "--list"]))?;
    ensure!(names.lines().any(|line| line.ends_with(": test")), "tests/{target} has no test with `{filter}` in its name");
    let mut command = process::program("valgrind");
    command
        .args(["--quiet", "--error-exitcode=1", "--leak-check=full"])
        // Memory still reachable at the end belongs to Rust's test harness and its threads.
        .args(["--show-leak-kinds=definite,indirect", "--errors-for-leak-kinds=definite,indirect"])
        .arg(executable)
        .args([filter, "--test-threads=1"]);
    Ok(command)
}

/// Builds an integration test and gives back its program.
fn test_executable(target: &str) -> Result<PathBuf> {
    let messages = process::run_for_output(
        // With the whole workspace, whose tests have been built already: alone it would be built with other features once more.
        process::cargo()
            .args(["test", "--locked", "--workspace", "--no-run", "--test", target])
            .arg("--message-format=json-render-diagnostics"),
    )?;
    for message in Message::parse_stream(messages.as_bytes()) {
        if let Message::CompilerArtifact(artifact) = message?
            && artifact.target.name == target
            && let Some(executable) = artifact.executable
        {
            return Ok(executable.into());
        }
    }
    bail!("cargo built no program for tests/{target}")
}

/// Builds the library so that fmi2CancelStep panics, and gives back its file. The dependencies are those of the Rust tests; the library
/// itself is not optimised, because a panic at the C border does not depend on that.
fn panicking() -> Result<PathBuf> {
    let build = ["rustc", "--locked", "--lib", "--crate-type", "cdylib", "--message-format=json-render-diagnostics"];
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

/// Selection of the Python tests.
enum Tests {
    /// Tests that need Python packages only.
    Usual,
    /// Also tests that need a browser, valgrind or a locale, and a library whose fmi2CancelStep panics.
    Full { panicking: PathBuf },
    /// The usual ones, on a unit for all platforms, and those that compare its libraries.
    Platforms,
    /// The test of fmi-sim alone.
    FmiSim,
    /// The tests of the live page alone.
    Page,
}

/// Runs the Python tests on the packed units, the plain one and one of one's own, last of all: the line it ends with is the one that
/// CI reads. pytest.ini leaves those out that need more than Python packages, unless asked for.
fn pytest(fmu: &Path, own: &Path, tests: &Tests) -> Result<()> {
    let (packages, marks) = match tests {
        Tests::Usual => (Packages::Usual, None),
        Tests::Full { .. } => (Packages::Full, Some("not platforms and not fmi_sim and not page")),
        Tests::Platforms => (Packages::Platforms, Some("not full and not fmi_sim and not page")),
        Tests::FmiSim => (Packages::Usual, Some("fmi_sim")),
        Tests::Page => (Packages::Full, Some("page")),
    };
    let mut command = venv::python(packages)?;
    command
        // Two files of tests at a time: a third one makes browsers late. tests/python/conftest.py says which files come first.
        .args(["-m", "pytest", "tests/python", "--numprocesses", "2", "--dist", "loadfile", "--no-loadscope-reorder"])
        .arg("--override-ini")
        .arg(format!("cache_dir={}", paths::in_root("target/pytest").display()))
        .env("FIVEBAR_FMU", fmu)
        .env("FIVEBAR_FMU_HERE", paths::fmu("FiveBar"))
        .env("FIVEBAR_OWN", own)
        .env("FIVEBAR_OWN_HERE", paths::fmu(OWN.1))
        .env("FMI_SIM", paths::fmi_sim().join("bin/fmi-sim"));
    if let Tests::Full { panicking } = tests {
        command.env("FIVEBAR_PANICKING", panicking).env("COFMUPY", venv::apart());
    }
    if let Some(marks) = marks {
        command.args(["-m", marks]);
    }
    process::run(&mut command).with_context(|| format!("tests/python on {}", paths::short(fmu)))
}
