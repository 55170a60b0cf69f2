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
use super::encoder::Measurement;
use super::error_state::{Error, independent};
use super::flow::Scene;
use super::hypotheses::{Alternative, Moves, is_distinguishable};
use super::machine::Machine;
use super::propagation::Propagation;
use super::tangent::{LinkState, Linkage, Links};
use super::tuning::{DOUBT_ENDS, DOUBT_FORCE, DOUBT_MODEL, DOUBT_NOISE, NEITHER_FITS, START_ODDS};
use super::witness::{ByFaults, DELAY, Faults, Witness, prior_sizes};

/// Doubt about the assembly of a start.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
#[expect(clippy::large_enum_variant, reason = "a step allocates nothing")]
pub(super) enum Doubt {
    /// Both encoders have not been heard yet.
    Pending,
    /// Both assemblies are followed.
    Open(Branches),
    /// The assembly is known, or a later question asks for it.
    Ended,
}

/// Estimate and motion in the other assembly, in comparison.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Branches {
    other: Alternative,
    /// Witnesses about the estimate and about the other motion.
    witnesses: [Witness; 2],
    /// Logarithm of the odds of the start.
    evidence: f64,
}

/// Verdict of the samples on the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// Nothing yet.
    Open,
    /// The start is in the right assembly.
    Right,
    /// The start is in the wrong one.
    Wrong,
}

impl Doubt {
    /// Whether both assemblies are followed.
    pub(super) fn is_open(&self) -> bool {
        matches!(self, Self::Open(_))
    }

    /// Both assemblies, while they are followed.
    fn branches(&mut self) -> Option<&mut Branches> {
        if let Self::Open(branches) = self { Some(branches) } else { None }
    }

    /// Motion in the other assembly, while it is followed.
    pub(super) fn other(&self) -> Option<&Alternative> {
        if let Self::Open(branches) = self { Some(&branches.other) } else { None }
    }

    /// Begins with the first samples of both encoders, where the assemblies are not one.
    pub(super) fn begin(&mut self, machine: &Machine, motion: &LinkState) {
        if matches!(self, Self::Pending) {
            let other = Alternative::of_start(machine, motion);
            let open = |other| Self::Open(Branches { other, witnesses: witnesses(machine), evidence: 0.0 });
            *self = other.map_or(Self::Ended, open);
        }
    }

    /// Receives a sample of encoder i, as the estimate has expected it, before its own update.
    pub(super) fn receive(&mut self, i: usize, sample: &Innovation) {
        if let Some(branches) = self.branches() {
            branches.witnesses[0].receive(i, sample);
        }
    }

    /// Follows a correction of the estimate by an error that turns its tangent basis.
    pub(super) fn follow(&mut self, error: &Error, turn: &Matrix2<f64>) {
        if let Some(branches) = self.branches() {
            branches.witnesses[0].correct(error, turn);
        }
    }

    /// Measurement update of the other motion by samples, and of its witness by those that the estimate's witness has `seen`, after the update of the
    /// estimate. Returns the motion that replaces the estimate, if any.
    pub(super) fn correct(
        &mut self,
        machine: &Machine,
        samples: &[Option<Measurement>; 2],
        seen: &[Option<Measurement>; 2],
    ) -> Option<Alternative> {
        let branches = self.branches()?;
        let verdict = branches.correct(machine, samples, seen);
        let other = branches.other;
        if verdict != Verdict::Open {
            *self = Self::Ended;
        }
        (verdict == Verdict::Wrong).then_some(other)
    }

    /// Time update by h seconds, after that of the estimate by a step from a motion to another under an unknown force. Returns the logarithm of
    /// the odds of the other assembly where the doubt ends undecided: at a direct singularity both assemblies are one.
    pub(super) fn step(
        &mut self,
        machine: &Machine,
        scene: &impl Scene,
        (step, [from, to], force): (&Propagation, [&LinkState; 2], &Links),
        (has_intervals, h): (bool, f64),
    ) -> Option<f64> {
        let Branches { other, witnesses: [own, mirrored], evidence } = self.branches()?;
        let follow = |witness: &mut Witness, step: &Propagation, [from, to]: [&LinkState; 2], force: &Links| {
            let alpha = (to.omega - from.omega) / h;
            let inertia = if has_intervals { step.inertia_torque(&alpha) } else { 0.0 };
            let by = ByFaults::new(scene, [from, to], force, h);
            let scales = [DOUBT_NOISE * machine.torque_scale(), DOUBT_NOISE * inertia];
            witness.predict(step, (&step.noise(h), DOUBT_MODEL, scales), &by, None, h);
        };
        let (before, acts) = (other.motion, other.belief.force);
        let Some(beside) = other.propagate(machine, scene, Moves::Under(&acts), h) else {
            // No motion in the other assembly goes on.
            *self = Self::Ended;
            return None;
        };
        if step.held || beside.held || ![to, &other.motion].into_iter().all(is_distinguishable) {
            let odds = START_ODDS - *evidence;
            *self = Self::Ended;
            return Some(odds);
        }
        follow(own, step, [from, to], force);
        follow(mirrored, &beside, [&before, &other.motion], &acts);
        None
    }

    /// Whether stored values are possible.
    pub(super) fn is_sound(&self, linkage: &Linkage) -> bool {
        match self {
            Self::Pending | Self::Ended => true,
            Self::Open(Branches { other, witnesses, evidence }) => {
                other.is_sound(linkage) && witnesses.iter().all(Witness::is_sound) && evidence.is_finite()
            }
        }
    }
}

impl Branches {
    /// Measurement update of the other motion and its witness.
    fn correct(&mut self, machine: &Machine, samples: &[Option<Measurement>; 2], seen: &[Option<Measurement>; 2]) -> Verdict {
        let Self { other, witnesses: [_, mirrored], .. } = self;
        let frame = machine.linkage.frame(&other.motion.theta);
        for (i, sample) in seen.iter().enumerate() {
            if let Some(sample) = sample {
                mirrored.receive(i, &sample.about(i, &other.motion, &frame).innovation);
            }
        }
        let Some((_, error, turn)) = other.update(&machine.linkage, samples) else { return Verdict::Right };
        mirrored.correct(&error, &turn);
        self.judge(machine)
    }

    /// Weighs the evidence.
    fn judge(&mut self, machine: &Machine) -> Verdict {
        let sizes = prior_sizes(machine);
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
            (self.witnesses, self.evidence) = (witnesses(machine), 0.0);
            return Verdict::Open;
        }
        self.evidence = evidence;
        let [right, wrong] = DOUBT_ENDS;
        match () {
            () if evidence >= right => Verdict::Right,
            () if evidence <= -wrong => Verdict::Wrong,
            () => Verdict::Open,
        }
    }
}

/// Witnesses that have seen nothing, of errors as of a start, and of an unknown force of any size.
fn witnesses(machine: &Machine) -> [Witness; 2] {
    let [angles, rates, _] = machine.start_variances();
    let force = (DOUBT_FORCE * machine.torque_scale()).powi(2);
    [Witness::new(Error::zeros(), independent([angles, rates, force])); 2]
}
