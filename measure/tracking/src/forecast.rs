//! Forecasts: coverage of the tip's bands, also after a push; scores compared with other methods; and accuracy of the probability of a
//! singularity.

use fivebar::effects::Inputs;
use fivebar::estimator::flow::unit_forces;
use fivebar::estimator::{Bands, Links, MEASURED, Measured};
use fivebar::simulation::{Following, Signal, Simulation};

use crate::compare::{Outside, Way, assembled, assembly};
use crate::learning;
use crate::machine::{COARSE, Encoder, FINE, Random, Scenario, motion, side, tip};
use crate::quality::{driven, fall, push, sines};
use crate::report::{Figure, Table, median};
use crate::scores::{ConstantVelocity, ELLIPSE, Scores, holds, in_hindsight, mean, scores};

/// Horizons, s.
const AHEAD: [f64; 3] = [0.1, 0.3, 0.5];
const H: f64 = 1e-3;
/// Members of the ensemble for comparison.
const MEMBERS: usize = 100;

/// Outcome of a forecast.
struct Outcome {
    inside: [bool; 3],
    /// Scores of the unit, with its covariance of the tip, and with its radius alone.
    scores: [[Scores; 2]; 3],
    /// Errors of the tip, m, with constant velocity and with a restart.
    others: [[[f64; 2]; 2]; 3],
    meets: bool,
    probability: f64,
    of_members: f64,
}

fn forecast(scenario: &Scenario, encoder: &Encoder, bands: Bands, random: &mut Random, members: usize) -> Option<Outcome> {
    let mut scenario = scenario.clone();
    scenario.model.estimator.forecast = bands;
    let (mut machine, mut twin) = (scenario.machine(), scenario.twin(encoder));
    let (mut straight, mut restart) =
        (ConstantVelocity::default(), Outside::new(Way::Restart, &scenario.model, &scenario.inputs(0.0)));
    let followed = random.between(0.3, 1.0);
    let steps = (followed / H) as u64;
    let inputs = |step: u64| scenario.inputs((step as f64 + 0.5) * H);
    // Resolution of the encoder at the end of a link.
    let noise = (scenario.model.geometry.links[0].length * encoder.quantum).powi(2) / 12.0;
    for step in 0..steps {
        let time = step as f64 * H;
        let (theta, _) = motion(&machine.state());
        let measured = Measured { theta: MEASURED.map(|link| encoder.read(theta[link], random)), time: [time; 2] };
        twin.correct(&measured, time);
        restart.correct(measured.theta, encoder, &inputs(step));
        restart.predict(&inputs(step));
        let [left, right] = measured.theta;
        if let Some(seen) = assembled(&scenario.model, &[left, right, 0.0, 0.0, 0.0, 0.0], assembly(&machine), &inputs(step)) {
            straight.receive(tip(&seen, &seen.state()), noise, H);
        }
        twin.advance_along(&Signal::held(inputs(step)), H, 1).ok()?;
        machine.advance(&inputs(step), H, 1).ok()?;
    }
    // Future inputs are known only if they are constant, as from here on.
    let held = inputs(steps);
    let probability = twin.singularity_probability(&held);
    let start = side(&motion(&machine.state()).0);
    let of_members = ensemble(&twin, &scenario, &held, members, random);
    let (mut inside, mut meets, mut next) = ([false; 3], false, 0);
    let (mut own, mut others) = ([[[0.0; 2]; 2]; 3], [[[0.0; 2]; 2]; 3]);
    for step in 1..=500 {
        twin.advance_along(&Signal::held(held), H, 1).ok()?;
        restart.predict(&held);
        machine.advance(&held, H, 1).ok()?;
        meets |= side(&motion(&machine.state()).0) * start < 0.0;
        if (f64::from(step) * H - AHEAD[next]).abs() < H / 2.0 {
            let ([x, y], [v, w]) = (tip(&machine, &machine.state()), tip(twin.simulation(), &twin.state_for(&held)));
            let (covariance, off) = (twin.tip_covariance(), [x - v, y - w]);
            inside[next] = holds(covariance, off);
            let round = twin.tip_radius().powi(2) / ELLIPSE;
            own[next] = [covariance, [round, 0.0, round]].map(|covariance| scores(covariance, off));
            // The last sample was taken one step before the forecast.
            others[next] = [straight.ahead(AHEAD[next] + H), restart.tip()].map(|[v, w]| [x - v, y - w]);
            next = (next + 1).min(2);
        }
    }
    Some(Outcome { inside, scores: own, others, meets, probability, of_members })
}

/// Fraction of random members of the estimate that meet a direct singularity within 0.5 s.
fn ensemble(twin: &Following, scenario: &Scenario, held: &Inputs, members: usize, random: &mut Random) -> f64 {
    if members == 0 {
        return 0.0;
    }
    let (linkage, estimate, belief) = (&twin.believed().linkage, twin.motion(), twin.estimator().belief());
    let frame = linkage.frame(&estimate.theta);
    let (units, root) =
        (unit_forces(linkage, &frame), root(&belief.bank.covariance().transpose().fixed_view::<6, 6>(0, 0).into_owned().into()));
    let start = side(&estimate.theta.into());
    let met = (0..members).filter(|_| {
        let white: [f64; 6] = std::array::from_fn(|_| random.normal());
        let error: [f64; 6] = std::array::from_fn(|i| (0..=i).map(|k| root[i][k] * white[k]).sum());
        let [a, b, c, d, x, y] = error;
        let Some((moved, _)) = linkage.closed(frame.displaced(&estimate, [a, b, c, d])) else { return false };
        let force: Links = belief.force + units.column(0) * x + units.column(1) * y;
        let inputs = Inputs {
            tau: [held.tau[0] + force[0], held.tau[1] + force[1]],
            tip_force: [held.tip_force[0] + force[2], held.tip_force[1] + force[3]],
            ..*held
        };
        let (theta, omega) = (moved.theta.into(), moved.omega.into());
        let Ok(mut run) = Simulation::at(&scenario.model, &inputs, theta, omega) else { return true };
        (0..100).any(|_| run.advance(&inputs, 5e-3, 1).is_err() || side(&motion(&run.state()).0) * start < 0.0)
    });
    met.count() as f64 / members as f64
}

/// Forecasts of 0.3 s, every 50 ms during the second after a push: whether the tip is within its radius; and the ratio of the radius 20 ms
/// after the push to the radius just before it.
fn after_push(scenario: &Scenario, encoder: &Encoder, random: &mut Random) -> Option<(Vec<bool>, f64)> {
    let (mut machine, mut twin) = (scenario.machine(), scenario.twin(encoder));
    let pushed = (scenario.plan.from / H).round() as u64;
    let (mut inside, mut radii) = (Vec::new(), [0.0; 2]);
    for step in 0..pushed + 1000 {
        let time = step as f64 * H;
        let (theta, _) = motion(&machine.state());
        twin.correct(&Measured { theta: MEASURED.map(|link| encoder.read(theta[link], random)), time: [time; 2] }, time);
        let ahead = || learning::forecast(&twin, &machine, scenario, step);
        if step >= pushed && (step - pushed).is_multiple_of(50) {
            inside.push(ahead().is_some_and(|[error, radius]| error <= radius));
        }
        for (radius, at) in radii.iter_mut().zip([pushed - 1, pushed + 20]) {
            if step == at {
                *radius = ahead()?[1];
            }
        }
        twin.advance_along(&Signal::held(scenario.inputs(time + H / 2.0)), H, 1).ok()?;
        machine.advance(&scenario.acting(time + H / 2.0), H, 1).ok()?;
    }
    Some((inside, radii[1] / radii[0]))
}

/// Coverage, scores, and forecasts after pushes.
pub fn table(runs: u64, first: u64) -> Table {
    let mut table =
        Table::new("Forecasts by sigma points: part within the 95 % ellipse, and Brier score of a direct singularity within 0.5 s");
    type Scene = fn(&mut Random) -> Scenario;
    // Scores of machines under servos are shown but not judged: a width in hindsight knows that nothing acts.
    let scenes: [(&str, Scene, bool); 4] = [
        ("free fall", |random| fall(random, false), true),
        ("fall, masses 5 % off", |random| fall(random, true), true),
        ("driven, masses 5 % off", driven, true),
        ("sines, masses 5 % off", |random| sines(random, 2.0), false),
    ];
    for (name, scene, moves) in scenes {
        for encoder in [COARSE, FINE] {
            for bands in [Bands::SigmaPoints, Bands::Linear] {
                let by_points = bands == Bands::SigmaPoints;
                let outcomes: Vec<Outcome> = (0..runs)
                    .filter_map(|seed| {
                        let mut random = Random::new(first + 7_600_000 + seed);
                        let scenario = scene(&mut random);
                        forecast(&scenario, &encoder, bands, &mut random, if by_points { MEMBERS } else { 0 })
                    })
                    .collect();
                let count = outcomes.len() as f64;
                for (i, ahead) in AHEAD.into_iter().enumerate() {
                    let covered = 100.0 * outcomes.iter().filter(|outcome| outcome.inside[i]).count() as f64 / count;
                    let label = format!("{name}, {}: within {ahead} s, %", encoder.name);
                    table.push(match by_points {
                        true => Figure::between(label, covered, [90.0, 100.0], format!("of {count}")),
                        false => Figure::untargeted(format!("{label}, linear"), covered, String::new()),
                    });
                    if by_points {
                        let own = [0, 1].map(|by| mean(outcomes.iter().map(|outcome| outcome.scores[i][by])));
                        let others = [0, 1]
                            .map(|way| in_hindsight(&outcomes.iter().map(|outcome| outcome.others[i][way]).collect::<Vec<_>>()));
                        for (k, (score, unit)) in [("logarithmic score", 1.0), ("CRPS, mm", 1e3)].into_iter().enumerate() {
                            let [[own, round], [straight, restart]] = [own, others].map(|pair| pair.map(|of| unit * of[k]));
                            let label = format!("{name}, {}: {score}, {ahead} s", encoder.name);
                            let note = format!("by its radius {round:.3}; constant velocity {straight:.3}, restart {restart:.3}");
                            table.push(match moves {
                                true => Figure::at_most(label, own, straight.min(restart), note),
                                false => Figure::untargeted(label, own, note),
                            });
                        }
                    }
                }
                if by_points {
                    let brier = |of: &dyn Fn(&Outcome) -> f64| {
                        outcomes.iter().map(|outcome| (of(outcome) - f64::from(u8::from(outcome.meets))).powi(2)).sum::<f64>()
                            / count
                    };
                    let (own, members) = (brier(&|o| o.probability), brier(&|o| o.of_members));
                    let label = format!("{name}, {}: Brier score", encoder.name);
                    table.push(Figure::at_most(label, own, members + 0.01, format!("100 members: {members:.4}")));
                }
            }
        }
    }
    let pushes: [(&str, Scene); 2] =
        [("a push of 0.5 N on sines", push), ("a push of 0.5 N in a fall, learned", |random| learning::pushed(random, true))];
    for (name, scene) in pushes {
        for encoder in [COARSE, FINE] {
            let outcomes: Vec<_> = (0..runs)
                .filter_map(|seed| {
                    let mut random = Random::new(first + 7_650_000 + seed);
                    let scenario = scene(&mut random);
                    after_push(&scenario, &encoder, &mut random)
                })
                .collect();
            let all = || outcomes.iter().flat_map(|(inside, _)| inside);
            let covered = 100.0 * all().filter(|inside| **inside).count() as f64 / all().count() as f64;
            let label = |what: &str| format!("{name}, {}: {what}", encoder.name);
            let note = format!("of {} runs", outcomes.len());
            table.push(Figure::between(label("within 0.3 s in the second after it, %"), covered, [80.0, 100.0], note));
            let wider = median(outcomes.iter().map(|(_, wider)| *wider));
            table.push(Figure::at_least(label("radius 20 ms after it over that before"), wider, 1.0, "median".into()));
        }
    }
    table
}

/// The lower triangular root of a covariance (Cholesky); columns without variance are 0.
pub(crate) fn root(covariance: &[[f64; 6]; 6]) -> [[f64; 6]; 6] {
    let mut root = [[0.0; 6]; 6];
    for i in 0..6 {
        for k in 0..=i {
            let rest: f64 = covariance[i][k] - (0..k).map(|j| root[i][j] * root[k][j]).sum::<f64>();
            root[i][k] = if i == k {
                rest.max(0.0).sqrt()
            } else if root[k][k] > 0.0 {
                rest / root[k][k]
            } else {
                0.0
            };
        }
    }
    root
}
