//! A machine without code of this library: two arms with two links each, connected at the tip by a joint with backlash, integrated by
//! Runge-Kutta of order 4 in steps of 10 µs. Link lengths differ from the twin's by up to 0.5 %; encoders are eccentric; samples are 2 ms
//! old.

use fivebar::estimator::{Measured, Status};
use fivebar::simulation::Signal;
use fivebar::simulation::bindings::default_inputs;

use crate::machine::{COARSE, Encoder, FINE, Random, Scenario, desk, no_inputs, start_off, tip};
use crate::report::{Figure, Table};
use crate::scores::holds;

/// Play of the joint at the tip, m; stiffness, N/m, and damping, N·s/m, beyond the play.
const JOINT: [f64; 3] = [2e-5, 2e5, 20.0];
/// Eccentricity e of the encoders, rad: angle + e sin(angle + phase).
const ECCENTRICITY: f64 = 3e-4;
/// Largest relative error of link lengths.
const TOLERANCE: f64 = 5e-3;
/// Delay of the samples, s.
const DELAY: f64 = 2e-3;
const STEP: f64 = 1e-5;
const G: f64 = 9.81;

/// An arm of two links: lengths, m, masses, kg, and inertias about the centres of mass, kg·m²; these are at mid-length.
#[derive(Clone, Copy)]
struct Arm {
    base: f64,
    length: [f64; 2],
    mass: [f64; 2],
    inertia: [f64; 2],
}

/// Angles and rates of both arms: proximal and distal of the left, then of the right.
type State = [f64; 8];

impl Arm {
    /// Position and velocity of the end.
    fn end(&self, [p, d, wp, wd]: [f64; 4]) -> [f64; 4] {
        let [a, b] = self.length;
        [
            self.base + a * p.cos() + b * d.cos(),
            a * p.sin() + b * d.sin(),
            -a * p.sin() * wp - b * d.sin() * wd,
            a * p.cos() * wp + b * d.cos() * wd,
        ]
    }

    /// Accelerations under gravity and a force on the end, by Lagrange's equations of the double pendulum.
    fn accelerations(&self, [p, d, wp, wd]: [f64; 4], [fx, fy]: [f64; 2]) -> [f64; 2] {
        let ([a, b], [m, n], [i, j]) = (self.length, self.mass, self.inertia);
        let (c, e) = (a / 2.0, b / 2.0);
        let (m11, m12, m22) = (i + m * c * c + n * a * a, n * a * e * (p - d).cos(), j + n * e * e);
        let coriolis = n * a * e * (p - d).sin();
        let q1 = -coriolis * wd * wd - (m * c + n * a) * G * p.cos() - a * p.sin() * fx + a * p.cos() * fy;
        let q2 = coriolis * wp * wp - n * e * G * d.cos() - b * d.sin() * fx + b * d.cos() * fy;
        let determinant = m11 * m22 - m12 * m12;
        [(m22 * q1 - m12 * q2) / determinant, (m11 * q2 - m12 * q1) / determinant]
    }
}

struct Foreign {
    arms: [Arm; 2],
    state: State,
}

impl Foreign {
    fn rates(&self, s: &State) -> State {
        let (left, right) = ([s[0], s[1], s[2], s[3]], [s[4], s[5], s[6], s[7]]);
        let (one, other) = (self.arms[0].end(left), self.arms[1].end(right));
        let apart = [other[0] - one[0], other[1] - one[1]];
        let distance = apart[0].hypot(apart[1]);
        let [play, k, c] = JOINT;
        let force = if distance > play {
            let along = [apart[0] / distance, apart[1] / distance];
            let opening = (other[2] - one[2]) * along[0] + (other[3] - one[3]) * along[1];
            let pull = (k * (distance - play) + c * opening).max(0.0);
            [pull * along[0], pull * along[1]]
        } else {
            [0.0; 2]
        };
        let a = self.arms[0].accelerations(left, force);
        let b = self.arms[1].accelerations(right, [-force[0], -force[1]]);
        [s[2], s[3], a[0], a[1], s[6], s[7], b[0], b[1]]
    }

    fn advance(&mut self, seconds: f64) {
        for _ in 0..(seconds / STEP).round() as u64 {
            let s = self.state;
            let plus = |h: f64, r: &State| -> State { std::array::from_fn(|i| s[i] + h * r[i]) };
            let k1 = self.rates(&s);
            let k2 = self.rates(&plus(STEP / 2.0, &k1));
            let k3 = self.rates(&plus(STEP / 2.0, &k2));
            let k4 = self.rates(&plus(STEP, &k3));
            self.state = std::array::from_fn(|i| s[i] + STEP / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]));
        }
    }

    /// The middle of the joint.
    fn tip(&self) -> [f64; 2] {
        let s = &self.state;
        let (one, other) = (self.arms[0].end([s[0], s[1], 0.0, 0.0]), self.arms[1].end([s[4], s[5], 0.0, 0.0]));
        [(one[0] + other[0]) / 2.0, (one[1] + other[1]) / 2.0]
    }
}

/// A fall of the desk machine with wrong link lengths.
fn machine(scenario: &Scenario, random: &mut Random) -> Option<Foreign> {
    let mut links = scenario.truth.geometry.links;
    for link in &mut links {
        link.length *= random.between(1.0 - TOLERANCE, 1.0 + TOLERANCE);
    }
    let arm = |base: f64, p: usize, d: usize| Arm {
        base,
        length: [links[p].length, links[d].length],
        mass: [links[p].mass, links[d].mass],
        inertia: [links[p].inertia, links[d].inertia],
    };
    let arms = [arm(0.0, 0, 1), arm(scenario.truth.geometry.base_distance, 3, 2)];
    let [p, q] = scenario.truth.start.theta;
    let elbows = [0, 1].map(|i| {
        let angle = [p, q][i];
        [arms[i].base + arms[i].length[0] * angle.cos(), arms[i].length[0] * angle.sin()]
    });
    // The tip is to the left of the arrow from the left to the right elbow.
    let arrow = [elbows[1][0] - elbows[0][0], elbows[1][1] - elbows[0][1]];
    let distance = arrow[0].hypot(arrow[1]);
    let [a, b] = [arms[0].length[1], arms[1].length[1]];
    let along = (a * a - b * b + distance * distance) / (2.0 * distance);
    let across = (a * a - along * along).max(0.0).sqrt();
    if across < 0.05 {
        return None;
    }
    let unit = [arrow[0] / distance, arrow[1] / distance];
    let top = [elbows[0][0] + along * unit[0] - across * unit[1], elbows[0][1] + along * unit[1] + across * unit[0]];
    let angle = |from: [f64; 2]| (top[1] - from[1]).atan2(top[0] - from[0]);
    Some(Foreign { arms, state: [p, angle(elbows[0]), 0.0, 0.0, q, angle(elbows[1]), 0.0, 0.0] })
}

/// Fraction of samples with the tip within its 95 % ellipse; fraction with the tip inside or a status that warns about the bands; largest
/// error, m.
fn honesty(encoder: &Encoder, random: &mut Random) -> Option<[f64; 4]> {
    let mut model = desk();
    model.estimator.max_delay = 2.0 * DELAY;
    model.start.theta = [random.between(1.7, 2.4), random.between(0.7, 1.4)];
    let truth = model.clone();
    start_off(&mut model, random, [0.02, 0.0]);
    // A user's model: eccentricity as encoder noise, the tolerance as length errors.
    model.estimator.sigma0_length = TOLERANCE * model.geometry.links[0].length / 3f64.sqrt();
    let scenario = Scenario { model, truth, course: no_inputs, plan: Default::default(), duration: 1.5, from: None };
    let mut foreign = machine(&scenario, random)?;
    let configured = Encoder { sigma: ECCENTRICITY, ..*encoder };
    let mut twin = scenario.twin(&configured);
    let phase = random.between(0.0, std::f64::consts::TAU);
    let mut line = std::collections::VecDeque::new();
    let (mut inside, mut honest, mut count, mut worst, mut squares) = (0.0, 0.0, 0.0, 0.0_f64, 0.0);
    for step in 0..(scenario.duration / 1e-3) as u64 {
        let time = step as f64 * 1e-3;
        let angles =
            [foreign.state[0], foreign.state[4]].map(|angle| encoder.read(angle + ECCENTRICITY * (angle + phase).sin(), random));
        line.push_back(Measured { theta: angles, time: [time; 2] });
        if let Some(sample) = line.front().copied().filter(|sample| sample.time[0] <= time - DELAY + 1e-9) {
            line.pop_front();
            twin.correct(&sample, time);
        }
        if time > 0.2 {
            let ([x, y], [v, w]) = (foreign.tip(), tip(twin.simulation(), &twin.state_for(&default_inputs())));
            let [dx, dy] = [x - v, y - w];
            let within = holds(twin.tip_covariance(), [dx, dy]);
            let warned = !matches!(twin.status(), Status::Following);
            inside += f64::from(u8::from(within));
            honest += f64::from(u8::from(within || warned));
            worst = worst.max(dx.hypot(dy));
            squares += dx * dx + dy * dy;
            count += 1.0;
        }
        twin.advance_along(&Signal::held(default_inputs()), 1e-3, 1).ok()?;
        foreign.advance(1e-3);
    }
    Some([inside / count, honest / count, worst, (squares / count).sqrt()])
}

/// Checks that bands stay honest.
pub fn table(runs: u64, first: u64) -> Table {
    let mut table = Table::new("A truth from other code: lengths 0.5 % off, eccentric encoders, 2 ms of delay, backlash");
    for encoder in [COARSE, FINE] {
        let outcomes: Vec<[f64; 4]> =
            (0..runs).filter_map(|seed| honesty(&encoder, &mut Random::new(first + 7_900_000 + seed))).collect();
        let mean = |i: usize| outcomes.iter().map(|outcome| outcome[i]).sum::<f64>() / outcomes.len() as f64;
        let remark = format!("of {} runs", outcomes.len());
        table.push(Figure::untargeted(format!("{}: tip within its 95 % ellipse, %", encoder.name), 100.0 * mean(0), remark));
        table.push(Figure::between(
            format!("{}: within, or the status says so, %", encoder.name),
            100.0 * mean(1),
            [90.0, 100.0],
            String::new(),
        ));
        table.push(Figure::untargeted(
            format!("{}: tip error, mm", encoder.name),
            1e3 * mean(3),
            format!("largest {:.2}", 1e3 * mean(2)),
        ));
    }
    table
}
