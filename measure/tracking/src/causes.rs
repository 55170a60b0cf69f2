//! Faults of every kind at a random time and of a random size: whether the estimator names what went wrong.

use std::collections::VecDeque;

use fivebar::estimator::{MEASURED, Measured};
use fivebar::simulation::{Parameters, Signal};

use crate::machine::{COARSE, Encoder, FINE, Random, Scenario, motion};
use crate::quality::{fall, sines};
use crate::report::{Figure, Table};

/// Time after the onset at which the cause is asked for, s.
const ASKED: f64 = 0.4;

/// Fault of a machine, its encoders or its clock, as `estimated.cause` counts them.
#[derive(Clone, Copy, Debug)]
enum Fault {
    Nothing,
    /// Torque on a motor, N·m.
    Torque(usize, f64),
    /// Force on the tip, N.
    Push([f64; 2]),
    /// Encoder reads on as at the onset.
    Frozen(usize),
    /// Encoder reads off by an angle, rad.
    Jump(usize, f64),
    /// Payload, kg.
    Payload(f64),
    /// Viscous friction in a joint, N·m·s/rad.
    Viscous(usize, f64),
    /// Samples are late by a time, s.
    Late(f64),
}

impl Fault {
    fn number(self) -> usize {
        match self {
            Self::Nothing => 0,
            Self::Torque(i, _) => 1 + i,
            Self::Push(_) => 3,
            Self::Frozen(i) | Self::Jump(i, _) => 4 + i,
            Self::Payload(_) | Self::Viscous(..) => 6,
            Self::Late(_) => 7,
        }
    }

    /// A fault of a kind.
    fn drawn(number: usize, random: &mut Random) -> Self {
        let mut signed = |least: f64, most: f64| {
            let size = random.between(least, most);
            if random.uniform() < 0.5 { -size } else { size }
        };
        match number {
            0 => Self::Nothing,
            1 | 2 => Self::Torque(number - 1, signed(0.02, 0.1)),
            3 => {
                let (size, angle) = (random.between(0.2, 1.0), random.between(0.0, std::f64::consts::TAU));
                Self::Push([size * angle.cos(), size * angle.sin()])
            }
            4 | 5 if signed(1.0, 1.0) > 0.0 => Self::Frozen(number - 4),
            4 | 5 => Self::Jump(number - 4, signed(0.02, 0.3)),
            6 if signed(1.0, 1.0) > 0.0 => Self::Payload(random.between(0.01, 0.05)),
            6 => Self::Viscous((5.0 * random.uniform()) as usize, random.between(5e-3, 3e-2)),
            _ => Self::Late(random.between(3e-3, 1e-2)),
        }
    }
}

/// What was told.
#[derive(Clone, Copy, Debug)]
struct Told {
    fault: usize,
    cause: usize,
    probability: f64,
}

fn run(scenario: &Scenario, encoder: &Encoder, fault: Fault, random: &mut Random) -> Told {
    let h = 1e-3;
    let onset = random.between(0.5, 1.0);
    let (mut machine, mut twin) = (scenario.machine(), scenario.twin(encoder));
    let (mut held, mut queue) = ([None; 2], VecDeque::new());
    let mut told = (0, 1.0);
    let mut scenario = scenario.clone();
    let (mut failing, mut last) = (false, Measured::default());
    scenario.truth.effects.payload.join = fivebar::effects::payload::Join::WithTip;
    for step in 0..((onset + ASKED) / h).round() as u64 {
        let time = step as f64 * h;
        if time >= onset && !failing {
            if std::env::var("SHOW").is_ok() { println!("onset {onset:.3} {fault:?} {}", twin.estimator().debug()); }
            failing = true;
            let effects = &mut scenario.truth.effects;
            match fault {
                Fault::Payload(mass) => (effects.payload.enabled, effects.payload.mass) = (true, mass),
                Fault::Viscous(joint, b) => {
                    effects.viscous.enabled = true;
                    effects.viscous.b = [0.0; 5];
                    effects.viscous.b[joint] = b;
                }
                Fault::Push(push) => (scenario.plan.push, scenario.plan.from) = (push, time),
                _ => (),
            }
            machine.tune(&scenario.truth.effects).unwrap_or_else(|error| panic!("{error}"));
        }
        let (theta, _) = motion(&machine.state());
        let mut measured = Measured { theta: MEASURED.map(|link| encoder.read(theta[link], random)), time: [time; 2] };
        match fault {
            Fault::Frozen(i) if failing => measured.theta[i] = *held[i].get_or_insert(measured.theta[i]),
            Fault::Jump(i, by) if failing => measured.theta[i] += by,
            Fault::Late(by) if failing => {
                queue.push_back(measured.theta);
                measured = if queue.len() as f64 * h > by + h {
                    Measured { theta: queue.pop_front().unwrap_or_default(), ..measured }
                } else {
                    last
                };
            }
            _ => (),
        }
        twin.correct(&measured, time);
        last = measured;
        let (cause, probability) = twin.cause();
        // Of a machine that nothing is wrong with, any cause that was ever told counts.
        if fault.number() > 0 || told.0 == 0 {
            told = (cause.number(), probability);
        }
        let middle = time + h / 2.0;
        let mut acting = scenario.acting(middle);
        if let Fault::Torque(i, torque) = fault && failing {
            acting.tau[i] += torque;
        }
        if twin.advance_along(&Signal::held(scenario.inputs(middle)), h, 1).is_err() || machine.advance(&acting, h, 1).is_err() {
            break;
        }
        if time < 0.3 {
            told = (0, 1.0);
        }
    }
    if std::env::var("SHOW").is_ok() { println!("  end {}", twin.estimator().debug()); }
    Told { fault: fault.number(), cause: told.0, probability: told.1 }
}

/// Faults that are named.
pub fn table(runs: u64, first: u64) -> Table {
    const NAMES: [&str; 8] =
        ["nothing", "torque at motor 1", "torque at motor 2", "force at the tip", "encoder 1", "encoder 2", "parameters", "timing"];
    let mut table = Table::new("Causes 0.4 s after the onset: right, %");
    type Scene = fn(&mut Random) -> Scenario;
    let scenes: [(&str, Scene); 2] = [("servos on sines", |random| sines(random, 2.0)), ("falls", |random| fall(random, true))];
    for encoder in [FINE, COARSE] {
        for (scene_name, scene) in scenes {
            let one = std::env::var("ONE").ok().and_then(|one| one.parse::<u64>().ok());
            let all: Vec<Told> = (0..8 * runs).filter(|seed| one.is_none_or(|one| one == *seed))
                .map(|seed| {
                    let mut random = Random::new(first + 8_100_000 + seed);
                    let mut scenario = scene(&mut random);
                    if std::env::var("EXACT").is_ok() {
                        scenario.truth = Parameters { geometry: scenario.model.geometry, ..scenario.truth };
                    }
                    let fault = Fault::drawn((seed % 8) as usize, &mut random);
                    let told = run(&scenario, &encoder, fault, &mut random);
                    if std::env::var("SHOW").is_ok() {
                        println!("{scene_name} {} {seed} {fault:?} {told:?}", encoder.name);
                    }
                    told
                })
                .collect();
            let right = |of: &Told| of.cause == of.fault;
            let label = format!("{scene_name}, {}", encoder.name);
            for (number, name) in NAMES.iter().enumerate() {
                let of: Vec<&Told> = all.iter().filter(|told| told.fault == number).collect();
                let count = of.iter().filter(|told| right(told)).count();
                let confused: Vec<String> = (0..8)
                    .map(|cause| of.iter().filter(|told| told.cause == cause).count().to_string())
                    .collect();
                table.push(Figure::told(
                    format!("{label}: {name}"),
                    100.0 * count as f64 / of.len() as f64,
                    format!("told as 0 to 7: {}", confused.join(", ")),
                ));
            }
            let count = all.iter().filter(|told| right(told)).count();
            let sure = all.iter().map(|told| told.probability).sum::<f64>() / all.len() as f64;
            let remark = format!("of {}; mean probability {:.0} %", all.len(), 100.0 * sure);
            table.push(Figure::at_least(format!("{label}: all"), 100.0 * count as f64 / all.len() as f64, 90.0, remark));
        }
    }
    table
}
