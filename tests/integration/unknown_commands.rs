//! Forecasts that do not know the future commands: counted coverage of their bands, and equal bits while samples arrive.

use fivebar::effects::Inputs;
use fivebar::estimator::{Bands, MEASURED, Measured};
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Following, Method, Parameters, Signal, Simulation};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::is_nightly;

const H: f64 = 1e-3;
/// Macro steps until the forecast begins, and until its errors are judged.
const FOLLOWED: u32 = 200;
const AHEAD: [u32; 2] = [100, 500];
/// Number of forecasts, and the judged bands: their shares and half-widths in standard deviations.
const RUNS: u64 = 200;
const SHARES: [(f64, f64); 2] = [(0.9, 1.644_854), (0.95, 1.959_964)];

/// Commands that walk.
#[derive(Clone, Copy, Debug)]
enum What {
    Torques,
    References,
    /// References that act 50 ms late.
    LateReferences,
}

/// A normal random number (Box and Muller).
fn normal(random: &mut ChaCha8Rng) -> f64 {
    let mut uniform = || random.next_u64() as f64 / 2f64.powi(64);
    (-2.0 * (1.0 - uniform()).ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos()
}

/// A horizontal machine that nothing unknown disturbs.
fn machine(period: u32) -> Parameters {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.1;
    parameters.start.theta = [2.2, 0.9];
    parameters.settings.method = Method::Dop853;
    parameters.effects.gravity.enabled = false;
    let own = &mut parameters.estimator;
    own.enabled = true;
    own.take_geometry_as_exact();
    (own.sigma, own.sigma0_theta, own.sigma0_omega) = ([1e-4 * f64::from(period).sqrt(); 2], 1e-3, 1e-2);
    own.torque_scale = 1e-4;
    parameters
}

/// Commands that walk at random, by the standard deviations of their changes within 0.1 s.
struct Walk {
    inputs: Inputs,
    tau: [f64; 2],
    theta: [f64; 2],
}

impl Walk {
    fn of(parameters: &Parameters, scales: [[f64; 2]; 2]) -> Self {
        let inputs = Inputs { servo_theta: parameters.start.theta, ..default_inputs() };
        let [tau, theta] = scales.map(|scale| scale.map(|scale| scale * (H / 0.1).sqrt()));
        Self { inputs, tau, theta }
    }

    fn step(&mut self, random: &mut ChaCha8Rng) {
        for i in 0..2 {
            self.inputs.tau[i] += self.tau[i] * normal(random);
            self.inputs.servo_theta[i] += self.theta[i] * normal(random);
        }
    }
}

/// Errors of both motor angles in standard deviations of forecasts that hold the last commands.
fn errors(parameters: &Parameters, mut walk: Walk, period: u32, random: &mut ChaCha8Rng) -> [[f64; 2]; 2] {
    let mut truth = Simulation::new(parameters, &walk.inputs).expect("a machine");
    let mut following = Following::new(parameters, &walk.inputs).expect("a scene");
    for step in 0..FOLLOWED {
        if step % period == 0 {
            let time = f64::from(step) * H;
            let theta = MEASURED.map(|link| truth.state().angles()[link] + parameters.estimator.sigma[0] * normal(random));
            following.correct(&Measured { theta, time: [time; 2] }, time);
        }
        following.advance_along(&Signal::held(walk.inputs), H, 1).expect("a step");
        truth.advance(&walk.inputs, H, 1).expect("a step");
        walk.step(random);
    }
    let held = walk.inputs;
    let mut found = [[0.0; 2]; 2];
    for step in 1..=AHEAD[1] {
        following.advance_along(&Signal::held(held), H, 1).expect("a step");
        truth.advance(&walk.inputs, H, 1).expect("a step");
        walk.step(random);
        if let Some(place) = AHEAD.iter().position(|ahead| *ahead == step) {
            let (estimate, sigma) = (following.motion(), following.sigmas()[0]);
            found[place] = MEASURED.map(|link| (truth.state().angles()[link] - estimate.theta[link]) / sigma[link]);
        }
    }
    found
}

/// Shares of 200 runs within the 90 % and 95 % bands 0.1 and 0.5 s ahead. The bands assume constant commands if `known`.
fn coverage(what: What, (bands, period): (Bands, u32), known: bool) -> [[f64; 2]; 2] {
    let (scales, servo) = match what {
        What::Torques => ([[2e-3, 1e-3], [0.0; 2]], false),
        What::References | What::LateReferences => ([[0.0; 2], [0.03, 0.02]], true),
    };
    let mut parameters = machine(period);
    parameters.effects.servo.delay = if matches!(what, What::LateReferences) { 0.05 } else { 0.0 };
    parameters.effects.servo.enabled = servo;
    (parameters.effects.servo.kp, parameters.effects.servo.kd) = ([0.5; 2], [0.03; 2]);
    parameters.estimator.forecast = bands;
    if !known {
        [parameters.estimator.command_scale_tau, parameters.estimator.command_scale_theta] = scales;
    }
    let run = |seed: u64| {
        let mut random = ChaCha8Rng::seed_from_u64(4200 + seed);
        errors(&parameters, Walk::of(&parameters, scales), period, &mut random)
    };
    let runs: Vec<_> = (0..RUNS).map(run).collect();
    [0, 1].map(|place| {
        SHARES.map(|(_, width)| {
            let errors = || runs.iter().flat_map(|run| run[place]);
            errors().filter(|error| error.abs() <= width).count() as f64 / errors().count() as f64
        })
    })
}

/// Torques and servo references that walk at random with the intensities of `estimator.commandScale`: the counted coverage of the 90 % and
/// 95 % bands 0.1 and 0.5 s ahead agrees with these shares, by both methods of the bands. With samples each 10 ms the bands also contain the
/// unknown forces that so few samples do not exclude, so that more errors are inside. The short form takes three cases: each kind of
/// commands, both methods, both periods.
#[test]
fn bands_cover_commands_that_change() {
    let short =
        [(What::Torques, Bands::SigmaPoints, 1), (What::References, Bands::Linear, 10), (What::LateReferences, Bands::Linear, 1)];
    let others = [
        (What::Torques, Bands::Linear, 1),
        (What::Torques, Bands::Linear, 10),
        (What::References, Bands::Linear, 1),
        (What::References, Bands::SigmaPoints, 1),
    ];
    for (what, bands, period) in short.into_iter().chain(others.into_iter().filter(|_| is_nightly())) {
        let found = coverage(what, (bands, period), false);
        for (counted, (share, _)) in found.iter().flat_map(|found| found.iter().zip(SHARES)) {
            // Three standard deviations of the share, if both angles of a run err together.
            let most = 3.0 * (share * (1.0 - share) / RUNS as f64).sqrt();
            let off = counted - share;
            assert!(-most <= off && (off <= most || period > 1), "{what:?}, {bands:?}, each {period} ms: {found:?}");
        }
    }
}

/// The same machines, commands taken as constant: less than half of the errors are inside the 95 % bands 0.5 s ahead.
#[test]
fn bands_that_take_commands_as_constant_are_too_narrow() {
    for what in [What::Torques, What::References] {
        let [_, [_, far]] = coverage(what, (Bands::Linear, 1), true);
        assert!(far < 0.5, "{what:?}: {far}");
    }
}

/// The scales only widen the bands of forecasts: while samples arrive the estimate is the same to the bit, and so is the mean motion
/// without samples.
#[test]
fn unknown_commands_change_no_estimate() {
    let twins = [[0.0; 2], [1e-3, 2e-3]].map(|scale| {
        let mut parameters = machine(1);
        parameters.estimator.command_scale_tau = scale;
        Following::new(&parameters, &default_inputs()).expect("a scene")
    });
    let [mut constant, mut walks] = twins;
    for step in 0..300 {
        let time = f64::from(step) * H;
        if step < 200 {
            let measured = Measured { theta: [2.2, 0.9], time: [time; 2] };
            constant.correct(&measured, time);
            walks.correct(&measured, time);
        }
        for twin in [&mut constant, &mut walks] {
            twin.advance_along(&Signal::held(default_inputs()), H, 1).expect("a step");
        }
        assert_eq!(constant.motion(), walks.motion(), "{time} s");
        // The second step without a sample is the first one that reveals missing samples.
        if step < 201 {
            assert_eq!(constant.estimate(), walks.estimate(), "{time} s");
        }
    }
    // The assembly of a machine that has never moved is in doubt, which makes the bands of the distal links wide.
    for (narrow, wide) in constant.sigmas().iter().zip(&walks.sigmas()) {
        for link in MEASURED {
            assert!(wide[link] > 1.1 * narrow[link], "{wide:?} {narrow:?}");
        }
    }
}

/// A machine that swings without friction, followed for 0.2 s and then silent; both kinds of commands are unknown.
fn silent(bands: Bands, step: f64) -> Following {
    let mut parameters = machine(1);
    parameters.effects.gravity.enabled = true;
    parameters.effects.servo.enabled = true;
    (parameters.effects.servo.kp, parameters.effects.servo.kd) = ([0.01; 2], [0.0; 2]);
    parameters.settings.step_size = step;
    let own = &mut parameters.estimator;
    (own.forecast, own.command_scale_tau, own.command_scale_theta) = (bands, [2e-3, 1e-3], [0.03, 0.02]);
    let inputs = Inputs { servo_theta: parameters.start.theta, ..default_inputs() };
    let mut truth = Simulation::new(&parameters, &inputs).expect("a machine");
    let mut following = Following::new(&parameters, &inputs).expect("a scene");
    for k in 0..(0.2 / step).round() as u32 {
        let time = f64::from(k) * step;
        following.correct(&Measured { theta: MEASURED.map(|link| truth.state().angles()[link]), time: [time; 2] }, time);
        following.advance_along(&Signal::held(inputs), step, 1).expect("a step");
        truth.advance(&inputs, step, 1).expect("a step");
    }
    following
}

/// A stored state of a silent twin is restored after each step: the covariances with the errors by commands are symmetric to the bit.
#[test]
fn states_with_unknown_commands_are_restored() {
    for bands in [Bands::Linear, Bands::SigmaPoints] {
        let mut following = silent(bands, H);
        for step in 0..300 {
            following.advance_along(&Signal::held(default_inputs()), H, 1).expect("a step");
            let (run, estimate) = (following.simulation().run().clone(), Box::new(following.estimate().clone()));
            let restored = Following::restored(following.parameters(), run, estimate);
            assert!(restored.is_ok(), "{bands:?}, step {step}: {restored:?}");
        }
    }
}

/// A swing diverges by e-fold in less than a second; after 200 s of silence the bands are still finite, and the state is possible.
#[test]
fn bands_of_a_long_silence_are_finite() {
    for bands in [Bands::Linear, Bands::SigmaPoints] {
        let mut following = silent(bands, 1e-2);
        following.advance_along(&Signal::held(default_inputs()), 1e-2, 20_000).expect("steps");
        let [angles, rates] = following.sigmas();
        assert!(angles.iter().chain(&rates).chain(&following.tip_covariance()).all(|x| x.is_finite()), "{angles:?} {rates:?}");
        let (run, estimate) = (following.simulation().run().clone(), Box::new(following.estimate().clone()));
        assert!(Following::restored(following.parameters(), run, estimate).is_ok(), "{bands:?}");
    }
}

/// Commands that become known during a silence leave errors of the motion that grow with its rates.
#[test]
fn errors_by_commands_that_were_unknown_stay() {
    let mut following = silent(Bands::SigmaPoints, H);
    let silence = |following: &mut Following, steps: u64| {
        following.advance_along(&Signal::held(default_inputs()), H, steps).expect("steps");
        following.sigmas()[0][MEASURED[0]]
    };
    let begin = silence(&mut following, 100);
    let (effects, mut own) = (following.parameters().effects.clone(), following.parameters().estimator.clone());
    [own.command_scale_tau, own.command_scale_theta] = [[0.0; 2]; 2];
    following.tune(&effects, &own).expect("tunable parameters");
    let end = silence(&mut following, 100);
    assert!(end > 1.5 * begin, "{begin} {end}");
}
