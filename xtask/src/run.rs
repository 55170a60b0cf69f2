//! `cargo xtask run`: packs the unit and calls `fivebar run`.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process, scenes};
use anyhow::Result;

/// Packs the unit and runs a scene by its own method, or another one; CSV, pictures and the page go to `target/run/NAME/` or
/// `target/run/NAME-METHOD/`.
pub(crate) fn run(scene: &str, method: Option<&str>) -> Result<()> {
    // Checked first, so that a misspelt name does not cost a build.
    scenes::check(scene)?;
    let fmu = package::package(Scope::Here)?;
    process::run(
        venv::python(Packages::Usual)?
            .args(["-m", "fivebar", "run", scene])
            .arg("--fmu")
            .arg(fmu)
            .arg("--out")
            .arg(paths::in_root("target/run").join(method.map_or(scene.to_owned(), |method| format!("{scene}-{method}"))))
            .args(method.map(|method| format!("--method={method}"))),
    )
}
