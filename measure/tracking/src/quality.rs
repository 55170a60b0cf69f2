//! Error of the tip while following a machine, by scene.

use fivebar::effects::Inputs;
use fivebar::estimator::Status;
use fivebar::simulation::bindings::default_inputs;
use fivebar::simulation::{Method, Parameters};

use crate::machine::{
    COARSE, Encoder, FINE, Plan, Random, Scenario, desk, five_percent, follow, minimum_jerk, no_inputs, side, start_off,
};
use crate::report::{Figure, Table, median};

/// Errors of the twin's start, rad and rad/s.
const START: [f64; 2] = [0.02, 0.2];
/// Beginning left out, s.
pub const SETTLED: f64 = 0.1;

/// The pick of `scenes/pick_and_place.json`.
pub fn pick_course(time: f64, _: &Plan) -> Inputs {
    let (go, go_rate) = minimum_jerk((time - 0.2) / 0.5);
    let (back, back_rate) = minimum_jerk((time - 0.9) / 0.5);
    let (part, rate) = (go - back, (go_rate - back_rate) / 0.5);
    Inputs { servo_theta: [2.7567 - 0.9601 * part, 1.345 - 0.9601 * part], servo_omega: [-0.9601 * rate; 2], ..default_inputs() }
}

/// Servos that follow sines.
pub fn sines_course(time: f64, plan: &Plan) -> Inputs {
    let rate = [7.0, 5.0];
    let theta = [2.0, 1.1];
    let angle = |i: usize| theta[i] + 0.25 * (rate[i] * time + plan.phase[i]).sin();
    let speed = |i: usize| 0.25 * rate[i] * (rate[i] * time + plan.phase[i]).cos();
    Inputs { servo_theta: [angle(0), angle(1)], servo_omega: [speed(0), speed(1)], ..default_inputs() }
}

/// Torques on both motors that swing the machine through singularities.
pub fn driven_course(time: f64, plan: &Plan) -> Inputs {
    let torque = |i: usize| 0.05 * (6.0 * time + plan.phase[i]).sin() + 0.03 * (17.0 * time + plan.phase[i + 2]).sin();
    Inputs { tau: [torque(0), torque(1)], ..default_inputs() }
}

/// Gains of servos.
pub fn servos(parameters: &mut Parameters, kp: f64, kd: f64) {
    let servo = &mut parameters.effects.servo;
    servo.enabled = true;
    (servo.kp, servo.kd) = ([kp; 2], [kd; 2]);
}

/// Random phases.
pub fn plan(random: &mut Random) -> Plan {
    Plan { phase: std::array::from_fn(|_| random.between(0.0, std::f64::consts::TAU)), from: f64::INFINITY, ..Plan::default() }
}

/// The pick with an unknown payload.
pub fn pick(random: &mut Random) -> Scenario {
    let mut model = desk();
    model.effects.gravity.enabled = false;
    servos(&mut model, 20.0, 0.5);
    model.start.theta = [2.7567, 1.345];
    let mut truth = model.clone();
    truth.effects.payload.enabled = true;
    truth.effects.payload.mass = 0.02;
    start_off(&mut model, random, START);
    Scenario { model, truth, course: pick_course, plan: plan(random), duration: 1.6, from: None }
}

/// A free fall from any posture; if `percent`, with masses 5 % off.
pub fn fall(random: &mut Random, percent: bool) -> Scenario {
    let mut model = desk();
    // Start angles for which the distal links reach each other, including errors of the start.
    model.start.theta = loop {
        let theta = [random.between(1.6, 2.6), random.between(0.5, 1.5)];
        let apart = [0.1 + 0.21 * (theta[1].cos() - theta[0].cos()), 0.21 * (theta[1].sin() - theta[0].sin())];
        if (0.05..0.38).contains(&apart[0].hypot(apart[1])) {
            break theta;
        }
    };
    model.start.omega = [random.between(-2.0, 2.0), random.between(-2.0, 2.0)];
    let truth = if percent { five_percent(&model, random) } else { model.clone() };
    start_off(&mut model, random, START);
    Scenario { model, truth, course: no_inputs, plan: plan(random), duration: 2.0, from: None }
}

/// A fall driven by torques.
pub fn driven(random: &mut Random) -> Scenario {
    Scenario { course: driven_course, ..fall(random, true) }
}

/// Servos on sines, masses 5 % off.
pub fn sines(random: &mut Random, duration: f64) -> Scenario {
    let mut model = desk();
    servos(&mut model, 1.0, 0.01);
    let plan = plan(random);
    let start = sines_course(0.0, &plan);
    (model.start.theta, model.start.omega) = (start.servo_theta, start.servo_omega);
    let truth = five_percent(&model, random);
    start_off(&mut model, random, START);
    Scenario { model, truth, course: sines_course, plan, duration, from: None }
}

/// Servos on sines, with unknown friction.
pub fn friction(random: &mut Random) -> Scenario {
    let mut scenario = sines(random, 2.0);
    scenario.truth = Parameters { geometry: scenario.model.geometry, ..scenario.truth };
    scenario.truth.effects.friction.enabled = true;
    scenario.truth.settings.method = Method::I3alp;
    scenario
}

/// A push of 0.5 N on the tip in a random direction, while servos follow sines.
pub fn push(random: &mut Random) -> Scenario {
    let mut scenario = sines(random, 1.5);
    let angle = random.between(0.0, std::f64::consts::TAU);
    scenario.plan.push = [0.5 * angle.cos(), 0.5 * angle.sin()];
    scenario.plan.from = 0.5;
    scenario
}

/// Outcome of following a machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outcome {
    /// Root mean square of the tip's error, m.
    pub rms: f64,
    /// Mean NEES.
    pub nees: f64,
    /// Whether the final error exceeds 10 mm, or the final side is wrong.
    pub lost: bool,
    /// Whether several branches were still followed at the end.
    pub open: bool,
}

/// Follows a scenario.
pub fn outcome(scenario: &Scenario, encoder: &Encoder, h: f64, random: &mut Random) -> Outcome {
    let (mut sum, mut nees, mut count) = (0.0, 0.0, 0u32);
    let (mut end, mut wrong, mut open) = (0.0, false, false);
    let done = follow(scenario, encoder, h, random, |at| {
        let (theta, omega) = crate::machine::motion(at.truth);
        if at.time >= SETTLED {
            sum += at.tip_error * at.tip_error;
            nees += at.twin.nees(&theta, &omega).min(1e4);
            count += 1;
        }
        end = at.tip_error;
        open = at.twin.status() == Status::TwoBranches;
        wrong = side(&theta) * side(&crate::machine::motion(at.estimate).0) < 0.0;
    });
    let lost = done.is_err() || end > 0.01 || (wrong && end > 0.001);
    Outcome { rms: (sum / f64::from(count)).sqrt(), nees: nees / f64::from(count), lost, open }
}

type Scene = fn(&mut Random) -> Scenario;

/// Tip errors and NEES by scene and encoder.
pub fn table(seeds: u64, first: u64) -> Table {
    let scenes: [(&str, Scene, [f64; 2], bool); 7] = [
        ("pick, 20 g unknown", pick, [0.12, 0.008], false),
        ("free fall", |random| fall(random, false), [0.09, 0.012], true),
        ("fall, masses 5 % off", |random| fall(random, true), [0.24, 0.029], true),
        ("driven, masses 5 % off", driven, [0.24, 0.029], true),
        ("sines, masses 5 % off", |random| sines(random, 2.0), [0.24, 0.029], true),
        ("friction unknown", friction, [0.48, 0.018], true),
        ("push of 0.5 N", push, [0.18, 0.020], true),
    ];
    let mut table = Table::new("Tip error at 1 ms, mm (root of the mean square over all runs), lost runs, NEES (ideal 4)");
    for (name, scene, most, judged) in scenes {
        for (encoder, most) in [COARSE, FINE].into_iter().zip(most) {
            let outcomes: Vec<Outcome> = (0..seeds)
                .map(|seed| {
                    let mut random = Random::new(first + 7_100_000 + seed);
                    let scenario = scene(&mut random);
                    outcome(&scenario, &encoder, 1e-3, &mut random)
                })
                .collect();
            let mean = |of: &dyn Fn(&Outcome) -> f64| outcomes.iter().map(of).sum::<f64>() / seeds as f64;
            let rms = 1e3 * mean(&|o| o.rms * o.rms).sqrt();
            let lost = outcomes.iter().filter(|o| o.lost).count();
            let nees = mean(&|o| o.nees);
            let label = format!("{name}, {}", encoder.name);
            table.push(Figure::at_most(
                format!("{label}: tip, mm"),
                rms,
                most,
                format!("median {:.4}", 1e3 * median(outcomes.iter().map(|o| o.rms))),
            ));
            table.push(Figure::at_most(format!("{label}: lost"), lost as f64, 0.0, format!("of {seeds}")));
            if judged {
                table.push(Figure::between(format!("{label}: NEES"), nees, [2.0, 6.5], String::new()));
            } else {
                table.push(Figure::untargeted(format!("{label}: NEES"), nees, "stiff servos at rest: not judged".into()));
            }
        }
    }
    table
}
