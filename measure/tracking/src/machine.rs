//! A measured machine: a simulation with other parameters and a push unknown to the twin, and its encoders.

use std::collections::VecDeque;

use fivebar::effects::Inputs;
use fivebar::estimator::{MEASURED, Measured};
use fivebar::mechanism::coordinates::THETA;
use fivebar::observers;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Following, Method, Parameters, Signal, Simulation, State, StepFailure};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Random numbers that are the same on every platform.
#[derive(Clone, Debug)]
pub struct Random(ChaCha8Rng);

impl Random {
    /// Generator from a seed.
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform number between two values.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Normal number (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// An encoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoder {
    /// Name in tables.
    pub name: &'static str,
    /// White noise, rad.
    pub sigma: f64,
    /// Resolution, rad.
    pub quantum: f64,
}

/// 0.1 degrees.
pub const COARSE: Encoder = Encoder { name: "0.1 deg", sigma: 0.0, quantum: 0.1 * std::f64::consts::PI / 180.0 };
/// 14 bits.
pub const MEDIUM: Encoder = Encoder { name: "14 bit", sigma: 0.0, quantum: std::f64::consts::TAU / 16384.0 };
/// 16 bits.
pub const FINE: Encoder = Encoder { name: "16 bit", sigma: 0.0, quantum: std::f64::consts::TAU / 65536.0 };

impl Encoder {
    /// Reading of an angle, rad.
    pub fn read(&self, angle: f64, random: &mut Random) -> f64 {
        let noisy = if self.sigma > 0.0 { angle + self.sigma * random.normal() } else { angle };
        if self.quantum > 0.0 { (noisy / self.quantum).round() * self.quantum } else { noisy }
    }

    /// Configures the encoder in a twin's parameters.
    pub fn tell(&self, parameters: &mut Parameters) {
        parameters.estimator.enabled = true;
        parameters.estimator.sigma = [self.sigma; 2];
        parameters.estimator.quantum = [self.quantum; 2];
    }
}

/// Angles or rates of links 1 to 4.
pub type Links = [f64; 4];

/// Inputs as functions of time, s.
pub type Course = fn(f64, &Plan) -> Inputs;

/// Systematic error of an encoder.
#[derive(Clone, Copy, Debug, Default)]
pub struct Systematic {
    /// Mounting angle, rad.
    pub offset: f64,
    /// Amplitude and phase of the error by an eccentric disc, rad.
    pub eccentricity: [f64; 2],
    /// Relative error of the scale.
    pub scale: f64,
}

impl Systematic {
    /// Reading of an encoder without noise, rad.
    pub fn shown(&self, angle: f64) -> f64 {
        let [amplitude, phase] = self.eccentricity;
        (1.0 + self.scale) * angle + self.offset + amplitude * (angle + phase).sin()
    }

    /// Angle for a reading of an encoder without noise, rad.
    pub fn angle(&self, shown: f64) -> f64 {
        // Each iteration reduces the error by the slope of the systematic error, 2e-3 at most.
        (0..4).fold(shown, |angle, _| angle + (shown - self.shown(angle)))
    }
}

/// Random parts of a course.
#[derive(Clone, Copy, Debug, Default)]
pub struct Plan {
    /// Phases, rad.
    pub phase: [f64; 4],
    /// A push on the tip, N.
    pub push: [f64; 2],
    /// Time at which the push starts, s.
    pub from: f64,
    /// A hand as in `scenes/haptic.json`, repeated every 2 s: factors of force and speed; 0: none.
    pub hand: [f64; 2],
    /// Systematic errors of the encoders, unknown to the twin.
    pub systematic: [Systematic; 2],
    /// Interval without samples of both encoders, s.
    pub silent: [f64; 2],
    /// Delay from taking a sample to its arrival, with the time of the sample, s.
    pub delay: f64,
}

/// A scene of following.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Model of the twin.
    pub model: Parameters,
    /// Parameters of the machine.
    pub truth: Parameters,
    /// Inputs of both.
    pub course: Course,
    /// Random parts of the course.
    pub plan: Plan,
    /// Duration, s.
    pub duration: f64,
    /// Angles and rates of all links at the machine's start, if different from its parameters.
    pub from: Option<(Links, Links)>,
}

impl Scenario {
    /// The master's inputs, without the push.
    pub fn inputs(&self, time: f64) -> Inputs {
        (self.course)(time, &self.plan)
    }

    /// Inputs and push on the machine; its servos use its own encoders.
    pub fn acting(&self, time: f64) -> Inputs {
        let inputs = self.inputs(time);
        let [x, y] = if time >= self.plan.from { self.plan.push } else { [0.0; 2] };
        let [stronger, faster] = self.plan.hand;
        let [along, onto] = hand(faster * time % 2.0).map(|force| stronger * force);
        Inputs {
            tip_force: [inputs.tip_force[0] + x + along, inputs.tip_force[1] + y + onto],
            servo_theta: [0, 1].map(|i| self.plan.systematic[i].angle(inputs.servo_theta[i])),
            ..inputs
        }
    }

    /// Simulation of the machine.
    pub fn machine(&self) -> Simulation {
        let made = match self.from {
            Some((theta, omega)) => Simulation::at(&self.truth, &self.acting(0.0), theta, omega),
            None => Simulation::new(&self.truth, &self.acting(0.0)),
        };
        made.unwrap_or_else(|error| panic!("the machine: {error}"))
    }

    /// The twin, with a start and an encoder.
    pub fn twin(&self, encoder: &Encoder) -> Following {
        let mut model = self.model.clone();
        encoder.tell(&mut model);
        Following::new(&model, &self.inputs(0.0)).unwrap_or_else(|error| panic!("the twin: {error}"))
    }
}

/// The unit's start values, for a machine with exact lengths and encoders that are configured as exact.
pub fn exact() -> Parameters {
    let mut parameters = default_parameters();
    parameters.estimator.take_geometry_as_exact();
    parameters
}

/// A scenario with geometry errors at the unit's start values.
pub fn by_start_values(mut scenario: Scenario) -> Scenario {
    let (own, start) = (&mut scenario.model.estimator, default_parameters().estimator);
    (own.sigma0_length, own.sigma0_offset, own.sigma0_eccentricity) =
        (start.sigma0_length, start.sigma0_offset, start.sigma0_eccentricity);
    scenario
}

/// A scenario with learning at the unit's start values.
pub fn learned(scenario: Scenario) -> Scenario {
    let mut scenario = by_start_values(scenario);
    scenario.model.estimator.learn_enabled = true;
    scenario
}

/// The table-top machine of the prototypes' measurements.
pub fn desk() -> Parameters {
    let mut parameters = exact();
    parameters.geometry.base_distance = 0.1;
    parameters.settings.method = Method::Dop853;
    parameters
}

/// Masses and inertias up to 5 % off, independently for each link.
pub fn five_percent(parameters: &Parameters, random: &mut Random) -> Parameters {
    let mut other = parameters.clone();
    for link in &mut other.geometry.links {
        let factor = random.between(0.95, 1.05);
        link.mass *= factor;
        link.inertia *= factor;
    }
    other
}

/// Adds a small error to the twin's start.
pub fn start_off(model: &mut Parameters, random: &mut Random, [theta, omega]: [f64; 2]) {
    for i in 0..2 {
        model.start.theta[i] += theta * random.normal();
        model.start.omega[i] += omega * random.normal();
    }
}

/// Minimum jerk from 0 to 1: value and derivative.
pub fn minimum_jerk(part: f64) -> (f64, f64) {
    let s = part.clamp(0.0, 1.0);
    (s * s * s * (10.0 - 15.0 * s + 6.0 * s * s), 30.0 * s * s * (1.0 - s) * (1.0 - s))
}

/// Force of the hand of `scenes/haptic.json`, along the wall and onto it, N.
fn hand(time: f64) -> [f64; 2] {
    let along = [(0.8, 0.0), (0.9, 1.2), (1.0, 1.2), (1.1, 0.0)];
    let onto = [(0.0, 0.0), (0.2, -0.5), (0.6, -3.0), (1.2, -3.0), (1.4, 0.1), (1.8, 0.0)];
    let between = |at: &[(f64, f64)]| {
        let rise = |pair: &[(f64, f64)]| (pair[1].1 - pair[0].1) * minimum_jerk((time - pair[0].0) / (pair[1].0 - pair[0].0)).0;
        at.windows(2).map(rise).sum()
    };
    [between(&along), between(&onto)]
}

/// Zero inputs.
pub fn no_inputs(_: f64, _: &Plan) -> Inputs {
    default_inputs()
}

/// Angles and rates of links 1 to 4.
pub fn motion(state: &State) -> (Links, Links) {
    (state.angles(), THETA.map(|i| state.core.v[i]))
}

/// Position of the tip, m.
pub fn tip(simulation: &Simulation, state: &State) -> [f64; 2] {
    observers::motion(simulation.model(), state).tip.into()
}

/// sin(θ₃ − θ₂).
pub fn side(theta: &Links) -> f64 {
    (theta[2] - theta[1]).sin()
}

/// State of a run at an instant.
pub struct Instant<'a> {
    /// Time, s.
    pub time: f64,
    /// The machine's state.
    pub truth: &'a State,
    /// The estimate, after the correction.
    pub estimate: &'a State,
    /// The twin.
    pub twin: &'a Following,
    /// Error of the tip, m, in x and y.
    pub off: [f64; 2],
    /// Size of the error of the tip, m.
    pub tip_error: f64,
}

/// Follows a machine in steps of h; calls `look` after each sample has been used.
pub fn follow(
    scenario: &Scenario,
    encoder: &Encoder,
    h: f64,
    random: &mut Random,
    mut look: impl FnMut(&Instant),
) -> Result<(), StepFailure> {
    let (mut machine, mut twin) = (scenario.machine(), scenario.twin(encoder));
    let mut measured = Measured::default();
    let mut on_the_way = VecDeque::new();
    let Plan { silent: [hushed, back], delay, systematic, .. } = scenario.plan;
    for step in 0..(scenario.duration / h).round() as u64 {
        let time = step as f64 * h;
        let truth = machine.state();
        let (theta, _) = motion(&truth);
        if !(hushed..back).contains(&time) {
            on_the_way.push_back(Measured {
                theta: [0, 1].map(|i| encoder.read(systematic[i].shown(theta[MEASURED[i]]), random)),
                time: [time; 2],
            });
        }
        // Half a step is added for round-off of times.
        while let Some(arrived) = on_the_way.pop_front_if(|sample| sample.time[0] <= time - delay + 0.5 * h) {
            measured = arrived;
        }
        twin.correct(&measured, time);
        let inputs = scenario.inputs(time);
        let estimate = twin.state_for(&inputs);
        let ([x, y], [v, w]) = (tip(&machine, &truth), tip(twin.simulation(), &estimate));
        let off = [x - v, y - w];
        look(&Instant { time, truth: &truth, estimate: &estimate, twin: &twin, off, tip_error: off[0].hypot(off[1]) });
        // Machine and twin use the inputs at the middle of the step.
        let macro_steps = (h / 1e-3).round().max(1.0);
        let middle = time + h / 2.0;
        twin.advance_along(&Signal::held(scenario.inputs(middle)), h / macro_steps, macro_steps as u64)?;
        machine.advance(&scenario.acting(middle), h / macro_steps, macro_steps as u64)?;
    }
    Ok(())
}
