//! Item 9 of the battery: random scenes with kinks in their loads: slow and fast impacts, stops, saturating drives, friction, all of them
//! together, and friction that sticks. Judged by a separate program, `independent.rs` with `sticking.rs`.

use std::f64::consts::TAU;
use std::sync::OnceLock;

use fivebar::effects::Law;
use fivebar::observers;
use fivebar::simulation::bindings::default_parameters;
use fivebar::simulation::{Inputs, Parameters, Simulation};

use super::{Case, Extent};
use crate::ends::Goal;
use crate::machine::NO_LOAD;
use crate::random::Random;
use crate::setting::Setting;
use crate::trial::{Span, Trial};
use crate::watch::Watch;

/// Generator of a random scene: parameters, inputs, and duration, s.
pub(crate) type Scene = fn(&mut Random) -> (Parameters, Inputs, f64);

/// The kinds of scenes, by name.
pub(crate) const KINDS: [(&str, Scene); 10] = [
    ("slow touches", slow_touch),
    ("fast touches", fast_touch),
    ("stops", stops),
    ("drives and friction", drives),
    ("all loads with kinks", everything),
    ("stick and slip", stick_and_slip),
    ("holding under gravity", holding),
    ("drives against friction that sticks", drives_that_stick),
    ("sticking on a plane", sticking_on_a_plane),
    ("all loads, and all friction sticks", everything_sticks),
];

pub(super) fn cases(extent: Extent) -> Vec<Case> {
    trials(&Vec::from_iter(0..extent.pick(200, 3))).into_iter().map(|(name, trials)| case(name, trials)).collect()
}

/// Scenes of every kind with these numbers.
pub(crate) fn trials(numbers: &[u64]) -> Vec<(&'static str, Vec<Trial>)> {
    let of_kind = |(kind, (name, scene)): (usize, (&'static str, Scene))| {
        let trials = numbers.iter().map(|&number| trial(scene, 1000 * (kind as u64 + 1) + number, number));
        (name, trials.collect())
    };
    KINDS.into_iter().enumerate().map(of_kind).collect()
}

/// A scene of a kind by its seed and number.
fn trial(scene: Scene, seed: u64, number: u64) -> Trial {
    let (parameters, inputs, duration) = scene(&mut Random::new(seed));
    // Some 200 communication steps, each a whole number of milliseconds.
    let size = 1e-3 * (duration / 0.2).ceil();
    let span = Span { inputs, size, count: (duration / size).ceil() as u64 };
    let duration = span.duration();
    Trial {
        schedule: vec![span],
        watch: Watch::Follows { goal: Box::new(Goal { parameters: parameters.clone(), inputs, duration }), end: OnceLock::new() },
        ..Trial::free(format!("scene {number}"), parameters, duration)
    }
}

fn case(name: &'static str, trials: Vec<Trial>) -> Case {
    Case {
        also: "the end is that of an independent program",
        explicit_energy: 1e-6,
        settings: vec![Setting::Default, Setting::TIGHT, Setting::EXPLICIT, Setting::AUTOMATIC],
        // 1 µJ and a third of it.
        ..Case::new(9, name, [2.85e-5, 9.5e-6], trials)
    }
}

/// A machine with motors 10 cm apart, at a regular posture.
fn machine(random: &mut Random, fastest: f64) -> Parameters {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.1;
    parameters.start.theta = [random.uniform(1.8, 2.4), random.uniform(0.7, 1.3)];
    parameters.start.omega = [random.uniform(-fastest, fastest), random.uniform(-fastest, fastest)];
    parameters
}

/// A plane that the free motion would pass by some distance.
fn plane(random: &mut Random, parameters: &mut Parameters, inputs: &Inputs, duration: f64, [shallow, deep]: [f64; 2]) {
    let angle = random.uniform(0.0, TAU);
    let normal = [angle.cos(), angle.sin()];
    let mut reach = f64::INFINITY;
    if let Ok(mut free) = Simulation::new(parameters, inputs) {
        for _ in 0..100 {
            let tip = observers::motion(free.model(), &free.state()).tip;
            reach = reach.min(normal[0] * tip.x + normal[1] * tip.y);
            if free.advance(inputs, duration / 100.0, 1).is_err() {
                break;
            }
        }
    }
    let contact = &mut parameters.effects.contact;
    contact.enabled = true;
    // Rounded, so that round-off of the library does not change the scene.
    let reach = 1e-6 * (1e6 * reach).ceil();
    (contact.nx, contact.ny, contact.offset) = (normal[0], normal[1], reach + random.log_uniform(shallow, deep));
    contact.k = random.log_uniform(1e3, 1e7);
    contact.d = if random.sign() > 0.0 { 0.0 } else { random.log_uniform(0.1, 20.0) };
    contact.width = random.log_uniform(1e-6, 1e-4);
    contact.mu = random.uniform(0.0, 0.5);
}

fn slow_touch(random: &mut Random) -> (Parameters, Inputs, f64) {
    let mut parameters = machine(random, 0.05);
    parameters.effects.gravity.enabled = false;
    let duration = random.uniform(2.0, 6.0);
    plane(random, &mut parameters, &NO_LOAD, duration, [1e-6, 5e-5]);
    (parameters, NO_LOAD, duration)
}

fn fast_touch(random: &mut Random) -> (Parameters, Inputs, f64) {
    let mut parameters = machine(random, 5.0);
    let duration = random.uniform(0.1, 0.4);
    plane(random, &mut parameters, &NO_LOAD, duration, [1e-6, 1e-2]);
    (parameters, NO_LOAD, duration)
}

/// Stops at the motors.
pub(crate) fn limits(random: &mut Random, parameters: &mut Parameters) {
    let stop = &mut parameters.effects.stop;
    stop.enabled = true;
    for motor in 0..2 {
        let theta = parameters.start.theta[motor];
        // Some start inside a stop.
        stop.lower[motor] = theta - random.uniform(-0.02, 0.5);
        stop.upper[motor] = f64::max(theta + random.uniform(-0.02, 0.5), stop.lower[motor] + 0.05);
    }
    stop.k = random.log_uniform(5.0, 5e3);
    stop.d = if random.sign() > 0.0 { 0.0 } else { random.log_uniform(1e-3, 0.5) };
    stop.width = random.log_uniform(1e-5, 1e-2);
}

fn stops(random: &mut Random) -> (Parameters, Inputs, f64) {
    let mut parameters = machine(random, 5.0);
    limits(random, &mut parameters);
    (parameters, NO_LOAD, random.uniform(0.1, 0.4))
}

fn driven(random: &mut Random, parameters: &mut Parameters) -> Inputs {
    let servo = &mut parameters.effects.servo;
    servo.enabled = true;
    for motor in 0..2 {
        servo.kp[motor] = random.log_uniform(0.1, 1e3);
        servo.kd[motor] = random.log_uniform(1e-3, 1.0);
        servo.limit[motor] = random.log_uniform(0.01, 1.0);
    }
    let friction = &mut parameters.effects.friction;
    friction.enabled = true;
    for joint in 0..5 {
        friction.coulomb[joint] = random.log_uniform(1e-4, 1e-2);
        friction.breakaway[joint] = friction.coulomb[joint] * random.uniform(1.0, 1.5);
    }
    friction.breakaway_velocity = random.log_uniform(0.01, 0.3);
    let theta = parameters.start.theta;
    Inputs { servo_theta: [0, 1].map(|motor| theta[motor] + random.uniform(-0.3, 0.3)), ..NO_LOAD }
}

fn drives(random: &mut Random) -> (Parameters, Inputs, f64) {
    let mut parameters = machine(random, 2.0);
    let inputs = driven(random, &mut parameters);
    (parameters, inputs, random.uniform(0.1, 0.4))
}

fn everything(random: &mut Random) -> (Parameters, Inputs, f64) {
    let parameters = machine(random, 3.0);
    loaded(random, parameters)
}

fn loaded(random: &mut Random, mut parameters: Parameters) -> (Parameters, Inputs, f64) {
    let mut inputs = driven(random, &mut parameters);
    inputs.tau = [random.uniform(-0.02, 0.02), random.uniform(-0.02, 0.02)];
    parameters.effects.viscous.enabled = true;
    parameters.effects.spring.enabled = true;
    limits(random, &mut parameters);
    let duration = random.uniform(0.1, 0.3);
    plane(random, &mut parameters, &inputs, duration, [1e-6, 1e-2]);
    (parameters, inputs, duration)
}

/// A soft servo pulls against friction that drops when it starts to slip.
fn stick_and_slip(random: &mut Random) -> (Parameters, Inputs, f64) {
    let mut parameters = machine(random, 0.0);
    coaxial(random, &mut parameters);
    parameters.effects.gravity.enabled = random.sign() > 0.0;
    let inputs = driven(random, &mut parameters);
    let friction = &mut parameters.effects.friction;
    friction.law = Law::Stick;
    for joint in 0..5 {
        friction.breakaway[joint] = friction.coulomb[joint] * random.uniform(1.0, 3.0);
    }
    friction.breakaway_velocity = random.log_uniform(1e-3, 0.3);
    parameters.effects.servo.kd = [0.0; 2];
    (parameters, inputs, random.uniform(0.2, 0.6))
}

/// Friction of the motors holds the machine, or nearly: links come to rest or slide down.
fn holding(random: &mut Random) -> (Parameters, Inputs, f64) {
    let mut parameters = machine(random, 1.0);
    coaxial(random, &mut parameters);
    let friction = &mut parameters.effects.friction;
    (friction.enabled, friction.law) = (true, Law::Stick);
    for joint in 0..5 {
        let scale = if joint == 0 || joint == 4 { random.log_uniform(0.01, 0.1) } else { random.log_uniform(1e-4, 1e-2) };
        (friction.coulomb[joint], friction.breakaway[joint]) = (scale, scale * random.uniform(1.0, 1.5));
    }
    friction.breakaway_velocity = random.log_uniform(0.01, 0.3);
    parameters.effects.viscous.enabled = random.sign() > 0.0;
    (parameters, NO_LOAD, random.uniform(0.2, 0.6))
}

fn drives_that_stick(random: &mut Random) -> (Parameters, Inputs, f64) {
    let mut parameters = machine(random, 2.0);
    coaxial(random, &mut parameters);
    let inputs = driven(random, &mut parameters);
    parameters.effects.friction.law = Law::Stick;
    (parameters, inputs, random.uniform(0.1, 0.4))
}

/// Half of the machines have coaxial motors: their inner joints turn, stop and stick together.
fn coaxial(random: &mut Random, parameters: &mut Parameters) {
    if random.sign() > 0.0 {
        parameters.geometry.base_distance = 0.0;
    }
}

/// A hand presses the tip onto a plane and pushes it along; the tip sticks or slips.
fn sticking_on_a_plane(random: &mut Random) -> (Parameters, Inputs, f64) {
    let mut parameters = machine(random, 1.0);
    coaxial(random, &mut parameters);
    let force = random.log_uniform(0.1, 3.0);
    let angle = random.uniform(0.0, TAU);
    let inputs = Inputs { tip_force: [force * angle.cos(), force * angle.sin()], ..NO_LOAD };
    parameters.effects.gravity.enabled = random.sign() > 0.0;
    // Without a damper the tip would never come to rest.
    parameters.effects.viscous.enabled = true;
    let friction = &mut parameters.effects.friction;
    (friction.enabled, friction.law) = (random.sign() > 0.0, Law::Stick);
    for joint in 0..5 {
        friction.coulomb[joint] = random.log_uniform(1e-4, 1e-2);
        friction.breakaway[joint] = friction.coulomb[joint] * random.uniform(1.0, 1.5);
    }
    let duration = random.uniform(0.1, 0.4);
    plane(random, &mut parameters, &inputs, duration, [1e-6, 1e-2]);
    let contact = &mut parameters.effects.contact;
    contact.law = Law::Stick;
    (contact.k, contact.d, contact.mu) = (random.log_uniform(1e3, 1e5), random.log_uniform(1.0, 20.0), random.uniform(0.1, 0.8));
    (parameters, inputs, duration)
}

fn everything_sticks(random: &mut Random) -> (Parameters, Inputs, f64) {
    let mut parameters = machine(random, 3.0);
    coaxial(random, &mut parameters);
    let (mut parameters, inputs, duration) = loaded(random, parameters);
    parameters.effects.friction.law = Law::Stick;
    parameters.effects.contact.law = Law::Stick;
    (parameters, inputs, duration)
}
