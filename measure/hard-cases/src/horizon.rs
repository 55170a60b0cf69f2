//! The predictability horizon: divergence of two free falls that differ by 1e-12 rad/s at the start.

use std::f64::consts::FRAC_PI_2;
use std::io::Write;

use fivebar::observers;
use fivebar::simulation::bindings::default_parameters;
use fivebar::simulation::{Parameters, Simulation};

use crate::machine::{NO_LOAD, fall_90_120};
use crate::setting::Setting;

/// Difference of both proximal rates at the start, rad/s. (In a direct singularity a difference of the proximal angles would change the
/// other angles by its square root.)
const APART: f64 = 1e-12;
/// Fixed step, s. Both runs make the same steps, so only the dynamics separates them.
const STEP: f64 = 1e-5;
/// Steps between two rows.
const STRIDE: u64 = 200;
/// Length of the runs, s.
const DURATION: f64 = 9.0;

/// The pairs: name, scene.
fn pairs() -> [(&'static str, Parameters); 3] {
    let mut near = default_parameters();
    near.start.theta = [FRAC_PI_2 - 0.01, FRAC_PI_2 + 0.02];
    [("90/90 deg", default_parameters()), ("90/90 deg, 0.01 and 0.02 rad off", near), ("90/120 deg", fall_90_120())]
}

/// Largest difference of the link angles of two runs, rad, over time; a pair ends if a step fails.
pub fn write(to: impl Write) -> csv::Result<()> {
    let mut writer = csv::Writer::from_writer(to);
    writer.write_record(["pair", "time [s]", "difference [rad]"])?;
    for (name, parameters) in pairs() {
        for (time, difference) in part(parameters) {
            writer.write_record([name.to_owned(), format!("{time:.3}"), format!("{difference:e}")])?;
        }
    }
    writer.flush()?;
    Ok(())
}

fn part(mut parameters: Parameters) -> Vec<(f64, f64)> {
    Setting::Fixed(STEP).apply(&mut parameters);
    let start = |parameters: &Parameters| Simulation::new(parameters, &NO_LOAD).expect("the pairs are within reach");
    let mut one = start(&parameters);
    parameters.start.omega = [APART; 2];
    let mut other = start(&parameters);
    let mut rows = Vec::new();
    for i in 0..(DURATION / STEP).round() as u64 / STRIDE {
        let theta = [&one, &other].map(|run| observers::motion(run.model(), &run.state()).theta);
        let difference = (0..4).map(|k| (theta[0][k] - theta[1][k]).abs()).fold(0.0, f64::max);
        rows.push((i as f64 * STRIDE as f64 * STEP, difference));
        if [&mut one, &mut other].into_iter().any(|run| run.advance(&NO_LOAD, STEP, STRIDE).is_err()) {
            break;
        }
    }
    rows
}
