//! Behind a vertex: what the motion may have become beside the estimate, followed until the samples have told which it is. It may have gone
//! straight on or turned to either side; later, `assembly` follows the other assembly with the same motors.

use borsh::{BorshDeserialize, BorshSerialize};

use super::bank::{MODELS, PRIOR};
use super::encoder::Reading;
use super::innovation::{Innovation, PredictedSample, log_likelihood};
use super::linkage::{Linkage, MEASURED, NEAR_VERTEX};
use super::track::{Track, wrapped};
use super::{Constants, Scene, transition};
use crate::mechanism::{Assembly, Geometry, Start, close};

/// It is dropped after this time, s,
const LIFETIME: f64 = 0.5;
/// or where the samples speak against it, and takes over where they speak for it: differences of log likelihoods.
const EVIDENCE_BOUNDS: [f64; 2] = [-12.0, 6.0];
/// A difference by which samples decide at once.
const IMMEDIATE_EVIDENCE: f64 = 15.0;
/// Motions that turn at a vertex are begun this far before it, rad of the fastest link,
const START_DISTANCE: f64 = 0.05;
/// so far aside, rad: how they turn does not depend on it,
const LATERAL_OFFSET: f64 = 5e-3;
/// in so many steps of Runge-Kutta.
const TURNING_STEPS: u32 = 128;
/// Where the smallest singular value of J, over the mean length, is near, a step turns no link by more than this part of it.
const LARGEST_TURN: f64 = 0.125;
/// Nothing is divided by 0 in a vertex.
const LEAST_SINGULAR_VALUE: f64 = 1e-6;
/// Most steps of Runge-Kutta in a macro step.
const MOST_STEPS: f64 = 256.0;

/// Most motions beside the estimate.
const MOST_HYPOTHESES: usize = 3;

/// What is followed beside the estimate.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Branches {
    /// Time since a vertex, s.
    since_vertex: f64,
    /// Whether the estimate comes nearer to one.
    approaches_vertex: bool,
    hypotheses: [Option<Hypothesis>; MOST_HYPOTHESES],
}

#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Hypothesis {
    track: Track,
    /// Whether it goes straight through a vertex.
    straight: bool,
    /// log likelihood less that of the estimate.
    evidence: f64,
    /// s.
    age: f64,
}

impl Default for Branches {
    fn default() -> Self {
        Self { since_vertex: f64::MAX, approaches_vertex: false, hypotheses: [None; MOST_HYPOTHESES] }
    }
}

impl Branches {
    /// Whether no vertex is near.
    pub(super) fn is_branch_known(&self) -> bool {
        self.since_vertex > LIFETIME
    }

    /// Whether something is followed beside the estimate.
    pub(super) fn are_open(&self) -> bool {
        self.hypotheses.iter().any(Option::is_some)
    }

    pub(super) fn tracks(&self) -> impl Iterator<Item = &Track> {
        self.hypotheses.iter().flatten().map(|other| &other.track)
    }

    pub(super) fn is_sound(&self) -> bool {
        self.since_vertex >= 0.0
            && self.hypotheses.iter().flatten().all(|other| other.evidence.is_finite() && (0.0..=LIFETIME).contains(&other.age))
    }

    /// The estimate has gone on by a macro step.
    pub(super) fn step(&mut self, constants: &Constants, held: bool, scene: &impl Scene, (h, switch_time): (f64, f64)) {
        self.since_vertex = (if held { 0.0 } else { self.since_vertex } + h).min(f64::MAX);
        for other in &mut self.hypotheses {
            if let Some(motion) = other {
                motion.age += h;
                let scale = constants.torque_scale();
                let goes_on = motion.age < LIFETIME
                    && propagate_hypothesis(&mut motion.track, constants, scene, motion.straight, (h, switch_time, scale), &PRIOR);
                if !goes_on {
                    *other = None;
                }
            }
        }
    }

    /// The estimate has come from `track`, whose smallest singular value is `from`, to where it is `to`. Where it goes away from a vertex
    /// again, what it may have become beside is begun: nobody can know on which side it has passed.
    pub(super) fn open_after_vertex(
        &mut self,
        linkage: &Linkage,
        track: &Track,
        scene: &impl Scene,
        [from, to]: [f64; 2],
        turned: bool,
    ) {
        let near = from.min(to) < NEAR_VERTEX;
        let leaves = near && (turned || self.approaches_vertex && to > from);
        self.approaches_vertex = near && !leaves && to < from;
        if leaves && !self.are_open() {
            let straight = turned.then(|| Hypothesis::new(*track, true));
            let aside = |side: f64| {
                track
                    .with_lateral_offset(linkage, scene, (START_DISTANCE, side * LATERAL_OFFSET, TURNING_STEPS))
                    .map(|track| Hypothesis::new(track, false))
            };
            self.hypotheses = [straight, aside(1.0), aside(-1.0)];
        }
    }

    /// What samples (innovation, angle) that come after some time of holding fit far better than the estimate.
    pub(super) fn preferred(&self, linkage: &Linkage, track: &Track, samples: &[Option<(Innovation, f64)>; 2]) -> Option<usize> {
        let evidence = |other: &Hypothesis| {
            let mut evidence = 0.0;
            for (encoder, sample) in samples.iter().enumerate() {
                let Some((innovation, angle)) = sample else { continue };
                let (nis, variance) = track.bank.predict_sample(innovation).nis_and_variance();
                let frame = linkage.frame(&other.track.theta);
                let (other_nis, other_variance) = other
                    .track
                    .bank
                    .predict_sample(&other.track.innovation(&frame, encoder, *angle, innovation.noise))
                    .nis_and_variance();
                evidence += log_likelihood(other_nis, other_variance) - log_likelihood(nis, variance);
            }
            evidence
        };
        self.best(evidence, IMMEDIATE_EVIDENCE)
    }

    /// Of what is followed beside that with most evidence, if it is more than `least`.
    fn best(&self, evidence: impl Fn(&Hypothesis) -> f64, least: f64) -> Option<usize> {
        let mut best = (None, least);
        for (k, other) in self.hypotheses.iter().enumerate() {
            if let Some(evidence) = other.as_ref().map(&evidence).filter(|evidence| *evidence > best.1) {
                best = (Some(k), evidence);
            }
        }
        best.0
    }

    /// A sample that the estimate takes in: its likelihood.
    pub(super) fn subtract_likelihood(&mut self, expected: &PredictedSample) {
        if self.are_open() {
            let (nis, variance) = expected.nis_and_variance();
            for other in self.hypotheses.iter_mut().flatten() {
                other.evidence -= log_likelihood(nis, variance);
            }
        }
    }

    /// The same samples for what is followed beside. What of it takes over.
    pub(super) fn correct(&mut self, linkage: &Linkage, readings: &[Option<Reading>; 2]) -> Option<usize> {
        for other in &mut self.hypotheses {
            if other.as_mut().is_some_and(|other| !other.correct(linkage, readings)) {
                *other = None;
            }
        }
        self.best(|other| other.evidence, EVIDENCE_BOUNDS[1])
    }

    /// One of them becomes the estimate, and the estimate one of them.
    #[cold]
    pub(super) fn swap(&mut self, track: &mut Track, with: usize) {
        let Some(ahead) = self.hypotheses[with].as_ref().map(|other| other.evidence) else { return };
        for (k, other) in self.hypotheses.iter_mut().enumerate() {
            if let Some(other) = other {
                other.evidence -= ahead;
                if k == with {
                    std::mem::swap(track, &mut other.track);
                    other.evidence = -ahead;
                    other.straight = false;
                }
            }
        }
    }
}

impl Hypothesis {
    fn new(track: Track, straight: bool) -> Self {
        Self { track, straight, evidence: 0.0, age: 0.0 }
    }

    /// Takes samples in; false where they speak against it.
    fn correct(&mut self, linkage: &Linkage, readings: &[Option<Reading>; 2]) -> bool {
        let Some(likelihood) = update_hypothesis(&mut self.track, linkage, readings) else { return false };
        self.evidence += likelihood;
        // NaN speaks against it.
        self.evidence > EVIDENCE_BOUNDS[0]
    }
}

/// A motion beside the estimate goes on by a macro step, by Runge–Kutta, with unknown forces of a scale, N·m, and models of such
/// priors; false where it cannot. `straight`: it goes straight through a vertex.
#[inline(never)]
pub(super) fn propagate_hypothesis(
    track: &mut Track,
    constants: &Constants,
    scene: &impl Scene,
    straight: bool,
    (h, switch_time, scale): (f64, f64, f64),
    priors: &[f64; MODELS],
) -> bool {
    let linkage = &constants.linkage;
    let from = linkage.frame(&track.theta);
    let fastest = track.omega.iter().fold(0.0_f64, |most, rate| most.max(rate.abs()));
    let fine = (h * fastest / (LARGEST_TURN * from.smallest.max(LEAST_SINGULAR_VALUE))).ceil().clamp(1.0, MOST_STEPS) as u32;
    let flow = track.flow(linkage, &from, scene, (h, fine));
    let (theta, omega, to) = if straight && from.smallest < NEAR_VERTEX {
        let Track { theta, omega, .. } = track.extrapolated(linkage, h);
        (theta, omega, linkage.frame(&theta))
    } else {
        // Next to a vertex J is no way back onto the loop.
        let at = linkage.posture(&flow.theta);
        if at.gram(linkage.length).1 < NEAR_VERTEX {
            (flow.theta, flow.omega, linkage.frame(&flow.theta))
        } else {
            let Some(closed) = linkage.closed(flow.theta, flow.omega) else { return false };
            closed
        }
    };
    let step = track.step((&from, &to), (&theta, &omega), &flow, h);
    track.bank.predict(linkage, (&from, &step.transition), [scale, 0.0], (h, switch_time), priors);
    (track.theta, track.omega) = (theta, omega);
    true
}

/// A motion beside the estimate takes samples in; their log likelihood, `None` where the loop cannot be closed.
#[inline(never)]
pub(super) fn update_hypothesis(track: &mut Track, linkage: &Linkage, readings: &[Option<Reading>; 2]) -> Option<f64> {
    let mut likelihood = 0.0;
    let frame = linkage.frame(&track.theta);
    for (encoder, reading) in readings.iter().enumerate() {
        let Some(Reading { angle, noise, age, dead_zone }) = *reading else { continue };
        let mut innovation = track.innovation(&frame, encoder, angle, noise);
        // Motions that are followed beside are slow: where they stood follows from their rates.
        let residual = wrapped(innovation.residual + age * track.omega[MEASURED[encoder]]);
        if residual.abs() < dead_zone {
            continue;
        }
        innovation.residual = residual - dead_zone.copysign(residual);
        let expected = track.bank.predict_sample(&innovation);
        let (nis, variance) = expected.nis_and_variance();
        // Of what is told within the slack by no motion, its density is no part.
        likelihood += if dead_zone > 0.0 { -0.5 * nis } else { log_likelihood(nis, variance) };
        track.bank.update(&expected);
    }
    track.inject_error(linkage, &frame).map(|_| likelihood)
}

/// The other assembly with the same angles and rates of the motors.
#[cold]
#[inline(never)]
pub(super) fn mirrored(constants: &Constants, track: &Track) -> Option<Track> {
    let linkage = &constants.linkage;
    let from = linkage.frame(&track.theta);
    let assembly = if from.side() > 0.0 { Assembly::Minus } else { Assembly::Plus };
    let start = Start { theta: MEASURED.map(|link| track.theta[link]), omega: MEASURED.map(|link| track.omega[link]), assembly };
    let (theta, omega) = posture(&constants.geometry, &start)?;
    let to = linkage.frame(&theta);
    // The same errors of the motors on the other tangent basis.
    let motors = |of: &super::Frame| MEASURED.map(|link| of.basis.map(|direction| direction[link]));
    let ([a, b], [[c, d], [e, f]]) = (motors(&from), motors(&to));
    let determinant = c * f - d * e;
    if determinant.abs() < 1e-3 {
        return None;
    }
    let inverse = [[f / determinant, -d / determinant], [-e / determinant, c / determinant]];
    let mut turn = [[0.0; transition::ERRORS]; transition::ERRORS];
    for i in 0..2 {
        for k in 0..2 {
            let value = inverse[i][0] * a[k] + inverse[i][1] * b[k];
            turn[i][k] = value;
            turn[2 + i][2 + k] = value;
        }
        turn[4 + i][4 + i] = 1.0;
    }
    let mut bank = track.bank;
    bank.propagate(&turn);
    Some(Track { theta, omega, force: [0.0; 4], bank })
}

/// Angles and rates of all links of a start.
pub(super) fn posture(geometry: &Geometry, start: &Start) -> Option<(super::Links, super::Links)> {
    use crate::mechanism::coordinates::THETA;
    let (q, v) = close(geometry, start).ok()?;
    Some((THETA.map(|i| q[i]), THETA.map(|i| v[i])))
}
