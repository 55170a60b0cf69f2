//! The second program for friction that sticks, in the joints or between tip and plane. Between events each sticking place adds a
//! constraint with a multiplier; at an event every pattern of sticking and slipping is tested against the law.

use fivebar::effects::Law;
use fivebar::simulation::Parameters;

use crate::independent::{Independent, JOINTS, Motion, eliminate, extrapolate};

/// Stick-slip state of a joint or of the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
enum StickSlip {
    Free,
    Slips(f64),
    Holds,
}

/// The joints, and the tip on the plane.
const FRICTION_PLACES: usize = 6;
/// Index of the tip.
const TIP: usize = 5;

type StickSlips = [StickSlip; FRICTION_PLACES];

/// Rates below this count as rest, rad/s.
const SLOW: f64 = 1e-8;
/// Longest step, s, short enough that a rate cannot pass 0 twice.
const LONGEST: f64 = 1e-3;

/// A scene with friction that sticks.
pub struct Sticking<'a> {
    scene: &'a Parameters,
    program: Independent<'a>,
}

/// Sliding rate at a friction place: row·(rates of the links). Its derivative is row·(accelerations of the links) + drift.
struct Row {
    row: [f64; 4],
    drift: f64,
}

impl Row {
    fn rate(&self, state: &Motion) -> f64 {
        (0..4).map(|link| self.row[link] * state[4 + link]).sum()
    }

    fn acceleration(&self, a: &[f64; 4]) -> f64 {
        self.drift + (0..4).map(|link| self.row[link] * a[link]).sum::<f64>()
    }
}

impl<'a> Sticking<'a> {
    /// Takes closure and loads from a program.
    pub fn new(program: Independent<'a>) -> Self {
        Self { scene: program.scene, program }
    }

    /// State after `duration` seconds; `None` if steps become too short or events too many.
    pub fn after(&self, start: Motion, duration: f64) -> Option<Motion> {
        let (mut state, mut time, mut wanted, mut events) = (start, 0.0, 1e-4_f64, 0);
        let mut stick_slip = self.decided(&mut state);
        while duration - time > 1e-12 {
            // At rest with constant inputs, nothing changes.
            if state[4..].iter().all(|rate| *rate == 0.0)
                && stick_slip.iter().filter(|place| **place == StickSlip::Holds).count() > 1
            {
                return Some(state);
            }
            let h = wanted.min(LONGEST).min(self.program.cap(&state)).min(duration - time);
            if h < 1e-13 || events > 10_000 {
                return None;
            }
            let (end, error) = extrapolate(&|state| self.slope(state, &stick_slip), &state, h);
            if error > 1.0 {
                wanted = h * (0.7 * error.powf(-0.2)).clamp(0.1, 0.9);
                continue;
            }
            if self.margin(&end, &stick_slip) >= 0.0 {
                (state, time) = (self.held(end, &stick_slip), time + h);
                wanted = h * (0.7 * error.max(1e-12).powf(-0.2)).clamp(0.2, 4.0);
                continue;
            }
            let (end, h) = self.event(&state, &stick_slip, h);
            (state, time, events) = (self.held(end, &stick_slip), time + h, events + 1);
            stick_slip = self.decided(&mut state);
            wanted = 1e-4;
        }
        Some(state)
    }

    /// Projects onto the closure, and sets sticking rates to 0.
    fn held(&self, state: Motion, stick_slip: &StickSlips) -> Motion {
        let mut state = self.program.closed(state);
        for place in (0..FRICTION_PLACES).filter(|place| stick_slip[*place] == StickSlip::Holds) {
            let row = self.row(place, &state);
            let rate = row.rate(&state);
            // The nearest rates that satisfy two closure equations and the sticking constraint.
            let mut matrix = [[0.0; 8]; 7];
            for (equation, closure) in self.program.equations(&state)[4..].iter().enumerate() {
                for link in 0..4 {
                    (matrix[4 + equation][link], matrix[link][4 + equation]) = (closure[link], closure[link]);
                }
            }
            for (link, by_rate) in row.row.into_iter().enumerate() {
                matrix[link][link] = 1.0;
                (matrix[6][link], matrix[link][6]) = (by_rate, by_rate);
            }
            matrix[6][7] = -rate;
            let change = eliminate(matrix);
            (0..4).for_each(|link| state[4 + link] += change[link]);
        }
        state
    }

    /// The end of the step just beyond a change of a friction place's state. It alternates false position (Illinois) and bisection: if two
    /// places are about to change, the smallest guard has a corner, at which false position alone stalls.
    fn event(&self, from: &Motion, stick_slip: &StickSlips, longest: f64) -> (Motion, f64) {
        /// Distance beyond the event, rad/s and N·m, within the smaller.
        const BEYOND: [f64; 2] = [5e-13, 4e-13];
        const ROUNDS: usize = 200;
        let step = |h: f64| extrapolate(&|state| self.slope(state, stick_slip), from, h).0;
        let above = |end: &Motion| self.margin(end, stick_slip) + BEYOND[0];
        let ([mut before, mut beyond], mut end) = ([0.0, longest], step(longest));
        let [mut high, mut low] = [above(from), above(&end)];
        for round in 0..ROUNDS {
            if low.abs() < BEYOND[1] || beyond - before < 1e-16 || high <= 0.0 {
                break;
            }
            let part = if round % 2 == 0 { (high / (high - low)).clamp(1e-3, 0.999) } else { 0.5 };
            let middle = before + (beyond - before) * part;
            let there = step(middle);
            let level = above(&there);
            if level > BEYOND[1] {
                (before, high, low) = (middle, level, 0.5 * low);
            } else {
                (beyond, low, end, high) = (middle, level, there, 0.5 * high);
            }
        }
        (end, beyond)
    }

    /// Smallest guard: slip rates in their direction, remaining friction of sticking joints, and the gap to the plane.
    fn margin(&self, state: &Motion, stick_slip: &StickSlips) -> f64 {
        let (_, torques) = self.accelerations(state, stick_slip);
        let margins = (0..FRICTION_PLACES).map(|place| match stick_slip[place] {
            StickSlip::Free if place == TIP && self.tip_sticks() => 1e-13 - self.program.pressed(state)[0],
            StickSlip::Free => f64::INFINITY,
            StickSlip::Slips(sign) => sign * self.row(place, state).rate(state) + 1e-13,
            StickSlip::Holds => self.bound(place, state, 0.0) - torques[place].abs(),
        });
        margins.fold(f64::INFINITY, f64::min)
    }

    fn tip_sticks(&self) -> bool {
        let contact = &self.scene.effects.contact;
        contact.enabled && contact.law == Law::Stick && contact.mu > 0.0
    }

    fn row(&self, place: usize, state: &Motion) -> Row {
        let mut row = [0.0; 4];
        if place < TIP {
            let (first, second) = JOINTS[place];
            row[first] = 1.0;
            if let Some(second) = second {
                row[second] = -1.0;
            }
            return Row { row, drift: 0.0 };
        }
        let contact = &self.scene.effects.contact;
        let length = contact.nx.hypot(contact.ny);
        let along_plane = [-contact.ny / length, contact.nx / length];
        let mut drift = 0.0;
        for (link, [x, y]) in self.program.arms(state) {
            row[link] = x * along_plane[1] - y * along_plane[0];
            drift -= state[4 + link] * state[4 + link] * (x * along_plane[0] + y * along_plane[1]);
        }
        Row { row, drift }
    }

    /// Friction at a slip rate, N·m or N; the breakaway value at rate 0.
    fn bound(&self, place: usize, state: &Motion, rate: f64) -> f64 {
        if place == TIP {
            return self.scene.effects.contact.mu * self.program.pressed(state)[1];
        }
        let friction = &self.scene.effects.friction;
        let u = rate / (std::f64::consts::SQRT_2 * friction.breakaway_velocity);
        friction.coulomb[place] + (friction.breakaway[place] - friction.coulomb[place]) * (-u * u).exp()
    }

    fn slope(&self, state: &Motion, stick_slip: &StickSlips) -> Motion {
        let (a, _) = self.accelerations(state, stick_slip);
        [state[4], state[5], state[6], state[7], a[0], a[1], a[2], a[3]]
    }

    /// Accelerations, and friction torques of the sticking places, at most two.
    fn accelerations(&self, state: &Motion, stick_slip: &StickSlips) -> ([f64; 4], [f64; FRICTION_PLACES]) {
        let mut matrix = [[0.0; 9]; 8];
        for (row, equation) in self.program.equations(state).into_iter().enumerate() {
            matrix[row][..6].copy_from_slice(&equation[..6]);
            matrix[row][8] = equation[6];
        }
        let mut columns = [None; FRICTION_PLACES];
        let mut column = 6;
        for place in 0..FRICTION_PLACES {
            if stick_slip[place] == StickSlip::Free {
                continue;
            }
            let sliding = self.row(place, state);
            match stick_slip[place] {
                StickSlip::Slips(sign) => {
                    let force = sign * self.bound(place, state, sliding.rate(state));
                    (0..4).for_each(|link| matrix[link][8] -= sliding.row[link] * force);
                }
                _ => {
                    for (link, by_rate) in sliding.row.into_iter().enumerate() {
                        (matrix[column][link], matrix[link][column]) = (by_rate, -by_rate);
                    }
                    matrix[column][8] = -sliding.drift;
                    columns[place] = Some(column);
                    column += 1;
                }
            }
        }
        for (unused, row) in matrix.iter_mut().enumerate().skip(column) {
            row[unused] = 1.0;
        }
        let solution = eliminate(matrix);
        let torques = columns.map(|column| column.map_or(0.0, |column| solution[column]));
        ([solution[0], solution[1], solution[2], solution[3]], torques)
    }

    /// Whether bodies touch and can slide at the place, so that friction could hold them.
    fn rubs(&self, place: usize, state: &Motion) -> bool {
        let friction = &self.scene.effects.friction;
        match place {
            TIP => self.tip_sticks() && self.program.pressed(state)[0] > 0.0,
            joint => friction.enabled && friction.law == Law::Stick && friction.breakaway[joint] > 0.0,
        }
    }

    /// Determines the new stick-slip states.
    fn decided(&self, state: &mut Motion) -> StickSlips {
        let all: Vec<usize> = (0..FRICTION_PLACES).filter(|place| self.rubs(*place, state)).collect();
        let able = |stick_slip: Vec<usize>| {
            stick_slip.into_iter().filter(|place| self.bound(*place, state, 0.0) > 0.0).collect::<Vec<_>>()
        };
        if state[4..].iter().all(|rate| rate.abs() < 100.0 * SLOW) {
            let mut still = *state;
            still[4..].fill(0.0);
            let (violation, stick_slip) = self.best(&still, &[StickSlip::Free; FRICTION_PLACES], &able(all.clone()), true);
            if violation < 1e-9 {
                *state = still;
                return stick_slip;
            }
        }
        let mut stick_slip = [StickSlip::Free; FRICTION_PLACES];
        for place in &all {
            stick_slip[*place] = StickSlip::Slips(if self.row(*place, state).rate(state) < 0.0 { -1.0 } else { 1.0 });
        }
        let zero = able(all.into_iter().filter(|place| self.row(*place, state).rate(state).abs() < SLOW).collect());
        self.best(state, &stick_slip, &zero, false).1
    }

    /// The stick-slip pattern that violates the law least, with exactly two sticking joints or with at most one.
    fn best(&self, state: &Motion, others: &StickSlips, zero: &[usize], rests: bool) -> (f64, StickSlips) {
        let mut best = (f64::INFINITY, *others);
        for code in 0..3_usize.pow(zero.len() as u32) {
            let mut stick_slip = *others;
            let mut rest = code;
            for place in zero {
                stick_slip[*place] = [StickSlip::Holds, StickSlip::Slips(1.0), StickSlip::Slips(-1.0)][rest % 3];
                rest /= 3;
            }
            let holding = zero.iter().filter(|place| stick_slip[**place] == StickSlip::Holds).count();
            if if rests { holding != 2 } else { holding > 1 } {
                continue;
            }
            // With coaxial motors one sticking inner joint makes everything turn as one piece; a second would add nothing.
            let inner = (1..TIP - 1).filter(|place| stick_slip[*place] == StickSlip::Holds).count();
            if self.scene.geometry.base_distance == 0.0 && inner > 1 {
                continue;
            }
            let (a, torques) = self.accelerations(state, &stick_slip);
            let violations = zero.iter().map(|place| match stick_slip[*place] {
                StickSlip::Holds => torques[*place].abs() / self.bound(*place, state, 0.0) - 1.0,
                StickSlip::Slips(sign) if !rests => -sign * self.row(*place, state).acceleration(&a),
                StickSlip::Slips(_) | StickSlip::Free => 0.0,
            });
            let moved = if rests { 1e-3 * a.iter().fold(0.0, |most: f64, a| most.max(a.abs())) } else { 0.0 };
            let violation = violations.fold(moved, f64::max);
            if violation < best.0 {
                best = (violation, stick_slip);
            }
        }
        best
    }
}
