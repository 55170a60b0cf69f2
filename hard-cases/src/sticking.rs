//! The same second program where friction in the joints sticks: between events a held joint is one more constraint with a multiplier; at
//! an event every pattern of joints that hold and slip is tried against the law. For joints only.

use fivebar::simulation::{Inputs, Parameters};

use crate::independent::{Independent, JOINTS, Motion, eliminate, extrapolate};

/// What a joint does.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Joint {
    Free,
    Slips(f64),
    Holds,
}

type Joints = [Joint; 5];

/// Rates below this, rad/s, are those of rest.
const SLOW: f64 = 1e-8;
/// The longest step, s: shorter than what lets a rate pass 0 twice.
const LONGEST: f64 = 1e-3;

/// A scene whose friction sticks.
pub struct Sticking<'a> {
    scene: &'a Parameters,
    program: Independent<'a>,
}

fn rate(state: &Motion, joint: usize) -> f64 {
    let (first, second) = JOINTS[joint];
    state[4 + first] - second.map_or(0.0, |second| state[4 + second])
}

impl<'a> Sticking<'a> {
    /// As [`Independent::new`].
    pub fn new(scene: &'a Parameters, inputs: &'a Inputs) -> Self {
        Self { scene, program: Independent::new(scene, inputs) }
    }

    /// After `duration` seconds; `None` where steps become too short or events too many.
    pub fn after(&self, start: Motion, duration: f64) -> Option<Motion> {
        let (mut state, mut time, mut wanted, mut events) = (start, 0.0, 1e-4_f64, 0);
        let mut joints = self.decided(&mut state);
        while duration - time > 1e-12 {
            // Nothing moves, and no input changes.
            if state[4..].iter().all(|rate| *rate == 0.0) && joints.iter().filter(|joint| **joint == Joint::Holds).count() > 1 {
                return Some(state);
            }
            let h = wanted.min(LONGEST).min(duration - time);
            if h < 1e-13 || events > 10_000 {
                return None;
            }
            let (end, error) = extrapolate(&|state| self.slope(state, &joints), &state, h);
            if error > 1.0 {
                wanted = h * (0.7 * error.powf(-0.2)).clamp(0.1, 0.9);
                continue;
            }
            if self.margin(&end, &joints) >= 0.0 {
                (state, time) = (self.program.closed(end), time + h);
                wanted = h * (0.7 * error.max(1e-12).powf(-0.2)).clamp(0.2, 4.0);
                continue;
            }
            let (end, h) = self.event(&state, &joints, h);
            (state, time, events) = (self.program.closed(end), time + h, events + 1);
            joints = self.decided(&mut state);
            wanted = 1e-4;
        }
        Some(state)
    }

    /// The end of the step that comes just beyond where its joints do something else: in halves.
    fn event(&self, from: &Motion, joints: &Joints, longest: f64) -> (Motion, f64) {
        let (mut before, mut beyond) = (0.0, longest);
        let step = |h: f64| extrapolate(&|state| self.slope(state, joints), from, h).0;
        for _ in 0..60 {
            let middle = 0.5 * (before + beyond);
            if self.margin(&step(middle), joints) >= 0.0 { before = middle } else { beyond = middle }
        }
        (step(beyond), beyond)
    }

    /// The least of what must not fall below 0: slip rates in their direction, and what holding joints have left.
    fn margin(&self, state: &Motion, joints: &Joints) -> f64 {
        let (_, torques) = self.accelerations(state, joints);
        let margins = (0..5).map(|joint| match joints[joint] {
            Joint::Free => f64::INFINITY,
            Joint::Slips(sign) => sign * rate(state, joint) + 1e-13,
            Joint::Holds => self.bound(joint, 0.0) - torques[joint].abs(),
        });
        margins.fold(f64::INFINITY, f64::min)
    }

    fn bound(&self, joint: usize, rate: f64) -> f64 {
        let friction = &self.scene.effects.friction;
        let u = rate / (std::f64::consts::SQRT_2 * friction.breakaway_velocity);
        friction.coulomb[joint] + (friction.breakaway[joint] - friction.coulomb[joint]) * (-u * u).exp()
    }

    fn slope(&self, state: &Motion, joints: &Joints) -> Motion {
        let (a, _) = self.accelerations(state, joints);
        [state[4], state[5], state[6], state[7], a[0], a[1], a[2], a[3]]
    }

    /// Accelerations, and the torques of the joints that hold. Two hold at most.
    fn accelerations(&self, state: &Motion, joints: &Joints) -> ([f64; 4], [f64; 5]) {
        let mut matrix = [[0.0; 9]; 8];
        for (row, equation) in self.program.equations(state).into_iter().enumerate() {
            matrix[row][..6].copy_from_slice(&equation[..6]);
            matrix[row][8] = equation[6];
        }
        let mut torques = [0.0; 5];
        let mut place = 6;
        for joint in 0..5 {
            let (first, second) = JOINTS[joint];
            let sides = [(Some(first), 1.0), (second, -1.0)];
            let links = || sides.into_iter().filter_map(|(link, sign)| link.map(|link| (link, sign)));
            match joints[joint] {
                Joint::Free => {}
                Joint::Slips(sign) => {
                    links().for_each(|(link, side)| matrix[link][8] -= side * sign * self.bound(joint, rate(state, joint)))
                }
                Joint::Holds => {
                    for (link, side) in links() {
                        matrix[place][link] = side;
                        matrix[link][place] = -side;
                    }
                    torques[joint] = place as f64;
                    place += 1;
                }
            }
        }
        for (unused, row) in matrix.iter_mut().enumerate().skip(place) {
            row[unused] = 1.0;
        }
        let solution = eliminate(matrix);
        let torques = torques.map(|place| if place > 0.0 { solution[place as usize] } else { 0.0 });
        ([solution[0], solution[1], solution[2], solution[3]], torques)
    }

    /// What the joints do from here on.
    fn decided(&self, state: &mut Motion) -> Joints {
        let rubs = |joint: &usize| self.scene.effects.friction.breakaway[*joint] > 0.0;
        let all: Vec<usize> = (0..5).filter(rubs).collect();
        if state[4..].iter().all(|rate| rate.abs() < 100.0 * SLOW) {
            let mut still = *state;
            still[4..].fill(0.0);
            let (violation, joints) = self.best(&still, &[Joint::Free; 5], &all, true);
            if violation < 1e-9 {
                *state = still;
                return joints;
            }
        }
        let mut joints = [Joint::Free; 5];
        for joint in &all {
            joints[*joint] = Joint::Slips(if rate(state, *joint) < 0.0 { -1.0 } else { 1.0 });
        }
        let zero: Vec<usize> = all.into_iter().filter(|joint| rate(state, *joint).abs() < SLOW).collect();
        self.best(state, &joints, &zero, false).1
    }

    /// Of all that some joints may do, with two of them holding or with one at most, what violates the law least.
    fn best(&self, state: &Motion, others: &Joints, zero: &[usize], rests: bool) -> (f64, Joints) {
        let mut best = (f64::INFINITY, *others);
        for code in 0..3_usize.pow(zero.len() as u32) {
            let mut joints = *others;
            let mut rest = code;
            for joint in zero {
                joints[*joint] = [Joint::Holds, Joint::Slips(1.0), Joint::Slips(-1.0)][rest % 3];
                rest /= 3;
            }
            let holding = zero.iter().filter(|joint| joints[**joint] == Joint::Holds).count();
            if if rests { holding != 2 } else { holding > 1 } {
                continue;
            }
            let (a, torques) = self.accelerations(state, &joints);
            let mut accelerated = [0.0; 8];
            accelerated[4..].copy_from_slice(&a);
            let violations = zero.iter().map(|joint| match joints[*joint] {
                Joint::Holds => torques[*joint].abs() / self.bound(*joint, 0.0) - 1.0,
                Joint::Slips(sign) if !rests => -sign * rate(&accelerated, *joint),
                Joint::Slips(_) | Joint::Free => 0.0,
            });
            let moved = if rests { 1e-3 * a.iter().fold(0.0, |most: f64, a| most.max(a.abs())) } else { 0.0 };
            let violation = violations.fold(moved, f64::max);
            if violation < best.0 {
                best = (violation, joints);
            }
        }
        best
    }
}
