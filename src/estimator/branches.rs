//! Behind a vertex: the other assembly, followed beside until the samples have told which it is.

use borsh::{BorshDeserialize, BorshSerialize};

use super::bank::Innovation;
use super::linkage::{Linkage, MEASURED};
use super::track::{Track, wrapped};
use super::{Constants, Scene, transition};
use crate::mechanism::{Assembly, Geometry, Start, close};

/// How long after a vertex the other assembly is begun, s,
const LATEST: f64 = 0.15;
/// where sin(θ₃ − θ₂) is at least this.
const APART: f64 = 0.1;
/// It is dropped after this time, s,
const LONGEST: f64 = 0.5;
/// or where the samples speak against it, and takes over where they speak for it: differences of log likelihoods.
const DECIDED: [f64; 2] = [-12.0, 6.0];
/// A difference by which samples decide at once.
const IMMEDIATE: f64 = 15.0;
/// Variances that the other assembly has beside: of rates, rad²/s², and of the force in squared torque scales.
const BESIDE: [f64; 2] = [0.01, 0.04];

/// What is followed beside the estimate.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Branches {
    /// Time since a vertex, s.
    since_vertex: f64,
    other: Option<Other>,
}

#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Other {
    track: Track,
    /// log likelihood less that of the estimate.
    evidence: f64,
    /// s.
    age: f64,
}

impl Default for Branches {
    fn default() -> Self {
        Self { since_vertex: f64::MAX, other: None }
    }
}

impl Branches {
    /// Whether no vertex is near.
    pub(super) fn are_known(&self) -> bool {
        self.since_vertex > LONGEST
    }

    pub(super) fn are_two(&self) -> bool {
        self.other.is_some()
    }

    pub(super) fn other(&self) -> Option<&Track> {
        self.other.as_ref().map(|other| &other.track)
    }

    pub(super) fn numbers(&self) -> [f64; 3] {
        [self.since_vertex, self.other.map_or(0.0, |other| other.evidence), self.other.map_or(0.0, |other| other.age)]
    }

    /// The estimate has gone on by a macro step.
    pub(super) fn step(
        &mut self,
        constants: &Constants,
        (track, held): (&Track, bool),
        scene: &impl Scene,
        (h, switch_time): (f64, f64),
    ) {
        let linkage = &constants.linkage;
        if held {
            self.since_vertex = 0.0;
        }
        let begins = self.since_vertex < LATEST && !held;
        self.since_vertex = (self.since_vertex + h).min(f64::MAX);
        if let Some(other) = &mut self.other {
            other.age += h;
            let goes_on = other.age < LONGEST && other.go_on(constants, scene, (h, switch_time));
            if !goes_on {
                self.other = None;
            }
        } else if begins && linkage.frame(&track.theta).side().abs() > APART {
            // Once for each vertex.
            self.since_vertex = LATEST;
            self.other = mirrored(constants, track).map(|track| Other { track, evidence: 0.0, age: 0.0 });
        }
    }

    /// Where the motion has turned next to a vertex, that which goes straight on is followed beside.
    pub(super) fn begin(&mut self, straight: Track) {
        if self.other.is_none() {
            self.other = Some(Other { track: straight, evidence: 0.0, age: 0.0 });
        }
    }

    /// Whether samples (innovation, angle) that come after some time of holding fit the other branch far better.
    pub(super) fn prefer_other(&self, linkage: &Linkage, track: &Track, samples: &[Option<(Innovation, f64)>; 2]) -> bool {
        let Some(other) = &self.other else { return false };
        let mut evidence = 0.0;
        for (encoder, sample) in samples.iter().enumerate() {
            let Some((innovation, angle)) = sample else { continue };
            let (nis, variance) = track.bank.surprise(innovation);
            let (other_nis, other_variance) =
                other.track.bank.surprise(&other.track.innovation(linkage, encoder, *angle, innovation.noise));
            evidence += 0.5 * (nis + libm::log(variance) - other_nis - libm::log(other_variance));
        }
        evidence > IMMEDIATE
    }

    /// A sample that the estimate takes in: its likelihood.
    pub(super) fn weigh(&mut self, track: &Track, sample: &Innovation) {
        if let Some(other) = &mut self.other {
            let (nis, variance) = track.bank.surprise(sample);
            other.evidence += 0.5 * (nis + libm::log(variance));
        }
    }

    /// The same samples (angle, noise, age) for the other assembly. Whether it takes over.
    pub(super) fn correct(&mut self, linkage: &Linkage, samples: &[Option<(f64, f64, f64)>; 2]) -> bool {
        let Some(other) = &mut self.other else { return false };
        for (encoder, sample) in samples.iter().enumerate() {
            let Some((angle, noise, age)) = *sample else { continue };
            let mut innovation = other.track.innovation(linkage, encoder, angle, noise);
            // Behind a vertex motions are slow: where it stood follows from its rate.
            innovation.residual = wrapped(innovation.residual + age * other.track.omega[MEASURED[encoder]]);
            let (nis, variance) = other.track.bank.surprise(&innovation);
            other.evidence -= 0.5 * (nis + libm::log(variance));
            other.track.bank.update(&innovation);
        }
        let closes = other.track.absorb(linkage).is_some();
        if !closes || !(other.evidence > DECIDED[0]) {
            self.other = None;
            return false;
        }
        other.evidence > DECIDED[1]
    }

    /// The other assembly becomes the estimate, and the estimate the other assembly.
    pub(super) fn swap(&mut self, track: &mut Track) {
        if let Some(other) = &mut self.other {
            std::mem::swap(track, &mut other.track);
            other.evidence = -other.evidence;
        }
    }
}

impl Other {
    /// One macro step, by Runge–Kutta; false where it cannot go on.
    #[inline(never)]
    fn go_on(&mut self, constants: &Constants, scene: &impl Scene, (h, switch_time): (f64, f64)) -> bool {
        let linkage = &constants.linkage;
        let (theta, omega) = if self.track.is_at_vertex(linkage) {
            let Track { theta, omega, .. } = self.track.gone_straight(linkage, h);
            (theta, omega)
        } else {
            let flow = self.track.flow(linkage, scene, h);
            let Some((theta, omega, _)) = linkage.closed(flow.theta, flow.omega) else { return false };
            (theta, omega)
        };
        let step = self.track.step(linkage, scene, (&theta, &omega), h);
        let frame = linkage.frame(&self.track.theta);
        self.track.bank.predict(linkage, (&frame, &step.transition), constants.torque_scale(), (h, switch_time));
        (self.track.theta, self.track.omega) = (theta, omega);
        true
    }
}

/// The other assembly with the same angles and rates of the motors.
#[inline(never)]
fn mirrored(constants: &Constants, track: &Track) -> Option<Track> {
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
    bank.carry(&turn);
    let scale = constants.torque_scale();
    for member in &mut bank.members {
        for i in 0..2 {
            member.covariance[2 + i][2 + i] += BESIDE[0];
            member.covariance[4 + i][4 + i] += BESIDE[1] * scale * scale;
        }
    }
    Some(Track { theta, omega, force: [0.0; 4], bank })
}

/// Angles and rates of all links of a start.
fn posture(geometry: &Geometry, start: &Start) -> Option<(super::Links, super::Links)> {
    use crate::mechanism::coordinates::THETA;
    let (q, v) = close(geometry, start).ok()?;
    Some((THETA.map(|i| q[i]), THETA.map(|i| v[i])))
}
