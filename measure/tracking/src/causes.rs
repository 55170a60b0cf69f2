//! Faults of every kind, at a random time and with a random size: does the estimator name the cause?

use std::collections::VecDeque;

use fivebar::effects::payload::Join;
use fivebar::estimator::{Cause, MEASURED, Measured};
use fivebar::simulation::Signal;

use crate::machine::{COARSE, Encoder, FINE, Random, Scenario, by_start_values, learned, motion};
use crate::quality::{fall, sines};
use crate::report::{Figure, Table};

/// Time from the onset to the evaluation of the cause, s.
const ASKED: f64 = 0.4;
/// Time before which causes do not count, s: an initial error of the twin surprises the estimator.
const SETTLED: f64 = 0.3;

/// A fault of a machine, its encoders or its clock, with the numbers of `estimated.cause`.
#[derive(Clone, Copy, Debug)]
enum Fault {
    Nothing,
    /// Torque on a motor, N·m.
    Torque(usize, f64),
    /// Force on the tip, N.
    Push([f64; 2]),
    /// The encoder's reading freezes at the onset.
    Frozen(usize),
    /// The encoder's reading is off by an angle, rad.
    Jump(usize, f64),
    /// Payload, kg.
    Payload(f64),
    /// Viscous friction in a joint, N·m·s/rad.
    Viscous(usize, f64),
    /// Samples are late by this time, s.
    Late(f64),
}

impl Fault {
    /// Starts the fault at a time, s.
    fn begin(self, scenario: &mut Scenario, time: f64) {
        let effects = &mut scenario.truth.effects;
        match self {
            Self::Payload(mass) => (effects.payload.enabled, effects.payload.mass) = (true, mass),
            Self::Viscous(joint, b) => {
                (effects.viscous.enabled, effects.viscous.b) = (true, [0.0; 5]);
                effects.viscous.b[joint] = b;
            }
            Self::Push(push) => (scenario.plan.push, scenario.plan.from) = (push, time),
            _ => (),
        }
    }

    /// Number of its cause.
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

    /// A random fault of a kind.
    fn drawn(number: usize, random: &mut Random) -> Self {
        let mut signed = |least: f64, most: f64| {
            let size = random.between(least, most);
            if random.uniform() < 0.5 { -size } else { size }
        };
        match number {
            0 => Self::Nothing,
            1 | 2 => Self::Torque(number - 1, signed(0.03, 0.12)),
            3 => {
                let (size, angle) = (random.between(0.25, 1.0), random.between(0.0, std::f64::consts::TAU));
                Self::Push([size * angle.cos(), size * angle.sin()])
            }
            4 | 5 if signed(1.0, 1.0) > 0.0 => Self::Frozen(number - 4),
            4 | 5 => Self::Jump(number - 4, signed(0.02, 0.3)),
            6 if signed(1.0, 1.0) > 0.0 => Self::Payload(random.between(0.01, 0.05)),
            6 => Self::Viscous((5.0 * random.uniform()) as usize, random.between(1e-2, 3e-2)),
            _ => Self::Late(random.between(3e-3, 1e-2)),
        }
    }
}

/// Cause reported by a twin for a fault.
#[derive(Clone, Copy, Debug)]
struct Report {
    fault: usize,
    cause: usize,
    probability: f64,
}

/// The cause reported 0.4 s after the onset of a fault; without a fault the first one reported.
fn run(mut scenario: Scenario, encoder: &Encoder, fault: Fault, random: &mut Random) -> Report {
    let h = 1e-3;
    let onset = random.between(0.5, 1.0);
    let (mut machine, mut twin) = (scenario.machine(), scenario.twin(encoder));
    scenario.truth.effects.payload.join = Join::WithTip;
    let (mut held, mut queue, mut last, mut failing) = (None, VecDeque::new(), Measured::default(), false);
    let mut report = (Cause::None, 1.0);
    for step in 0..((onset + ASKED) / h).round() as u64 {
        let time = step as f64 * h;
        if time >= onset && !failing {
            failing = true;
            fault.begin(&mut scenario, time);
            machine.tune(&scenario.truth.effects).unwrap_or_else(|error| panic!("the machine: {error}"));
        }
        let (theta, _) = motion(&machine.state());
        let mut measured = Measured { theta: MEASURED.map(|link| encoder.read(theta[link], random)), time: [time; 2] };
        match fault {
            Fault::Frozen(i) if failing => measured.theta[i] = *held.get_or_insert(measured.theta[i]),
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
        // Without a fault, any reported cause counts.
        if time > SETTLED && (failing && !matches!(fault, Fault::Nothing) || report.0 == Cause::None) {
            report = twin.cause();
        }
        let middle = time + h / 2.0;
        let mut acting = scenario.acting(middle);
        if let Fault::Torque(i, torque) = fault
            && failing
        {
            acting.tau[i] += torque;
        }
        if twin.advance_along(&Signal::held(scenario.inputs(middle)), h, 1).is_err() || machine.advance(&acting, h, 1).is_err() {
            break;
        }
    }
    Report { fault: fault.number(), cause: report.0.number(), probability: report.1 }
}

/// Causes reported for `runs` faults of each kind, alternately for servos on sines and falls; `uncertain` sets the twin's geometry errors.
fn trials(encoder: &Encoder, uncertain: fn(Scenario) -> Scenario, runs: u64, first: u64) -> Vec<Report> {
    type Scene = fn(&mut Random) -> Scenario;
    let scenes: [Scene; 2] = [|random| sines(random, 2.0), |random| fall(random, true)];
    let one = |seed: u64| {
        let mut random = Random::new(first + 8_200_000 + seed);
        let scenario = uncertain(scenes[(seed / 8 % 2) as usize](&mut random));
        let fault = Fault::drawn((seed % 8) as usize, &mut random);
        run(scenario, encoder, fault, &mut random)
    };
    (0..8 * runs).map(one).collect()
}

/// Number of faults named correctly, with `runs` of each of eight kinds, at 16 bits and at 0.1°.
pub fn named(runs: u64, first: u64) -> [usize; 2] {
    [FINE, COARSE]
        .map(|encoder| trials(&encoder, |exact| exact, runs, first).iter().filter(|report| report.cause == report.fault).count())
}

/// Faults named correctly, by encoder and kind.
pub fn table(runs: u64, first: u64) -> Table {
    const NAMES: [&str; 8] =
        ["nothing", "torque at motor 1", "torque at motor 2", "force at the tip", "encoder 1", "encoder 2", "parameters", "timing"];
    let mut table = Table::new("Causes 0.4 s after the onset of a fault, servos on sines and falls alternately: right, %");
    for encoder in [FINE, COARSE] {
        let all = trials(&encoder, |exact| exact, runs, first);
        let share =
            |of: &[Report]| 100.0 * of.iter().filter(|report| report.cause == report.fault).count() as f64 / of.len() as f64;
        for (number, name) in NAMES.iter().enumerate() {
            let of: Vec<Report> = all.iter().filter(|report| report.fault == number).copied().collect();
            let count = |cause: usize| of.iter().filter(|report| report.cause == cause).count().to_string();
            let remark = format!("of {}; reported as 0 to 7: {}", of.len(), (0..8).map(count).collect::<Vec<_>>().join(", "));
            table.push(Figure::untargeted(format!("{name}, {}", encoder.name), share(&of), remark));
        }
        let remark = format!("of {}", all.len());
        let name = format!("all, {}", encoder.name);
        let judged = if encoder == FINE {
            Figure::at_least(name, share(&all), 90.0, remark)
        } else {
            Figure::untargeted(name, share(&all), remark)
        };
        table.push(judged);
        // Calibration, shown and not judged: in each range, the share of right causes should equal their mean reported probability.
        for [least, most] in [[0.0, 0.7], [0.7, 0.94], [0.94, 1.0]] {
            let holds = |probability: f64| least <= probability && (probability < most || most == 1.0);
            let of: Vec<Report> = all.iter().filter(|report| report.cause > 0 && holds(report.probability)).copied().collect();
            let mean = 100.0 * of.iter().map(|report| report.probability).sum::<f64>() / of.len().max(1) as f64;
            let name = format!("causes of probability {least} to {most}, {}", encoder.name);
            table.push(Figure::untargeted(name, share(&of), format!("of {}; mean probability {mean:.0} %", of.len())));
        }
        type Way = fn(Scenario) -> Scenario;
        let ways: [(&str, Way, Option<f64>); 2] = [("start values", by_start_values, None), ("learned", learned, Some(90.0))];
        for (name, uncertain, least) in ways {
            let all = trials(&encoder, uncertain, runs, first);
            let silent = all.iter().filter(|report| report.fault > 0 && report.cause == 0).count();
            let (label, of) = (format!("all, {name}, {}", encoder.name), format!("of {}; {silent} reported as nothing", all.len()));
            table.push(match least {
                Some(least) => Figure::at_least(label, share(&all), least, of),
                None => Figure::untargeted(label, share(&all), of),
            });
        }
    }
    table
}
