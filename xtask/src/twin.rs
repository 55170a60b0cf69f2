//! `cargo xtask twin`: packs the unit and calls `fivebar twin`, the live twin in real time.

use crate::package::{self, Scope};
use crate::venv::{self, Packages};
use crate::{paths, process, scenes};
use anyhow::Result;

/// Duration, scene and broker of a run of the twin.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Seconds of real time
    #[arg(long, default_value_t = 60.0)]
    seconds: f64,
    /// A file of scenes/, without `.json`: machine and motion
    #[arg(long, default_value = "pick_and_place")]
    scene: String,
    /// An MQTT broker instead of the included one
    #[arg(long, value_name = "HOST:PORT")]
    broker: Option<String>,
    /// Show the dashboard in a browser and keep running until Ctrl-C
    #[arg(long)]
    open: bool,
    /// Draw the dashboard of a run that learns instead, write docs/images/dashboard.svg (needs .ci/setup)
    #[arg(long, exclusive = true)]
    picture: bool,
}

/// Packs the unit and runs the pipeline; summary, pictures, page and record go to `target/twin/`.
pub(crate) fn twin(options: &Options) -> Result<()> {
    let Options { seconds, scene, broker, open, picture } = options;
    if *picture {
        return draw_dashboard();
    }
    // Checked first, so that a misspelt name does not cost a build.
    scenes::check(scene)?;
    let fmu = package::package(Scope::Here)?;
    process::become_program(
        venv::python(Packages::Usual)?
            .args(["-m", "fivebar", "twin", "--scene", scene])
            .arg("--fmu")
            .arg(fmu)
            .arg("--out")
            .arg(paths::in_root("target/twin"))
            .arg(format!("--seconds={seconds}"))
            .args(broker.as_ref().map(|broker| format!("--broker={broker}")))
            .args(open.then_some("--open")),
    )
}

/// Packs the unit, runs the twin for some 30 s and writes docs/images/dashboard.svg.
fn draw_dashboard() -> Result<()> {
    let fmu = package::package(Scope::Here)?;
    process::run(
        venv::python(Packages::Full)?
            .arg("xtask/python/dashboard_picture.py")
            .arg("--fmu")
            .arg(fmu)
            .arg("--folder")
            .arg(paths::in_root("target/twin-picture"))
            .arg("--out")
            .arg(paths::in_root("docs/images/dashboard.svg")),
    )
}
