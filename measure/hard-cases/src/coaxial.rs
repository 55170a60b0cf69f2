//! Random machines with coaxial motors on every branch of their closure, with every effect and every method: if a motion completes with
//! OK, is its end correct and its energy balanced?
//!
//! The judge is the program of `independent.rs` and `sticking.rs`, which uses the equations of a single branch. A second run of it from a
//! slightly changed start determines the allowed error of an end.

use std::f64::consts::{PI, TAU};
use std::fmt;
use std::io::{self, Write};

use fivebar::effects::Law;
use fivebar::integrator::StepError;
use fivebar::observers;
use fivebar::simulation::bindings::default_parameters;
use fivebar::simulation::{FailureCause, Inputs, Parameters, Simulation};
use rayon::prelude::*;

use crate::cases::kinks;
use crate::ends::apart;
use crate::independent::{Closure, Independent, Motion};
use crate::machine::{NO_LOAD, leg_to};
use crate::random::Random;
use crate::report::{csv_table, markdown_table};
use crate::setting::Setting;

/// Pattern of link lengths in the order 1-2-3-4; equal letters are equal lengths.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Lengths {
    Pairs([[usize; 2]; 2]),
    Equal,
    NearlyEqual,
    Different,
}

/// Pairs of links, numbered from 0, that may have equal lengths.
const PAIRINGS: [[[usize; 2]; 2]; 3] = [[[0, 3], [1, 2]], [[0, 2], [1, 3]], [[0, 1], [3, 2]]];

const NEARLY_EQUAL: &str = "nearly equal lengths";

const LENGTHS: [(&str, Lengths); 6] = [
    ("lengths abba", Lengths::Pairs(PAIRINGS[0])),
    ("lengths abab", Lengths::Pairs(PAIRINGS[1])),
    ("lengths aabb", Lengths::Pairs(PAIRINGS[2])),
    ("lengths aaaa", Lengths::Equal),
    (NEARLY_EQUAL, Lengths::NearlyEqual),
    ("lengths abcd", Lengths::Different),
];

const EFFECTS: [&str; 14] = [
    "gravity",
    "no gravity",
    "viscous",
    "smooth friction",
    "friction that sticks",
    "springs",
    "stops",
    "contact",
    "contact that sticks",
    "servo",
    "payload",
    "torques that change",
    "all effects",
    "all effects, friction sticks",
];

/// Macro step and communication step, s.
const STEP: f64 = 1e-3;
/// Change of the start, rad and rad/s.
const NUDGE: f64 = 1e-9;
/// Sensitivity of an end, rad, above which the judge cannot decide.
const UNKNOWN: f64 = 0.1;

/// A method with its requirements.
struct Judged {
    setting: Setting,
    /// Allowed error of the end, expressed as the change of the start with the same effect, rad and rad/s: the sum of local errors of some
    /// hundred steps, with a reserve of ten.
    end: f64,
    /// Largest |energy.error|, J.
    energy: f64,
    /// Whether it controls its error. Its requirements then also apply to stiff loads and loads with kinks, which fixed steps do not
    /// resolve.
    by_error: bool,
}

const fn by_error(setting: Setting, end: f64, energy: f64) -> Judged {
    Judged { setting, end, energy, by_error: true }
}

/// Energies are up to 1 J. At 1e-11 rad the judge's own error, 2e-13 rad and 2e-12 rad/s per step, also matters. `i3alp` takes some
/// thousand steps. Its rates are of lower order than its angles, and so are its ends and its energy. Motions on a wrong branch are off by
/// 1e-2 rad and more.
const JUDGED: [Judged; 7] = [
    by_error(Setting::Dop853(1e-11), 3e-7, 1e-8),
    by_error(Setting::Automatic(1e-11), 3e-7, 1e-8),
    by_error(Setting::Tolerance(1e-11), 1e-5, 1e-6),
    by_error(Setting::Dop853(3e-9), 1e-5, 1e-6),
    by_error(Setting::Automatic(3e-9), 1e-5, 1e-6),
    by_error(Setting::Default, 1e-4, 1e-5),
    // The error of fixed steps is of second order: (8 rad/s · 1/4 ms)² in a second.
    Judged { setting: Setting::Conserving(2.5e-4), end: 1e-3, energy: 1e-6, by_error: false },
];

/// A scene with its number.
#[derive(Clone, Debug)]
struct Scene {
    number: u64,
    lengths: &'static str,
    effect: &'static str,
    parameters: Parameters,
    closure: Closure,
    start: Motion,
    /// Inputs, and the number of macro steps with each.
    spans: Vec<(Inputs, u64)>,
}

impl Scene {
    /// Successive numbers go through all effects, and combine each effect with other lengths every time.
    fn new(number: u64) -> Self {
        let random = &mut Random::new(number);
        let (round, turn) = (number as usize / EFFECTS.len(), number as usize % EFFECTS.len());
        let effect = EFFECTS[turn];
        let (lengths, kind) = LENGTHS[(turn + round) % LENGTHS.len()];
        let mut parameters = default_parameters();
        parameters.geometry.base_distance = 0.0;
        parameters.settings.step_size = STEP;
        let closure = links(random, &mut parameters, kind);
        let start = start(random, &parameters, closure);
        parameters.start.theta = [start[0], start[3]];
        let count = (random.uniform(0.1, 0.5) / STEP) as u64;
        let mut scene = Self { number, lengths, effect, parameters, closure, start, spans: vec![(NO_LOAD, count)] };
        scene.switch_on(random);
        scene
    }

    /// Enables its effects.
    fn switch_on(&mut self, random: &mut Random) {
        let is = |names: &[&str]| names.contains(&self.effect) || self.effect.starts_with("all effects");
        let sticks = self.effect.ends_with("sticks");
        let all = &mut self.parameters.effects;
        all.gravity.enabled = !is(&["no gravity"]) || random.sign() > 0.0;
        if is(&["viscous"]) {
            all.viscous.enabled = true;
            all.viscous.b = all.viscous.b.map(|_| random.log_uniform(1e-5, 1e-2));
        }
        if is(&["smooth friction", "friction that sticks"]) {
            let friction = &mut all.friction;
            (friction.enabled, friction.law) = (true, if sticks { Law::Stick } else { Law::Smooth });
            for joint in 0..5 {
                friction.coulomb[joint] = random.log_uniform(1e-4, 3e-2);
                friction.breakaway[joint] = friction.coulomb[joint] * random.uniform(1.0, 1.5);
            }
            friction.breakaway_velocity = random.log_uniform(0.1, 0.5);
        }
        if is(&["springs"]) {
            all.spring.enabled = true;
            all.spring.k = all.spring.k.map(|_| random.log_uniform(1e-2, 1.0));
            all.spring.theta0 = self.parameters.start.theta.map(|theta| theta + random.uniform(-1.0, 1.0));
        }
        if is(&["payload"]) {
            all.payload.enabled = true;
            all.payload.mass = random.log_uniform(1e-3, 0.1);
        }
        let mut inputs = NO_LOAD;
        if is(&["servo"]) {
            let servo = &mut all.servo;
            servo.enabled = true;
            for motor in 0..2 {
                servo.kp[motor] = random.log_uniform(0.1, 10.0);
                servo.kd[motor] = random.log_uniform(1e-3, 0.1);
                servo.limit[motor] = random.log_uniform(0.03, 1.0);
                inputs.servo_theta[motor] = self.parameters.start.theta[motor] + random.uniform(-0.3, 0.3);
            }
        }
        let (torques, stops, touches) = (is(&["torques that change"]), is(&["stops"]), is(&["contact", "contact that sticks"]));
        if stops {
            kinks::limits(random, &mut self.parameters);
            self.parameters.effects.stop.width = random.log_uniform(1e-3, 1e-2);
        }
        let count = self.spans[0].1;
        self.spans = vec![(inputs, count)];
        if torques {
            self.spans.clear();
            for _ in 0..5 {
                inputs.tau = [random.uniform(-0.05, 0.05), random.uniform(-0.05, 0.05)];
                self.spans.push((inputs, count.div_ceil(5)));
            }
        }
        if touches {
            self.plane(random, if sticks { Law::Stick } else { Law::Smooth });
        }
    }

    /// A plane that the motion without it would pass by some distance.
    fn plane(&mut self, random: &mut Random, law: Law) {
        let angle = random.uniform(0.0, TAU);
        let (nx, ny) = (angle.cos(), angle.sin());
        let mut reach = f64::INFINITY;
        let program = Independent::on(self.closure, &self.parameters, &NO_LOAD);
        let mut look = |state: &Motion| {
            let [x, y] = program.tip(state);
            reach = reach.min(nx * x + ny * y);
        };
        look(&self.start);
        self.follow(self.start, STEP * 10.0, &mut look);
        let contact = &mut self.parameters.effects.contact;
        (contact.enabled, contact.law, contact.nx, contact.ny) = (true, law, nx, ny);
        // Folded legs keep the tip on the motor axes, so no plane may press it there.
        let folded = self.closure == Closure::Opposite(PAIRINGS[2]);
        contact.offset = if folded { -0.01 } else { reach + random.log_uniform(1e-5, 1e-2) };
        contact.k = random.log_uniform(1e3, 1e5);
        contact.d = if law == Law::Smooth && random.sign() > 0.0 { 0.0 } else { random.log_uniform(1.0, 20.0) };
        contact.width = random.log_uniform(1e-4, 1e-3);
        contact.mu = random.uniform(0.0, 0.5);
        contact.slip_velocity = 0.02;
    }

    /// End by the judge; calls `look` every `part` seconds. `None` if the judge fails.
    fn follow(&self, start: Motion, part: f64, look: &mut impl FnMut(&Motion)) -> Option<Motion> {
        let mut state = start;
        let merged = Independent::on(self.closure, &self.parameters, &NO_LOAD).merged(&self.start);
        for (inputs, count) in &self.spans {
            let program = Independent::on(self.closure, &merged, inputs);
            let duration = *count as f64 * STEP;
            let parts = (duration / part).ceil().max(1.0);
            for _ in 0..parts as u64 {
                state = program.followed(state, duration / parts)?;
                look(&state);
            }
        }
        Some(state)
    }

    /// Link angles at the end by the judge, and the difference from a run with a changed start, rad.
    fn expected(&self) -> Option<([f64; 4], f64)> {
        let program = Independent::on(self.closure, &self.parameters, &NO_LOAD);
        let end = |start| Some(angles(&self.follow(start, f64::INFINITY, &mut |_| ())?));
        let at = end(self.start)?;
        Some((at, apart(&at, &end(program.closed(self.start.map(|x| x + NUDGE)))?).max(NUDGE)))
    }

    /// Whether friction sticks; fixed steps refuse it.
    fn sticks(&self) -> bool {
        let effects = &self.parameters.effects;
        (effects.friction.enabled && effects.friction.law == Law::Stick)
            || (effects.contact.enabled && effects.contact.law == Law::Stick)
    }

    /// Whether loads are smooth and not stiff.
    fn is_gentle(&self) -> bool {
        let effects = &self.parameters.effects;
        ![effects.friction.enabled, effects.stop.enabled, effects.contact.enabled, effects.servo.enabled].contains(&true)
    }

    /// Runs a method from a start.
    fn run(&self, setting: Setting, start: &Motion) -> Run {
        let mut parameters = self.parameters.clone();
        setting.apply(&mut parameters);
        let mut run = Run { setting, energy: 0.0, end: Err(Ending::GivenUp(String::new())), off: None, wrong: None };
        let omega = std::array::from_fn(|link| start[4 + link]);
        let mut simulation = match Simulation::at(&parameters, &self.spans[0].0, angles(start), omega) {
            Ok(simulation) => simulation,
            Err(refusal) => return Run { end: Err(Ending::GivenUp(refusal.to_string())), ..run },
        };
        let parts = (STEP / parameters.settings.step_size).round() as u64;
        for (inputs, count) in &self.spans {
            for _ in 0..*count {
                if let Err(failure) = simulation.advance(inputs, STEP / parts as f64, parts) {
                    return Run { end: Err(Ending::of(&failure.cause)), ..run };
                }
                let error = observers::energies(simulation.model(), &simulation.state()).error.abs();
                run.energy = if error.is_nan() { f64::INFINITY } else { run.energy.max(error) };
            }
        }
        run.end = Ok(simulation.state().angles());
        run
    }

    /// Runs every method and judges the ends.
    fn find(self) -> Finding {
        let expected = self.expected();
        let alone = expected.is_none();
        let expected = expected.or_else(|| {
            let nudged = Independent::on(self.closure, &self.parameters, &NO_LOAD).closed(self.start.map(|x| x + NUDGE));
            let [at, beside] = [&self.start, &nudged].map(|start| self.run(JUDGED[0].setting, start).end.ok());
            Some((at?, apart(&at?, &beside?).max(NUDGE)))
        });
        let runs = JUDGED.iter().filter(|judged| judged.by_error || !self.sticks()).map(|judged| {
            let mut run = self.run(judged.setting, &self.start);
            let (Ok(end), true) = (&run.end, judged.by_error || self.is_gentle()) else { return run };
            if run.energy > judged.energy {
                run.wrong = Some(format!("energy.error is {:.1e} J, allowed {:e} J", run.energy, judged.energy));
            }
            // Fixed steps may leave a nearly singular posture on the other branch.
            if let Some((expected, growth)) = expected.filter(|_| judged.by_error || self.lengths != NEARLY_EQUAL) {
                let (off, allowed) = (apart(end, &expected), growth / NUDGE * judged.end);
                if allowed < UNKNOWN {
                    run.off = Some([off / allowed, off]);
                    if off > allowed || off.is_nan() {
                        run.wrong = Some(format!("ends {off:.1e} rad off, allowed {allowed:.1e} rad"));
                    }
                }
            }
            run
        });
        Finding { runs: runs.collect(), alone, scene: self }
    }
}

/// Lengths and masses of a machine, and one of the closure branches that its lengths allow.
fn links(random: &mut Random, parameters: &mut Parameters, kind: Lengths) -> Closure {
    let any = PAIRINGS[random.uniform(0.0, 3.0) as usize];
    let pairs = if let Lengths::Pairs(pairs) = kind { pairs } else { any };
    let length = random.uniform(0.15, 0.3);
    let ratio = random.uniform(0.5, 0.95);
    let equal = kind == Lengths::Equal || (kind == Lengths::NearlyEqual && random.sign() > 0.0);
    let [one, other] = if random.sign() > 0.0 { [1.0, ratio] } else { [ratio, 1.0] };
    let nearly = random.log_uniform(1e-6, 1e-2);
    for (link, part) in parameters.geometry.links.iter_mut().enumerate() {
        part.length = length
            * if equal {
                1.0
            } else if pairs[0].contains(&link) {
                one
            } else {
                other
            };
        match kind {
            Lengths::NearlyEqual => part.length *= 1.0 + nearly * random.uniform(-1.0, 1.0),
            Lengths::Different => part.length = random.uniform(0.12, 0.3),
            Lengths::Pairs(_) | Lengths::Equal => {}
        }
        part.mass = random.uniform(0.005, 0.04);
        part.com = part.length * random.uniform(0.3, 0.7);
        part.inertia = part.mass * part.length.powi(2) * random.uniform(0.05, 0.12);
    }
    match kind {
        Lengths::NearlyEqual | Lengths::Different => Closure::Tip,
        Lengths::Pairs(_) if random.sign() > 0.0 => Closure::Mirrored(pairs),
        Lengths::Pairs(_) | Lengths::Equal => Closure::Opposite(pairs),
    }
}

/// A motion on the branch: in one of five scenes at rest, in one of five near a posture with all links in line.
fn start(random: &mut Random, parameters: &Parameters, closure: Closure) -> Motion {
    let lengths = parameters.geometry.lengths();
    let near = (random.uniform(0.0, 1.0) < 0.2).then(|| random.sign() * random.log_uniform(1e-5, 1e-1));
    let [direction, posture] = [0; 2].map(|_| random.uniform(-PI, PI));
    let sides = [0; 2].map(|_| random.sign());
    let mut vectors = [direction; 4];
    match closure {
        Closure::Opposite([long, short]) => {
            let other = near.map_or(posture, |near| near + if sides[0] > 0.0 { 0.0 } else { PI });
            (vectors[long[1]], vectors[short[0]], vectors[short[1]]) = (direction + PI, direction + other, direction + other + PI);
        }
        Closure::Mirrored(pairs) => {
            let longer = usize::from(lengths[pairs[1][0]] > lengths[pairs[0][0]]);
            let (long, short) = (pairs[longer], pairs[1 - longer]);
            let beta = near.map_or(posture, |near| sides[0] * PI / 2.0 + near);
            let alpha = sides[1] * (-lengths[short[0]] / lengths[long[0]] * beta.cos()).acos();
            for (pair, opening) in [(long, alpha), (short, beta)] {
                (vectors[pair[0]], vectors[pair[1]]) = (direction + opening, direction - opening);
            }
        }
        Closure::Tip => {
            let [a, b, c, d] = lengths;
            let (least, most) = ((a - b).abs().max((c - d).abs()), (a + b).min(c + d));
            let reach = least + (most - least) * random.uniform(0.02, 0.98);
            let tip = [reach * direction.cos(), reach * direction.sin()];
            let [left, right] = [([a, b], sides[0]), ([d, c], sides[1])].map(|(leg, side)| leg_to(0.0, leg, tip, side));
            vectors = [left[0], left[1], right[1] + PI, right[0] + PI];
        }
    }
    let fastest = if random.uniform(0.0, 1.0) < 0.2 { 0.0 } else { 8.0 };
    let near_branch = std::array::from_fn(|i| match i {
        0 | 1 => vectors[i],
        2 | 3 => vectors[i] - PI,
        _ => random.uniform(-fastest, fastest),
    });
    Independent::on(closure, parameters, &NO_LOAD).closed(near_branch)
}

fn angles(state: &Motion) -> [f64; 4] {
    std::array::from_fn(|link| state[link])
}

/// Early end of a run, with the message.
#[derive(Clone, Debug)]
enum Ending {
    /// fmi2Discard.
    GivenUp(String),
    /// By the unit's own checks.
    Stopped(String),
}

impl Ending {
    fn of(cause: &FailureCause) -> Self {
        match cause {
            FailureCause::Step(
                StepError::Imbalance { .. } | StepError::SignWithoutSingularity { .. } | StepError::BranchChange,
            ) => Self::Stopped(cause.to_string()),
            _ => Self::GivenUp(cause.to_string()),
        }
    }
}

/// Result of a scene with one method.
#[derive(Clone, Debug)]
struct Run {
    setting: Setting,
    /// Worst |energy.error|, J.
    energy: f64,
    /// Link angles at the end, rad.
    end: Result<[f64; 4], Ending>,
    /// Distance of the end from the expected one, relative to the allowed distance and in rad, if the judge can decide.
    off: Option<[f64; 2]>,
    /// Objection to a run that completed with OK.
    wrong: Option<String>,
}

/// A scene with all methods.
#[derive(Clone, Debug)]
struct Finding {
    scene: Scene,
    runs: Vec<Run>,
    /// Whether the judge failed; then `dop853` at 1e-11 rad replaces it.
    alone: bool,
}

impl Finding {
    /// A line for every early or wrong end.
    fn complaints(&self) -> impl Iterator<Item = String> {
        let Scene { number, lengths, effect, closure, .. } = &self.scene;
        self.runs.iter().filter_map(move |run| {
            let what = match (&run.end, &run.wrong) {
                (_, Some(wrong)) => format!("WRONG: {wrong}"),
                (Err(Ending::Stopped(sentence)), _) => format!("stopped: {sentence}"),
                (Err(Ending::GivenUp(sentence)), _) => format!("given up: {sentence}"),
                (Ok(_), None) => return None,
            };
            let alone = if self.alone { ", without the second program" } else { "" };
            let Run { setting, .. } = run;
            Some(format!("{number}, {effect}, {lengths}, {closure:?}, {} {}{alone}: {what}", setting.method(), setting.label()))
        })
    }
}

/// All scenes of a kind.
#[derive(Clone, Debug)]
pub struct Coaxial {
    kind: &'static str,
    scenes: usize,
    runs: usize,
    /// Scenes on which the judge failed.
    alone: usize,
    /// Runs that cannot be judged.
    unknown: usize,
    /// Largest distance from the expected end, relative to the allowed distance and in rad, and its run.
    off: ([f64; 2], String),
    /// Largest |energy.error| of a judged run, J, and its run.
    energy: (f64, String),
    given_up: Seen,
    stopped: Seen,
    wrong: Seen,
}

/// Number of occurrences, and the first run.
#[derive(Clone, Debug, Default)]
struct Seen {
    count: usize,
    first: String,
}

impl Seen {
    fn note(&mut self, run: &str, sentence: &str) {
        if self.count == 0 {
            self.first = format!("{run}: {sentence}");
        }
        self.count += 1;
    }
}

impl Coaxial {
    fn of<'a>(kind: &'static str, findings: impl Iterator<Item = &'a Finding>) -> Self {
        let none = Seen::default;
        let mut row = Self {
            kind,
            scenes: 0,
            runs: 0,
            alone: 0,
            unknown: 0,
            off: ([0.0; 2], String::new()),
            energy: (0.0, String::new()),
            given_up: none(),
            stopped: none(),
            wrong: none(),
        };
        for finding in findings {
            row.scenes += 1;
            row.alone += usize::from(finding.alone);
            for run in &finding.runs {
                row.runs += 1;
                let name = format!("{} {} {}", finding.scene.number, run.setting.method(), run.setting.label());
                match &run.end {
                    Err(Ending::GivenUp(sentence)) => row.given_up.note(&name, sentence),
                    Err(Ending::Stopped(sentence)) => row.stopped.note(&name, sentence),
                    Ok(_) => row.unknown += usize::from(run.off.is_none()),
                }
                if let Some(wrong) = &run.wrong {
                    row.wrong.note(&name, wrong);
                }
                if let Some(off) = run.off.filter(|off| off[0] > row.off.0[0]) {
                    row.off = (off, name.clone());
                }
                if run.energy > row.energy.0 {
                    row.energy = (run.energy, name);
                }
            }
        }
        row
    }

    /// Whether no run completes with OK at a wrong end.
    pub fn is_met(&self) -> bool {
        self.wrong.count == 0
    }

    /// Row of a table.
    fn cells(&self) -> [String; 12] {
        let seen = |seen: &Seen| if seen.count == 0 { "0".into() } else { format!("{}, first {}", seen.count, seen.first) };
        let ([part, off], by) = &self.off;
        [
            self.kind.to_owned(),
            self.scenes.to_string(),
            self.runs.to_string(),
            self.alone.to_string(),
            self.unknown.to_string(),
            format!("{part:.1e}"),
            format!("{off:.1e}"),
            by.clone(),
            format!("{:.1e}, {}", self.energy.0, self.energy.1),
            seen(&self.given_up),
            seen(&self.stopped),
            seen(&self.wrong),
        ]
    }
}

impl fmt::Display for Coaxial {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.cells().join(" | "))
    }
}

const HEADER: [&str; 12] = [
    "kind",
    "scenes",
    "runs",
    "scenes without the second program",
    "ends not judged",
    "worst end, of allowed",
    "its distance [rad]",
    "its run",
    "worst energy.error [J]",
    "given up",
    "stopped by a check",
    "wrong with OK",
];

/// Runs the scenes of these numbers and counts their runs by effect, by lengths, and in total. Each run that stops early or is wrong gives
/// `complain` a sentence.
pub fn measure(numbers: &[u64], complain: impl Fn(&str) + Sync) -> Vec<Coaxial> {
    let find = |number: &u64| {
        let finding = Scene::new(*number).find();
        finding.complaints().for_each(|complaint| complain(&complaint));
        finding
    };
    let findings: Vec<Finding> = numbers.par_iter().map(find).collect();
    let of =
        |kind: &'static str, is: &dyn Fn(&Scene) -> bool| Coaxial::of(kind, findings.iter().filter(|finding| is(&finding.scene)));
    let effects = EFFECTS.iter().map(|effect| of(effect, &|scene| scene.effect == *effect));
    let lengths = LENGTHS.iter().map(|(name, _)| of(name, &|scene| scene.lengths == *name));
    effects.chain(lengths).chain([of("all", &|_| true)]).filter(|row| row.scenes > 0).collect()
}

/// The rows as CSV.
pub fn write_csv(rows: &[Coaxial], to: impl Write) -> csv::Result<()> {
    csv_table(HEADER, rows.iter().map(Coaxial::cells), to)
}

/// The rows in Markdown.
pub fn write_markdown(rows: &[Coaxial], mut to: impl Write) -> io::Result<()> {
    markdown_table(HEADER, rows.iter().map(Coaxial::cells), &mut to)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The judge ignores a tilted gravity, so no method ends where it expects, although the energy balance holds.
    #[test]
    fn motions_that_end_elsewhere_are_noticed() {
        let mut scene = Scene::new(0);
        scene.spans[0].1 = 100;
        assert_eq!((scene.effect, scene.closure), ("gravity", Closure::Opposite(PAIRINGS[0])));
        scene.parameters.effects.gravity.tilt = 0.1;
        let finding = scene.find();
        let row = Coaxial::of("all", [&finding].into_iter());
        assert_eq!((row.runs, row.wrong.count, row.is_met()), (JUDGED.len(), JUDGED.len(), false), "{row}");
        assert!(finding.complaints().all(|complaint| complaint.contains("WRONG: ends")));
    }
}
