//! Other filters on the same machines: open loop, a restart from every sample, and extended and unscented Kalman filters in the motor
//! angles, as users build them around a unit.

use std::path::Path;

use fivebar::effects::Inputs;
use fivebar::estimator::{MEASURED, wrapped};
use fivebar::mechanism::{Assembly, Start};
use fivebar::simulation::{Parameters, Simulation};

use crate::forecast::root;
use crate::machine::{COARSE, Encoder, FINE, Random, Scenario, follow, motion, side, tip};
use crate::quality::{SETTLED, fall, pick, push, sines};
use crate::report::{Figure, Table, median};

const H: f64 = 1e-3;
/// Angles and rates of the motors, unknown motor torques.
type Error = [f64; 6];
type Matrix = [Error; 6];
/// White acceleration of motors, rad²/s³, and random walk of the unknown torques, N²m²/s: the pair with the fewest lost scenes.
const NOISE: [f64; 2] = [0.1, 1e-4];
/// Initial standard deviations: angles, rad, rates, rad/s, torques, N·m.
const START: [f64; 3] = [0.02, 0.2, 0.02];

/// A filter around the unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// No correction.
    OpenLoop,
    /// Restart with angles and rates of the motors from differences of samples.
    Restart,
    /// Extended Kalman filter with Jacobians by finite differences.
    Extended,
    /// Unscented Kalman filter with thirteen sigma points.
    Unscented,
}

/// A twin corrected by an external filter.
pub(crate) struct Outside<'a> {
    way: Way,
    model: &'a Parameters,
    run: Simulation,
    mean: Error,
    covariance: Matrix,
    before: Option<[f64; 2]>,
}

pub(crate) fn assembled(model: &Parameters, x: &Error, assembly: Assembly, inputs: &Inputs) -> Option<Simulation> {
    let start = Start { theta: [x[0], x[1]], omega: [x[2], x[3]], assembly };
    Simulation::new(&Parameters { start, ..model.clone() }, inputs).ok()
}

fn with_torques(inputs: &Inputs, x: &Error) -> Inputs {
    Inputs { tau: [inputs.tau[0] + x[4], inputs.tau[1] + x[5]], ..*inputs }
}

fn motors(run: &Simulation) -> [f64; 4] {
    let (theta, omega) = motion(&run.state());
    [theta[0], theta[3], omega[0], omega[3]]
}

pub(crate) fn assembly(run: &Simulation) -> Assembly {
    if side(&motion(&run.state()).0) > 0.0 { Assembly::Plus } else { Assembly::Minus }
}

impl<'a> Outside<'a> {
    pub(crate) fn new(way: Way, model: &'a Parameters, inputs: &Inputs) -> Self {
        let run = Simulation::new(model, inputs).unwrap_or_else(|error| panic!("the twin: {error}"));
        let m = motors(&run);
        let mut covariance = [[0.0; 6]; 6];
        for (i, row) in covariance.iter_mut().enumerate() {
            row[i] = START[i / 2] * START[i / 2];
        }
        Self { way, model, run, mean: [m[0], m[1], m[2], m[3], 0.0, 0.0], covariance, before: None }
    }

    /// The tip, m.
    pub(crate) fn tip(&self) -> [f64; 2] {
        tip(&self.run, &self.run.state())
    }

    /// Restarts from the mean, if it can be assembled.
    fn restart(&mut self, inputs: &Inputs) {
        if let Some(run) = assembled(self.model, &self.mean, assembly(&self.run), &with_torques(inputs, &self.mean)) {
            self.run = run;
        }
    }

    pub(crate) fn correct(&mut self, sample: [f64; 2], encoder: &Encoder, inputs: &Inputs) {
        match self.way {
            Way::OpenLoop => {}
            Way::Restart => {
                if let Some(before) = self.before.replace(sample) {
                    let rate = [0, 1].map(|i| wrapped(sample[i] - before[i]) / H);
                    self.mean = [sample[0], sample[1], rate[0], rate[1], 0.0, 0.0];
                    self.restart(inputs);
                }
            }
            Way::Extended | Way::Unscented => {
                let noise = encoder.sigma * encoder.sigma + encoder.quantum * encoder.quantum / 12.0;
                for i in 0..2 {
                    let variance = self.covariance[i][i] + noise;
                    let column: Error = std::array::from_fn(|k| self.covariance[k][i]);
                    let residual = wrapped(sample[i] - self.mean[i]);
                    for k in 0..6 {
                        self.mean[k] += column[k] * residual / variance;
                        for j in 0..6 {
                            self.covariance[k][j] -= column[k] * column[j] / variance;
                        }
                    }
                }
                self.restart(inputs);
            }
        }
    }

    /// A mean, one step later.
    fn moved(&self, x: &Error, inputs: &Inputs) -> Option<Error> {
        let held = with_torques(inputs, x);
        let mut run = assembled(self.model, x, assembly(&self.run), &held)?;
        run.advance(&held, H, 1).ok()?;
        let m = motors(&run);
        Some([m[0], m[1], m[2], m[3], x[4], x[5]])
    }

    pub(crate) fn predict(&mut self, inputs: &Inputs) {
        let filters = matches!(self.way, Way::Extended | Way::Unscented);
        if filters {
            self.predict_covariance(inputs);
        }
        let held = with_torques(inputs, &self.mean);
        if self.run.advance(&held, H, 1).is_ok() && filters {
            let m = motors(&self.run);
            self.mean[..4].copy_from_slice(&m);
        }
    }

    fn predict_covariance(&mut self, inputs: &Inputs) {
        let Some(centre) = self.moved(&self.mean, inputs) else { return };
        let off =
            |x: &Error| -> Error { std::array::from_fn(|i| if i < 2 { wrapped(x[i] - centre[i]) } else { x[i] - centre[i] }) };
        let mut next = [[0.0; 6]; 6];
        if self.way == Way::Extended {
            let mut f = [[0.0; 6]; 6];
            for k in 0..6 {
                let step = 1e-5;
                let mut x = self.mean;
                x[k] += step;
                let column = self.moved(&x, inputs).map_or([0.0; 6], |x| off(&x));
                for i in 0..6 {
                    f[i][k] = column[i] / step;
                }
            }
            for i in 0..6 {
                for j in 0..6 {
                    next[i][j] = (0..6)
                        .flat_map(|a| (0..6).map(move |b| (a, b)))
                        .map(|(a, b)| f[i][a] * self.covariance[a][b] * f[j][b])
                        .sum();
                }
            }
        } else {
            let root = root(&self.covariance);
            for k in 0..12 {
                let sign = if k < 6 { 6f64.sqrt() } else { -(6f64.sqrt()) };
                let x: Error = std::array::from_fn(|i| self.mean[i] + sign * root[i][k % 6]);
                let point = self.moved(&x, inputs).map_or([0.0; 6], |x| off(&x));
                for i in 0..6 {
                    for j in 0..6 {
                        next[i][j] += point[i] * point[j] / 12.0;
                    }
                }
            }
        }
        for i in 0..2 {
            next[2 + i][2 + i] += NOISE[0] * H;
            next[4 + i][4 + i] += NOISE[1] * H;
        }
        // Near a direct singularity values may diverge.
        if next.iter().flatten().all(|x| x.is_finite() && x.abs() < 1e6) {
            self.covariance = next;
        }
    }
}

/// Run of a filter: the tip's error after each sample, m.
struct Followed(Vec<f64>);

impl Followed {
    /// Root mean square, m, without the beginning.
    fn rms(&self) -> f64 {
        let settled = &self.0[(SETTLED / H).round() as usize..];
        (settled.iter().map(|error| error * error).sum::<f64>() / settled.len() as f64).sqrt()
    }

    /// Whether the final error exceeds 10 mm.
    fn is_lost(&self) -> bool {
        self.0.last().is_none_or(|last| last.is_nan() || *last >= 0.01)
    }
}

fn from_outside(scenario: &Scenario, way: Way, encoder: &Encoder, random: &mut Random) -> Followed {
    let mut machine = scenario.machine();
    let mut twin = Outside::new(way, &scenario.model, &scenario.inputs(0.0));
    let mut errors = Vec::new();
    for step in 0..(scenario.duration / H).round() as u64 {
        let time = step as f64 * H;
        let truth = machine.state();
        let (theta, _) = motion(&truth);
        let inputs = scenario.inputs(time + H / 2.0);
        twin.correct(MEASURED.map(|link| encoder.read(theta[link], random)), encoder, &inputs);
        let ([x, y], [v, w]) = (tip(&machine, &truth), twin.tip());
        errors.push((x - v).hypot(y - w));
        twin.predict(&inputs);
        if machine.advance(&scenario.acting(time + H / 2.0), H, 1).is_err() {
            break;
        }
    }
    Followed(errors)
}

fn by_the_unit(scenario: &Scenario, encoder: &Encoder, random: &mut Random) -> Followed {
    let mut errors = Vec::new();
    match follow(scenario, encoder, H, random, |at| errors.push(at.tip_error)) {
        Ok(()) => Followed(errors),
        Err(failure) => panic!("the unit: {failure}"),
    }
}

type Scene = fn(&mut Random) -> Scenario;

/// Compared scenes.
const SCENES: [(&str, Scene); 4] = [
    ("pick, 20 g unknown", pick),
    ("fall, masses 5 % off", |random| fall(random, true)),
    ("sines, masses 5 % off", |random| sines(random, 2.0)),
    ("push of 0.5 N", push),
];

/// External filters, with their names in tables.
const WAYS: [(&str, Way); 4] =
    [("open loop", Way::OpenLoop), ("start anew", Way::Restart), ("EKF, motors", Way::Extended), ("UKF, motors", Way::Unscented)];

/// Compared scenes, encoders and seeds, each with its scenario and the continued random numbers.
fn runs(seeds: u64, first: u64) -> impl Iterator<Item = (&'static str, Encoder, u64, Scenario, Random)> {
    SCENES.into_iter().flat_map(move |(name, scene)| {
        [COARSE, FINE].into_iter().flat_map(move |encoder| {
            (0..seeds).map(move |seed| {
                let mut random = Random::new(first + 7_100_000 + seed);
                let scenario = scene(&mut random);
                (name, encoder, seed, scenario, random)
            })
        })
    })
}

/// Tip errors of all methods.
pub fn table(seeds: u64, first: u64) -> Table {
    let mut table = Table::new("Side by side, 1 ms: tip error, mm (median over the runs), and lost runs");
    let all: Vec<_> = runs(seeds, first).collect();
    for same in all.chunks(seeds as usize) {
        let (name, encoder) = (same[0].0, same[0].1);
        let mut row = |way: &str, followed: Vec<Followed>| {
            let lost = followed.iter().filter(|run| run.is_lost()).count();
            let error = 1e3 * median(followed.iter().map(Followed::rms));
            table.push(Figure::untargeted(format!("{name}, {}: {way}", encoder.name), error, format!("{lost} of {seeds} lost")));
        };
        for (label, way) in WAYS {
            row(
                label,
                same.iter().map(|(_, _, _, scenario, random)| from_outside(scenario, way, &encoder, &mut random.clone())).collect(),
            );
        }
        row(
            "the unit",
            same.iter().map(|(_, _, _, scenario, random)| by_the_unit(scenario, &encoder, &mut random.clone())).collect(),
        );
    }
    table
}

/// Writes the comparison for other programs, as tables in a folder: `runs.csv`, a row for each run with the twin's variables;
/// `samples.csv`, the samples of both encoders, the inputs and the true tip; `errors.csv`, the tip's error of each method, m.
pub fn write(seeds: u64, first: u64, folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)?;
    // The separator is a semicolon because names of scenes contain commas.
    let file = |name: &str| csv::WriterBuilder::new().delimiter(b';').from_path(folder.join(name));
    let (mut described, mut samples, mut errors) = (file("runs.csv")?, file("samples.csv")?, file("errors.csv")?);
    described.write_record(["run", "scene", "encoder", "seed", "variable", "value"])?;
    let columns = ["tau[1]", "tau[2]", "servo.theta[1]", "servo.theta[2]", "servo.omega[1]", "servo.omega[2]"];
    samples.write_record([&["run", "time", "measured[1]", "measured[2]"][..], &columns, &["tip.x", "tip.y"]].concat())?;
    errors.write_record(["run", "time"].into_iter().chain(WAYS.map(|(label, _)| label)).chain(["the unit"]))?;
    let all: Vec<_> = runs(seeds, first).collect();
    let count = all.len();
    for (run, (name, encoder, seed, scenario, random)) in all.into_iter().enumerate() {
        eprintln!("[{}/{count}] {name}, {}: by the ways in Rust", run + 1, encoder.name);
        let run = run.to_string();
        for (variable, value) in variables(&scenario.model, &encoder) {
            described.write_record([&run, name, encoder.name, &seed.to_string(), variable, &value.to_string()])?;
        }
        let (mut machine, mut noise) = (scenario.machine(), random.clone());
        for step in 0..(scenario.duration / H).round() as u64 {
            let time = step as f64 * H;
            let truth = machine.state();
            let (theta, inputs) = (motion(&truth).0, scenario.inputs(time + H / 2.0));
            let [left, right] = MEASURED.map(|link| encoder.read(theta[link], &mut noise));
            let [x, y] = tip(&machine, &truth);
            let loads = [inputs.tau, inputs.servo_theta, inputs.servo_omega].concat();
            let numbers = [&[time, left, right][..], &loads, &[x, y]].concat();
            samples.write_record(std::iter::once(run.clone()).chain(numbers.iter().map(f64::to_string)))?;
            machine.advance(&scenario.acting(time + H / 2.0), H, 1).map_err(|failure| anyhow::anyhow!("the machine: {failure}"))?;
        }
        let mut courses: Vec<Followed> =
            WAYS.iter().map(|(_, way)| from_outside(&scenario, *way, &encoder, &mut random.clone())).collect();
        courses.push(by_the_unit(&scenario, &encoder, &mut random.clone()));
        for step in 0..(scenario.duration / H).round() as usize {
            let all = courses.iter().map(|course| course.0.get(step).unwrap_or(&f64::NAN));
            errors.write_record([&run, &(step as f64 * H).to_string()].into_iter().cloned().chain(all.map(f64::to_string)))?;
        }
    }
    [described, samples, errors].into_iter().try_for_each(|mut table| table.flush())?;
    Ok(())
}

/// Variables of a twin that differ from the unit's start values, by name.
fn variables(model: &Parameters, encoder: &Encoder) -> Vec<(&'static str, f64)> {
    let servo = &model.effects.servo;
    let bit = |value: bool| f64::from(u8::from(value));
    vec![
        ("base.distance", model.geometry.base_distance),
        ("gravity.enabled", bit(model.effects.gravity.enabled)),
        ("servo.enabled", bit(servo.enabled)),
        ("servo.kp[1]", servo.kp[0]),
        ("servo.kp[2]", servo.kp[1]),
        ("servo.kd[1]", servo.kd[0]),
        ("servo.kd[2]", servo.kd[1]),
        ("init.theta[1]", model.start.theta[0]),
        ("init.theta[2]", model.start.theta[1]),
        ("init.omega[1]", model.start.omega[0]),
        ("init.omega[2]", model.start.omega[1]),
        ("estimator.quantum[1]", encoder.quantum),
        ("estimator.quantum[2]", encoder.quantum),
        ("estimator.sigma0.length", model.estimator.sigma0_length),
        ("estimator.sigma0.offset", model.estimator.sigma0_offset),
        ("estimator.sigma0.eccentricity", model.estimator.sigma0_eccentricity),
    ]
}
