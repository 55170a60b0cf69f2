//! The Python tests and checks.

use super::OWN;
use super::steps::Timed;
use crate::venv::{self, Packages};
use crate::{paths, process};
use anyhow::{Context, Result};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Selection of the tests.
pub(super) enum Tests {
    /// Tests that need Python packages only.
    Usual,
    /// Also tests that need a browser, valgrind or a locale, and a library in which fmi2CancelStep panics.
    Full { panicking: PathBuf },
    /// Also long tests, and the site.
    Nightly { panicking: PathBuf },
    /// The usual tests on a unit for all platforms, and tests that compare its libraries.
    Platforms,
    /// Only the test of fmi-sim.
    FmiSim,
    /// Only the tests of the live page.
    Page,
}

/// Runs the tests on the packed units: the plain one and one of one's own. By default pytest.ini excludes tests that need more than
/// Python packages.
pub(super) fn pytest(fmu: &Path, own: &Path, tests: &Tests) -> Result<Vec<Timed>> {
    let (packages, marks) = match tests {
        Tests::Usual => (Packages::Usual, None),
        Tests::Full { .. } => (Packages::Full, Some("not nightly and not platforms and not fmi_sim and not page")),
        Tests::Nightly { .. } => (Packages::Nightly, Some("not platforms and not fmi_sim and not page")),
        Tests::Platforms => (Packages::Platforms, Some("not full and not nightly and not fmi_sim and not page")),
        Tests::FmiSim => (Packages::Usual, Some("fmi_sim")),
        Tests::Page => (Packages::Full, Some("page")),
    };
    let report = paths::in_root("target/pytest/report.xml");
    let mut command = venv::python(packages)?;
    command
        // More than two processes would make browsers late. A process without tests left takes some from the other.
        .args(["-m", "pytest", "tests/python", "--quiet", "--numprocesses", "2", "--dist", "worksteal"])
        .arg(format!("--junit-xml={}", report.display()))
        .arg("--override-ini")
        .arg(format!("cache_dir={}", paths::in_root("target/pytest").display()))
        .env("FIVEBAR_FMU", fmu)
        .env("FIVEBAR_FMU_HERE", paths::fmu("FiveBar"))
        .env("FIVEBAR_OWN", own)
        .env("FIVEBAR_OWN_HERE", paths::fmu(OWN.1))
        .env("FMI_SIM", paths::fmi_sim().join("bin/fmi-sim"));
    if let Tests::Full { panicking } | Tests::Nightly { panicking } = tests {
        command.env("FIVEBAR_PANICKING", panicking).env("COFMUPY", venv::apart());
    }
    if let Some(marks) = marks {
        command.args(["-m", marks]);
    }
    process::run(&mut command).with_context(|| format!("tests/python on {}", paths::short(fmu)))?;
    times(&fs::read_to_string(&report).with_context(|| paths::short(&report))?)
}

/// Format, lints and types of the Python sources; with `full` also lints of the JavaScript sources.
pub(super) fn lints(full: bool) -> Result<()> {
    process::run(venv::python(Packages::Usual)?.args(["-m", "ruff", "check", "--quiet"]))?;
    process::run(venv::python(Packages::Usual)?.args(["-m", "ruff", "format", "--quiet", "--check"]))?;
    process::run(venv::python(Packages::Usual)?.args(["-m", "mypy"]).current_dir(paths::in_root("python")))?;
    if full {
        process::run(venv::installed(Packages::Full, "oxlint")?.args(["--deny-warnings", "page", "python", "tests"]))?;
    }
    Ok(())
}

/// Names and times of the tests in a JUnit report.
fn times(report: &str) -> Result<Vec<Timed>> {
    let document = roxmltree::Document::parse(report)?;
    let tests = document.descendants().filter(|node| node.has_tag_name("testcase"));
    Ok(tests
        .filter_map(|test| {
            let file = test.attribute("classname")?.rsplit('.').next()?;
            let seconds = test.attribute("time")?.parse().ok()?;
            Some(Timed {
                name: format!("{file}.py::{}", test.attribute("name")?),
                time: Duration::try_from_secs_f64(seconds).ok()?,
            })
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_from_the_report() {
        let report = r#"<testsuites><testsuite><testcase classname="tests.python.test_run" name="test_summary[a]" time="1.25"/></testsuite></testsuites>"#;
        let tests = times(report).unwrap();
        assert_eq!((tests.len(), tests[0].name.as_str()), (1, "test_run.py::test_summary[a]"));
        assert_eq!(tests[0].time, Duration::from_millis(1250));
    }
}
