//! Hypotheses after a vertex: the motion may have continued straight or turned to either side. Each is propagated and updated beside the
//! estimate until the evidence of samples decides; afterwards `assembly` follows the mirrored assembly.

use borsh::{BorshDeserialize, BorshSerialize};

use super::bank::{MODELS, PRIOR};
use super::encoder::Reading;
use super::innovation::{Innovation, PredictedSample, log_likelihood};
use super::linkage::{Linkage, MEASURED, NEAR_VERTEX};
use super::track::{Track, wrapped};
use super::{Constants, Scene, transition};
use crate::mechanism::{Assembly, Geometry, Start, close};

/// Life of a hypothesis, s: by then samples have decided.
const LIFETIME: f64 = 0.5;
/// Log-likelihood ratios relative to the estimate below which a hypothesis is dropped and above which it replaces the estimate.
const EVIDENCE_BOUNDS: [f64; 2] = [-12.0, 6.0];
/// Log-likelihood ratio of the first samples after a vertex that replaces the estimate at once.
const IMMEDIATE_EVIDENCE: f64 = 15.0;
/// Angle of the fastest link before the vertex at which turning hypotheses start, rad.
const START_DISTANCE: f64 = 0.05;
/// Lateral offset at which turning hypotheses start, rad: the way they turn hardly depends on it.
const LATERAL_OFFSET: f64 = 5e-3;
/// Runge–Kutta steps of a turning hypothesis, there and back.
const TURNING_STEPS: u32 = 128;
/// Largest turn of a link per Runge–Kutta step relative to the smallest singular value of J over the mean length.
const LARGEST_TURN: f64 = 0.125;
/// Floor of the smallest singular value in a division, dimensionless.
const LEAST_SINGULAR_VALUE: f64 = 1e-6;
/// Largest number of Runge–Kutta steps in a macro step.
const MOST_STEPS: f64 = 256.0;

/// Largest number of hypotheses.
const MOST_HYPOTHESES: usize = 3;

/// Hypotheses after a vertex.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Branches {
    /// Time since the last vertex, s.
    since_vertex: f64,
    /// Whether the estimate approaches a vertex.
    approaches_vertex: bool,
    hypotheses: [Option<Hypothesis>; MOST_HYPOTHESES],
}

#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Hypothesis {
    track: Track,
    /// Whether the hypothesis continues straight through a vertex.
    straight: bool,
    /// Log-likelihood ratio relative to the estimate.
    evidence: f64,
    /// Age, s.
    age: f64,
}

impl Default for Branches {
    fn default() -> Self {
        Self { since_vertex: f64::MAX, approaches_vertex: false, hypotheses: [None; MOST_HYPOTHESES] }
    }
}

impl Branches {
    /// Whether the branch is known: the last vertex was left longer ago than a hypothesis lives, [`LIFETIME`].
    pub(super) fn is_branch_known(&self) -> bool {
        self.since_vertex > LIFETIME
    }

    /// Whether any hypothesis is open.
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

    /// Time update of the hypotheses by a macro step.
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

    /// Opens hypotheses where the estimate leaves a vertex, since no sample has told on which side it was passed. The smallest singular
    /// value of J was `from` at `track`, before the macro step, and is `to` after it.
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

    /// Hypothesis that the first samples (innovation, angle) after a vertex favour by far.
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

    /// Hypothesis of most evidence, if that exceeds `least`.
    fn best(&self, evidence: impl Fn(&Hypothesis) -> f64, least: f64) -> Option<usize> {
        let mut best = (None, least);
        for (k, other) in self.hypotheses.iter().enumerate() {
            if let Some(evidence) = other.as_ref().map(&evidence).filter(|evidence| *evidence > best.1) {
                best = (Some(k), evidence);
            }
        }
        best.0
    }

    /// Subtracts the estimate's log-likelihood of a sample from the evidence.
    pub(super) fn subtract_likelihood(&mut self, expected: &PredictedSample) {
        if self.are_open() {
            let (nis, variance) = expected.nis_and_variance();
            for other in self.hypotheses.iter_mut().flatten() {
                other.evidence -= log_likelihood(nis, variance);
            }
        }
    }

    /// Measurement update of the hypotheses. Returns the one that replaces the estimate, if any.
    pub(super) fn correct(&mut self, linkage: &Linkage, readings: &[Option<Reading>; 2]) -> Option<usize> {
        for other in &mut self.hypotheses {
            if other.as_mut().is_some_and(|other| !other.correct(linkage, readings)) {
                *other = None;
            }
        }
        self.best(|other| other.evidence, EVIDENCE_BOUNDS[1])
    }

    /// Exchanges a hypothesis with the estimate.
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

    /// Measurement update; false where the evidence refutes the hypothesis.
    fn correct(&mut self, linkage: &Linkage, readings: &[Option<Reading>; 2]) -> bool {
        let Some(likelihood) = update_hypothesis(&mut self.track, linkage, readings) else { return false };
        self.evidence += likelihood;
        // NaN refutes the hypothesis.
        self.evidence > EVIDENCE_BOUNDS[0]
    }
}

/// Time update of a hypothesis by a macro step with Runge–Kutta, under an unknown force of scale `scale`, N·m, and models of these priors;
/// false where it fails. `straight`: the motion continues straight through a vertex.
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
        // Next to a vertex J cannot close the loop.
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

/// Measurement update of a hypothesis; returns its log-likelihood, `None` where the loop cannot be closed.
#[inline(never)]
pub(super) fn update_hypothesis(track: &mut Track, linkage: &Linkage, readings: &[Option<Reading>; 2]) -> Option<f64> {
    let mut likelihood = 0.0;
    let frame = linkage.frame(&track.theta);
    for (encoder, reading) in readings.iter().enumerate() {
        let Some(Reading { angle, noise, age, dead_zone }) = *reading else { continue };
        let mut innovation = track.innovation(&frame, encoder, angle, noise);
        // Hypotheses keep no history: a past angle is extrapolated by the rate.
        let residual = wrapped(innovation.residual + age * track.omega[MEASURED[encoder]]);
        if residual.abs() < dead_zone {
            continue;
        }
        innovation.residual = residual - dead_zone.copysign(residual);
        let expected = track.bank.predict_sample(&innovation);
        let (nis, variance) = expected.nis_and_variance();
        // Within the dead zone of a reading all motions are equally likely: the normalisation by the variance is left out.
        likelihood += if dead_zone > 0.0 { -0.5 * nis } else { log_likelihood(nis, variance) };
        track.bank.update(&expected);
    }
    track.inject_error(linkage, &frame).map(|_| likelihood)
}

/// Hypothesis of the mirrored assembly with equal angles and rates of the motors.
#[cold]
#[inline(never)]
pub(super) fn mirrored(constants: &Constants, track: &Track) -> Option<Track> {
    let linkage = &constants.linkage;
    let from = linkage.frame(&track.theta);
    let assembly = if from.side() > 0.0 { Assembly::Minus } else { Assembly::Plus };
    let start = Start { theta: MEASURED.map(|link| track.theta[link]), omega: MEASURED.map(|link| track.omega[link]), assembly };
    let (theta, omega) = posture(&constants.geometry, &start)?;
    let to = linkage.frame(&theta);
    // Equal errors of the motors on the other tangent basis.
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

/// Angles, rad, and rates, rad/s, of all links at a start.
pub(super) fn posture(geometry: &Geometry, start: &Start) -> Option<(super::Links, super::Links)> {
    use crate::mechanism::coordinates::THETA;
    let (q, v) = close(geometry, start).ok()?;
    Some((THETA.map(|i| q[i]), THETA.map(|i| v[i])))
}
