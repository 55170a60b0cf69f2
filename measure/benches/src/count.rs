//! Instructions of every case: this program runs again under callgrind and dumps the counter after each case.

use std::fs;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};

use crate::case::Case;
use crate::cases;

/// The counted function, by callgrind's name.
const REGION: &str = "benches::case::measured";

/// Runs every case once, in order; for callgrind.
pub(crate) fn each_once() -> Result<()> {
    cases::all()?.iter().try_for_each(|case| case.once().map(drop))
}

/// Counts of a case.
#[derive(Clone, Debug)]
pub(crate) struct Count {
    /// Instructions per counted operation.
    pub(crate) instructions: f64,
    /// Whether a function of the estimator has run.
    pub(crate) estimates: bool,
}

/// Instructions of all cases.
pub(crate) fn instructions() -> Result<Vec<f64>> {
    Ok(counts()?.into_iter().map(|count| count.instructions).collect())
}

/// Counts of all cases, with the line of this program.
pub(crate) fn counts() -> Result<Vec<Count>> {
    let cases = cases::all()?;
    let folder = tempfile::tempdir().context("a folder for callgrind's dumps")?;
    let dumps = folder.path().join("dump");
    let mut file = std::ffi::OsString::from("--callgrind-out-file=");
    file.push(&dumps);
    // The environment lies on the stack, and a copy to where it lies takes two instructions less from some places: each machine counts the same.
    let path = std::env::var_os("PATH").unwrap_or_default();
    let output = Command::new("valgrind")
        .env_clear()
        .env("PATH", path)
        .args(["--tool=callgrind", &format!("--toggle-collect={REGION}"), &format!("--dump-after={REGION}")])
        .arg(file)
        .arg(std::env::current_exe()?)
        .arg("count")
        .stdin(Stdio::null())
        .output()
        .context("valgrind could not be started; .ci/setup installs it")?;
    ensure!(output.status.success(), "valgrind failed:\n{}", String::from_utf8_lossy(&output.stderr));
    let last = dumps.with_extension((cases.len() + 1).to_string());
    ensure!(!last.exists(), "callgrind dumped more often than there are cases: {REGION} is called elsewhere");
    let count = |(i, case): (usize, &Case)| {
        let dump = dumps.with_extension((i + 1).to_string());
        let text = fs::read_to_string(&dump).context("callgrind did not dump: it has found no measured function")?;
        Ok(Count { instructions: total(&text)? / case.times as f64, estimates: estimates(&text) })
    };
    cases.iter().enumerate().map(count).collect()
}

/// Whether a dump names a function of the estimator.
fn estimates(dump: &str) -> bool {
    const OWN: [&str; 2] = ["fivebar::estimator::", "fivebar::simulation::following::"];
    dump.lines().filter(|line| line.starts_with("fn=")).any(|line| OWN.iter().any(|own| line.contains(own)))
}

/// The sum at the end of a dump.
fn total(dump: &str) -> Result<f64> {
    let count = dump.lines().find_map(|line| line.strip_prefix("totals: ")).context("a dump without totals")?;
    let count: f64 = count.trim().parse().context("totals is no number")?;
    ensure!(count > 0.0, "callgrind counted nothing in {REGION}");
    Ok(count)
}
