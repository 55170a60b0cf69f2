//! Instructions of every case, and accesses to data and cache misses of those that call C functions: this program runs again under
//! callgrind and dumps the counters after each case.

use std::fs;
use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result, ensure};
use tempfile::TempDir;

use crate::case::Case;
use crate::cases;

/// The counted function, by callgrind's name.
const REGION: &str = "benches::case::measured";

/// The simulated first caches: size in bytes, ways, bytes per line. They are the same on every host, and as large as on most processors.
const FIRST_CACHE: &str = "32768,8,64";

/// Copies of memory without `rep movsb`, which some processors have and others do not: valgrind counts an instruction for each byte of it.
const PLAIN_COPIES: &str = "glibc.cpu.hwcaps=-ERMS,-FSRM";

/// Counts of a case, per counted operation.
#[derive(Clone, Debug)]
pub(crate) struct Count {
    /// Instructions.
    pub(crate) instructions: f64,
    /// Accesses to data; only of the cases that call C functions ([`Case::is_call`]).
    pub(crate) accesses: Option<Accesses>,
    /// Whether a function of the estimator has run.
    pub(crate) estimates: bool,
}

/// Accesses to data per counted operation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Accesses {
    pub(crate) reads: f64,
    pub(crate) writes: f64,
    /// Misses of the first data cache, by reads and writes.
    pub(crate) misses: f64,
}

/// Runs cases once, in order, for callgrind: those that call C functions, or all others.
pub(crate) fn each_once(calls: bool) -> Result<()> {
    cases::all()?.iter().filter(|case| case.is_call() == calls).try_for_each(|case| case.once().map(drop))
}

/// Counts of all cases. The simulation of caches takes four times as long as counting, so that only calls have it.
pub(crate) fn counts() -> Result<Vec<Count>> {
    let cases = cases::all()?;
    let selected = |calls| cases.iter().filter(move |case| case.is_call() == calls).collect::<Vec<_>>();
    // Both programs run at the same time.
    let [calls, others] = [true, false].map(Counting::start);
    let (mut calls, mut others) = (calls?.finish(&selected(true))?.into_iter(), others?.finish(&selected(false))?.into_iter());
    let next = |case: &Case| if case.is_call() { calls.next() } else { others.next() };
    cases.iter().map(next).collect::<Option<_>>().context("there are as many counts as cases")
}

/// This program under callgrind.
struct Counting {
    program: Child,
    /// Folder of the dumps; removed at the end.
    folder: TempDir,
}

impl Counting {
    /// Starts the cases that call C functions, with caches, or all others without.
    fn start(calls: bool) -> Result<Self> {
        let folder = tempfile::tempdir().context("a folder for callgrind's dumps")?;
        let mut file = std::ffi::OsString::from("--callgrind-out-file=");
        file.push(folder.path().join("dump"));
        let mut valgrind = Command::new("valgrind");
        // The environment lies on the stack, and a copy to where it lies takes two instructions less from some places: each machine counts the same.
        let path = std::env::var_os("PATH").unwrap_or_default();
        valgrind.env_clear().env("PATH", path).env("GLIBC_TUNABLES", PLAIN_COPIES);
        valgrind.args(["--tool=callgrind", &format!("--toggle-collect={REGION}"), &format!("--dump-after={REGION}")]);
        if calls {
            valgrind.args([
                "--cache-sim=yes",
                &format!("--D1={FIRST_CACHE}"),
                &format!("--I1={FIRST_CACHE}"),
                "--LL=8388608,16,64",
            ]);
        }
        valgrind.arg(file).arg(std::env::current_exe()?).arg("count");
        if calls {
            valgrind.arg("--calls");
        }
        let program = valgrind.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn();
        Ok(Self { program: program.context("valgrind could not be started; .ci/setup installs it")?, folder })
    }

    /// Waits for the end and reads a dump for each case.
    fn finish(self, cases: &[&Case]) -> Result<Vec<Count>> {
        let Self { program, folder } = self;
        let output = program.wait_with_output()?;
        ensure!(output.status.success(), "valgrind failed:\n{}", String::from_utf8_lossy(&output.stderr));
        let dump = |number: usize| folder.path().join(format!("dump.{number}"));
        ensure!(!dump(cases.len() + 1).exists(), "callgrind dumped more often than there are cases: {REGION} is called elsewhere");
        let count = |(i, case): (usize, &&Case)| {
            let text = fs::read_to_string(dump(i + 1)).context("callgrind did not dump: it has found no measured function")?;
            let each = |events: &[&str]| Ok::<_, anyhow::Error>(total(&text, events)? / case.times as f64);
            let accesses = || {
                Ok::<_, anyhow::Error>(Accesses { reads: each(&["Dr"])?, writes: each(&["Dw"])?, misses: each(&["D1mr", "D1mw"])? })
            };
            Ok(Count {
                instructions: each(&["Ir"])?,
                accesses: case.is_call().then(accesses).transpose()?,
                estimates: estimates(&text),
            })
        };
        cases.iter().enumerate().map(count).collect()
    }
}

/// Whether a dump names a function of the estimator.
fn estimates(dump: &str) -> bool {
    const OWN: [&str; 2] = ["fivebar::estimator::", "fivebar::simulation::following::"];
    dump.lines().filter(|line| line.starts_with("fn=")).any(|line| OWN.iter().any(|own| line.contains(own)))
}

/// Number of these events in a dump. Its line `events:` names the columns of its line `totals:`, which leaves out zeros at its end.
fn total(dump: &str, events: &[&str]) -> Result<f64> {
    let line = |key: &str| dump.lines().find_map(|line| line.strip_prefix(key)).with_context(|| format!("a dump without {key}"));
    let names: Vec<&str> = line("events: ")?.split_whitespace().collect();
    let counts: Vec<f64> = line("totals: ")?
        .split_whitespace()
        .map(|count| count.parse().with_context(|| format!("totals is {count}, not a number")))
        .collect::<Result<_>>()?;
    ensure!(counts.first().is_some_and(|count| *count > 0.0), "callgrind counted nothing in {REGION}");
    let count = |event: &&str| {
        let place = names.iter().position(|name| name == event).with_context(|| format!("a dump without {event}"))?;
        Ok(counts.get(place).copied().unwrap_or(0.0))
    };
    events.iter().map(count).sum()
}

#[cfg(test)]
mod tests {
    use super::total;

    #[test]
    fn events_are_found_by_their_names() {
        let dump = "# callgrind format\nevents: Ir Dr Dw I1mr D1mr D1mw\nfn=(1) measured\n1 5 2 1\ntotals: 100 30 20 5 4\n";
        assert_eq!(total(dump, &["Ir"]).unwrap(), 100.0);
        assert_eq!(total(dump, &["D1mr", "D1mw"]).unwrap(), 4.0);
        assert!(total(dump, &["DLmr"]).unwrap_err().to_string().contains("DLmr"));
        assert!(total(&dump.replace("100 30 20 5 4", "0"), &["Ir"]).is_err());
    }
}
