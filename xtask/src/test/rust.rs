//! The Rust tests: built by cargo, run program by program, with the time of each test.

use super::steps::Timed;
use crate::process;
use anyhow::{Context, Result, bail, ensure};
use cargo_metadata::Message;
use std::path::PathBuf;
use std::process::Command;
use std::time::{Duration, Instant};

/// A test program.
pub(super) struct Program {
    /// Name of the target: `integration`, or the crate's name.
    name: String,
    file: PathBuf,
    /// The folder of its package, used as working directory as cargo does.
    folder: PathBuf,
}

/// Builds all test programs. Only the lints build examples.
pub(super) fn build() -> Result<Vec<Program>> {
    let others = ["test", "--no-run", "--locked", "--workspace", "--exclude", "fivebar", "--lib", "--bins", "--tests"];
    let mut built = programs(process::cargo().args(others).arg(process::MESSAGES))?;
    // The package `fivebar` is optimised. Its own test programs need not be: optimised they take five times as long to build, and that
    // costs three times what it saves in their runs. Integration tests link the optimised library.
    for target in [&["--lib"][..], &["--test", "integration"]] {
        let of_library = ["rustc", "--locked", "--package", "fivebar", "--profile", "test", process::MESSAGES];
        built.extend(programs(process::cargo().args(of_library).args(target).args(["--", "-C", "opt-level=0"]))?);
    }
    ensure!(!built.is_empty(), "cargo has built no tests");
    Ok(built)
}

/// Runs cargo and returns the test programs that it has built.
fn programs(cargo: &mut Command) -> Result<Vec<Program>> {
    let messages = process::run_for_output(cargo)?;
    let mut programs = Vec::new();
    for message in Message::parse_stream(messages.as_bytes()) {
        if let Message::CompilerArtifact(artifact) = message?
            && artifact.profile.test
            && let Some(file) = artifact.executable
        {
            let folder = artifact.manifest_path.parent().context("a package lies in a folder")?;
            programs.push(Program { name: artifact.target.name, file: file.into(), folder: folder.into() });
        }
    }
    Ok(programs)
}

/// Runs all tests, with `nightly` in their long form. If a test fails, shows its program's output.
pub(super) fn run(programs: &[Program], nightly: bool) -> Result<Vec<Timed>> {
    let mut all = Vec::new();
    for program in programs {
        let begin = Instant::now();
        let mut command = process::program(&program.file);
        command.current_dir(&program.folder);
        // A stable test harness reports times only with unstable options.
        command.env("RUSTC_BOOTSTRAP", "1").args(["-Z", "unstable-options", "--report-time"]);
        if nightly {
            command.env("FIVEBAR_NIGHTLY", "1").env("PROPTEST_CASES", "1024");
        }
        let output = command.output().with_context(|| format!("{} could not be started", program.file.display()))?;
        let text = String::from_utf8_lossy(&output.stdout);
        if !output.status.success() {
            bail!("{}\n{}\ntests of `{}` failed", text, String::from_utf8_lossy(&output.stderr), program.name);
        }
        let tests = times(&text);
        if !tests.is_empty() {
            println!("{}: {} passed in {:.1} s", program.name, tests.len(), begin.elapsed().as_secs_f64());
        }
        all.extend(tests);
    }
    Ok(all)
}

/// The tests of `integration` that match one of the filters, under valgrind's memory checker.
pub(super) fn memory(programs: &[Program], filters: &[&str]) -> Result<Command> {
    let integration = programs.iter().find(|program| program.name == "integration").context("there are no integration tests")?;
    let names = process::output(process::program(&integration.file).args(filters).arg("--list"))?;
    ensure!(names.lines().any(|line| line.ends_with(": test")), "no integration test is called {}", filters.join(" or "));
    let mut command = process::program("valgrind");
    command
        .args(["--quiet", "--error-exitcode=1", "--leak-check=full"])
        // Memory still reachable at the end belongs to Rust's test harness and its threads.
        .args(["--show-leak-kinds=definite,indirect", "--errors-for-leak-kinds=definite,indirect"])
        .arg(&integration.file)
        .args(filters)
        .args(["--quiet", "--test-threads=1"]);
    Ok(command)
}

/// Passed tests, from lines such as `test kinks::a_stop ... ok <0.123s>`.
fn times(output: &str) -> Vec<Timed> {
    let line = |line: &str| {
        let (name, rest) = line.strip_prefix("test ")?.split_once(" ... ok <")?;
        let seconds = rest.strip_suffix("s>")?.parse().ok()?;
        Some(Timed { name: name.split(" - ").next()?.into(), time: Duration::try_from_secs_f64(seconds).ok()? })
    };
    output.lines().filter_map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_from_the_harness() {
        let tests = times(
            "\nrunning 3 tests\ntest a::b ... ok <1.500s>\ntest c ... ignored, nightly\ntest d - should panic ... ok <0.001s>\n",
        );
        let read: Vec<_> = tests.iter().map(|test| (test.name.as_str(), test.time.as_millis())).collect();
        assert_eq!(read, [("a::b", 1500), ("d", 1)]);
    }
}
