//! Doubt about the start: encoders do not see the assembly, and a start may be in the wrong one. Both are followed until motion has told them
//! apart.
//!
//! The motion in the other assembly has an unknown force of its own. About each motion a witness (`witness.rs`) knows no force but one of any
//! size that hardly changes, and leaves masses, payload, friction and a delay of the samples free. An assembly that is wrong needs a force that
//! changes as the machine accelerates, which none of these explains. With the sum X of r²/S that the best of them leave, and the determinant D
//! that their freedom costs, the evidence for the start is
//!
//! ```text
//! ½ [ (X' − X)/c + ln D' − ln D ]        c = max(1, min(X, X')/n)
//! ```
//!
//! with a dash in the other assembly, after n samples. Next to the readings' noise the process noise of both witnesses is small: by a larger one r²/S
//! would be smaller in the assembly whose motors it moves more.

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::Matrix2;

use super::belief::Innovation;
use super::constants::{DOUBT_ENDS, DOUBT_FORCE, DOUBT_MODEL, DOUBT_NOISE, NEITHER_FITS, START_ODDS};
use super::encoder::Measurement;
use super::error_state::{Error, independent};
use super::flow::Scene;
use super::hypotheses::{Hypothesis, is_distinguishable};
use super::parameters::Constants;
use super::propagation::Propagation;
use super::tangent::{LinkState, Linkage, Links};
use super::witness::{ByFaults, DELAY, Faults, Witness, prior_sizes};
use crate::copies::clone_by_fields;

/// Doubt about the assembly of a start.
#[derive(Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Doubt {
    /// Whether both encoders have not been heard yet.
    pending: bool,
    /// Both assemblies while they are followed.
    branches: Option<Branches>,
}

clone_by_fields!(Doubt { pending, branches });

/// Estimate and motion in the other assembly, in comparison.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Branches {
    other: Hypothesis,
    /// Witnesses about the estimate and about the other motion.
    witnesses: [Witness; 2],
    /// Logarithm of the odds of the start.
    evidence: f64,
}

/// Verdict of the samples on the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// Nothing yet.
    None,
    /// The start is in the right assembly.
    Right,
    /// The start is in the wrong one.
    Wrong,
}

impl Doubt {
    /// Before the first sample.
    pub(super) const NEW: Self = Self { pending: true, branches: None };
    /// Ended.
    pub(super) const ENDED: Self = Self { pending: false, branches: None };

    /// Whether both assemblies are followed.
    pub(super) fn is_open(&self) -> bool {
        self.branches.is_some()
    }

    /// Motion in the other assembly, while it is followed.
    pub(super) fn other(&self) -> Option<&Hypothesis> {
        self.branches.as_ref().map(|branches| &branches.other)
    }

    /// Begins with the first samples of both encoders, where the assemblies are not one.
    pub(super) fn begin(&mut self, constants: &Constants, motion: &LinkState) {
        if std::mem::take(&mut self.pending) {
            let other = Hypothesis::of_start(constants, motion);
            self.branches = other.map(|other| Branches { other, witnesses: witnesses(constants), evidence: 0.0 });
        }
    }

    /// Receives a sample of encoder i, as the estimate has expected it, before its own update.
    pub(super) fn receive(&mut self, i: usize, sample: &Innovation) {
        if let Some(branches) = &mut self.branches {
            branches.witnesses[0].receive(i, sample);
        }
    }

    /// Follows a correction of the estimate by an error that turns its tangent basis.
    pub(super) fn follow(&mut self, error: &Error, turn: &Matrix2<f64>) {
        if let Some(branches) = &mut self.branches {
            branches.witnesses[0].correct(error, turn);
        }
    }

    /// Measurement update of the other motion by samples, and of its witness by those that the estimate's witness has `seen`, after the update of the
    /// estimate. Returns the motion that replaces the estimate, if any.
    pub(super) fn correct(
        &mut self,
        constants: &Constants,
        samples: &[Option<Measurement>; 2],
        seen: &[Option<Measurement>; 2],
    ) -> Option<Hypothesis> {
        let branches = self.branches.as_mut()?;
        let verdict = branches.correct(constants, samples, seen);
        let other = branches.other;
        if verdict != Verdict::None {
            *self = Self::ENDED;
        }
        (verdict == Verdict::Wrong).then_some(other)
    }

    /// Time update by h seconds, after that of the estimate by a step from a motion to another under an unknown force. Returns the logarithm of
    /// the odds of the other assembly where the doubt ends undecided: at a direct singularity both assemblies are one.
    pub(super) fn step(
        &mut self,
        constants: &Constants,
        scene: &impl Scene,
        (step, [from, to], force): (&Propagation, [&LinkState; 2], &Links),
        (has_intervals, h): (bool, f64),
    ) -> Option<f64> {
        let Branches { other, witnesses: [own, mirrored], evidence } = self.branches.as_mut()?;
        let follow = |witness: &mut Witness, step: &Propagation, [from, to]: [&LinkState; 2], force: &Links| {
            let alpha = (to.omega - from.omega) / h;
            let inertia = if has_intervals { step.inertia_torque(&alpha) } else { 0.0 };
            let by = ByFaults::new(scene, [from, to], force, h);
            let scales = [DOUBT_NOISE * constants.torque_scale(), DOUBT_NOISE * inertia];
            witness.predict(step, (&step.noise(h), DOUBT_MODEL, scales), &by, None, h);
        };
        let (before, acts) = (other.motion, other.belief.force);
        let Some(beside) = other.propagate(constants, scene, &acts, None, h) else {
            // No motion in the other assembly goes on.
            *self = Self::ENDED;
            return None;
        };
        if step.held || beside.held || ![to, &other.motion].into_iter().all(is_distinguishable) {
            let odds = START_ODDS - *evidence;
            *self = Self::ENDED;
            return Some(odds);
        }
        follow(own, step, [from, to], force);
        follow(mirrored, &beside, [&before, &other.motion], &acts);
        None
    }

    /// Whether stored values are possible.
    pub(super) fn is_sound(&self, linkage: &Linkage) -> bool {
        self.branches.as_ref().is_none_or(|Branches { other, witnesses, evidence }| {
            other.is_of_start() && other.is_sound(linkage) && witnesses.iter().all(Witness::is_sound) && evidence.is_finite()
        })
    }
}

impl Branches {
    /// Measurement update of the other motion and its witness.
    fn correct(&mut self, constants: &Constants, samples: &[Option<Measurement>; 2], seen: &[Option<Measurement>; 2]) -> Verdict {
        let Self { other, witnesses: [_, mirrored], .. } = self;
        let frame = constants.linkage.frame(&other.motion.theta);
        for (i, sample) in seen.iter().enumerate() {
            if let Some(sample) = sample {
                mirrored.receive(i, &sample.about(i, &other.motion, &frame).innovation);
            }
        }
        let Some((_, error, turn)) = other.update(&constants.linkage, samples) else { return Verdict::Right };
        mirrored.correct(&error, &turn);
        self.judge(constants)
    }

    /// Weighs the evidence.
    fn judge(&mut self, constants: &Constants) -> Verdict {
        let sizes = prior_sizes(constants);
        let free = Faults::from_fn(|k, _| if k < DELAY { 0.0 } else { sizes[k] });
        let [own, other] = self.witnesses.each_ref().map(|witness| {
            let (less, freedom) = witness.explained(&free);
            (witness.squares - less, freedom)
        });
        let samples = self.witnesses[0].samples;
        let scatter = own.0.min(other.0) / samples.max(1.0);
        let [most, enough] = NEITHER_FITS;
        let evidence = 0.5 * ((other.0 - own.0) / scatter.max(1.0) + other.1 - own.1);
        if !evidence.is_finite() || scatter > most && samples > enough {
            // Something acts that neither explains.
            (self.witnesses, self.evidence) = (witnesses(constants), 0.0);
            return Verdict::None;
        }
        self.evidence = evidence;
        let [right, wrong] = DOUBT_ENDS;
        match () {
            () if evidence >= right => Verdict::Right,
            () if evidence <= -wrong => Verdict::Wrong,
            () => Verdict::None,
        }
    }
}

/// Witnesses that have seen nothing, of errors as of a start, and of an unknown force of any size.
fn witnesses(constants: &Constants) -> [Witness; 2] {
    let [angles, rates, _] = constants.start_variances();
    let force = (DOUBT_FORCE * constants.torque_scale()).powi(2);
    [Witness::new(Error::zeros(), independent([angles, rates, force])); 2]
}
