//! The private Python environment under `target/venv`, made from the pinned requirements.

use crate::{paths, process};
use anyhow::{Context, Result, bail};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Pinned requirements, the closure included.
const REQUIREMENTS: &str = "xtask/python/requirements.txt";

/// The name under which a Python 3 is on the path.
const PYTHON: &str = if cfg!(windows) { "python" } else { "python3" };

/// Python of the private environment, which is made or renewed first where the requirements ask for it.
pub(crate) fn python() -> Result<Command> {
    let folder = paths::venv();
    let python = folder.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    let requirements =
        fs::read_to_string(paths::in_root(REQUIREMENTS)).with_context(|| format!("{REQUIREMENTS} cannot be read"))?;
    // The stamp is a copy of the requirements, written last: a venv that was interrupted while it was made has none.
    let stamp = folder.join("requirements.stamp");
    if fs::read_to_string(&stamp).ok().as_deref() != Some(&requirements) {
        make(&folder, &python)?;
        fs::write(&stamp, &requirements).with_context(|| format!("{} cannot be written", paths::short(&stamp)))?;
    }
    let mut command = process::program(python);
    // Python's own settings of the caller must not reach into the private environment.
    command.env_remove("PYTHONPATH").env_remove("PYTHONHOME");
    Ok(command)
}

fn make(folder: &Path, python: &PathBuf) -> Result<()> {
    println!("installing the Python packages of {REQUIREMENTS} into {} (first run, or the file changed)", paths::short(folder));
    need_python()?;
    // --clear: packages that are no longer required go, and a broken venv is made anew.
    let made = process::output(process::program(PYTHON).args(["-m", "venv", "--clear"]).arg(folder));
    if made.is_err() {
        bail!(
            "`{PYTHON} -m venv` failed: Python's module venv (with ensurepip) is needed; \
             on Debian and Ubuntu `apt-get install python3-venv` brings it"
        );
    }
    process::run(
        process::program(python)
            .args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-input"])
            .arg("--requirement")
            .arg(paths::in_root(REQUIREMENTS)),
    )
    .context("the Python packages could not be installed")
}

/// The oldest Python for which the pinned packages exist is 3.11.
fn need_python() -> Result<()> {
    let found = process::program(PYTHON)
        .args(["-c", "import sys; sys.exit(sys.version_info < (3, 11))"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if !found {
        bail!("`{PYTHON}` with version 3.11 or newer is needed on the path");
    }
    Ok(())
}
