//! A stored state of any motion can be read back, however strange the motion, and continues with equal bits. `forged_states.rs` has states
//! that must be refused.

use std::f64::consts::{PI, TAU};

use fivebar::effects::payload::Join;
use fivebar::effects::{self, Law};
use fivebar::fmi::Snapshot;
use fivebar::hybrid::StickSlip;
use fivebar::mechanism::Assembly;
use fivebar::mechanism::coordinates::THETA;
use fivebar::observers;
use fivebar::simulation::bindings::{default_inputs, default_parameters};
use fivebar::simulation::{Inputs, Method, Parameters, Run, Signal, Simulation};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::{dense_methods, enable, methods_of_fixed_steps, methods_with_events, unequal};

/// Masters may store states in one thread and continue them in another.
#[test]
fn simulations_and_stored_states_may_change_threads() {
    const fn may_change_threads<T: Send + Sync>() {}
    const { may_change_threads::<Simulation>() };
    const { may_change_threads::<Snapshot>() };
}

/// The methods with `solver.adaptive`, then without.
fn methods() -> Vec<(Method, bool)> {
    let with = methods_with_events().into_iter().map(|method| (method, true));
    with.chain(methods_of_fixed_steps().into_iter().map(|method| (method, false))).collect()
}

/// Two runs of a scene: one undisturbed, one converted to bytes and back before every call.
struct Twins {
    name: String,
    free: Simulation,
    stored: Simulation,
}

impl Twins {
    fn new(name: String, free: Simulation) -> Self {
        let stored = free.clone();
        let mut twins = Self { name, free, stored };
        twins.store();
        twins
    }

    fn bytes(simulation: &Simulation) -> Vec<u8> {
        borsh::to_vec(simulation.run()).expect("bytes")
    }

    /// Converts one of two states to bytes and back, and checks that it still equals the other.
    fn store(&mut self) {
        let Self { name, free, stored } = self;
        let bytes = Self::bytes(stored);
        assert_eq!(bytes, Self::bytes(free), "{name}: the runs have parted");
        let run: Run = borsh::from_slice(&bytes).expect("a run");
        *stored = Simulation::restored(stored.parameters(), run).unwrap_or_else(|refusal| {
            let (norms, core) = (observers::constraint_norms(stored.model(), &stored.state()), stored.state().core);
            panic!("{name}: {refusal}: {norms:?}, rates of {:e}, {:?}", core.v.max_norm(), core.counters)
        });
    }

    /// Makes the same call on both simulations; false if it fails.
    fn both<E: PartialEq + std::fmt::Debug>(&mut self, call: impl Fn(&mut Simulation) -> Result<(), E>) -> bool {
        let outcomes = [&mut self.free, &mut self.stored].map(call);
        assert_eq!(outcomes[0], outcomes[1], "{}", self.name);
        self.store();
        outcomes[0].is_ok()
    }

    fn advance(&mut self, inputs: &Inputs, h: f64, steps: u64) -> bool {
        self.both(|simulation| simulation.advance(inputs, h, steps))
    }

    /// A step with new parameters, as a master's calls make it: a refusal changes nothing.
    fn tune(&mut self, effects: &effects::Parameters, inputs: &Inputs, h: f64) -> bool {
        self.both(|simulation| {
            let before = simulation.clone();
            let tuned = simulation.tune(effects).map_err(|refusal| refusal.to_string());
            let done = tuned.and_then(|()| simulation.advance(inputs, h, 1).map_err(|failure| failure.to_string()));
            done.inspect_err(|_| *simulation = before)
        })
    }
}

struct Random(ChaCha8Rng);

impl Random {
    /// Uniform between two numbers.
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A random index below `count`.
    fn one_of(&mut self, count: usize) -> usize {
        (self.0.next_u64() % count as u64) as usize
    }

    fn pair(&mut self, largest: f64) -> [f64; 2] {
        [self.between(-largest, largest), self.between(-largest, largest)]
    }

    fn inputs(&mut self) -> Inputs {
        let (tau, tip_force) = (self.pair(0.05), self.pair(0.2));
        Inputs { tau, tip_force, servo_theta: self.pair(3.0), servo_omega: self.pair(3.0) }
    }

    /// A machine with any effects and any motion.
    fn scene(&mut self, (method, adaptive): (Method, bool)) -> Parameters {
        let mut parameters = if self.one_of(2) == 0 { unequal() } else { default_parameters() };
        (parameters.settings.method, parameters.settings.adaptive) = (method, adaptive);
        parameters.settings.error_tolerance = self.between(-10.0, -5.0).exp2().powi(4);
        parameters.start.theta = self.pair(PI);
        parameters.start.omega = self.pair(15.0);
        parameters.start.assembly = if self.one_of(2) == 0 { Assembly::Plus } else { Assembly::Minus };
        parameters.geometry.base_distance *= [1.0, 0.5, 0.0][self.one_of(3)];
        if self.one_of(4) == 0 {
            parameters.geometry.links[self.one_of(4)].inertia = 1e-9;
        }
        parameters.effects.gravity.enabled = self.one_of(2) == 0;
        for effect in effects::NAMES {
            if self.one_of(4) == 0 {
                enable(&mut parameters, effect);
            }
        }
        parameters.effects.servo.delay = [0.0, self.between(0.0, 0.01)][self.one_of(2)];
        parameters
    }

    /// Other values of the tunable parameters.
    fn tuned(&mut self, effects: &effects::Parameters) -> effects::Parameters {
        let mut effects = effects.clone();
        match self.one_of(6) {
            5 => {
                effects.payload.mass = self.between(0.0, 0.2);
                effects.payload.join = if self.one_of(2) == 0 { Join::AtRest } else { Join::WithTip };
            }
            0 => effects.gravity.g = self.between(0.0, 20.0),
            1 => effects.spring.k = [self.between(0.0, 0.2); 2],
            2 => effects.viscous.b[self.one_of(5)] = self.between(0.0, 1e-3),
            3 => effects.friction.coulomb[self.one_of(5)] = self.between(0.0, 5e-4),
            _ => effects.servo.kp = [self.between(0.0, 2.0); 2],
        }
        effects
    }
}

/// Any machine and effects; inputs constant, changing or ramped; tuned parameters; changing grids.
#[test]
fn states_of_random_motions_are_read_back() {
    let mut random = Random(ChaCha8Rng::seed_from_u64(11));
    let (methods, mut scenes, mut calls) = (methods(), 0, 0);
    while scenes < 100 {
        let method = methods[scenes % methods.len()];
        let parameters = random.scene(method);
        let mut inputs = random.inputs();
        // Many of these machines cannot be assembled.
        let Ok(start) = Simulation::new(&parameters, &inputs) else { continue };
        let mut twins = Twins::new(format!("scene {scenes}: {parameters:?}"), start);
        scenes += 1;
        for _ in 0..60 {
            let (h, steps) = (random.between(1e-4, 2e-3), 1 + random.one_of(5) as u64);
            let done = match random.one_of(8) {
                0..4 => twins.advance(&inputs, h, steps),
                4 | 5 => {
                    inputs = random.inputs();
                    twins.advance(&inputs, h, steps)
                }
                6 => {
                    let signal = Signal::new(inputs, [random.inputs(), random.inputs()]);
                    inputs = signal.at(h * steps as f64);
                    twins.both(|simulation| simulation.advance_along(&signal, h, steps))
                }
                _ => {
                    let tuned = random.tuned(&twins.free.parameters().effects);
                    twins.tune(&tuned, &inputs, h)
                }
            };
            if !done {
                break;
            }
            calls += 1;
        }
    }
    // Some methods fail early in difficult motions.
    assert!(calls > 60 * scenes / 2, "{calls} calls");
}

/// States of runs in model exchange can be read back.
#[test]
fn states_of_driven_runs_are_read_back() {
    let mut random = Random(ChaCha8Rng::seed_from_u64(12));
    let (methods, mut scenes, mut moves) = (methods(), 0, 0);
    while scenes < 30 {
        let parameters = random.scene(methods[scenes % methods.len()]);
        let Ok(start) = Simulation::for_model_exchange(&parameters, &random.inputs()) else { continue };
        let mut twins = Twins::new(format!("scene {scenes}: {parameters:?}"), start);
        scenes += 1;
        for _ in 0..40 {
            let (state, kick) = (twins.free.state(), [random.pair(0.2), random.pair(2.0)]);
            let [theta, omega] = [state.core.q, state.core.v].map(|x| [x[THETA[0]], x[THETA[3]]]);
            let to = [theta[0] + kick[0][0], theta[1] + kick[0][1], omega[0] + kick[1][0], omega[1] + kick[1][1]];
            moves += usize::from(twins.both(|simulation| simulation.set_states(to)));
            let (completed, inputs) = (random.one_of(2) == 0, random.inputs());
            let tuned = random.tuned(&twins.free.parameters().effects);
            twins.both(|simulation| {
                if completed {
                    simulation.complete(&inputs);
                }
                simulation.tune(&tuned)
            });
        }
    }
    assert!(moves > 30 * 40 / 2, "{moves} moves");
}

/// The postures of the paper's machine with all links in line, the signs of the link rates in the closure there, and a direction of motion
/// through each: Σ s ω = 0, Σ s ω² = 0 (`docs/method.md`, equation (23)).
fn vertices() -> impl Iterator<Item = [[f64; 4]; 2]> {
    let postures = [[0.0, 0.0, PI, 0.0], [0.0, 0.0, 0.0, PI], [0.0, PI, PI, PI], [PI, 0.0, PI, PI]];
    postures.into_iter().map(|theta| {
        let [c1, c2, c3, c4] = theta.map(|theta: f64| theta.cos().signum());
        let signs = [c1, c2, -c3, -c4];
        let sum: f64 = signs.iter().sum();
        let odd = signs.iter().position(|sign| sign * sum < 0.0).expect("one sign differs");
        // (1; a, b, c) with a + b + c = 1 = a² + b² + c²: an asymmetric point of this circle.
        let (sin, cos) = 0.7_f64.sin_cos();
        let (e1, e2) = (cos / 3.0_f64.sqrt(), sin / 3.0);
        let mut rest = [1.0 / 3.0 + e1 + e2, 1.0 / 3.0 - e1 + e2, 1.0 / 3.0 - 2.0 * e2].into_iter();
        let omega = std::array::from_fn(|i| if i == odd { 1.0 } else { rest.next().expect("three others") });
        [theta, omega]
    })
}

/// Through vertices, from rest in them, and near them; with and without driving or dissipating loads.
#[test]
fn states_in_and_near_vertices_are_read_back() {
    for (method, adaptive) in methods() {
        for [theta, omega] in vertices() {
            for (rate, gravity, friction) in [
                (0.0, true, false),
                (0.0, false, false),
                (3.0, false, false),
                (20.0, true, false),
                (-5.0, true, true),
                (0.0, true, true),
            ] {
                let mut parameters = default_parameters();
                (parameters.settings.method, parameters.settings.adaptive) = (method, adaptive);
                parameters.effects.gravity.enabled = gravity;
                parameters.effects.viscous.enabled = friction;
                // Shortly before the vertex, so that the motion meets it, and exactly in it.
                for before in [0.0, 3.3e-3] {
                    let omega = omega.map(|omega| omega * rate);
                    let theta: [f64; 4] = std::array::from_fn(|i| theta[i] - before * omega[i]);
                    let name =
                        format!("{method:?}, adaptive {adaptive}, {theta:?}, {omega:?}, gravity {gravity}, friction {friction}");
                    // The cone is curved: before the vertex the rates alone close the loop only to second order.
                    let Ok(start) = Simulation::at(&parameters, &default_inputs(), theta, omega) else { continue };
                    let mut twins = Twins::new(name, start);
                    let pushed = Inputs { tau: [0.01, 0.0], ..default_inputs() };
                    for step in 0..60 {
                        let inputs = if step < 40 { default_inputs() } else { pushed };
                        if !twins.advance(&inputs, 1e-3 / 3.0, 1) {
                            break;
                        }
                    }
                }
            }
        }
    }
}

/// Within 1e-5 rad of a vertex, on a ray along which a steep spring prevents the motion: no straight passage, but the energy is conserved.
#[test]
fn states_next_to_a_vertex_under_steep_springs_are_read_back() {
    for method in dense_methods() {
        for ([theta, omega], stiffness, aside, rate) in vertices().flat_map(|vertex| {
            let cases = [1e3, 1e6].into_iter().flat_map(|k| [1e-7, 1e-6, 5e-6].map(|aside| (k, aside)));
            cases.flat_map(move |(k, aside)| [1e-3, 0.1, 3.0].map(|rate| (vertex, k, aside, rate)))
        }) {
            let mut parameters = default_parameters();
            parameters.settings.method = method;
            enable(&mut parameters, "spring");
            parameters.effects.spring.k = [stiffness; 2];
            parameters.effects.spring.theta0 = [theta[0], theta[3]];
            let omega = omega.map(|omega| omega * rate);
            let theta: [f64; 4] = std::array::from_fn(|i| theta[i] + aside * omega[i] / rate);
            let name = format!("{method:?}, {theta:?}, {omega:?}, {stiffness:e} N.m/rad, {aside:e} rad");
            let start = Simulation::at(&parameters, &default_inputs(), theta, omega).expect("on the cone, to 3e-11 of its size");
            let mut twins = Twins::new(name, start);
            for _ in 0..20 {
                if !twins.advance(&default_inputs(), 1e-7, 1) {
                    break;
                }
            }
        }
    }
}

/// Machines that start at rest with distal links in line, so that motor rates are proportional: friction holds both motors at the start;
/// in the fall one of them continues to stick while the other slips.
#[test]
fn states_of_motors_that_stuck_as_one_are_read_back() {
    for (method, error_tolerance) in methods_with_events().into_iter().flat_map(|m| [3e-9, 1e-6].map(|t| (m, t))) {
        let mut parameters = default_parameters();
        enable(&mut parameters, "friction");
        parameters.effects.friction.law = Law::Stick;
        (parameters.settings.method, parameters.settings.error_tolerance) = (method, error_tolerance);
        let inputs = default_inputs();
        let mut twins =
            Twins::new(format!("{method:?} {error_tolerance:e}"), Simulation::new(&parameters, &inputs).expect("a scene"));
        let mut moved_apart = false;
        for _ in 0..60 {
            assert!(twins.advance(&inputs, 1e-3, 1));
            let state = twins.free.state();
            let rates = [0, 3].map(|link| state.core.v[THETA[link]].abs());
            let stick = [0, 4].map(|place| matches!(state.stick_slip.at(place), StickSlip::Sticks(_)));
            // Tolerance: a slipping place counts as sticking below 50 stick velocities.
            assert!((0..2).all(|i| !stick[i] || rates[i] <= 5.1e-5), "{}: {rates:?} {stick:?}", twins.name);
            moved_apart |= rates[0].max(rates[1]) > 1e-3;
        }
        assert!(moved_apart, "{}", twins.name);
    }
}

/// Spinning links: whole turns move from the angles to their counters, also in the middle of a step.
#[test]
fn states_with_many_turns_are_read_back() {
    for (method, adaptive) in methods() {
        for effect in ["spring", "gravity", "servo"] {
            let mut parameters = default_parameters();
            (parameters.settings.method, parameters.settings.adaptive) = (method, adaptive);
            parameters.effects.gravity.enabled = false;
            enable(&mut parameters, effect);
            parameters.effects.spring.k = [1e-5; 2];
            (parameters.effects.servo.kp, parameters.effects.servo.kd) = ([1e-5; 2], [0.0; 2]);
            parameters.geometry.base_distance = 0.0;
            parameters.start.theta = [2.0, 1.0];
            parameters.start.omega = [60.0, 60.0];
            let start = Simulation::new(&parameters, &default_inputs()).expect("scene");
            let mut twins = Twins::new(format!("{method:?}, adaptive {adaptive}, {effect}"), start);
            let done = (0..200).take_while(|_| twins.advance(&default_inputs(), 1e-3, 5)).count();
            // A fixed step may fail.
            assert!(done == 200 || !adaptive, "{}: {done}", twins.name);
            if done == 200 {
                let turned = twins.free.state().angles()[0] / TAU;
                assert!(turned.abs() > 4.0, "{}: {turned} turns", twins.name);
            }
        }
    }
}

/// A single folded leg that turns about the axis of the left motor: the determinants of its posture are round-off, of either sign.
#[test]
fn states_of_a_folded_leg_that_whirls_are_read_back() {
    for (method, adaptive) in methods() {
        let mut parameters = default_parameters();
        (parameters.settings.method, parameters.settings.adaptive) = (method, adaptive);
        parameters.effects.gravity.enabled = false;
        for rate in [10.0, -20.0] {
            let start = Simulation::at(&parameters, &default_inputs(), [0.3, 0.3 + PI, PI, PI], [rate, rate, 0.0, 0.0]);
            let mut twins = Twins::new(format!("{method:?}, adaptive {adaptive}, {rate} rad/s"), start.expect("a folded leg"));
            let done = (0..1500).take_while(|_| twins.advance(&default_inputs(), 1e-3, 1)).count();
            assert!(done == 1500 || !adaptive, "{}: {done}", twins.name);
        }
    }
}

/// The paper's fall of 50 s passes singularities of every kind; its state is stored at intervals.
#[test]
fn states_of_a_long_fall_are_read_back() {
    for (method, adaptive) in [(Method::I3alp, true), (Method::Dop853, true), (Method::I3alpConserving, false)] {
        let mut parameters = default_parameters();
        (parameters.settings.method, parameters.settings.adaptive) = (method, adaptive);
        let mut twins = Twins::new(format!("{method:?}"), Simulation::new(&parameters, &default_inputs()).expect("scene"));
        for _ in 0..700 {
            // 71 is not a divisor of anything.
            assert!(twins.advance(&default_inputs(), 1e-3, 71), "{}", twins.name);
        }
        let passes = twins.free.singular();
        assert!(passes.iter().sum::<u64>() > 100, "{passes:?}");
    }
}
