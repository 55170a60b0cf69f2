//! Whether a packed unit accepts its own start: it is asked, through FMPy, for only the library knows.

use crate::process;
use crate::venv::{self, Packages};
use anyhow::{Result, ensure};
use std::path::Path;

/// Fails with the unit's own sentence, if it refuses.
pub(super) fn check(fmu: &Path) -> Result<()> {
    let sentence = process::output(venv::python(Packages::Usual)?.arg("xtask/python/start.py").arg(fmu))?;
    ensure!(sentence.is_empty(), "the start is refused: {}", sentence.trim_end());
    Ok(())
}
