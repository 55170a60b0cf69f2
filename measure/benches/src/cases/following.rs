//! Cost of following a machine, compared with the bare step: with samples of both encoders at every step, also while learning masses and
//! friction; without samples; and while following both assemblies, from the start or after a direct singularity.

use std::hint::black_box;

use anyhow::{Context, Result, ensure};
use fivebar::effects::Inputs;
use fivebar::estimator::{Linkage, MEASURED, Measured, Pair, Status};
use fivebar::mechanism::Assembly;
use fivebar::mechanism::coordinates::THETA;
use fivebar::simulation::{Following, Parameters, Signal, Simulation};

use super::{H, STEPS};
use crate::case::{Case, Work};
use crate::scene::Scene;

pub(crate) const FOLLOWING: &str = "following";

/// Resolution of the encoders, rad: 16 bits.
const QUANTUM: f64 = std::f64::consts::TAU / 65536.0;

/// Steps until the start is no longer in doubt.
const RUN_UP: u64 = 400;

/// Steps counted while both assemblies are followed.
const DOUBTFUL: u64 = 100;
/// Limit of the step after the last of them.
const LATEST: u64 = 1600;

/// Encoder samples of a machine at a range of steps.
fn samples(machine: &mut Simulation, inputs: &Inputs, steps: std::ops::Range<u64>) -> Result<Vec<(Measured, f64)>> {
    let mut samples = Vec::new();
    for step in steps {
        let (theta, now) = (machine.state().angles(), step as f64 * H);
        let theta = MEASURED.map(|link| (theta[link] / QUANTUM).round() * QUANTUM);
        samples.push((Measured { theta, time: [now; 2] }, now));
        machine.advance(inputs, H, 1)?;
    }
    Ok(samples)
}

/// A twin of a machine with these parameters. Its lengths and mounting angles are uncertain if `geometry`, otherwise exact.
fn twin(mut parameters: Parameters, inputs: &Inputs, geometry: bool) -> Result<Following> {
    parameters.estimator.enabled = true;
    parameters.estimator.quantum = [QUANTUM; 2];
    parameters.estimator.sigma0_theta = 1e-3;
    parameters.estimator.sigma0_omega = 1e-2;
    if !geometry {
        parameters.estimator.take_geometry_as_exact();
    }
    Ok(Following::new(&parameters, inputs)?)
}

/// Learned parameters.
#[derive(Clone, Copy, PartialEq)]
enum Learned {
    None,
    /// Masses, payload and viscous friction.
    Loads,
    /// Loads, lengths and mounting angles.
    All,
}

/// The followed fall; `speak`: whether the encoders deliver samples.
fn followed(name: &'static str, speak: bool, learned: Learned) -> Case {
    Case::new(FOLLOWING, name, STEPS, move || {
        let Scene { mut parameters, inputs, .. } = Scene::fall();
        let (effects, learn) = (&mut parameters.effects, learned != Learned::None);
        (effects.payload.enabled, effects.viscous.enabled) = (learn, learn);
        (effects.payload.mass, effects.viscous.b) = (5e-3, [1e-5; 5]);
        parameters.estimator.learn_enabled = learn;
        let run_up = if speak { RUN_UP } else { 0 };
        let mut samples = samples(&mut Simulation::new(&parameters, &inputs)?, &inputs, 0..run_up + STEPS)?;
        let mut twin = twin(parameters, &inputs, learned == Learned::All)?;
        for (measured, now) in samples.drain(..run_up as usize) {
            twin.correct(&measured, now);
            twin.advance_along(&Signal::held(inputs), H, 1).map_err(|failure| anyhow::anyhow!("{failure}"))?;
        }
        ensure!(!speak || twin.status() != Status::TwoBranches, "the start is still doubted");
        let work: Work = Box::new(move || {
            for (measured, now) in &samples {
                if speak {
                    twin.correct(black_box(measured), *now);
                }
                twin.advance_along(black_box(&Signal::held(inputs)), H, 1).expect("the fall does not fail");
            }
        });
        Ok(work)
    })
}

/// A twin, and its encoder samples with their times, s.
type Sampled = (Following, Vec<(Measured, f64)>);

/// A fall; its start is in doubt until the machine has moved.
fn start() -> Result<Sampled> {
    let Scene { parameters, inputs, .. } = Scene::fall();
    let samples = samples(&mut Simulation::new(&parameters, &inputs)?, &inputs, 0..LATEST)?;
    Ok((twin(parameters, &inputs, false)?, samples))
}

/// A free machine that slowly crosses the singularity with its distal links in line, so that for some time samples cannot tell the side.
fn crossing() -> Result<Sampled> {
    /// Step of the crossing.
    const CROSSING: u64 = 1000;
    /// Rate at the crossing, along the first direction of the tangent basis, rad/s.
    const SLOW: f64 = 0.2;
    let Scene { mut parameters, inputs, .. } = Scene::fall();
    parameters.effects.gravity.enabled = false;
    parameters.geometry.base_distance = 0.1;
    // Distal links in line above the base: the distance between the elbows is the sum of both lengths.
    let [left, right] = [0, 1].map(|leg| parameters.geometry.links[1 + leg].length);
    let reach = (left + right - parameters.geometry.base_distance) / 2.0 / parameters.geometry.links[0].length;
    let pi = std::f64::consts::PI;
    let crossing = [pi - reach.acos(), 0.0, pi, reach.acos()];
    let frame = Linkage::new(&parameters.geometry).frame(&crossing.into());
    let omega: [f64; 4] = (frame.basis * Pair::new(SLOW, 0.0)).into();
    // A run with reversed rates finds the start of the crossing.
    let mut back = Simulation::at(&parameters, &inputs, crossing, omega.map(|rate| -rate))?;
    back.advance(&inputs, H, CROSSING)?;
    let state = back.state();
    let (theta, omega) = (state.angles(), THETA.map(|i| -state.core.v[i]));
    let mut machine = Simulation::at(&parameters, &inputs, theta, omega)?;
    parameters.start.theta = MEASURED.map(|link| theta[link]);
    parameters.start.omega = MEASURED.map(|link| omega[link]);
    parameters.start.assembly = if (theta[2] - theta[1]).sin() > 0.0 { Assembly::Plus } else { Assembly::Minus };
    let samples = samples(&mut machine, &inputs, 0..LATEST)?;
    Ok((twin(parameters, &inputs, false)?, samples))
}

/// A machine followed in both assemblies.
fn doubtful(name: &'static str, machine: fn() -> Result<Sampled>) -> Case {
    Case::new(FOLLOWING, name, DOUBTFUL, move || {
        let (mut twin, samples) = machine()?;
        let inputs = Scene::fall().inputs;
        let follow = move |twin: &mut Following, (measured, now): &(Measured, f64)| {
            twin.correct(black_box(measured), *now);
            twin.advance_along(black_box(&Signal::held(inputs)), H, 1)
        };
        let open = |twin: &Following| twin.status() == Status::TwoBranches;
        let mut ahead = samples.into_iter();
        while !open(&twin) {
            follow(&mut twin, &ahead.next().context("two assemblies are never followed")?)?;
        }
        let samples: Vec<_> = ahead.take(DOUBTFUL as usize).collect();
        ensure!(samples.len() == DOUBTFUL as usize, "two assemblies are followed too late");
        let mut trial = twin.clone();
        for sample in &samples {
            follow(&mut trial, sample)?;
            ensure!(open(&trial), "two assemblies are not followed for long enough");
        }
        let work: Work = Box::new(move || {
            for sample in &samples {
                follow(&mut twin, sample).expect("it has been tried");
            }
        });
        Ok(work)
    })
}

pub(super) fn cases() -> Vec<Case> {
    vec![
        followed("a step with a sample of both encoders", true, Learned::None),
        followed("a step with a sample of both encoders, masses, payload and viscous friction learned", true, Learned::Loads),
        followed("a step with a sample of both encoders, lengths and mounting angles learned as well", true, Learned::All),
        followed("a coasting step", false, Learned::None),
        doubtful("a step with a sample of both encoders, the start doubted", start),
        doubtful("a step with a sample of both encoders, two assemblies followed", crossing),
    ]
}
