//! Item 10 of the battery: following machines through singularities with encoders of 16 bits. The twin starts at the machine's posture.

use std::f64::consts::TAU;
use std::time::Instant;

use fivebar::estimator::{MEASURED, Measured};
use fivebar::mechanism::{Assembly, Start};
use fivebar::observers::{self, SingularityKind};
use fivebar::simulation::{Following, Signal};
use rayon::prelude::*;

use super::{CONSTRAINTS, Extent, postures, vertices};
use crate::machine::{NO_LOAD, fall_90_120, relative_size};
use crate::report::{Row, Verdict};
use crate::setting::Setting;
use crate::trial::Trial;

/// Sampling interval, s.
const SAMPLE: f64 = 1e-3;
/// Resolution of the encoders, rad.
const QUANTUM: f64 = TAU / 65536.0;
/// Error of the tip at the end, m, above which it counts as lost.
const LOST: f64 = 0.01;
/// Methods of the twin; the last two are for comparison.
const SETTINGS: [Setting; 6] =
    [Setting::Default, Setting::EXPLICIT, Setting::AUTOMATIC, Setting::CONSERVING, Setting::Printed(1e-3), Setting::Rk4(1e-3)];
const JUDGED: usize = 4;

/// Machines of a kind.
struct Machines {
    case: &'static str,
    /// Whether no machine may be lost. After a vertex encoders do not show the branch for a while.
    kept: bool,
    trials: Vec<Trial>,
}

fn machines(extent: Extent) -> Vec<Machines> {
    let duration = extent.pick(5.0, 0.5);
    let mut direct = postures::direct(duration);
    // Without folded starts: if elbows coincide, the motor angles do not determine the distal links.
    direct.retain(|trial| trial.label.contains("stretched"));
    direct.push(Trial::free("fall from 90/120 deg", fall_90_120(), duration));
    let mut coaxial = postures::coaxial(duration);
    coaxial.retain(|trial| trial.label.starts_with("rhombus"));
    vec![
        Machines { case: "followed: direct singularities", kept: true, trials: direct },
        Machines { case: "followed: inverse singularities", kept: true, trials: postures::inverse(duration) },
        Machines { case: "followed: coaxial motors", kept: true, trials: coaxial },
        Machines { case: "followed: vertices", kept: false, trials: vertices::crossings(extent).trials },
    ]
}

/// Every kind with every setting, for cases with `only` in their names; passes each row to `done`.
pub fn followed(extent: Extent, only: &str, mut done: impl FnMut(Row)) {
    for Machines { case, kept, trials } in machines(extent).iter().filter(|machines| machines.case.contains(only)) {
        for (i, setting) in SETTINGS.into_iter().enumerate() {
            done(measure(case, trials, *kept, setting, i < JUDGED));
        }
    }
}

/// Number of these rows.
pub fn followed_count(only: &str) -> usize {
    SETTINGS.len() * machines(Extent::Quick).iter().filter(|machines| machines.case.contains(only)).count()
}

fn measure(case: &'static str, trials: &[Trial], kept: bool, setting: Setting, judged: bool) -> Row {
    let begin = Instant::now();
    let [position, velocity] = CONSTRAINTS;
    let mut row = Row {
        item: 10,
        case,
        method: setting.method(),
        setting: setting.label(),
        runs: trials.len(),
        criterion: format!(
            "complete, every number finite, Phi <= {position:e} m, Phidot <= {velocity:e} m/s (outputs in a vertex aside){}",
            if kept { format!(", none ends more than {LOST} m off") } else { String::new() }
        ),
        ..Row::default()
    };
    let outcomes: Vec<Result<Followed, String>> = trials.par_iter().map(|trial| follow(trial, setting)).collect();
    let mut astray = 0;
    for (trial, outcome) in trials.iter().zip(outcomes) {
        let objection = match outcome {
            Ok(followed) => {
                row.position = row.position.max(followed.position);
                row.velocity = row.velocity.max(followed.velocity);
                astray += usize::from(followed.tip > LOST);
                (followed.position > position || followed.velocity > velocity)
                    .then(|| format!("Phi {:.1e}, Phidot {:.1e}", followed.position, followed.velocity))
            }
            Err(what) => {
                row.ended_early += 1;
                Some(what)
            }
        };
        if let Some(objection) = objection {
            row.failures += 1;
            row.objections.push(format!("{}: {objection}", trial.label));
        }
    }
    if kept && astray > 0 {
        row.failures += astray;
        row.objections.push(format!("{astray} end more than {LOST} m off"));
    }
    row.statuses = format!("{astray} more than {LOST} m off");
    row.verdict = match (judged, row.failures == 0) {
        (true, true) => Verdict::Pass,
        (true, false) => Verdict::Fail,
        (false, _) => Verdict::ForComparison,
    };
    row.seconds = begin.elapsed().as_secs_f64();
    row
}

/// Result for a followed machine: largest violations, scaled to the paper's machine, and error of the tip at the end, m.
struct Followed {
    position: f64,
    velocity: f64,
    tip: f64,
}

/// Simulates the machine by the explicit method and follows it by the setting.
fn follow(trial: &Trial, setting: Setting) -> Result<Followed, String> {
    let mut machine = trial.start(Setting::EXPLICIT).map_err(|refusal| refusal.to_string())?;
    let mut parameters = trial.parameters.clone();
    setting.apply(&mut parameters);
    let start = observers::motion(machine.model(), &machine.state());
    let assembly = if (start.theta[2] - start.theta[1]).sin() >= 0.0 { Assembly::Plus } else { Assembly::Minus };
    let motors = |of: [f64; 4]| MEASURED.map(|link| of[link]);
    parameters.start = Start { theta: motors(start.theta), omega: motors(start.omega), assembly };
    parameters.estimator.enabled = true;
    parameters.estimator.quantum = [QUANTUM; 2];
    parameters.estimator.take_geometry_as_exact();
    let mut twin = Following::new(&parameters, &NO_LOAD).map_err(|refusal| format!("refused, {refusal}"))?;
    let size = relative_size(&parameters.geometry);
    let steps = (SAMPLE / parameters.settings.step_size).round().max(1.0);
    let mut followed = Followed { position: 0.0, velocity: 0.0, tip: f64::INFINITY };
    for sample in 0..(trial.duration() / SAMPLE).round() as u64 {
        let time = sample as f64 * SAMPLE;
        let measured = machine.state().angles();
        let theta = MEASURED.map(|link| (measured[link] / QUANTUM).round() * QUANTUM);
        twin.correct(&Measured { theta, time: [time; 2] }, time);
        twin.advance_along(&Signal::held(NO_LOAD), SAMPLE / steps, steps as u64).map_err(|failure| failure.to_string())?;
        machine.advance(&NO_LOAD, SAMPLE, 1).map_err(|failure| format!("the machine, {failure}"))?;
        let (model, state) = (twin.simulation().model(), twin.simulation().state());
        let numbers = [twin.sigmas().concat(), twin.tip_covariance().to_vec(), vec![twin.estimator().nis()]].concat();
        let motion = state.core.q.iter().chain(&state.core.v).chain(&state.core.a).chain(&state.core.lambda);
        if !numbers.iter().chain(motion).all(|x| x.is_finite()) {
            return Err(format!("not finite at {time} s"));
        }
        let norms = observers::constraint_norms(model, &state);
        if observers::singularity(model, &state).kind != SingularityKind::Constraint {
            followed.position = followed.position.max(norms.position / size);
            followed.velocity = followed.velocity.max(norms.velocity / size);
        }
        let ([x, y], [v, w]): ([f64; 2], [f64; 2]) =
            (observers::motion(machine.model(), &machine.state()).tip.into(), observers::motion(model, &state).tip.into());
        followed.tip = (x - v).hypot(y - w);
    }
    Ok(followed)
}
