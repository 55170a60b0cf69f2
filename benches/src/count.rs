//! Instructions of every case, by callgrind: this program runs once more under it, and the counter is dumped after each case.

use std::fs;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};

use crate::cases;

/// The function that callgrind counts in, as it names it.
const REGION: &str = "benches::case::measured";

/// Every case once, in order: what runs under callgrind.
pub(crate) fn each_once() -> Result<()> {
    cases::all()?.iter().try_for_each(|case| case.once().map(drop))
}

/// Instructions of each of all cases, per time that it does what it counts.
pub(crate) fn instructions() -> Result<Vec<f64>> {
    let cases = cases::all()?;
    let folder = tempfile::tempdir().context("a folder for callgrind's dumps")?;
    let dumps = folder.path().join("dump");
    let mut file = std::ffi::OsString::from("--callgrind-out-file=");
    file.push(&dumps);
    let output = Command::new("valgrind")
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
    cases.iter().enumerate().map(|(i, case)| Ok(total(&dumps.with_extension((i + 1).to_string()))? / case.times as f64)).collect()
}

/// The sum that a dump ends with.
fn total(dump: &std::path::Path) -> Result<f64> {
    let text = fs::read_to_string(dump).with_context(|| format!("callgrind did not dump: it has found no {REGION}"))?;
    let count = text.lines().find_map(|line| line.strip_prefix("totals: ")).context("a dump without totals")?;
    let count: f64 = count.trim().parse().context("totals is no number")?;
    ensure!(count > 0.0, "callgrind counted nothing in {REGION}");
    Ok(count)
}
