//! Random scenes of every kind, by every method with checked steps, at any tolerance: the checks must not stop a correct step.

use std::f64::consts::PI;
use std::io::{self, Write};

use fivebar::effects::Law;
use fivebar::integrator::StepError;
use fivebar::mechanism::{Assembly, Link};
use fivebar::observers;
use fivebar::simulation::bindings::default_parameters;
use fivebar::simulation::{FailureCause, Inputs, Method, Parameters, Simulation};
use rayon::prelude::*;

use crate::cases::kinks;
use crate::machine::{NO_LOAD, mgl};
use crate::random::Random;
use crate::report::markdown_table;

/// The methods that check their steps.
const METHODS: [Method; 4] = [Method::I3alp, Method::Dop853, Method::Automatic, Method::I3alpConserving];

/// Work in one macro step at which a run counts as complete.
const MOST_WORK: u32 = 100_000;

/// A random scene.
struct Scene {
    number: u64,
    method: usize,
    parameters: Parameters,
    /// Inputs, and the number of communication steps with each.
    held: Vec<(Inputs, u32)>,
    /// Communication step, s.
    step: f64,
}

/// End of a run.
enum End {
    Complete,
    /// The start was refused.
    Refused,
    /// A check stopped it: the message, and the energy error of the same run without checks at this time, J.
    Stopped(String, f64),
    /// It ended with another status.
    GivenUp(String),
}

/// Runs of a method.
#[derive(Clone, Debug, Default)]
pub struct Row {
    method: &'static str,
    runs: usize,
    refused: usize,
    given_up: Vec<String>,
    stopped: Vec<String>,
}

impl Row {
    /// Number of completed runs.
    pub fn complete(&self) -> usize {
        self.runs - self.refused - self.given_up.len() - self.stopped.len()
    }

    /// Whether no check stopped a run.
    pub fn is_met(&self) -> bool {
        self.stopped.is_empty()
    }
}

/// Runs `count` scenes, starting at the number `from`.
pub fn measure(from: u64, count: u64) -> Vec<Row> {
    let ends: Vec<(usize, u64, End)> = (from..from + count)
        .into_par_iter()
        .map(|number| {
            let scene = Scene::random(number);
            (scene.method, scene.number, scene.run())
        })
        .collect();
    let mut rows = METHODS.map(|method| Row { method: method.name(), ..Row::default() });
    for (method, number, end) in ends {
        let row = &mut rows[method];
        row.runs += 1;
        match end {
            End::Complete => {}
            End::Refused => row.refused += 1,
            End::Stopped(why, energy) => row.stopped.push(format!("scene {number}: {why}; without checks {energy:.1e} J off")),
            End::GivenUp(why) => row.given_up.push(format!("scene {number}: {why}")),
        }
    }
    rows.into()
}

/// The rows in Markdown, followed by each scene that did not complete.
pub fn write_markdown(rows: &[Row], mut to: impl Write) -> io::Result<()> {
    let cells = rows.iter().map(|row| {
        let [refused, given_up, stopped] = [row.refused, row.given_up.len(), row.stopped.len()].map(|count| count.to_string());
        [row.method.to_owned(), row.runs.to_string(), refused, given_up, stopped]
    });
    markdown_table(["method", "runs", "starts refused", "given up", "stopped by a check"], cells, &mut to)?;
    for row in rows {
        for line in row.stopped.iter().chain(&row.given_up) {
            writeln!(to, "{}, {line}", row.method)?;
        }
    }
    Ok(())
}

impl Scene {
    fn random(number: u64) -> Self {
        let mut random = Random::new(number);
        let kinds = kinks::KINDS.len() as u64;
        // Half of the scenes have loads with kinks.
        let (mut parameters, inputs, duration) = match number % (2 * kinds) {
            kind if kind < kinds => kinks::KINDS[kind as usize].1(&mut random),
            other if other % 2 == 0 => any_machine(&mut random),
            _ => equal_in_pairs(&mut random),
        };
        let method = (random.uniform(0.0, METHODS.len() as f64) as usize).min(METHODS.len() - 1);
        let settings = &mut parameters.settings;
        (settings.method, settings.max_work) = (METHODS[method], MOST_WORK);
        settings.error_tolerance = random.log_uniform(1e-11, 1e-3);
        settings.step_size = random.log_uniform(1e-4, 5e-3);
        if settings.method == Method::I3alpConserving {
            (parameters.effects.friction.law, parameters.effects.contact.law) = (Law::Smooth, Law::Smooth);
        }
        let step = parameters.settings.step_size * random.uniform(1.0, 8.0).floor();
        let count = (duration.min(0.5) / step).ceil() as u32;
        let torque = if random.sign() > 0.0 { mgl(&parameters.geometry) } else { 0.0 };
        let held = (0..4).map(|part| {
            let tau = inputs.tau.map(|tau| tau + torque * random.uniform(-0.5, 0.5));
            (Inputs { tau, ..inputs }, count * (part + 1) / 4 - count * part / 4)
        });
        Self { number, method, held: held.collect(), parameters, step }
    }

    fn run(&self) -> End {
        let Ok(simulation) = Simulation::new(&self.parameters, &self.held[0].0) else { return End::Refused };
        let Err((steps, failure)) = self.follow(simulation, u32::MAX) else { return End::Complete };
        match failure.cause {
            FailureCause::Step(
                StepError::Imbalance { .. } | StepError::SignWithoutSingularity { .. } | StepError::BranchChange,
            ) => End::Stopped(failure.to_string(), self.energy_error_without_checks(steps + 1)),
            _ => End::GivenUp(failure.to_string()),
        }
    }

    /// Takes up to `most` communication steps; returns the simulation, or the number of completed steps and the reason for the failure.
    fn follow(&self, mut simulation: Simulation, most: u32) -> Result<Simulation, (u32, fivebar::simulation::StepFailure)> {
        let macro_steps = (self.step / self.parameters.settings.step_size).round() as u64;
        let mut steps = 0;
        for (inputs, count) in &self.held {
            for _ in 0..*count {
                if steps == most {
                    return Ok(simulation);
                }
                simulation.advance(inputs, self.parameters.settings.step_size, macro_steps).map_err(|failure| (steps, failure))?;
                steps += 1;
            }
        }
        Ok(simulation)
    }

    /// Energy error after `steps` communication steps without checks, J.
    fn energy_error_without_checks(&self, steps: u32) -> f64 {
        let mut parameters = self.parameters.clone();
        parameters.settings.checks = false;
        let Ok(simulation) = Simulation::new(&parameters, &self.held[0].0) else { return f64::NAN };
        let followed = self.follow(simulation, steps);
        followed.map_or(f64::NAN, |simulation| observers::energies(simulation.model(), &simulation.state()).error)
    }
}

/// A machine of any proportions with any motion.
fn any_machine(random: &mut Random) -> (Parameters, Inputs, f64) {
    let mut parameters = default_parameters();
    let mut link = || {
        let (length, mass) = (random.log_uniform(0.05, 1.0), random.log_uniform(1e-3, 10.0));
        Link {
            length,
            mass,
            inertia: random.log_uniform(0.01, 0.5) * mass * length * length,
            com: length * random.uniform(-0.2, 1.2),
        }
    };
    parameters.geometry.links = [(); 4].map(|()| link());
    parameters.geometry.base_distance = random.uniform(0.0, 1.0);
    parameters.start.theta = [random.uniform(-PI, PI), random.uniform(-PI, PI)];
    parameters.start.omega = [random.uniform(-10.0, 10.0), random.uniform(-10.0, 10.0)];
    parameters.start.assembly = if random.sign() > 0.0 { Assembly::Plus } else { Assembly::Minus };
    parameters.effects.gravity.enabled = random.sign() > 0.0;
    let effects = &mut parameters.effects;
    for enabled in [
        &mut effects.rotor.enabled,
        &mut effects.payload.enabled,
        &mut effects.viscous.enabled,
        &mut effects.friction.enabled,
        &mut effects.spring.enabled,
        &mut effects.servo.enabled,
    ] {
        *enabled = random.uniform(0.0, 1.0) < 0.2;
    }
    (parameters, NO_LOAD, random.uniform(0.1, 0.5))
}

/// Coaxial motors and pairs of equal lengths, near postures with all links in line.
fn equal_in_pairs(random: &mut Random) -> (Parameters, Inputs, f64) {
    const PATTERNS: [[usize; 4]; 4] = [[0, 1, 1, 0], [0, 1, 0, 1], [0, 0, 1, 1], [0, 0, 0, 0]];
    let mut parameters = default_parameters();
    parameters.geometry.base_distance = 0.0;
    let pattern = PATTERNS[(random.uniform(0.0, 4.0) as usize).min(3)];
    let lengths = [random.uniform(0.15, 0.3), random.uniform(0.1, 0.3)];
    for (link, pair) in parameters.geometry.links.iter_mut().zip(pattern) {
        link.length = lengths[pair];
    }
    let theta = random.uniform(-PI, PI);
    parameters.start.theta = [theta, theta + random.uniform(-1.5, 1.5)];
    parameters.start.omega = [random.uniform(-6.0, 6.0), random.uniform(-6.0, 6.0)];
    parameters.start.assembly = if random.sign() > 0.0 { Assembly::Plus } else { Assembly::Minus };
    (parameters, NO_LOAD, random.uniform(0.2, 0.5))
}
