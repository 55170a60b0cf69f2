//! Behind a direct singularity that is passed slowly or only grazed: whether the machine has crossed it, or has turned back before it.
//! Behind a vertex: in which of the two assemblies it has come out.
//!
//! The motors do not tell the two assemblies apart, only how the motion goes on does, and slowly. An unknown force explains either, and as
//! the models of the estimate allow for forces that change, it is not they that can decide. So two motions are followed beside the estimate
//! on which next to nothing acts that is not known, one in each assembly: the one that tells the samples better is right.

use borsh::{BorshDeserialize, BorshSerialize};

use super::bank::{MODELS, Matrix};
use super::branches::{mirrored, propagate_hypothesis, update_hypothesis};
use super::encoder::Reading;
use super::linkage::Frame;
use super::track::Track;
use super::{Constants, Scene, bank, propagate, transition};

/// It is left where |sin(θ₃ − θ₂)| is at least this.
pub(super) const DISTINGUISHABLE: f64 = 0.1;
/// Unknown forces on both motions, in those of the estimate: these, with the quietest and the loudest model. A force that does act lets the
/// loudest take part on both sides, so that it does not decide.
const QUIET_FORCE_SCALE: f64 = 0.006;
/// What acts on them unknown where they begin, in torque scales: a force of 0.006 held a motion back from the line that it had passed.
const INITIAL_FORCE_SIGMA: f64 = 0.001;
const PRIOR: [f64; MODELS] = [0.999, 0.0, 0.0, 0.001];
/// A motion goes on as the estimate does, with other forces, where a plane of one tangent space is at least this large on the other.
const LEAST_BASIS_OVERLAP: f64 = 0.9999;

/// Both are dropped after this time, s,
const LIFETIME: f64 = 5.0;
/// or where samples speak against the other assembly, and the other takes over where they speak for it: differences of log likelihoods.
const EVIDENCE_BOUNDS: [f64; 2] = [-30.0, 6.0];
/// How sure of its side an estimate may be, at the least, for both to be followed; next to the line it errs by more than it thinks,
const LEAST_ODDS_TO_OPEN: f64 = -300.0;
/// and no more than this is believed of it.
const LEAST_INITIAL_ODDS: f64 = -10.0;
/// Where the sine of the angle between the distal links changes faster, 1/s, there is no doubt: a machine does not turn back from that.
const SLOW_PASSAGE: f64 = 1.0;
/// The least that is believed of a motion that has come through the line by itself.
const LARGEST_ODDS_AFTER_CROSSING: f64 = -4.0;
/// The log likelihood of the other side far from direct singularities.
const NEGLIGIBLE_ODDS: f64 = -1e3;
/// Variance of the unknown force of an assembly that takes over, in squared torque scales.
const REPLACEMENT_FORCE_VARIANCE: f64 = 0.04;

/// What is known of the side on which a direct singularity is left.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct AssemblyHypotheses {
    /// The log likelihood of the other side of the singularity that the estimate is passing, at its largest: −1000 far from one, 0 behind a
    /// vertex.
    mirror_log_likelihood: f64,
    /// A motion on which next to nothing acts that is not known, from where the estimate has come near the line, and the log likelihood of its
    /// other side, at its largest.
    quiet: Option<(Track, f64)>,
    pair: Option<AssemblyPair>,
}

/// Motions in the assembly of the estimate and in the other.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct AssemblyPair {
    tracks: [Track; 2],
    /// log likelihood of the other less that of the estimate.
    evidence: f64,
    /// s.
    age: f64,
}

/// Where the estimate passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Passage {
    /// Neither of the others.
    Clear,
    /// By a vertex, or several motions are followed behind it: nothing is known of the side.
    Vertex,
    /// Without samples: nothing decides.
    Unseen,
}

/// How the estimate has gone on.
pub(super) struct Propagation<'a> {
    pub(super) from: &'a Frame,
    pub(super) to: &'a Frame,
    /// Of its errors,
    pub(super) transition: &'a Matrix,
    /// in so many steps of Runge-Kutta.
    pub(super) steps: u32,
}

impl Default for AssemblyHypotheses {
    fn default() -> Self {
        Self { mirror_log_likelihood: NEGLIGIBLE_ODDS, quiet: None, pair: None }
    }
}

impl AssemblyHypotheses {
    /// Where nothing is known of the side: both are followed, as soon as they are apart.
    pub(super) fn of_unknown_side() -> Self {
        Self { mirror_log_likelihood: 0.0, ..Self::default() }
    }

    /// Whether both assemblies are followed.
    pub(super) fn is_open(&self) -> bool {
        self.pair.is_some()
    }

    pub(super) fn tracks(&self) -> impl Iterator<Item = &Track> {
        self.pair.iter().flat_map(|pair| &pair.tracks).chain(self.quiet.iter().map(|(track, _)| track))
    }

    pub(super) fn is_sound(&self) -> bool {
        let is_known = |odds: f64| (NEGLIGIBLE_ODDS..=0.0).contains(&odds);
        is_known(self.mirror_log_likelihood)
            && self.quiet.is_none_or(|(_, odds)| is_known(odds))
            && self.pair.is_none_or(|pair| pair.evidence.is_finite() && (0.0..=LIFETIME).contains(&pair.age))
    }

    /// The estimate has gone on by a macro step.
    #[inline(never)]
    pub(super) fn step(
        &mut self,
        constants: &Constants,
        (track, passage, propagation): (&Track, Passage, &Propagation<'_>),
        scene: &impl Scene,
        (h, switch_time): (f64, f64),
    ) {
        match passage {
            Passage::Clear => (),
            Passage::Unseen => return *self = Self::default(),
            Passage::Vertex => return *self = Self::of_unknown_side(),
        }
        let scale = QUIET_FORCE_SCALE * constants.torque_scale();
        if let Some(pair) = &mut self.pair {
            pair.age += h;
            let timing = (h, switch_time, scale);
            let [own, other] = &mut pair.tracks;
            let goes_on = pair.age < LIFETIME
                && propagate_with_estimate(own, constants, scene, propagation, timing)
                && propagate_hypothesis(other, constants, scene, false, timing, &PRIOR);
            if !goes_on {
                self.pair = None;
            }
        }
        if let Some((quiet, mirror_log_likelihood)) = &mut self.quiet {
            if propagate_with_estimate(quiet, constants, scene, propagation, (h, switch_time, scale)) {
                *mirror_log_likelihood = mirror_log_likelihood
                    .max(quiet.mirror_log_likelihood(&constants.linkage.frame(&quiet.theta)))
                    .clamp(NEGLIGIBLE_ODDS, 0.0);
            } else {
                self.quiet = None;
            }
        }
        let side = signed_distance(track).abs();
        if side < DISTINGUISHABLE {
            let rate = (track.omega[2] - track.omega[1]) * libm::cos(track.theta[2] - track.theta[1]);
            if rate.abs() < SLOW_PASSAGE {
                match self.pair.take() {
                    // It comes back before samples have told all: the likelier goes on through the line.
                    Some(AssemblyPair { tracks: [own, other], evidence, .. }) => {
                        self.mirror_log_likelihood = evidence.clamp(NEGLIGIBLE_ODDS, 0.0);
                        self.quiet = Some((if evidence > 0.0 { other } else { own }, (-evidence.abs()).max(NEGLIGIBLE_ODDS)));
                    }
                    None if self.mirror_log_likelihood == NEGLIGIBLE_ODDS && self.quiet.is_none() => {
                        self.quiet = Some((with_quiet_force(constants, track), NEGLIGIBLE_ODDS));
                    }
                    None => (),
                }
            }
            let odds = track.mirror_log_likelihood(propagation.to);
            self.mirror_log_likelihood = self.mirror_log_likelihood.max(odds).clamp(NEGLIGIBLE_ODDS, 0.0);
        } else {
            let prior = std::mem::replace(&mut self.mirror_log_likelihood, NEGLIGIBLE_ODDS);
            let quiet = self.quiet.take();
            if prior > LEAST_ODDS_TO_OPEN {
                self.pair = match quiet {
                    Some((quiet, sure)) => {
                        let other = signed_distance(&quiet) * signed_distance(track) < 0.0;
                        AssemblyPair::around(
                            constants,
                            &quiet,
                            (other, sure.clamp(LEAST_INITIAL_ODDS, LARGEST_ODDS_AFTER_CROSSING)),
                        )
                    }
                    None => {
                        AssemblyPair::around(constants, &with_quiet_force(constants, track), (false, prior.max(LEAST_INITIAL_ODDS)))
                    }
                };
            }
        }
    }

    /// Samples that the estimate has taken in. The motion that takes over.
    pub(super) fn correct(&mut self, constants: &Constants, readings: &[Option<Reading>; 2]) -> Option<Track> {
        if let Some((quiet, _)) = &mut self.quiet
            && update_hypothesis(quiet, &constants.linkage, readings).is_none()
        {
            self.quiet = None;
        }
        let pair = self.pair.as_mut()?;
        let told = [0, 1].map(|k| update_hypothesis(&mut pair.tracks[k], &constants.linkage, readings));
        let ([Some(own), Some(other)], scale) = (told, constants.torque_scale()) else {
            self.pair = None;
            return None;
        };
        pair.evidence += other - own;
        if pair.evidence.is_nan() || pair.evidence <= EVIDENCE_BOUNDS[0] {
            self.pair = None;
            return None;
        }
        if pair.evidence < EVIDENCE_BOUNDS[1] {
            return None;
        }
        pair.tracks.swap(0, 1);
        pair.evidence = -pair.evidence;
        let track = pair.tracks[0];
        let mut bank = track.bank.with_priors(bank::PRIOR);
        bank.inflate_force(REPLACEMENT_FORCE_VARIANCE * scale * scale);
        Some(Track { bank, ..track })
    }
}

impl AssemblyPair {
    /// A motion and the one in the other assembly, with the log likelihood of that; `crossed`: it is the other that the estimate is in, which
    /// the next samples make give way.
    #[cold]
    fn around(constants: &Constants, track: &Track, (crossed, odds): (bool, f64)) -> Option<Self> {
        let other = mirrored(constants, track)?;
        Some(if crossed {
            Self { tracks: [other, *track], evidence: (-odds).max(EVIDENCE_BOUNDS[1] + 1.0), age: 0.0 }
        } else {
            Self { tracks: [*track, other], evidence: odds, age: 0.0 }
        })
    }
}

/// The same motion where next to nothing acts that is not known.
#[cold]
fn with_quiet_force(constants: &Constants, track: &Track) -> Track {
    let scale = INITIAL_FORCE_SIGMA * constants.torque_scale();
    Track { force: [0.0; 4], bank: track.bank.with_priors(PRIOR).with_force(scale * scale), ..*track }
}

/// sin(θ₃ − θ₂).
fn signed_distance(track: &Track) -> f64 {
    libm::sin(track.theta[2] - track.theta[1])
}

/// A motion in the assembly of the estimate goes on by a macro step, and its errors as those of the estimate do; false where it cannot.
#[inline(never)]
fn propagate_with_estimate(
    track: &mut Track,
    constants: &Constants,
    scene: &impl Scene,
    propagation: &Propagation<'_>,
    timing: (f64, f64, f64),
) -> bool {
    let linkage = &constants.linkage;
    let from = linkage.frame(&track.theta);
    let onto = from.basis_map_to(propagation.from);
    let [[a, b], [c, d]] = onto;
    if (a * d - b * c).abs() < LEAST_BASIS_OVERLAP {
        return propagate_hypothesis(track, constants, scene, false, timing, &PRIOR);
    }
    let (h, switch_time, scale) = timing;
    let (theta, omega) = transition::motion(linkage, scene, (track.theta, track.omega), h, propagation.steps);
    let Some((theta, omega, to)) = linkage.closed(theta, omega) else { return false };
    let transition = propagate::between_frames(propagation.transition, &onto, &propagation.to.basis_map_to(&to));
    track.bank.predict(linkage, (&from, &transition), [scale, 0.0], (h, switch_time), &PRIOR);
    (track.theta, track.omega) = (theta, omega);
    true
}
