//! Starts in the right and in the wrong assembly: how soon the doubt ends, and how often it is wrong.

use fivebar::estimator::Status;
use fivebar::mechanism::Assembly;

use crate::faults::{SILENT, haptic, is_wrong_in_silence, stiff, swing};
use crate::geometry::{Scene, as_built};
use crate::machine::{COARSE, Encoder, FINE, Instant, MEDIUM, Random, Scenario, follow};
use crate::quality::{driven, fall, friction, pick, push, sines};
use crate::report::{Figure, Table, quantile};
use crate::scores::half_width;

/// Longest judged part of a run, s.
const LONGEST: f64 = 2.0;
/// Time outside its band without doubt, s, after which a right start counts as abandoned.
const ASTRAY: f64 = 0.02;

/// Outcome of a run.
#[derive(Default)]
struct Outcome {
    /// Whether the tip was off while status and bands gave no warning.
    silent: bool,
    /// Whether the tip was off and outside its 95 % ellipse while only one assembly was followed.
    astray: bool,
    /// Whether the tip is off at the end.
    lost: bool,
    /// Time at which the doubt ended, s.
    doubted: f64,
}

/// A run of a machine that starts in an assembly, with a twin that starts in the right or the wrong one.
fn run(scenario: &Scenario, (encoder, h): (&Encoder, f64), (own, wrong): (Assembly, bool), random: &mut Random) -> Outcome {
    let other = if own == Assembly::Plus { Assembly::Minus } else { Assembly::Plus };
    let mut believed = scenario.clone();
    believed.truth.start.assembly = own;
    believed.model.start.assembly = if wrong { other } else { own };
    believed.duration = believed.duration.min(LONGEST);
    let (mut outcome, mut silent, mut astray) = (Outcome::default(), 0.0, 0.0);
    let done = follow(&believed, encoder, h, random, |&Instant { time, twin, tip_error, .. }| {
        silent = if is_wrong_in_silence(twin, time, tip_error) { silent + h } else { 0.0 };
        outcome.silent |= silent >= SILENT.2;
        let undoubted = twin.status() != Status::TwoBranches;
        if !undoubted {
            outcome.doubted = time;
        }
        let is_beyond = tip_error > SILENT.0.max(half_width(twin.tip_covariance()));
        astray = if undoubted && is_beyond { astray + h } else { 0.0 };
        outcome.astray |= astray > ASTRAY;
        outcome.lost = tip_error > SILENT.0;
    });
    outcome.lost |= done.is_err();
    outcome
}

/// Right and wrong starts in both assemblies, scene by scene.
pub fn table(runs: u64, first: u64) -> Table {
    let rows: [(&str, Scene, Encoder, f64, &[Assembly]); 17] = [
        ("pick", pick, FINE, 1e-3, &BOTH),
        ("pick", pick, COARSE, 5e-3, &BOTH),
        ("sines", |random| sines(random, LONGEST), FINE, 1e-3, &BOTH),
        ("sines", |random| sines(random, LONGEST), COARSE, 1e-3, &BOTH),
        ("friction", friction, FINE, 1e-3, &BOTH),
        ("push", push, FINE, 1e-3, &BOTH),
        ("fall", |random| fall(random, true), FINE, 1e-3, &BOTH),
        ("driven", driven, FINE, 1e-3, &BOTH),
        ("swing", swing, FINE, 1e-3, &BOTH),
        ("swing", swing, COARSE, 1e-3, &BOTH),
        ("stiff swing", stiff, FINE, 1e-3, &BOTH),
        ("stiff swing", stiff, MEDIUM, 1e-3, &BOTH),
        // In the other assembly its machine would start behind the wall.
        ("haptic", haptic, FINE, 1e-3, &[Assembly::Plus]),
        ("pick, as built", |random| as_built(pick, random), FINE, 1e-3, &BOTH),
        ("sines, as built", |random| as_built(|random| sines(random, LONGEST), random), FINE, 1e-3, &BOTH),
        ("fall, as built", |random| as_built(|random| fall(random, true), random), FINE, 1e-3, &BOTH),
        ("swing, as built", |random| as_built(swing, random), FINE, 1e-3, &BOTH),
    ];
    const BOTH: [Assembly; 2] = [Assembly::Plus, Assembly::Minus];
    let mut table = Table::new("Starts in the right assembly and in the wrong one, runs");
    for (name, scene, encoder, h, assemblies) in rows {
        for (own, wrong) in assemblies.iter().flat_map(|own| [(*own, false), (*own, true)]) {
            let outcomes: Vec<Outcome> = (0..runs)
                .map(|seed| {
                    let mut random = Random::new(first + 7_920_000 + seed);
                    let scenario = scene(&mut random);
                    run(&scenario, (&encoder, h), (own, wrong), &mut random)
                })
                .collect();
            let count = |of: &dyn Fn(&Outcome) -> bool| outcomes.iter().filter(|outcome| of(outcome)).count();
            let doubted = |part: f64| 1e3 * quantile(outcomes.iter().map(|outcome| outcome.doubted), part);
            let remark = format!(
                "of {runs}; silent {}, lost at the end {}, doubted for {:.0} ms (median), {:.0} (90 %), {:.0} (longest)",
                count(&|o| o.silent),
                count(&|o| o.lost),
                doubted(0.5),
                doubted(0.9),
                doubted(1.0)
            );
            let label = format!("{name}, {}, {} ms, {own:?}, {}", encoder.name, 1e3 * h, if wrong { "wrong" } else { "right" });
            table.push(if wrong {
                Figure::at_most(format!("{label}: wrong in silence"), count(&|o| o.silent) as f64, (runs / 200) as f64, remark)
            } else {
                Figure::at_most(format!("{label}: taken away"), count(&|o| o.astray) as f64, 0.0, remark)
            });
        }
    }
    table
}
