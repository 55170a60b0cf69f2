//! Forecasts: how often the tip is within its bands, and how good the probability of a singularity is.

use fivebar::effects::Inputs;
use fivebar::estimator::flow::unit_forces;
use fivebar::estimator::{Bands, Links, MEASURED, Measured};
use fivebar::simulation::{Following, Signal, Simulation};

use crate::machine::{COARSE, Encoder, FINE, Random, Scenario, motion, side, tip};
use crate::quality::{driven, fall};
use crate::report::{Figure, Table};

/// When bands are looked at, s ahead.
const AHEAD: [f64; 3] = [0.1, 0.3, 0.5];
/// χ² of two degrees of freedom at 95 %.
const ELLIPSE: f64 = 5.991;
const H: f64 = 1e-3;
/// Members of the ensemble that is compared with.
const MEMBERS: usize = 100;

/// Outcome of a forecast.
struct Outcome {
    inside: [bool; 3],
    meets: bool,
    probability: f64,
    of_members: f64,
}

fn forecast(scenario: &Scenario, encoder: &Encoder, bands: Bands, random: &mut Random, members: usize) -> Option<Outcome> {
    let mut scenario = scenario.clone();
    scenario.model.estimator.forecast = bands;
    let (mut machine, mut twin) = (scenario.machine(), scenario.twin(encoder));
    let followed = random.between(0.3, 1.0);
    let steps = (followed / H) as u64;
    let inputs = |step: u64| scenario.inputs((step as f64 + 0.5) * H);
    for step in 0..steps {
        let time = step as f64 * H;
        let (theta, _) = motion(&machine.state());
        let measured = Measured { theta: MEASURED.map(|link| encoder.read(theta[link], random)), time: [time; 2] };
        twin.correct(&measured, time);
        twin.advance_along(&Signal::held(inputs(step)), H, 1).ok()?;
        machine.advance(&inputs(step), H, 1).ok()?;
    }
    // The inputs ahead are known only where they are held, as from here on.
    let held = inputs(steps);
    let probability = twin.singularity_probability(&twin.state_for(&held).inputs);
    let start = side(&motion(&machine.state()).0);
    let of_members = ensemble(&twin, &scenario, &held, members, random);
    let (mut inside, mut meets, mut next) = ([false; 3], false, 0);
    for step in 1..=500 {
        twin.advance_along(&Signal::held(held), H, 1).ok()?;
        machine.advance(&held, H, 1).ok()?;
        meets |= side(&motion(&machine.state()).0) * start < 0.0;
        if (f64::from(step) * H - AHEAD[next]).abs() < H / 2.0 {
            let ([x, y], [v, w]) = (tip(&machine, &machine.state()), tip(twin.simulation(), &twin.state_for(&held)));
            let ([xx, xy, yy], [dx, dy]) = (twin.tip_covariance(), [x - v, y - w]);
            let squared = (dx * dx * yy - 2.0 * dx * dy * xy + dy * dy * xx) / (xx * yy - xy * xy);
            inside[next] = squared <= ELLIPSE;
            next = (next + 1).min(2);
        }
    }
    Some(Outcome { inside, meets, probability, of_members })
}

/// Part of random members of the estimate that meet a direct singularity within 0.5 s.
fn ensemble(twin: &Following, scenario: &Scenario, held: &Inputs, members: usize, random: &mut Random) -> f64 {
    if members == 0 {
        return 0.0;
    }
    let (linkage, estimate, belief) = (&twin.constants().linkage, twin.motion(), twin.estimator().belief());
    let frame = linkage.frame(&estimate.theta);
    let (units, root) = (unit_forces(linkage, &frame), root(&belief.bank.covariance().transpose().into()));
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

/// Coverage and Brier scores.
pub fn table(runs: u64, first: u64) -> Table {
    let mut table =
        Table::new("Forecasts by sigma points: part within the 95 % ellipse, and Brier score of a direct singularity within 0.5 s");
    type Scene = fn(&mut Random) -> Scenario;
    let scenes: [(&str, Scene); 3] = [
        ("free fall", |random| fall(random, false)),
        ("fall, masses 5 % off", |random| fall(random, true)),
        ("driven, masses 5 % off", driven),
    ];
    for (name, scene) in scenes {
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
                        false => Figure::told(format!("{label}, linear"), covered, String::new()),
                    });
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
