//! Every state that a run with an estimator reaches can be stored, and continues with equal bits, whatever the samples were.
//! `forged_states.rs` has states that must be refused.

use std::f64::consts::{PI, TAU};

use fivebar::effects::{Inputs, NAMES};
use fivebar::estimator::{Bands, MEASURED, Measured};
use fivebar::mechanism::Assembly;
use fivebar::simulation::bindings::default_parameters;
use fivebar::simulation::{Estimate, Following, Method, Parameters, Run, Signal, Simulation};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::{enable, is_nightly, unequal};

struct Random(ChaCha8Rng);

impl Random {
    /// Uniform in [0, 1).
    fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// A random index below `count`.
    fn one_of(&mut self, count: usize) -> usize {
        (self.0.next_u64() % count as u64) as usize
    }

    /// Whether an event of this probability happens.
    fn is(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }

    fn pair(&mut self, largest: f64) -> [f64; 2] {
        [self.between(-largest, largest), self.between(-largest, largest)]
    }

    fn inputs(&mut self) -> Inputs {
        let (tau, tip_force) = (self.pair(0.05), self.pair(0.2));
        Inputs { tau, tip_force, servo_theta: self.pair(3.0), servo_omega: self.pair(3.0) }
    }

    /// Parameters of a unit that tracks a machine: any geometry, effects, encoders, priors and start.
    fn scene(&mut self) -> Parameters {
        let mut parameters = if self.is(0.5) { unequal() } else { default_parameters() };
        parameters.settings.method = [Method::Dop853, Method::Automatic, Method::I3alp][self.one_of(3)];
        // A run whose forces become too stiff ends.
        parameters.settings.max_work = 1000;
        parameters.start.theta = if self.is(0.5) { [2.2, 0.9] } else { self.pair(PI) };
        parameters.start.omega = if self.is(0.5) { [0.0; 2] } else { self.pair(10.0) };
        parameters.start.assembly = if self.is(0.5) { Assembly::Plus } else { Assembly::Minus };
        let geometry = &mut parameters.geometry;
        match self.one_of(4) {
            0 => geometry.base_distance = 0.1,
            1 => geometry.base_distance = 0.0,
            // Four equal lengths: the machine has vertices.
            2 => {
                geometry.base_distance = 0.42;
                geometry.links.iter_mut().for_each(|link| link.length = 0.21);
            }
            _ => (),
        }
        parameters.effects.gravity.enabled = self.is(0.5);
        for effect in NAMES {
            if self.is(0.15) {
                enable(&mut parameters, effect);
            }
        }
        parameters.effects.viscous.b = [2e-4; 5];
        let estimator = &mut parameters.estimator;
        estimator.enabled = true;
        estimator.learn_enabled = self.is(0.5);
        match self.one_of(3) {
            0 => estimator.sigma = [self.between(1e-5, 3e-3); 2],
            1 => (estimator.sigma, estimator.quantum) = ([0.0; 2], [[1e-4, 1.7e-3, 1e-6][self.one_of(3)]; 2]),
            _ => estimator.quantum = [1e-4; 2],
        }
        if self.is(0.4) {
            estimator.take_geometry_as_exact();
        }
        if self.is(0.3) && !estimator.learn_enabled {
            estimator.max_delay = 5e-3;
        }
        if self.is(0.5) {
            (estimator.sigma0_theta, estimator.sigma0_omega) = (self.power_of_ten(-6.0, 0.0), self.power_of_ten(-5.0, 1.0));
        }
        if self.is(0.2) {
            estimator.torque_scale = self.power_of_ten(-3.0, 1.0);
        }
        if self.is(0.3) {
            estimator.forecast = Bands::SigmaPoints;
        }
        if self.is(0.3) {
            (estimator.command_scale_tau, estimator.command_scale_theta) = ([self.power_of_ten(-4.0, 0.0); 2], [0.1; 2]);
        }
        parameters
    }
}

/// How samples of an encoder fail for a while.
#[derive(Clone, Copy, Debug)]
enum Trouble {
    None,
    /// A part of the samples is off by up to half of this, rad.
    Wild {
        part: f64,
        by: f64,
    },
    /// The reading stays at this angle, rad.
    Stuck {
        at: f64,
    },
    /// The reading is off by this, rad.
    Jump {
        by: f64,
    },
    Silent,
    /// Samples are not numbers, or too large.
    Invalid {
        value: f64,
    },
    /// Time stamps are off by up to half of this, s.
    Stamps {
        by: f64,
    },
    /// The angle of the other axis.
    Exchanged,
}

impl Random {
    fn power_of_ten(&mut self, low: f64, high: f64) -> f64 {
        10.0_f64.powf(self.between(low, high))
    }

    fn trouble(&mut self, reading: f64) -> Trouble {
        match self.one_of(10) {
            0 => Trouble::Wild { part: self.uniform(), by: self.power_of_ten(-3.0, 1.0) },
            1 => Trouble::Stuck { at: reading },
            2 => Trouble::Jump { by: self.power_of_ten(-3.0, 0.5) },
            3 => Trouble::Silent,
            4 => Trouble::Invalid { value: [f64::NAN, f64::INFINITY, 1e300][self.one_of(3)] },
            5 => Trouble::Stamps { by: self.power_of_ten(-4.0, 0.0) },
            6 => Trouble::Exchanged,
            _ => Trouble::None,
        }
    }
}

/// A machine that differs from its description, the unit that tracks it, and the same unit, which is stored and restored now and then.
struct Pair {
    machine: Simulation,
    free: Following,
    stored: Following,
    /// States that were refused, with their instants.
    refusals: Vec<String>,
}

impl Pair {
    /// `None` if the machine or its description cannot be assembled.
    fn new(random: &mut Random, inputs: &Inputs) -> Option<Self> {
        let model = random.scene();
        let mut truth = model.clone();
        for link in &mut truth.geometry.links {
            link.mass *= random.between(0.8, 1.2);
            link.length *= random.between(0.998, 1.002);
        }
        if random.is(0.3) {
            truth.start.theta.iter_mut().for_each(|theta| *theta += random.between(-0.3, 0.3));
        }
        if random.is(0.2) {
            truth.start.assembly = if random.is(0.5) { Assembly::Plus } else { Assembly::Minus };
        }
        let machine = Simulation::new(&truth, inputs).ok()?;
        let free = Following::new(&model, inputs).ok()?;
        Some(Self { machine, stored: free.clone(), free, refusals: Vec::new() })
    }

    fn bytes(following: &Following) -> Vec<u8> {
        borsh::to_vec(&(following.simulation().run(), following.estimate())).expect("bytes")
    }

    /// Checks the state, and converts it to bytes and back now and then. Returns whether it is accepted.
    fn check(&mut self, random: &mut Random, case: &str) -> bool {
        let Self { free, stored, .. } = self;
        let mut accepted = free.estimator().check(free.believed(), &free.motion()).map_err(String::from);
        if accepted.is_ok() && random.is(0.02) {
            let bytes = Self::bytes(stored);
            assert_eq!(bytes, Self::bytes(free), "{case}: the runs have parted");
            let (run, estimate): (Run, Box<Estimate>) = borsh::from_slice(&bytes).expect("a state");
            let restored = Following::restored(stored.parameters(), run, estimate);
            accepted = restored.map(|restored| *stored = restored).map_err(|refusal| refusal.to_string());
        }
        accepted.map_err(|refusal| self.refusals.push(format!("{case}: {refusal}"))).is_ok()
    }
}

/// States that were refused in a random run, and the number of states. Every 50 samples or so each encoder fails in another way; inputs and
/// pushes change.
pub(crate) fn refused(seed: u64) -> (Vec<String>, usize) {
    let mut random = Random(ChaCha8Rng::seed_from_u64(seed));
    let mut inputs = random.inputs();
    let Some(mut pair) = Pair::new(&mut random, &inputs) else { return (Vec::new(), 0) };
    let h = [1e-3, 1e-3, 5e-3][random.one_of(3)];
    let estimator = pair.free.parameters().estimator.clone();
    let delay = if estimator.max_delay > 0.0 { 2e-3 } else { 0.0 };
    let turns = [0, 1].map(|_| if random.is(0.1) { TAU * (random.one_of(9) as f64 - 4.0) } else { 0.0 });
    let (mut troubles, mut before, mut push) = ([Trouble::None; 2], Measured::default(), [0.0; 2]);
    let mut states = 0;
    for step in 0..600 {
        let time = f64::from(step) * h;
        if random.is(0.02) {
            troubles = [0, 1].map(|i| random.trouble(before.theta[i]));
        }
        if random.is(0.01) {
            inputs = random.inputs();
        }
        if random.is(0.01) {
            push = if random.is(0.5) { random.pair(1.0) } else { [0.0; 2] };
        }
        let angles = MEASURED.map(|link| pair.machine.state().angles()[link]);
        let mut measured = Measured { theta: before.theta, time: [time - delay; 2] };
        for i in 0..2 {
            let (sigma, quantum) = (estimator.sigma[i], estimator.quantum[i]);
            let angle = angles[i] + turns[i] + sigma * random.between(-1.7, 1.7);
            let reading = if quantum > 0.0 { (angle / quantum).round() * quantum } else { angle };
            measured.theta[i] = reading;
            match troubles[i] {
                Trouble::None => (),
                Trouble::Wild { part, by } => {
                    measured.theta[i] += if random.is(part) { by * random.between(-0.5, 0.5) } else { 0.0 };
                }
                Trouble::Stuck { at } => measured.theta[i] = at,
                Trouble::Jump { by } => measured.theta[i] += by,
                Trouble::Silent => (measured.theta[i], measured.time[i]) = (before.theta[i], before.time[i]),
                Trouble::Invalid { value } => measured.theta[i] = value,
                Trouble::Stamps { by } => measured.time[i] += by * random.between(-0.5, 0.5),
                Trouble::Exchanged => measured.theta[i] = angles[1 - i],
            }
        }
        before = measured;
        let case = |when: &str| format!("seed {seed}, {when} at {time} s, {troubles:?}");
        for twin in [&mut pair.free, &mut pair.stored] {
            twin.correct(&measured, time);
        }
        if !pair.check(&mut random, &case("corrected")) {
            break;
        }
        let steps = (h / 1e-3).round() as u64;
        let advance = |twin: &mut Following| twin.advance_along(&Signal::held(inputs), h / steps as f64, steps).is_ok();
        let moved = [advance(&mut pair.free), advance(&mut pair.stored)];
        let acting = Inputs { tip_force: [0, 1].map(|i| inputs.tip_force[i] + push[i]), ..inputs };
        if moved.contains(&false) || pair.machine.advance(&acting, h / steps as f64, steps).is_err() {
            break;
        }
        states += 2;
        if !pair.check(&mut random, &case("moved")) {
            break;
        }
    }
    (pair.refusals, states)
}

/// Wild samples, encoders that stick, jump, fall silent or are exchanged, delays, wrong time stamps, pushes, wrong starts, vertices,
/// learning: each state that such a run reaches is accepted, and continues with the same bits.
#[test]
fn each_reached_state_is_restored() {
    let runs: Vec<_> = (0..if is_nightly() { 1000 } else { 60 }).map(refused).collect();
    let refusals: Vec<&String> = runs.iter().flat_map(|(refusals, _)| refusals).collect();
    let states: usize = runs.iter().map(|(_, states)| states).sum();
    assert!(refusals.is_empty(), "{} of {states} states: {refusals:#?}", refusals.len());
    // Many machines cannot be assembled, and some runs end early.
    assert!(states > 300 * runs.len(), "{states} states in {} runs", runs.len());
}
