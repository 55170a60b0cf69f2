//! A stand-in for a five-bar gripper with servo drives, as real ones are: the unit believes a servo gain that is 50 % off, and does not know
//! the delay of the commands. Samples each 10 ms, encoder steps of 0.63 mrad, commands that step from sample to sample at 4 rad/s.

use std::collections::VecDeque;

use fivebar::effects::Inputs;
use fivebar::estimator::{MEASURED, Measured};
use fivebar::mechanism::Link;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Following, Method, Parameters, Signal, Simulation};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::is_nightly;

/// Macro step and time between samples, s.
const H: f64 = 1e-3;
const PERIOD: f64 = 0.01;
/// Encoder step, rad.
const QUANTUM: f64 = 0.63e-3;
/// Delay of the commands, in macro steps.
const DELAY: usize = 17;
/// Rate of the commands, rad/s.
const SPEED: f64 = 4.0;

/// Uniform in [0, 1).
fn uniform(random: &mut ChaCha8Rng) -> f64 {
    random.next_u64() as f64 / 2f64.powi(64)
}

/// Gripper: links of 60 and 80 mm, geared drives.
fn gripper(kp: f64) -> Parameters {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.04;
    for (link, (length, mass)) in
        parameters.geometry.links.iter_mut().zip([(0.06, 0.02), (0.08, 0.015), (0.08, 0.015), (0.06, 0.02)])
    {
        *link = Link { length, mass, inertia: mass * length * length / 12.0, com: length / 2.0 };
    }
    parameters.start.theta = [2.2, 0.9];
    parameters.settings.method = Method::Automatic;
    let effects = &mut parameters.effects;
    effects.gravity.enabled = false;
    (effects.servo.enabled, effects.servo.kp, effects.servo.kd) = (true, [kp; 2], [0.02; 2]);
    effects.servo.limit = [0.6; 2];
    effects.rotor.enabled = true;
    effects.rotor.inertia = [2e-4; 2];
    let own = &mut parameters.estimator;
    own.enabled = true;
    (own.sigma, own.quantum) = ([0.0; 2], [QUANTUM; 2]);
    parameters
}

/// Commands at each sample: moves at 4 rad/s to targets within 0.4 rad of the start, and pauses of 0 to 0.6 s.
struct Plan {
    now: [f64; 2],
    target: [f64; 2],
    pause: [f64; 2],
    centre: [f64; 2],
}

impl Plan {
    fn of(parameters: &Parameters) -> Self {
        let centre = parameters.start.theta;
        Self { now: centre, target: centre, pause: [0.3, 0.5], centre }
    }

    fn next(&mut self, random: &mut ChaCha8Rng) -> [f64; 2] {
        for i in 0..2 {
            if self.now[i] != self.target[i] {
                self.now[i] += (self.target[i] - self.now[i]).clamp(-SPEED * PERIOD, SPEED * PERIOD);
            } else if self.pause[i] > 0.0 {
                self.pause[i] -= PERIOD;
            } else {
                self.target[i] = self.centre[i] + 0.8 * uniform(random) - 0.4;
                self.pause[i] = 0.6 * uniform(random);
            }
        }
        self.now
    }
}

/// Outcome of a run.
#[derive(Default)]
struct Figures {
    /// Alarms after the first second.
    alarms: usize,
    /// Normalised squares.
    innovations: Vec<f64>,
    /// Errors and half-widths of 95 % bands of both angles, rad, 0.1 and 0.5 s ahead.
    ahead: [Vec<[f64; 2]>; 2],
}

/// Value that a share of the values do not exceed.
fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}

/// Forecast of the measured angles, rad, with their standard deviations.
struct Prediction {
    sample: usize,
    theta: [f64; 2],
    sigma: [f64; 2],
}

/// Follows a machine whose commands arrive late, and forecasts every 50 ms along the last command.
fn follow(machine: &Parameters, believed: &Parameters, seconds: f64, seed: u64) -> Figures {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut plan = Plan::of(machine);
    let at = |servo_theta: [f64; 2]| Inputs { servo_theta, ..default_inputs() };
    let mut truth = Simulation::new(machine, &at(plan.now)).expect("a machine");
    let mut following = Following::new(believed, &at(plan.now)).expect("a scene");
    let mut on_the_way: VecDeque<[f64; 2]> = std::iter::repeat_n(plan.now, DELAY).collect();
    let mut figures = Figures::default();
    let (samples, steps) = ((seconds / PERIOD).round() as usize, (PERIOD / H).round() as usize);
    let mut alarmed = false;
    let mut readings = Vec::new();
    let mut predictions: [Vec<Prediction>; 2] = Default::default();
    for sample in 0..samples {
        let time = sample as f64 * PERIOD;
        let command = plan.next(&mut random);
        let theta = MEASURED.map(|link| (truth.state().angles()[link] / QUANTUM).round() * QUANTUM);
        readings.push(theta);
        following.correct(&Measured { theta, time: [time; 2] }, time);
        if time > 1.0 {
            figures.innovations.push(following.estimator().nis());
            let alarm = following.estimator().alarm();
            figures.alarms += usize::from(alarm && !alarmed);
            alarmed = alarm;
        }
        following.advance_along(&Signal::held(at(command)), H, 1).expect("a step");
        if time > 1.0 && sample % 5 == 0 {
            let mut ahead = following.clone();
            for (place, until) in [10_usize, 50].into_iter().enumerate() {
                let from = [1, 10 * steps][place];
                ahead.advance_along(&Signal::held(at(command)), H, (until * steps - from) as u64).expect("a forecast");
                let (motion, sigma) = (ahead.motion(), ahead.sigmas()[0]);
                predictions[place].push(Prediction {
                    sample: sample + until,
                    theta: MEASURED.map(|link| motion.theta[link]),
                    sigma: MEASURED.map(|link| sigma[link]),
                });
            }
        }
        following.advance_along(&Signal::held(at(command)), H, (steps - 1) as u64).expect("a step");
        for _ in 0..steps {
            on_the_way.push_back(command);
            let arrived = on_the_way.pop_front().expect("a command");
            truth.advance(&at(arrived), H, 1).expect("a step");
        }
    }
    for (place, predictions) in predictions.iter().enumerate() {
        for Prediction { sample, theta, sigma } in predictions.iter().filter(|each| each.sample < readings.len()) {
            for i in 0..2 {
                let width = 1.959_964 * sigma[i].hypot(QUANTUM / 12f64.sqrt());
                figures.ahead[place].push([(readings[*sample][i] - theta[i]).abs(), width]);
            }
        }
    }
    figures
}

/// With a torque scale of the size of the unmodelled torques (the servos' errors of gain and delay, up to their limit of 0.6 N·m) and with the
/// changes of the commands as `fivebar import` measures them: no more than a false alarm a minute, at least 90 % of the innovations and
/// forecasts inside their 95 % bands, and median half-widths of at most 4 times the 95th percentile of the errors.
///
/// With the start values of both there are 121 to 169 alarms a minute, and 31 to 35 % of the forecasts 0.5 s ahead are inside.
#[test]
fn a_gripper_with_another_gain_and_delay_is_followed() {
    for kp in [0.5, 1.5] {
        let (machine, mut believed) = (gripper(1.0), gripper(kp));
        believed.estimator.torque_scale = 1.0;
        // Root mean square of the changes of these commands within 0.1 s, rad.
        believed.estimator.command_scale_theta = [0.13; 2];
        // The first second is not judged. Allowed are one false alarm in a minute, and none in half a minute.
        let (seconds, most) = if is_nightly() { (61.0, 1) } else { (31.0, 0) };
        let figures = follow(&machine, &believed, seconds, 1);
        assert!(figures.alarms <= most, "{kp}: {} alarms", figures.alarms);
        let share = |inside: usize, all: usize| inside as f64 / all as f64;
        // χ² of two readings at 95 %.
        let inside = figures.innovations.iter().filter(|nis| **nis < 5.991_465).count();
        let innovations = share(inside, figures.innovations.len());
        assert!(innovations >= 0.9, "{kp}: {innovations} of the innovations");
        for (place, ahead) in figures.ahead.iter().enumerate() {
            let forecasts = share(ahead.iter().filter(|[error, width]| error < width).count(), ahead.len());
            let error = quantile(ahead.iter().map(|[error, _]| *error).collect(), 0.95);
            let width = quantile(ahead.iter().map(|[_, width]| *width).collect(), 0.5);
            assert!(forecasts >= 0.9 && width <= 4.0 * error, "{kp}, {place}: {forecasts}, {width} of {error}");
        }
    }
}
