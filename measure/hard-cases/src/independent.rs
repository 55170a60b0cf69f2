//! A second program for the same motions, by another method and without the library's code: absolute link angles with Lagrange
//! multipliers, Gauss elimination, and extrapolation of the modified midpoint rule (Gragg, Bulirsch and Stoer; Hairer, Nørsett, Wanner,
//! section II.9). It shares only the parameters of a scene with the library.
//!
//! No step can miss a contact: its length is limited by the time in which the fastest approach closes the gap to the nearest stop or
//! plane.

use std::f64::consts::{E, PI, SQRT_2, TAU};

use fivebar::effects::Law;
use fivebar::simulation::{Inputs, Parameters};

use crate::sticking::Sticking;

/// Angles and rates of links 1 to 4, rad and rad/s.
pub type Motion = [f64; 8];

/// The columns of the extrapolation.
const COLUMNS: usize = 6;
/// Error of a step, in rad and in tenths of a rad/s.
const TOLERANCE: f64 = 2e-13;
/// Longest step, s.
const LONGEST: f64 = 5e-3;
/// Joints as differences of links: left base, left elbow, tip, right elbow, right base.
pub(crate) const JOINTS: [(usize, Option<usize>); 5] = [(0, None), (1, Some(0)), (1, Some(2)), (2, Some(3)), (3, None)];

/// Closure equations of this program. With coaxial motors the links are vectors with sum zero; vectors of the right leg point from the tip
/// to the motors. If lengths are equal in pairs, each branch has equations that are regular in every posture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Closure {
    /// Both legs end at the tip; singular if all links are in line.
    Tip,
    /// In each of these pairs the link vectors are opposite.
    Opposite([[usize; 2]; 2]),
    /// In each of these pairs the link vectors are mirror images in one axis: θ = x ± α, and x ± β, with a cos α + b cos β = 0.
    Mirrored([[usize; 2]; 2]),
}

/// A closure equation, `gap` = 0. Its second derivative is row·(accelerations of the links) − `drift`.
struct Equation {
    row: [f64; 4],
    gap: f64,
    drift: f64,
}

/// A scene, as seen by this program.
#[derive(Clone, Debug)]
pub struct Independent<'a> {
    pub(crate) scene: &'a Parameters,
    inputs: &'a Inputs,
    closure: Closure,
}

fn along(angle: f64, length: f64) -> [f64; 2] {
    [length * angle.cos(), length * angle.sin()]
}

impl<'a> Independent<'a> {
    /// For the default orientation of gravity; without rotors. Equal links with coaxial motors form a parallelogram.
    pub fn new(scene: &'a Parameters, inputs: &'a Inputs) -> Self {
        let links = &scene.geometry.links;
        let equal = links.iter().all(|link| link.length == links[0].length);
        let is_rhombus = scene.geometry.base_distance == 0.0 && equal;
        Self::on(if is_rhombus { Closure::Opposite([[0, 2], [3, 1]]) } else { Closure::Tip }, scene, inputs)
    }

    /// Like [`Independent::new`], with another closure of the scene.
    pub fn on(closure: Closure, scene: &'a Parameters, inputs: &'a Inputs) -> Self {
        assert!(!scene.effects.rotor.enabled, "rotors are not known here");
        Self { scene, inputs, closure }
    }

    /// The start, from the proximal angles and rates; the tip is to the left of the arrow from the left elbow to the right one.
    pub fn start(&self) -> Motion {
        let [left, distal_left, distal_right, right] = self.scene.geometry.links.map(|link| link.length);
        let ([a, d], [wa, wd]) = (self.scene.start.theta, self.scene.start.omega);
        let (p, r) = (along(a, left), along(d, right));
        let q = [self.scene.geometry.base_distance + r[0], r[1]];
        let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
        let distance = dx.hypot(dy);
        let foot = (distance * distance + distal_left * distal_left - distal_right * distal_right) / (2.0 * distance);
        let height = (distal_left * distal_left - foot * foot).sqrt();
        let tip = [p[0] + (foot * dx - height * dy) / distance, p[1] + (foot * dy + height * dx) / distance];
        let b = (tip[1] - p[1]).atan2(tip[0] - p[0]);
        let c = (tip[1] - q[1]).atan2(tip[0] - q[0]);
        // Rate equations of the closure, solved for the distal links.
        let [[jb, jc], [kb, kc]] =
            [[-distal_left * b.sin(), distal_right * c.sin()], [distal_left * b.cos(), -distal_right * c.cos()]];
        let x = left * a.sin() * wa - right * d.sin() * wd;
        let y = -left * a.cos() * wa + right * d.cos() * wd;
        let determinant = jb * kc - jc * kb;
        [a, b, c, d, wa, (x * kc - jc * y) / determinant, (jb * y - kb * x) / determinant, wd]
    }

    /// State after `duration` seconds, with friction that sticks if the scene has it; `None` if the program fails.
    pub(crate) fn followed(&self, start: Motion, duration: f64) -> Option<Motion> {
        let effects = &self.scene.effects;
        let sticks = [(effects.friction.enabled, effects.friction.law), (effects.contact.enabled, effects.contact.law)]
            .contains(&(true, Law::Stick));
        if sticks { Sticking::new(self.clone()).after(start, duration) } else { self.after(start, duration) }
    }

    /// State after `duration` seconds; `None` if steps become too short.
    pub fn after(&self, start: Motion, duration: f64) -> Option<Motion> {
        let (mut state, mut time, mut wanted) = (start, 0.0, 1e-4_f64);
        while time < duration {
            let h = wanted.min(self.cap(&state)).min(duration - time);
            if h < 1e-12 {
                return if duration - time < 1e-11 { Some(state) } else { None };
            }
            let (end, error) = self.extrapolate(&state, h);
            if error <= 1.0 {
                state = self.closed(end);
                time += h;
            }
            // The error of a small step is mostly round-off and does not decrease with the step. So steps may grow faster than the order
            // suggests.
            wanted = h * (0.7 * error.max(1e-12).powf(-0.2)).clamp(0.2, 4.0);
        }
        Some(state)
    }

    /// Position of the tip, m.
    pub fn tip(&self, state: &Motion) -> [f64; 2] {
        let links = &self.scene.geometry.links;
        let (p, d) = (along(state[0], links[0].length), along(state[1], links[1].length));
        [p[0] + d[0], p[1] + d[1]]
    }

    /// Longest step that cannot pass a gap, s.
    pub(crate) fn cap(&self, state: &Motion) -> f64 {
        /// A step may always cross this fraction of a ramp.
        const PART: f64 = 0.3;
        let effects = &self.scene.effects;
        let mut cap = LONGEST;
        let mut near = |gap: f64, width: f64, speed: f64| {
            for border in [gap.abs(), (gap + width).abs()] {
                cap = cap.min(border.max(PART * width) / (1.5 * speed + 1e-3));
            }
        };
        if effects.contact.enabled {
            let (contact, [x, y], length) = (&effects.contact, self.tip(state), effects.contact.nx.hypot(effects.contact.ny));
            let links = &self.scene.geometry.links;
            let speed = links[0].length * state[4].abs() + links[1].length * state[5].abs();
            near((contact.nx * x + contact.ny * y) / length - contact.offset, contact.width, speed);
        }
        if effects.stop.enabled {
            for (motor, link) in [0, 3].into_iter().enumerate() {
                let (angle, speed) = (state[link], state[4 + link].abs());
                near(effects.stop.upper[motor] - angle, effects.stop.width, speed);
                near(angle - effects.stop.lower[motor], effects.stop.width, speed);
            }
        }
        cap
    }

    /// An extrapolated step, with its error in units of the tolerance.
    fn extrapolate(&self, from: &Motion, h: f64) -> (Motion, f64) {
        extrapolate(&|state| self.slope(state), from, h)
    }

    /// Rates and accelerations.
    fn slope(&self, state: &Motion) -> Motion {
        let solution = eliminate(self.equations(state));
        let [wa, wb, wc, wd] = [4, 5, 6, 7].map(|i: usize| state[i]);
        [wa, wb, wc, wd, solution[0], solution[1], solution[2], solution[3]]
    }

    /// Equations of motion and closure in four accelerations and two multipliers; the last column is the right-hand side.
    pub(crate) fn equations(&self, state: &Motion) -> [[f64; 7]; 6] {
        let links = &self.scene.geometry.links;
        let mut matrix = [[0.0; 7]; 6];
        let forces = self.forces(state);
        // For each leg: proximal and distal link, and payload.
        for ([proximal, distal], payload) in [([0, 1], self.payload()), ([3, 2], 0.0)] {
            let ([angle, rate], [other, other_rate]) = ([state[proximal], state[4 + proximal]], [state[distal], state[4 + distal]]);
            let (p, q) = (&links[proximal], &links[distal]);
            let coupling = p.length * (q.mass * q.com + payload * q.length);
            matrix[proximal][proximal] = p.inertia + p.mass * p.com * p.com + (q.mass + payload) * p.length * p.length;
            matrix[distal][distal] = q.inertia + q.mass * q.com * q.com + payload * q.length * q.length;
            matrix[proximal][distal] = coupling * (angle - other).cos();
            matrix[distal][proximal] = matrix[proximal][distal];
            matrix[proximal][6] = forces[proximal] - coupling * (angle - other).sin() * other_rate * other_rate;
            matrix[distal][6] = forces[distal] + coupling * (angle - other).sin() * rate * rate;
        }
        for (row, equation) in [4, 5].into_iter().zip(self.closure(state)) {
            for (link, by) in equation.row.into_iter().enumerate() {
                (matrix[row][link], matrix[link][row]) = (by, by);
            }
            matrix[row][6] = equation.drift;
        }
        matrix
    }

    /// Mass at the tip, kg, as part of the left leg.
    fn payload(&self) -> f64 {
        let payload = &self.scene.effects.payload;
        if payload.enabled { payload.mass } else { 0.0 }
    }

    fn closure(&self, state: &Motion) -> [Equation; 2] {
        let lengths = self.scene.geometry.lengths();
        let vectors: [f64; 4] = std::array::from_fn(|link| state[link] + if link < 2 { 0.0 } else { PI });
        match self.closure {
            Closure::Tip => {
                let arms: [[f64; 2]; 4] = std::array::from_fn(|link| along(vectors[link], lengths[link]));
                let sum = |axis: usize, of: &dyn Fn(usize) -> f64| (0..4).map(|link| arms[link][axis] * of(link)).sum::<f64>();
                let drift = |axis| sum(axis, &|link| state[4 + link].powi(2));
                [
                    Equation {
                        row: arms.map(|[_, y]| -y),
                        gap: sum(0, &|_| 1.0) - self.scene.geometry.base_distance,
                        drift: drift(0),
                    },
                    Equation { row: arms.map(|[x, _]| x), gap: sum(1, &|_| 1.0), drift: drift(1) },
                ]
            }
            Closure::Opposite(pairs) => pairs.map(|[one, other]| {
                let mut row = [0.0; 4];
                (row[one], row[other]) = (1.0, -1.0);
                let apart = vectors[one] - vectors[other] - PI;
                Equation { row, gap: apart - TAU * (apart / TAU).round(), drift: 0.0 }
            }),
            Closure::Mirrored(pairs) => {
                let mut axes = Equation { row: [0.0; 4], gap: 0.0, drift: 0.0 };
                let mut along_axis = Equation { row: [0.0; 4], gap: 0.0, drift: 0.0 };
                for ([one, other], sign) in pairs.into_iter().zip([1.0, -1.0]) {
                    (axes.row[one], axes.row[other]) = (sign, sign);
                    axes.gap += sign * (vectors[one] + vectors[other]);
                    let (half, rate) = (0.5 * (vectors[one] - vectors[other]), 0.5 * (state[4 + one] - state[4 + other]));
                    let [x, y] = along(half, lengths[one]);
                    (along_axis.row[one], along_axis.row[other]) = (-0.5 * y, 0.5 * y);
                    along_axis.gap += x;
                    along_axis.drift += x * rate * rate;
                }
                [axes, along_axis]
            }
        }
    }

    /// Generalised forces in the link angles, N·m.
    fn forces(&self, state: &Motion) -> [f64; 4] {
        let (links, effects) = (&self.scene.geometry.links, &self.scene.effects);
        let (angle, rate) = (&state[..4], &state[4..]);
        let mut forces = [0.0; 4];
        forces[0] += self.inputs.tau[0];
        forces[3] += self.inputs.tau[1];
        for (link, [x, y]) in self.arms(state) {
            forces[link] += x * self.inputs.tip_force[1] - y * self.inputs.tip_force[0];
        }
        if effects.gravity.enabled {
            let g = effects.gravity.g;
            for (proximal, distal, payload) in [(0, 1, self.payload()), (3, 2, 0.0)] {
                let (p, q) = (&links[proximal], &links[distal]);
                forces[proximal] -= g * (p.mass * p.com + (q.mass + payload) * p.length) * angle[proximal].cos();
                forces[distal] -= g * (q.mass * q.com + payload * q.length) * angle[distal].cos();
            }
        }
        for (joint, (first, second)) in JOINTS.into_iter().enumerate() {
            let w = rate[first] - second.map_or(0.0, |second| rate[second]);
            let mut torque = 0.0;
            if effects.viscous.enabled {
                torque -= effects.viscous.b[joint] * w;
            }
            // `sticking.rs` handles friction that sticks.
            if effects.friction.enabled && effects.friction.law == Law::Smooth {
                let friction = &effects.friction;
                let (coulomb, breakaway, velocity) =
                    (friction.coulomb[joint], friction.breakaway[joint], friction.breakaway_velocity);
                let u = w / (SQRT_2 * velocity);
                torque -= (2.0 * E).sqrt() * (breakaway - coulomb) * (-u * u).exp() * u + coulomb * (10.0 * w / velocity).tanh();
            }
            forces[first] += torque;
            if let Some(second) = second {
                forces[second] -= torque;
            }
        }
        for (motor, link) in [0, 3].into_iter().enumerate() {
            if effects.spring.enabled {
                forces[link] -= effects.spring.k[motor] * (angle[link] - effects.spring.theta0[motor]);
            }
            if effects.servo.enabled {
                let servo = &effects.servo;
                let pull = servo.kp[motor] * (self.inputs.servo_theta[motor] - angle[link])
                    + servo.kd[motor] * (self.inputs.servo_omega[motor] - rate[link]);
                forces[link] += servo.limit[motor] * (pull / servo.limit[motor]).tanh();
            }
            if effects.stop.enabled {
                let stop = &effects.stop;
                forces[link] += push(stop.lower[motor] - angle[link], -rate[link], [stop.k, stop.d, stop.width]);
                forces[link] -= push(angle[link] - stop.upper[motor], rate[link], [stop.k, stop.d, stop.width]);
            }
        }
        if effects.contact.enabled {
            let contact = &effects.contact;
            let length = contact.nx.hypot(contact.ny);
            let n = [contact.nx / length, contact.ny / length];
            let arms = self.arms(state);
            let v = arms.iter().fold([0.0; 2], |v, (link, [x, y])| [v[0] - rate[*link] * y, v[1] + rate[*link] * x]);
            let [_, normal] = self.pressed(state);
            // `sticking.rs` handles friction that sticks.
            let drag = match contact.law {
                Law::Smooth => contact.mu * normal * ((n[0] * v[1] - n[1] * v[0]) / contact.slip_velocity).tanh(),
                Law::Stick => 0.0,
            };
            let force = [normal * n[0] + drag * n[1], normal * n[1] - drag * n[0]];
            for (link, [x, y]) in arms {
                forces[link] += x * force[1] - y * force[0];
            }
        }
        forces
    }

    /// Lever arms of the left leg's links on the tip, m.
    pub(crate) fn arms(&self, state: &Motion) -> [(usize, [f64; 2]); 2] {
        let links = &self.scene.geometry.links;
        [(0, along(state[0], links[0].length)), (1, along(state[1], links[1].length))]
    }

    /// Penetration of the tip into the plane, m, and normal force, N.
    pub(crate) fn pressed(&self, state: &Motion) -> [f64; 2] {
        let contact = &self.scene.effects.contact;
        let length = contact.nx.hypot(contact.ny);
        let (n, [x, y]) = ([contact.nx / length, contact.ny / length], self.tip(state));
        let v =
            self.arms(state).iter().fold([0.0; 2], |v, (link, [x, y])| [v[0] - state[4 + link] * y, v[1] + state[4 + link] * x]);
        let depth = contact.offset - n[0] * x - n[1] * y;
        [depth, push(depth, -n[0] * v[0] - n[1] * v[1], [contact.k, contact.d, contact.width])]
    }

    /// Projects onto the closure: nearest angles first, then rates.
    pub fn closed(&self, mut state: Motion) -> Motion {
        for round in 0..4 {
            let [one, other] = self.closure(&state);
            let dot = |x: &[f64; 4], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
            let gap =
                if round == 3 { [&one, &other].map(|equation| dot(&equation.row, &state[4..])) } else { [one.gap, other.gap] };
            let (xx, xy, yy) = (dot(&one.row, &one.row), dot(&one.row, &other.row), dot(&other.row, &other.row));
            let determinant = xx * yy - xy * xy;
            let pull = [(yy * gap[0] - xy * gap[1]) / determinant, (xx * gap[1] - xy * gap[0]) / determinant];
            for link in 0..4 {
                state[link + if round == 3 { 4 } else { 0 }] -= one.row[link] * pull[0] + other.row[link] * pull[1];
            }
        }
        state
    }

    /// Merges the friction of joints that always turn together into one of them, and removes it from joints that do not turn, because their
    /// individual torques are not unique. A motion shows which joints these are.
    pub(crate) fn merged(&self, state: &Motion) -> Parameters {
        let mut merged = self.scene.clone();
        // Possible joint rates of a motion on the closure.
        let turns = JOINTS.map(|(first, second)| {
            let mut rates = *state;
            rates[4..].fill(0.0);
            rates[4 + first] = 1.0;
            if let Some(second) = second {
                rates[4 + second] = -1.0;
            }
            let rates = self.closed(rates);
            [rates[4], rates[5], rates[6], rates[7]]
        });
        let equal = |x: &[f64; 4], y: &[f64; 4], sign: f64| x.iter().zip(y).all(|(x, y)| (x - sign * y).abs() < 1e-12);
        let friction = &mut merged.effects.friction;
        for torques in [&mut friction.coulomb, &mut friction.breakaway] {
            for joint in 0..JOINTS.len() {
                let first = (0..joint).find(|first| [1.0, -1.0].iter().any(|sign| equal(&turns[*first], &turns[joint], *sign)));
                let torque = torques[joint];
                if equal(&turns[joint], &[0.0; 4], 1.0) {
                    torques[joint] = 0.0;
                } else if let Some(first) = first {
                    torques[first] += torque;
                    torques[joint] = 0.0;
                }
            }
        }
        merged
    }
}

/// An extrapolated step, with its error in units of the tolerance.
pub(crate) fn extrapolate(slope: &impl Fn(&Motion) -> Motion, from: &Motion, h: f64) -> (Motion, f64) {
    let mut table: Vec<Motion> = Vec::with_capacity(COLUMNS);
    let mut error = f64::INFINITY;
    for column in 0..COLUMNS {
        let mut entry = midpoint(slope, from, h, 2 * (column + 1));
        for back in 0..column {
            let ratio = ((column + 1) as f64 / (column - back) as f64).powi(2);
            let previous = table[column - 1 - back];
            let higher = std::array::from_fn(|i| entry[i] + (entry[i] - previous[i]) / (ratio - 1.0));
            table[column - 1 - back] = entry;
            if back + 1 == column {
                error = (0..8)
                    .map(|i| (higher[i] - entry[i]).abs() / if i < 4 { TOLERANCE } else { 10.0 * TOLERANCE })
                    .fold(0.0, f64::max);
            }
            entry = higher;
        }
        table.push(entry);
    }
    let end = table[COLUMNS - 1];
    (end, if end.iter().all(|x| x.is_finite()) { error } else { f64::INFINITY })
}

/// The modified midpoint rule in `parts` parts.
fn midpoint(slope: &impl Fn(&Motion) -> Motion, from: &Motion, h: f64, parts: usize) -> Motion {
    let part = h / parts as f64;
    let add = |x: &Motion, factor: f64, slope: &Motion| -> Motion { std::array::from_fn(|i| x[i] + factor * slope[i]) };
    let (mut before, mut here) = (*from, add(from, part, &slope(from)));
    for _ in 1..parts {
        let next = add(&before, 2.0 * part, &slope(&here));
        (before, here) = (here, next);
    }
    // Gragg's last step.
    let end = add(&before, part, &slope(&here));
    std::array::from_fn(|i| (here[i] + end[i]) / 2.0)
}

/// A one-sided spring and damper with its ramp: max(0, s (k δ + c δ̇)).
fn push(depth: f64, rate: f64, [stiffness, damping, width]: [f64; 3]) -> f64 {
    if depth <= 0.0 {
        return 0.0;
    }
    let u = (depth / width).min(1.0);
    (u * u * u * (10.0 - 15.0 * u + 6.0 * u * u) * (stiffness * depth + damping * rate)).max(0.0)
}

/// Gauss elimination with column pivoting; the last column is the right-hand side.
pub(crate) fn eliminate<const N: usize, const W: usize>(mut matrix: [[f64; W]; N]) -> [f64; N] {
    for column in 0..N {
        let pivot = (column..N).max_by(|i, j| matrix[*i][column].abs().total_cmp(&matrix[*j][column].abs())).unwrap_or(column);
        matrix.swap(column, pivot);
        for row in column + 1..N {
            let factor = matrix[row][column] / matrix[column][column];
            let (above, below) = matrix.split_at_mut(row);
            for (x, y) in below[0].iter_mut().zip(&above[column]).skip(column) {
                *x -= factor * y;
            }
        }
    }
    let mut solution = [0.0; N];
    for row in (0..N).rev() {
        let known: f64 = (row + 1..N).map(|k| matrix[row][k] * solution[k]).sum();
        solution[row] = (matrix[row][N] - known) / matrix[row][row];
    }
    solution
}
