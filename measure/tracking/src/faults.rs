//! Encoders, clocks and starts that fail: how often the estimate is wrong without a warning, and how soon the failure is reported.

use std::collections::VecDeque;
use std::time::Instant;

use fivebar::effects::Inputs;
use fivebar::estimator::{Cause, Fault, MEASURED, Measured, Status};
use fivebar::mechanism::Assembly;
use fivebar::simulation::bindings::default_inputs;
use fivebar::simulation::{Following, Method, Signal};

use crate::machine::{
    COARSE, Encoder, FINE, MEDIUM, Plan, Random, Scenario, by_start_values, desk, five_percent, learned, motion, no_inputs,
    start_off, tip,
};
use crate::quality::{fall, friction, pick, plan, push, servos, sines};
use crate::report::{Figure, Table, median, most_of};
use crate::scores::half_width;

/// An estimate is wrong in silence if the tip error exceeds this, m, and this number of half-widths, without a warning for this time, s.
pub const SILENT: (f64, f64, f64) = (0.01, 3.0, 0.1);
/// Time within which a failure must be reported, s.
const SOON: f64 = 0.2;
/// Allowed rate of failures that could be named by then and are not.
const UNNAMED: f64 = 0.05;
/// Largest time for a sample, ms.
const DEAREST: f64 = 1.0;
/// Distance of the axis from a frozen reading that is visible, in quantisation intervals and in standard deviations of the angle.
const VISIBLE: [f64; 2] = [2.0, 4.0];

/// Whether a tip error, m, exceeds the twin's band.
fn is_beyond(twin: &Following, time: f64, off: f64) -> bool {
    time > 0.1 && off > SILENT.0.max(SILENT.1 * half_width(twin.tip_covariance()))
}

/// Whether a tip error, m, exceeds the twin's band without a warning.
pub fn is_wrong_in_silence(twin: &Following, time: f64, off: f64) -> bool {
    let is_fine = twin.status() == Status::Following && !twin.estimator().alarm();
    is_beyond(twin, time, off) && is_fine
}

/// Failure of encoder 1, of both encoders or clocks, or of the start.
#[derive(Clone, Copy, Debug)]
enum Failure {
    /// The reading freezes at the onset.
    Frozen,
    /// The reading is 0.
    Zero,
    /// The reading is off by an angle, rad.
    Jump(f64),
    /// No samples for one second.
    Missing,
    /// No more samples.
    Gone,
    /// Both readings freeze at the onset.
    BothFrozen,
    /// No samples of both encoders for 0.3 s.
    Silence,
    /// Besides another failure, this fraction of each encoder's samples is missing all the time.
    Lossy(f64, &'static Failure),
    /// The encoders are exchanged.
    Swapped,
    /// Besides another failure, time stamps have normal noise, s.
    Jitter(f64, &'static Failure),
    /// Time stamps are late by a constant, s.
    Late(f64),
    /// From the onset time stamps are late by a constant, s; before that there is no sample for the same time.
    Delayed(f64),
    /// The twin starts in the other assembly.
    Assembly,
    /// No failure.
    Nothing,
}

impl Failure {
    /// Whether both encoders read correctly, so that none is stuck.
    fn leaves_encoders_sound(self) -> bool {
        use Failure::{Assembly, Gone, Jitter, Late, Lossy, Missing, Nothing, Silence};
        match self {
            Lossy(_, other) | Jitter(_, other) => other.leaves_encoders_sound(),
            other => matches!(other, Silence | Missing | Gone | Late(_) | Assembly | Nothing),
        }
    }

    /// Whether encoder 1 freezes; visible only after its axis has turned.
    fn freezes(self) -> bool {
        match self {
            Self::Lossy(_, other) | Self::Jitter(_, other) => other.freezes(),
            other => matches!(other, Self::Frozen),
        }
    }

    /// Whether a cause can name the failure: exactly one encoder fails.
    fn has_name(self) -> bool {
        !matches!(self, Self::BothFrozen) && [Cause::Encoder(0), Cause::Timing].into_iter().any(|cause| self.is_named(cause))
    }

    /// Whether a cause names the failure. Only the status reports missing samples, samples late from the start, and the wrong assembly.
    fn is_named(self, cause: Cause) -> bool {
        use Failure::{BothFrozen, Delayed, Frozen, Jitter, Jump, Lossy, Swapped, Zero};
        match self {
            Lossy(_, other) | Jitter(_, other) => other.is_named(cause),
            Frozen | Zero | Jump(_) => cause == Cause::Encoder(0),
            BothFrozen | Swapped => matches!(cause, Cause::Encoder(_)),
            Delayed(_) => cause == Cause::Timing,
            _ => false,
        }
    }
}

/// Generator of a scene's machine and twin.
type Scene = fn(&mut Random) -> Scenario;

/// Outcome of a run.
#[derive(Default)]
struct Outcome {
    /// Whether the tip is off at the end.
    lost: bool,
    /// Whether the tip was off without a warning by the status.
    silent: bool,
    /// Whether the tip was outside its band, with any status.
    beyond: bool,
    /// Time from the onset to the first status that reports it, s.
    found: f64,
    /// Time from the onset to the first sample with the right cause, s.
    named: f64,
    /// Whether the axis moved far enough from its frozen reading in time for a report: visible to an observer who knows the instant of the
    /// failure.
    visible: bool,
    /// Whether an encoder was reported stuck while its reading was true.
    early: bool,
    /// Fraction of the samples after which some had been refused for their time stamp.
    refused: f64,
    /// Computing time of the twin for each sample, s.
    taken: Vec<f64>,
}

fn swing_course(time: f64, plan: &Plan) -> Inputs {
    let theta = [2.0, 1.1];
    let angle = |i: usize| theta[i] + 0.25 * (2.0 * time + plan.phase[i]).sin();
    let speed = |i: usize| 0.5 * (2.0 * time + plan.phase[i]).cos();
    Inputs { servo_theta: [angle(0), angle(1)], servo_omega: [speed(0), speed(1)], ..default_inputs() }
}

/// Servos of 1 N·m/rad that swing both axes by 0.25 rad at 2 rad/s; masses 5 % off.
pub fn swing(random: &mut Random) -> Scenario {
    swing_by(random, 1.0)
}

/// As [`swing`], with servos of 20 N·m/rad.
pub fn stiff(random: &mut Random) -> Scenario {
    swing_by(random, 20.0)
}

/// A scene with machine and twin in the assembly minus.
fn in_minus(mut scenario: Scenario) -> Scenario {
    (scenario.model.start.assembly, scenario.truth.start.assembly) = (Assembly::Minus, Assembly::Minus);
    scenario
}

fn swing_by(random: &mut Random, gain: f64) -> Scenario {
    let mut model = desk();
    servos(&mut model, gain, 0.01 * gain);
    let plan = plan(random);
    let start = swing_course(0.0, &plan);
    (model.start.theta, model.start.omega) = (start.servo_theta, start.servo_omega);
    let truth = five_percent(&model, random);
    start_off(&mut model, random, [0.02, 0.2]);
    Scenario { model, truth, course: swing_course, plan, duration: 3.0, from: None }
}

fn falling(random: &mut Random) -> Scenario {
    fall(random, true)
}

fn fast(random: &mut Random) -> Scenario {
    sines(random, 3.0)
}

/// The machine of `scenes/haptic.json`, pressed onto a wall by a hand. As in the twin's demonstration, masses are 5 % off, the payload is
/// a fifth larger, and damping is unknown.
pub fn haptic(random: &mut Random) -> Scenario {
    let mut model = desk();
    model.settings.method = Method::Automatic;
    model.settings.error_tolerance = 1e-6;
    let effects = &mut model.effects;
    effects.gravity.enabled = false;
    (effects.payload.enabled, effects.friction.enabled, effects.contact.enabled) = (true, true, true);
    effects.contact.offset = 0.2;
    model.start.theta = [2.2209, 0.9207];
    let mut truth = five_percent(&model, random);
    truth.effects.payload.mass *= 1.2;
    truth.effects.viscous.enabled = true;
    let hand = [random.between(0.5, 1.5), random.between(0.7, 1.5)];
    Scenario { model, truth, course: no_inputs, plan: Plan { hand, ..plan(random) }, duration: 2.0, from: None }
}

/// A run with a failure.
fn run(scenario: &Scenario, (encoder, h): (&Encoder, f64), failure: Failure, random: &mut Random) -> Outcome {
    let onset = random.between(0.5, 1.2);
    let (failure, lost, jitter) = match failure {
        Failure::Lossy(part, other) => (*other, part, 0.0),
        Failure::Jitter(sigma, other) => (*other, 0.0, sigma),
        other => (other, 0.0, 0.0),
    };
    let onset = if let Failure::Nothing = failure { f64::INFINITY } else { onset };
    let mut believed = scenario.clone();
    if let Failure::Assembly = failure {
        let assembly = &mut believed.model.start.assembly;
        *assembly = if *assembly == Assembly::Plus { Assembly::Minus } else { Assembly::Plus };
    }
    // For late samples the machine starts before its twin.
    let (mut machine, mut queue) = (scenario.machine(), VecDeque::new());
    let lead = if let Failure::Late(by) = failure { (by / h).round() as u64 } else { 0 };
    for step in 0..lead {
        let time = step as f64 * h;
        queue.push_back(MEASURED.map(|link| encoder.read(motion(&machine.state()).0[link], random)));
        machine.advance(&scenario.acting(time + h / 2.0), h, 1).unwrap_or_else(|error| panic!("the machine: {error}"));
    }
    let ahead = lead as f64 * h;
    let (theta, omega) = motion(&machine.state());
    for (i, link) in MEASURED.into_iter().enumerate() {
        let (start, from) = (&mut believed.model.start, &scenario.truth.start);
        start.theta[i] += theta[link] - from.theta[i];
        start.omega[i] += omega[link] - from.omega[i];
    }
    let mut twin = believed.twin(encoder);
    let mut outcome = Outcome { found: f64::INFINITY, named: f64::INFINITY, ..Outcome::default() };
    let (mut held, mut wrong, mut beyond, mut refused, mut stamp) = (None, 0.0, 0.0, 0.0, Measured::default().time);
    // A second twin without the samples of the frozen encoder.
    let mut observer = None;
    let steps = (scenario.duration / h).round() as u64;
    for step in 0..steps {
        let time = step as f64 * h;
        let truth = machine.state();
        let (theta, _) = motion(&truth);
        let mut measured = Measured { theta: MEASURED.map(|link| encoder.read(theta[link], random)), time: [time; 2] };
        let failing = time >= onset;
        match failure {
            Failure::Frozen if failing => measured.theta[0] = held.get_or_insert(measured.theta)[0],
            Failure::BothFrozen if failing => measured.theta = *held.get_or_insert(measured.theta),
            Failure::Zero if failing => measured.theta[0] = 0.0,
            Failure::Jump(by) if failing => measured.theta[0] += by,
            Failure::Missing if (onset..onset + 1.0).contains(&time) => measured.time[0] = stamp[0],
            Failure::Gone if failing => measured.time[0] = stamp[0],
            Failure::Silence if (onset..onset + 0.3).contains(&time) => measured.time = stamp,
            Failure::Swapped => measured.theta.swap(0, 1),
            Failure::Late(_) => {
                // A sample carries the time stamp of its arrival.
                queue.push_back(measured.theta);
                measured.theta = queue.pop_front().unwrap_or_default();
            }
            Failure::Delayed(by) if failing => {
                queue.push_back(measured.theta);
                if queue.len() > (by / h).round() as usize {
                    measured.theta = queue.pop_front().unwrap_or_default();
                } else {
                    measured.time = stamp;
                }
            }
            _ => (),
        }
        if jitter > 0.0 {
            measured.time = [0, 1].map(|_| time + jitter * random.normal());
        }
        for (time, before) in measured.time.iter_mut().zip(stamp) {
            if lost > 0.0 && random.between(0.0, 1.0) < lost {
                *time = before;
            }
        }
        if let Failure::Frozen = failure
            && (onset..onset + SOON).contains(&time)
        {
            let (informed, last) = observer.get_or_insert_with(|| (twin.clone(), stamp[0]));
            informed.correct(&Measured { time: [*last, time], ..measured }, time);
            let sigma = informed.sigmas()[0][MEASURED[0]];
            let visible = VISIBLE[0] * encoder.quantum + VISIBLE[1] * sigma;
            outcome.visible |= (theta[MEASURED[0]] - measured.theta[0]).abs() > visible;
        }
        stamp = measured.time;
        let begin = Instant::now();
        twin.correct(&measured, time);
        let corrected = begin.elapsed();
        refused += f64::from(u8::from(matches!(twin.status(), Status::Faulty(Fault::Late | Fault::Future))));
        let inputs = scenario.inputs(time + ahead);
        let estimate = twin.state_for(&inputs);
        let ([x, y], [v, w]) = (tip(&machine, &truth), tip(twin.simulation(), &estimate));
        let off = (x - v).hypot(y - w);
        wrong = if is_wrong_in_silence(&twin, time, off) { wrong + h } else { 0.0 };
        outcome.silent |= wrong >= SILENT.2;
        beyond = if is_beyond(&twin, time, off) { beyond + h } else { 0.0 };
        outcome.beyond |= beyond >= SILENT.2;
        outcome.lost = off > SILENT.0;
        let [first, second] = [0, 1].map(|i| twin.estimator().encoder(i).1 == Fault::Stuck);
        let sound = !failing || failure.leaves_encoders_sound();
        outcome.early |= first && sound || second && (sound || !matches!(failure, Failure::BothFrozen));
        if failing && twin.status() != Status::Following && outcome.found.is_infinite() {
            outcome.found = time - onset;
        }
        if failing && failure.is_named(twin.cause().0) && outcome.named.is_infinite() {
            outcome.named = time - onset;
        }
        let macro_steps = (h / 1e-3).round().max(1.0);
        let middle = time + ahead + h / 2.0;
        let signal = Signal::held(scenario.inputs(middle));
        let begin = Instant::now();
        let moved = twin.advance_along(&signal, h / macro_steps, macro_steps as u64);
        outcome.taken.push((corrected + begin.elapsed()).as_secs_f64());
        if let Some((informed, _)) = &mut observer
            && time < onset + SOON
        {
            informed
                .advance_along(&signal, h / macro_steps, macro_steps as u64)
                .unwrap_or_else(|error| panic!("the twin without the encoder: {error}"));
        }
        let moved = moved.and_then(|()| machine.advance(&scenario.acting(middle), h / macro_steps, macro_steps as u64));
        if moved.is_err() {
            outcome.lost = true;
            break;
        }
    }
    outcome.refused = refused / steps as f64;
    outcome
}

/// Number of lost runs among those with unreported delays of 8 ms, from a start in the right assembly, while learning.
pub fn lost_by_late_samples(seeds: impl IntoIterator<Item = u64>) -> usize {
    count(|random| learned(fast(random)), Failure::Late(8e-3), &FINE, seeds, |outcome| outcome.lost)
}

/// Number of lost runs without a failure, for stiff servos that swing a machine, from a start in the right assembly: at 16 bits in plus, at
/// 14 bits in minus.
pub fn lost_in_stiff_swings(plus: impl IntoIterator<Item = u64>, minus: impl IntoIterator<Item = u64>) -> [usize; 2] {
    let lost = |outcome: &Outcome| outcome.lost;
    let in_minus = |random: &mut Random| in_minus(stiff(random));
    [count(stiff, Failure::Nothing, &FINE, plus, lost), count(in_minus, Failure::Nothing, &MEDIUM, minus, lost)]
}

/// Number of runs with a good encoder reported stuck, with time stamps that jitter by 0.3 ms, while learning.
pub fn stuck_by_jitter(seeds: impl IntoIterator<Item = u64>) -> usize {
    count(|random| learned(fast(random)), Failure::Jitter(3e-4, &Failure::Nothing), &FINE, seeds, |outcome| outcome.early)
}

/// Number of falls with the unit's start values and no warning although an encoder freezes.
pub fn silent_in_falls(seeds: impl IntoIterator<Item = u64>) -> usize {
    count(|random| by_start_values(falling(random)), Failure::Frozen, &FINE, seeds, |outcome| outcome.silent)
}

/// Number of falls in which one encoder stops and the other leaves the tip outside its band.
pub fn beyond_by_one_encoder(seeds: impl IntoIterator<Item = u64>) -> usize {
    count(falling, Failure::Gone, &FINE, seeds, |outcome| outcome.beyond)
}

/// Number of falls without a warning although both encoders freeze at once.
pub fn silent_where_both_freeze(seeds: impl IntoIterator<Item = u64>) -> usize {
    count(falling, Failure::BothFrozen, &FINE, seeds, |outcome| outcome.silent)
}

/// Number of swings with a jump of 0.1 rad and no warning while one in fifty samples is lost.
pub fn silent_with_lost_samples(seeds: impl IntoIterator<Item = u64>) -> usize {
    count(swing, Failure::Lossy(0.02, &Failure::Jump(0.1)), &FINE, seeds, |outcome| outcome.silent)
}

/// Number of runs at 1 kHz with some property.
fn count(
    scene: Scene,
    failure: Failure,
    encoder: &Encoder,
    seeds: impl IntoIterator<Item = u64>,
    is_of_kind: fn(&Outcome) -> bool,
) -> usize {
    let outcome = |seed| {
        let mut random = Random::new(seed);
        let scenario = scene(&mut random);
        run(&scenario, (encoder, 1e-3), failure, &mut random)
    };
    seeds.into_iter().map(outcome).filter(is_of_kind).count()
}

/// Times of the most expensive and of the median sample of a run, s. Each is the smallest of three, because other programs run as well.
fn dearest(scene: Scene, random: &Random, failure: Failure, tolerance: f64) -> [f64; 2] {
    let again = || {
        let mut random = random.clone();
        let mut scenario = scene(&mut random);
        (scenario.model.settings.method, scenario.model.settings.error_tolerance) = (Method::Automatic, tolerance);
        run(&scenario, (&FINE, 1e-3), failure, &mut random).taken
    };
    let times = [again(), again(), again()];
    let least = || (0..times[0].len()).map(|sample| times.iter().map(|of| of[sample]).fold(f64::INFINITY, f64::min));
    [least().fold(0.0, f64::max), median(least())]
}

/// An encoder of some bits.
const fn bits(name: &'static str, bits: u32) -> Encoder {
    Encoder { name, sigma: 0.0, quantum: std::f64::consts::TAU / (1_u64 << bits) as f64 }
}

/// Failures, each in its scenes and with its encoders.
pub fn table(runs: u64, first: u64) -> Table {
    const JITTER: Failure = Failure::Jitter(3e-4, &Failure::Nothing);
    const FIFTH: Failure = Failure::Lossy(0.2, &Failure::Nothing);
    const FEW: Encoder = bits("12 bit", 12);
    const FEWEST: Encoder = bits("10 bit", 10);
    let rows: [(&str, Scene, Failure, Encoder, f64); 104] = [
        ("frozen, swing", swing, Failure::Frozen, FINE, 1e-3),
        ("frozen, swing", swing, Failure::Frozen, MEDIUM, 1e-3),
        ("frozen, swing", swing, Failure::Frozen, FEW, 1e-3),
        ("frozen, swing", swing, Failure::Frozen, FEWEST, 1e-3),
        ("frozen, swing", swing, Failure::Frozen, COARSE, 1e-3),
        ("frozen, swing", swing, Failure::Frozen, COARSE, 5e-3),
        ("frozen, swing", swing, Failure::Frozen, FINE, 2e-4),
        ("frozen, fall", falling, Failure::Frozen, FINE, 1e-3),
        ("frozen, fall", falling, Failure::Frozen, COARSE, 1e-3),
        ("frozen, stiff swing", stiff, Failure::Frozen, FINE, 1e-3),
        ("frozen, stiff swing", stiff, Failure::Frozen, COARSE, 1e-3),
        ("wrong assembly, swing", swing, Failure::Assembly, FINE, 1e-3),
        ("wrong assembly, sines", fast, Failure::Assembly, FINE, 1e-3),
        ("wrong assembly, pick", pick, Failure::Assembly, FINE, 1e-3),
        ("wrong assembly, fall", falling, Failure::Assembly, FINE, 1e-3),
        ("jitter of 0.3 ms, swing", swing, JITTER, FINE, 1e-3),
        ("jitter of 0.3 ms, sines", fast, JITTER, FINE, 1e-3),
        ("late by 8 ms, sines", fast, Failure::Late(8e-3), FINE, 1e-3),
        ("late by 8 ms from some instant on, sines", fast, Failure::Delayed(8e-3), FINE, 1e-3),
        ("late by 8 ms from some instant on, sines", fast, Failure::Delayed(8e-3), COARSE, 1e-3),
        (
            "late by 8 ms from some instant on, sines, start values",
            |random| by_start_values(fast(random)),
            Failure::Delayed(8e-3),
            FINE,
            1e-3,
        ),
        ("late by 8 ms from some instant on, sines, learned", |random| learned(fast(random)), Failure::Delayed(8e-3), FINE, 1e-3),
        ("zero, swing", swing, Failure::Zero, FINE, 1e-3),
        ("off by 0.1 rad, swing", swing, Failure::Jump(0.1), FINE, 1e-3),
        ("off by 0.1 rad, swing", swing, Failure::Jump(0.1), COARSE, 1e-3),
        ("off by 0.1 rad, swing", swing, Failure::Jump(0.1), COARSE, 5e-3),
        ("off by 0.1 rad, fall", falling, Failure::Jump(0.1), FINE, 1e-3),
        ("off by 0.01 rad, swing", swing, Failure::Jump(0.01), FINE, 1e-3),
        ("off by 0.1 rad, swing, start values", |random| by_start_values(swing(random)), Failure::Jump(0.1), FINE, 1e-3),
        ("off by 0.1 rad, swing, start values", |random| by_start_values(swing(random)), Failure::Jump(0.1), COARSE, 5e-3),
        ("off by 0.03 rad, swing, start values", |random| by_start_values(swing(random)), Failure::Jump(0.03), FINE, 1e-3),
        ("off by 0.1 rad, swing, learned", |random| learned(swing(random)), Failure::Jump(0.1), FINE, 1e-3),
        ("off by 0.1 rad, swing, learned", |random| learned(swing(random)), Failure::Jump(0.1), COARSE, 5e-3),
        ("off by 0.1 rad, fall, learned", |random| learned(falling(random)), Failure::Jump(0.1), FINE, 1e-3),
        ("off by 0.03 rad, swing, learned", |random| learned(swing(random)), Failure::Jump(0.03), FINE, 1e-3),
        ("frozen, swing, start values", |random| by_start_values(swing(random)), Failure::Frozen, FINE, 1e-3),
        ("frozen, fall, start values", |random| by_start_values(falling(random)), Failure::Frozen, FINE, 1e-3),
        ("frozen, fall, start values", |random| by_start_values(falling(random)), Failure::Frozen, COARSE, 1e-3),
        ("frozen, swing, learned", |random| learned(swing(random)), Failure::Frozen, FINE, 1e-3),
        ("frozen, swing, learned", |random| learned(swing(random)), Failure::Frozen, COARSE, 5e-3),
        ("frozen, fall, learned", |random| learned(falling(random)), Failure::Frozen, FINE, 1e-3),
        ("frozen, fall, learned", |random| learned(falling(random)), Failure::Frozen, COARSE, 1e-3),
        ("zero, swing, learned", |random| learned(swing(random)), Failure::Zero, FINE, 1e-3),
        ("swapped, swing, learned", |random| learned(swing(random)), Failure::Swapped, FINE, 1e-3),
        ("missing, swing, learned", |random| learned(swing(random)), Failure::Missing, FINE, 1e-3),
        ("missing, fall, learned", |random| learned(falling(random)), Failure::Missing, FINE, 1e-3),
        ("jitter of 0.3 ms, sines, learned", |random| learned(fast(random)), JITTER, FINE, 1e-3),
        ("jitter of 0.3 ms, pick, start values", |random| by_start_values(pick(random)), JITTER, FINE, 1e-3),
        ("late by 8 ms, sines, learned", |random| learned(fast(random)), Failure::Late(8e-3), FINE, 1e-3),
        ("swapped, swing", swing, Failure::Swapped, FINE, 1e-3),
        ("missing, swing", swing, Failure::Missing, FINE, 1e-3),
        ("gone, fall", falling, Failure::Gone, FINE, 1e-3),
        ("gone, fall", falling, Failure::Gone, FINE, 5e-3),
        ("gone, fall", falling, Failure::Gone, COARSE, 1e-3),
        ("gone, fall, start values", |random| by_start_values(falling(random)), Failure::Gone, FINE, 1e-3),
        ("gone, fall, learned", |random| learned(falling(random)), Failure::Gone, FINE, 1e-3),
        ("gone, push", push, Failure::Gone, FINE, 1e-3),
        ("both frozen, swing", swing, Failure::BothFrozen, FINE, 1e-3),
        ("both frozen, fall", falling, Failure::BothFrozen, FINE, 1e-3),
        ("both frozen, fall, start values", |random| by_start_values(falling(random)), Failure::BothFrozen, FINE, 1e-3),
        ("silence, swing", swing, Failure::Silence, FINE, 1e-3),
        ("silence, pick, start values", |random| by_start_values(pick(random)), Failure::Silence, FINE, 5e-3),
        ("silence, pick, start values", |random| by_start_values(pick(random)), Failure::Silence, COARSE, 5e-3),
        ("silence, pick, learned", |random| learned(pick(random)), Failure::Silence, FINE, 5e-3),
        ("drop-outs, fall", falling, FIFTH, FINE, 1e-3),
        ("drop-outs, pick, start values", |random| by_start_values(pick(random)), FIFTH, FINE, 5e-3),
        ("drop-outs, push, start values", |random| by_start_values(push(random)), FIFTH, COARSE, 5e-3),
        ("drop-outs, swing, learned", |random| learned(swing(random)), FIFTH, FINE, 1e-3),
        ("off by 0.1 rad, a fiftieth of the samples lost, swing", swing, Failure::Lossy(0.02, &Failure::Jump(0.1)), FINE, 1e-3),
        (
            "off by 0.1 rad, a fiftieth of the samples lost, swing, start values",
            |random| by_start_values(swing(random)),
            Failure::Lossy(0.02, &Failure::Jump(0.1)),
            FINE,
            1e-3,
        ),
        (
            "frozen, a fiftieth of the samples lost, swing, start values",
            |random| by_start_values(swing(random)),
            Failure::Lossy(0.02, &Failure::Frozen),
            FINE,
            1e-3,
        ),
        (
            "frozen, a fifth of the samples lost, swing, learned",
            |random| learned(swing(random)),
            Failure::Lossy(0.2, &Failure::Frozen),
            COARSE,
            5e-3,
        ),
        ("frozen, jitter of 0.3 ms, swing", swing, Failure::Jitter(3e-4, &Failure::Frozen), COARSE, 1e-3),
        (
            "frozen, jitter of 0.3 ms, fall, start values",
            |random| by_start_values(falling(random)),
            Failure::Jitter(3e-4, &Failure::Frozen),
            FINE,
            1e-3,
        ),
        ("off by 0.1 rad, jitter of 0.3 ms, swing", swing, Failure::Jitter(3e-4, &Failure::Jump(0.1)), FINE, 1e-3),
        (
            "off by 0.1 rad, jitter of 0.3 ms, swing, start values",
            |random| by_start_values(swing(random)),
            Failure::Jitter(3e-4, &Failure::Jump(0.1)),
            FINE,
            1e-3,
        ),
        ("nothing, swing", swing, Failure::Nothing, FINE, 1e-3),
        ("nothing, stiff swing", stiff, Failure::Nothing, FINE, 1e-3),
        ("nothing, stiff swing", stiff, Failure::Nothing, COARSE, 1e-3),
        ("nothing, stiff swing", stiff, Failure::Nothing, MEDIUM, 1e-3),
        ("nothing, stiff swing in minus", |random| in_minus(stiff(random)), Failure::Nothing, FINE, 1e-3),
        ("nothing, stiff swing in minus", |random| in_minus(stiff(random)), Failure::Nothing, MEDIUM, 1e-3),
        ("nothing, fall", falling, Failure::Nothing, FINE, 1e-3),
        ("nothing, pick", pick, Failure::Nothing, FINE, 1e-3),
        ("nothing, pick", pick, Failure::Nothing, COARSE, 1e-3),
        ("nothing, push", push, Failure::Nothing, COARSE, 1e-3),
        ("nothing, push", push, Failure::Nothing, FINE, 1e-3),
        ("nothing, push", push, Failure::Nothing, MEDIUM, 1e-3),
        ("nothing, push", push, Failure::Nothing, COARSE, 5e-3),
        ("nothing, push", push, Failure::Nothing, FEWEST, 1e-3),
        ("nothing, friction", friction, Failure::Nothing, FINE, 1e-3),
        ("nothing, friction", friction, Failure::Nothing, COARSE, 1e-3),
        ("nothing, friction", friction, Failure::Nothing, FEWEST, 5e-3),
        ("nothing, swing, learned", |random| learned(swing(random)), Failure::Nothing, FINE, 1e-3),
        ("nothing, fall, learned", |random| learned(falling(random)), Failure::Nothing, FINE, 1e-3),
        ("nothing, push, learned", |random| learned(push(random)), Failure::Nothing, FINE, 1e-3),
        ("nothing, push, learned", |random| learned(push(random)), Failure::Nothing, COARSE, 5e-3),
        ("nothing, push, start values", |random| by_start_values(push(random)), Failure::Nothing, COARSE, 5e-3),
        ("nothing, friction, learned", |random| learned(friction(random)), Failure::Nothing, FINE, 1e-3),
        ("nothing, pick, learned", |random| learned(pick(random)), Failure::Nothing, COARSE, 1e-3),
        ("nothing, haptic", haptic, Failure::Nothing, FINE, 5e-3),
        ("nothing, haptic", haptic, Failure::Nothing, FINE, 1e-3),
        ("nothing, haptic", haptic, Failure::Nothing, FEW, 5e-3),
        ("nothing, haptic", haptic, Failure::Nothing, COARSE, 1e-3),
    ];
    let mut table = Table::new("Encoders, clocks and starts that fail, runs");
    for (name, scene, failure, encoder, h) in rows {
        let outcomes: Vec<Outcome> = (0..runs)
            .map(|seed| {
                let mut random = Random::new(first + 7_900_000 + seed);
                let scenario = scene(&mut random);
                run(&scenario, (&encoder, h), failure, &mut random)
            })
            .collect();
        let count = |of: &dyn Fn(&Outcome) -> bool| outcomes.iter().filter(|outcome| of(outcome)).count();
        let silent = count(&|o| o.silent);
        let refused = 100.0 * outcomes.iter().map(|o| o.refused).sum::<f64>() / runs as f64;
        let remark = format!(
            "of {runs}; lost at the end {}, reported within 0.2 s {}, named {}, visible but not reported {}, stuck in error {}, beyond its band {}, refused stamps {refused:.1} %",
            count(&|o| o.lost),
            count(&|o| o.found <= SOON),
            count(&|o| o.named <= SOON),
            count(&|o| o.visible && o.found > SOON),
            count(&|o| o.early),
            count(&|o| o.beyond),
        );
        let label = format!("{name}, {}, {} ms", encoder.name, 1e3 * h);
        let wrong = format!("{label}: wrong in silence");
        table.push(match failure {
            // Cannot be detected with one encoder and the model.
            Failure::BothFrozen => Figure::untargeted(wrong, silent as f64, remark),
            _ if failure.leaves_encoders_sound() => {
                Figure::at_most(format!("{wrong}, or stuck in error"), count(&|o| o.silent || o.early) as f64, 0.0, remark)
            }
            _ => Figure::at_most(wrong, silent as f64, 0.0, remark),
        });
        if failure.has_name() {
            let unnamed = count(&|o| o.named > SOON && (o.visible || !failure.freezes())) as f64;
            table.push(Figure::at_most(
                format!("{label}: not named within 0.2 s"),
                unnamed,
                most_of(UNNAMED, runs),
                format!("of {runs}"),
            ));
        }
    }
    let failures: [(&str, Scene, Failure); 9] = [
        ("frozen, swing", swing, Failure::Frozen),
        ("frozen, fall", falling, Failure::Frozen),
        ("zero, swing", swing, Failure::Zero),
        ("off by 0.1 rad, swing", swing, Failure::Jump(0.1)),
        ("off by 0.1 rad, fall", falling, Failure::Jump(0.1)),
        ("swapped, swing", swing, Failure::Swapped),
        ("missing, swing", swing, Failure::Missing),
        ("wrong assembly, swing", swing, Failure::Assembly),
        ("nothing, swing", swing, Failure::Nothing),
    ];
    for (name, scene, failure) in failures {
        for tolerance in [1e-6, 1e-9] {
            let times =
                (0..runs.div_ceil(4)).map(|seed| dearest(scene, &Random::new(first + 7_910_000 + seed), failure, tolerance));
            let [dearest, usual] = times.fold([0.0_f64; 2], |most, each| [most[0].max(each[0]), most[1].max(each[1])]);
            let remark = format!("{:.3} ms in the median", 1e3 * usual);
            let label = format!("{name}, tolerance {tolerance:.0e} rad: dearest sample, ms");
            table.push(Figure::at_most(label, 1e3 * dearest, DEAREST, remark));
        }
    }
    table
}
