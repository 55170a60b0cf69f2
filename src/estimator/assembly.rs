//! Assembly hypotheses: after a slow or grazing passage of a direct singularity, whether the machine has crossed it or turned back; after a
//! vertex, in which assembly it has come out.
//!
//! Motor angles do not distinguish the two assemblies; only the later motion does, and slowly. An unknown force explains either, and the
//! models of the estimate admit forces that change, so their evidence does not decide. Two hypotheses under nearly no unknown force, one in
//! each assembly, are therefore compared by the likelihood of the samples.

use borsh::{BorshDeserialize, BorshSerialize};

use super::bank::{MODELS, Matrix};
use super::branches::{mirrored, propagate_hypothesis, update_hypothesis};
use super::encoder::Reading;
use super::linkage::Frame;
use super::track::Track;
use super::{Constants, Scene, bank, propagate, transition};

/// Distance |sin(θ₃ − θ₂)| from a direct singularity at which its passage ends.
pub(super) const DISTINGUISHABLE: f64 = 0.1;
/// Torque scale of the unknown force in both hypotheses, relative to that of the estimate, for the quietest and the loudest model. Under a
/// real disturbance the loudest takes over in both, so that the disturbance does not decide.
const QUIET_FORCE_SCALE: f64 = 0.006;
/// Initial standard deviation of the unknown force in both hypotheses, in torque scales: 0.006 held a motion back from the line of the
/// distal links that it had crossed.
const INITIAL_FORCE_SIGMA: f64 = 0.001;
/// Prior probabilities of the models in both hypotheses: the quietest and the loudest alone.
const PRIOR: [f64; MODELS] = [0.999, 0.0, 0.0, 0.001];
/// Least |det| of the map between tangent spaces for which a hypothesis takes the transition matrix of the estimate.
const LEAST_BASIS_OVERLAP: f64 = 0.9999;

/// Life of the hypotheses, s: by then samples have decided.
const LIFETIME: f64 = 5.0;
/// Log-likelihood ratios at which the mirrored assembly is dropped, and at which it replaces the estimate.
const EVIDENCE_BOUNDS: [f64; 2] = [-30.0, 6.0];
/// Least log-likelihood of the other side for which hypotheses open: next to the line the estimate errs by more than its covariance says.
const LEAST_ODDS_TO_OPEN: f64 = -300.0;
/// Least log-likelihood assigned to the other side when hypotheses open.
const LEAST_INITIAL_ODDS: f64 = -10.0;
/// Rate of sin(θ₃ − θ₂), 1/s, above which a passage is certain: no machine turns back from that.
const SLOW_PASSAGE: f64 = 1.0;
/// Largest prior log-likelihood of the mirrored assembly for a quiet motion that has crossed the line itself.
const LARGEST_ODDS_AFTER_CROSSING: f64 = -4.0;
/// Log-likelihood of the other side far from direct singularities.
const NEGLIGIBLE_ODDS: f64 = -1e3;
/// Variance of the unknown force added when the other assembly replaces the estimate, in squared torque scales.
const REPLACEMENT_FORCE_VARIANCE: f64 = 0.04;

/// Knowledge of the side on which a direct singularity was left.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct AssemblyHypotheses {
    /// Largest log-likelihood of the other side during the present passage of a singularity: −1000 far from one, 0 after a vertex.
    mirror_log_likelihood: f64,
    /// Motion under nearly no unknown force since the singularity was approached, with the largest log-likelihood of its other side.
    quiet: Option<(Track, f64)>,
    pair: Option<AssemblyPair>,
}

/// Hypotheses in the assembly of the estimate and in the mirrored one.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct AssemblyPair {
    tracks: [Track; 2],
    /// Log-likelihood of the mirrored assembly minus that of the estimate's.
    evidence: f64,
    /// Age, s.
    age: f64,
}

/// Surroundings of the estimate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Passage {
    /// No vertex near, and samples arrive.
    Clear,
    /// A vertex is near, or hypotheses after it are open: the side is unknown.
    Vertex,
    /// Without samples: nothing decides.
    Unseen,
}

/// Time update of the estimate.
pub(super) struct Propagation<'a> {
    pub(super) from: &'a Frame,
    /// Posture before.
    pub(super) to: &'a Frame,
    /// Transition matrix of the errors.
    pub(super) transition: &'a Matrix,
    /// Number of Runge–Kutta steps.
    pub(super) steps: u32,
}

impl Default for AssemblyHypotheses {
    fn default() -> Self {
        Self { mirror_log_likelihood: NEGLIGIBLE_ODDS, quiet: None, pair: None }
    }
}

impl AssemblyHypotheses {
    /// Unknown side: hypotheses open as soon as the assemblies are distinguishable.
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

    /// Time update of the hypotheses by a macro step.
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
                    // The motion returns to the singularity undecided: the likelier hypothesis continues through it.
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

    /// Measurement update of the hypotheses by samples that the estimate has used. Returns the motion that replaces the estimate, if any.
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
    /// Hypotheses from a motion and its mirror image, of log-likelihood `odds`; `crossed`: the estimate is in the mirrored assembly, which
    /// the next samples then replace.
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

/// Motion under nearly no unknown force.
#[cold]
fn with_quiet_force(constants: &Constants, track: &Track) -> Track {
    let scale = INITIAL_FORCE_SIGMA * constants.torque_scale();
    Track { force: [0.0; 4], bank: track.bank.with_priors(PRIOR).with_force(scale * scale), ..*track }
}

/// Signed distance from a direct singularity, sin(θ₃ − θ₂).
fn signed_distance(track: &Track) -> f64 {
    libm::sin(track.theta[2] - track.theta[1])
}

/// Time update of a hypothesis in the assembly of the estimate, with the transition matrix of the estimate where that is close enough;
/// false where it fails.
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
