//! Dry friction that sticks on machines with coaxial motors, or nearly so: against closed forms of the rotation about the axis as one
//! piece, and against Moreau's time stepping. Inner joints can lock the opening of such a machine (the relative rotation of its motors),
//! never its rotation about the axis.

use std::f64::consts::PI;

use fivebar::effects::Law;
use fivebar::mechanism::Assembly;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Inputs, Method, Parameters, Simulation};

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::{enable, methods_with_events};

/// Duration of each motion, s.
const DURATION: f64 = 0.1;

fn coaxial() -> Parameters {
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.0;
    parameters.effects.friction.law = Law::Stick;
    parameters.effects.contact.law = Law::Stick;
    parameters
}

/// Friction in all inner joints locks the opening of the stretched machine, in which the tip's joint is at a turning point.
fn at_a_turning_point() -> Parameters {
    let mut parameters = coaxial();
    enable(&mut parameters, "friction");
    parameters.geometry.links[0].length = 0.4;
    (parameters.effects.friction.breakaway[2], parameters.effects.friction.breakaway[3]) = (0.09, 0.07);
    parameters
}

/// Light distal links and a payload: joint forces are large compared with the masses.
fn of_light_links() -> Parameters {
    let mut parameters = coaxial();
    enable(&mut parameters, "friction");
    enable(&mut parameters, "payload");
    parameters.effects.payload.mass = 0.011;
    parameters.start.theta = [-1.55, 0.8];
    let links = &mut parameters.geometry.links;
    (links[0].length, links[1].length, links[3].length) = (0.4, 0.33, 0.08);
    (links[1].mass, links[2].mass, links[3].com) = (0.001, 0.003, 0.0);
    let friction = &mut parameters.effects.friction;
    friction.breakaway[2] = 0.01;
    (friction.coulomb[3], friction.breakaway[3]) = (0.0, 0.0);
    parameters
}

/// Uniform random numbers.
fn random(seed: u64) -> impl FnMut(f64, f64) -> f64 {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    move |low, high| low + (high - low) * ((random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64)
}

/// Random lengths; in half of the machines the angles are at a turning point of the opening; everything is at rest.
fn random_machine(uniform: &mut impl FnMut(f64, f64) -> f64, distances: &[f64]) -> Parameters {
    let mut parameters = coaxial();
    parameters.geometry.base_distance = distances[uniform(0.0, distances.len() as f64) as usize];
    for link in &mut parameters.geometry.links {
        link.length = uniform(0.08, 0.4);
    }
    let left = uniform(-PI, PI);
    parameters.start.theta = [left, [left, left + PI, uniform(-PI, PI), uniform(-PI, PI)][uniform(0.0, 4.0) as usize]];
    parameters.start.assembly = if uniform(0.0, 1.0) < 0.5 { Assembly::Plus } else { Assembly::Minus };
    parameters
}

fn angles(parameters: &Parameters, inputs: &Inputs, method: Method) -> Result<[f64; 4], String> {
    let mut parameters = parameters.clone();
    parameters.settings.method = method;
    let mut simulation = Simulation::new(&parameters, inputs).map_err(|refused| refused.to_string())?;
    simulation.advance(inputs, 1e-3, (1e3 * DURATION) as u64).map_err(|failed| failed.to_string())?;
    Ok(simulation.state().angles())
}

fn farthest(one: [f64; 4], other: [f64; 4]) -> f64 {
    one.into_iter().zip(other).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
}

/// Motors push an arm with locked inner joints: it turns about the axis as one piece, with friction only in the motors.
#[test]
fn locked_inner_joints_do_not_hold_the_motors() {
    const MOTORS: f64 = 1e-3;
    let (mut uniform, mut judged) = (random(64), 0);
    for scene in 0..60 {
        let mut parameters = random_machine(&mut uniform, &[0.0, 0.0, 1e-9, 1e-7]);
        parameters.effects.gravity.enabled = false;
        enable(&mut parameters, "friction");
        let inner = [1, 2, 3].map(|_| uniform(0.05, 0.1));
        let friction = &mut parameters.effects.friction;
        friction.coulomb = [MOTORS, inner[0], inner[1], inner[2], MOTORS];
        friction.breakaway = friction.coulomb;
        let inputs = Inputs { tau: [uniform(0.02, 0.04), uniform(0.0, 0.01)], ..default_inputs() };
        let Ok(start) = Simulation::new(&parameters, &inputs) else { continue };
        let start = start.state().angles();
        // Machines near a direct singularity are skipped: the inertia of the opening is then so large or so small that the inner joints
        // slip.
        if (start[1] - start[2]).sin().abs() < 0.3 {
            continue;
        }
        judged += 1;
        let inertia: f64 = [(0, 1), (3, 2)].into_iter().fold(0.0, |sum, (proximal, distal)| {
            let [p, d] = [proximal, distal].map(|link: usize| &parameters.geometry.links[link]);
            let turn = (start[distal] - start[proximal]).cos();
            let far = p.length * p.length + d.com * d.com + 2.0 * p.length * d.com * turn;
            sum + p.inertia + p.mass * p.com * p.com + d.inertia + d.mass * far
        });
        let turned = (inputs.tau[0] + inputs.tau[1] - 2.0 * MOTORS) / inertia * DURATION * DURATION / 2.0;
        for method in methods_with_events() {
            let end = angles(&parameters, &inputs, method).unwrap_or_else(|failed| panic!("{scene}, {method:?}: {failed}"));
            let off = farthest(end, start.map(|angle| angle + turned));
            // Some hundred local errors of 3e-9 rad. Motors 1e-7 m apart move locked joints by 1e-6 of the rotation, which costs the motors
            // 1e-5 of their torque.
            assert!(off < 1e-6 + 1e-5 * turned, "{scene}, {method:?}: turned {turned} rad, {off:e} off");
        }
    }
    assert!(judged >= 30, "{judged} machines");
}

/// The tip is on the axis, pressed into a plane and sticking: each folded leg turns as one piece, because the plane moves nothing there.
#[test]
fn a_tip_on_the_axis_does_not_hold_folded_legs() {
    let mut uniform = random(65);
    for scene in 0..12 {
        let mut parameters = coaxial();
        parameters.effects.gravity.enabled = false;
        enable(&mut parameters, "contact");
        parameters.effects.contact.offset = uniform(1e-4, 0.05);
        parameters.start.assembly = Assembly::Minus;
        parameters.start.theta = [1.5, 1.5 - uniform(0.8, 2.2)];
        parameters.start.omega = [uniform(-4.0, 4.0), uniform(-4.0, 4.0)];
        let lengths = if scene % 2 == 0 { [0.21; 2] } else { [uniform(0.1, 0.4), uniform(0.1, 0.4)] };
        for (link, leg) in parameters.geometry.links.iter_mut().zip([0, 0, 1, 1]) {
            link.length = lengths[leg];
        }
        let inputs = Inputs { tau: [uniform(-0.01, 0.01), 0.0], ..default_inputs() };
        let links = &parameters.geometry.links;
        let inertia = |p: usize, d: usize| {
            let (p, d) = (&links[p], &links[d]);
            p.inertia + p.mass * p.com * p.com + d.inertia + d.mass * (p.length - d.com) * (p.length - d.com)
        };
        let [left, right] = [(0, inertia(0, 1)), (1, inertia(3, 2))].map(|(motor, inertia)| {
            parameters.start.omega[motor] * DURATION + inputs.tau[motor] / inertia * DURATION * DURATION / 2.0
        });
        let start = Simulation::new(&parameters, &inputs).expect("a scene").state().angles();
        assert!((start[0] - start[1]).cos() < -1.0 + 1e-9, "{scene}: {start:?}");
        for method in methods_with_events() {
            let end = angles(&parameters, &inputs, method).unwrap_or_else(|failed| panic!("{scene}, {method:?}: {failed}"));
            let off = farthest(end, [start[0] + left, start[1] + left, start[2] + right, start[3] + right]);
            // Some hundred local errors of 3e-9 rad.
            assert!(off < 1e-6, "{scene}, {method:?}: {off:e} rad off");
        }
    }
}

/// Random frictions, loads, rates and base distances, and two machines that must not rest against any load.
#[test]
fn coaxial_machines_move_as_by_time_stepping() {
    let mut uniform = random(66);
    let mut scenes = vec![(at_a_turning_point(), default_inputs()), (of_light_links(), default_inputs())];
    for _ in 0..40 {
        let mut parameters = random_machine(&mut uniform, &[0.0, 0.0, 0.0, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5]);
        parameters.effects.gravity.enabled = uniform(0.0, 1.0) < 0.6;
        if uniform(0.0, 1.0) < 0.5 {
            parameters.start.omega = [uniform(-3.0, 3.0), uniform(-3.0, 3.0)];
        }
        enable(&mut parameters, "friction");
        let friction = &mut parameters.effects.friction;
        for joint in 0..5 {
            friction.coulomb[joint] = 10_f64.powf(uniform(-4.0, -1.0));
            friction.breakaway[joint] = friction.coulomb[joint] * uniform(1.0, 3.0);
        }
        let pushes = uniform(0.0, 1.0) < 0.7;
        let tau = if pushes { [uniform(-0.05, 0.05), uniform(-0.05, 0.05)] } else { [0.0; 2] };
        scenes.push((parameters, Inputs { tau, ..default_inputs() }));
    }
    let (mut judged, mut turned) = (0, 0);
    for (scene, (parameters, inputs)) in scenes.iter().enumerate() {
        let Ok(start) = Simulation::new(parameters, inputs) else { continue };
        let start = start.state().angles();
        let [coarse, fine] = [500, 1000].map(|steps| TimeStepping::new(parameters, inputs, start).after(steps));
        let (Some(coarse), Some(fine)) = (coarse, fine) else { continue };
        judged += 1;
        turned += u32::from(farthest(fine, start) > 1e-3);
        for method in methods_with_events() {
            let end = angles(parameters, inputs, method).unwrap_or_else(|failed| panic!("{scene}, {method:?}: {failed}"));
            // The time stepping is of first order; a step that begins or ends with a stop has a full first-order error.
            let (off, allowed) = (farthest(end, fine), 3.0 * farthest(coarse, fine) + 1e-4);
            assert!(off < allowed, "{scene}, {method:?}: {off:e} rad off, {allowed:e} allowed");
        }
    }
    assert!(judged >= 20 && turned >= 10, "{judged} machines, of which {turned} moved");
}

/// Moreau's time stepping in the two motor angles: no events, no regularisation; projected Gauss–Seidel computes the friction impulses of
/// each step.
struct TimeStepping<'a> {
    scene: &'a Parameters,
    inputs: &'a Inputs,
    angles: [f64; 4],
    rates: [f64; 2],
}

/// Joint rates from link rates.
const JOINTS: [[f64; 4]; 5] =
    [[1.0, 0.0, 0.0, 0.0], [1.0, -1.0, 0.0, 0.0], [0.0, 1.0, -1.0, 0.0], [0.0, 0.0, 1.0, -1.0], [0.0, 0.0, 0.0, 1.0]];

fn dot<const N: usize>(x: &[f64; N], y: &[f64; N]) -> f64 {
    x.iter().zip(y).map(|(x, y)| x * y).sum()
}

impl<'a> TimeStepping<'a> {
    fn new(scene: &'a Parameters, inputs: &'a Inputs, angles: [f64; 4]) -> Self {
        Self { scene, inputs, angles, rates: scene.start.omega }
    }

    /// Link angles after the duration; `None` near a direct singularity, where motor angles are no coordinates.
    fn after(mut self, steps: u32) -> Option<[f64; 4]> {
        let h = DURATION / f64::from(steps);
        for _ in 0..steps {
            self.drift(0.5 * h);
            let direct = (self.angles[1] - self.angles[2]).sin().abs();
            if direct.is_nan() || direct < 0.05 {
                return None;
            }
            self.rates = self.rates_after(h);
            self.drift(0.5 * h);
        }
        Some(self.angles)
    }

    /// Moves the links by their rates; Newton's iteration over the distal ones then closes the loop.
    fn drift(&mut self, h: f64) {
        let rates = self.link_rates(&self.angles);
        (0..4).for_each(|link| self.angles[link] += h * rates[link]);
        let [a, b, c, d] = self.scene.geometry.lengths();
        for _ in 0..3 {
            let [t1, t2, t3, t4] = self.angles;
            let x = a * t1.cos() + b * t2.cos() - c * t3.cos() - d * t4.cos() - self.scene.geometry.base_distance;
            let y = a * t1.sin() + b * t2.sin() - c * t3.sin() - d * t4.sin();
            self.angles[1] += (x * t3.cos() + y * t3.sin()) / (b * (t2 - t3).sin());
            self.angles[2] += (x * t2.cos() + y * t2.sin()) / (c * (t2 - t3).sin());
        }
    }

    /// Link rates per unit rate of each motor.
    fn motions(&self, [t1, t2, t3, t4]: &[f64; 4]) -> [[f64; 4]; 2] {
        let [a, b, c, d] = self.scene.geometry.lengths();
        let [b, c] = [b, c].map(|length| length * (t2 - t3).sin());
        [
            [1.0, -a * (t1 - t3).sin() / b, -a * (t1 - t2).sin() / c, 0.0],
            [0.0, d * (t4 - t3).sin() / b, d * (t4 - t2).sin() / c, 1.0],
        ]
    }

    fn link_rates(&self, angles: &[f64; 4]) -> [f64; 4] {
        let [left, right] = self.motions(angles);
        std::array::from_fn(|link| left[link] * self.rates[0] + right[link] * self.rates[1])
    }

    /// Mass matrix, and torques on the links.
    fn masses_and_torques(&self, rates: &[f64; 4]) -> ([[f64; 4]; 4], [f64; 4]) {
        let (effects, links) = (&self.scene.effects, &self.scene.geometry.links);
        let g = if effects.gravity.enabled { effects.gravity.g } else { 0.0 };
        let payload = if effects.payload.enabled { effects.payload.mass } else { 0.0 };
        let (mut mass, mut torque) = ([[0.0; 4]; 4], [0.0; 4]);
        for (proximal, distal, payload, tau) in [(0, 1, payload, self.inputs.tau[0]), (3, 2, 0.0, self.inputs.tau[1])] {
            let (p, d) = (&links[proximal], &links[distal]);
            let [first, second] = [p.mass * p.com + (d.mass + payload) * p.length, d.mass * d.com + payload * d.length];
            let (sine, cosine) = (self.angles[distal] - self.angles[proximal]).sin_cos();
            mass[proximal][proximal] = p.inertia + p.mass * p.com * p.com + (d.mass + payload) * p.length * p.length;
            mass[distal][distal] = d.inertia + d.mass * d.com * d.com + payload * d.length * d.length;
            (mass[proximal][distal], mass[distal][proximal]) = (second * p.length * cosine, second * p.length * cosine);
            let inertial = |rate: f64| second * p.length * sine * rate * rate;
            torque[proximal] = tau - g * first * self.angles[proximal].cos() + inertial(rates[distal]);
            torque[distal] = -g * second * self.angles[distal].cos() - inertial(rates[proximal]);
        }
        (mass, torque)
    }

    /// Motor rates after the loads and friction of a step.
    fn rates_after(&self, h: f64) -> [f64; 2] {
        /// Time difference for the change of the motions along the path, s.
        const LATER: f64 = 1e-6;
        let (motions, rates) = (self.motions(&self.angles), self.link_rates(&self.angles));
        let [ahead, behind] =
            [LATER, -LATER].map(|later| self.link_rates(&std::array::from_fn(|link| self.angles[link] + later * rates[link])));
        let drift: [f64; 4] = std::array::from_fn(|link| (ahead[link] - behind[link]) / (2.0 * LATER));
        let (mass, torque) = self.masses_and_torques(&rates);
        let times = |x: &[f64; 4]| mass.map(|row| dot(&row, x));
        let [left, right] = motions.map(|motion| times(&motion));
        let [a, b, d] = [dot(&motions[0], &left), dot(&motions[0], &right), dot(&motions[1], &right)];
        let response = |[x, y]: [f64; 2]| [d * x - b * y, a * y - b * x].map(|part| part / (a * d - b * b));
        let inertial = times(&drift);
        let net = std::array::from_fn(|link| torque[link] - inertial[link]);
        let by_loads = response(motions.map(|motion| dot(&motion, &net)));
        let mut end: [f64; 2] = std::array::from_fn(|motor| self.rates[motor] + h * by_loads[motor]);

        let friction = &self.scene.effects.friction;
        let places: [_; 5] = std::array::from_fn(|joint| {
            let row = motions.map(|motion| dot(&motion, &JOINTS[joint]));
            let u = dot(&row, &self.rates) / (std::f64::consts::SQRT_2 * friction.breakaway_velocity);
            let bound = friction.coulomb[joint] + (friction.breakaway[joint] - friction.coulomb[joint]) * (-u * u).exp();
            (row, response(row), h * bound)
        });
        let mut impulses = [0.0_f64; 5];
        for _ in 0..1000 {
            let mut change = 0.0_f64;
            for (impulse, (row, response, most)) in impulses.iter_mut().zip(&places) {
                // No impulse moves a joint at its turning point.
                let mobility = dot(row, response).max(1e-12);
                let by = (*impulse - dot(row, &end) / mobility).clamp(-most, *most) - *impulse;
                *impulse += by;
                change = change.max(by.abs() / h);
                (0..2).for_each(|motor| end[motor] += by * response[motor]);
            }
            if change < 1e-10 {
                break;
            }
        }
        end
    }
}
