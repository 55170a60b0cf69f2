//! Doubt about the start: encoders do not measure the assembly, so a start may be in the wrong one. Both assemblies are tracked until the
//! motion decides between them.
//!
//! The motion in the other assembly has its own unknown force. Each motion has a witness (`witness.rs`), which allows only an unknown force
//! of any size that hardly changes, and leaves masses, payload, friction and a delay of the samples free. The wrong assembly needs a force
//! that changes as the machine accelerates, and none of these free parameters explains such a force. X is the sum of r²/S that the best
//! values of the free parameters leave, and the determinant D is the cost of their freedom. The evidence for the start is
//!
//! ```text
//! ½ [ (X' − X)/c + ln D' − ln D ]        c = max(1, min(X, X')/n)
//! ```
//!
//! after n samples; the dash marks the other assembly. The process noise of both witnesses is small compared with the noise of the
//! readings. A larger process noise would favour the assembly in which it moves the motors more, because r²/S would be smaller there.

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
    /// No samples of both encoders have arrived together yet.
    Pending,
    /// Both assemblies are tracked.
    Open(Branches),
    /// The assembly is known, or the hypotheses (`hypotheses.rs`) decide it.
    Ended,
}

/// Comparison of the estimate with the motion in the other assembly.
#[derive(Clone, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Branches {
    other: Alternative,
    /// Witnesses about the estimate and about the other motion.
    witnesses: [Witness; 2],
    /// Log-odds of the start.
    evidence: f64,
}

/// Verdict of the samples on the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    /// Undecided.
    Open,
    /// The start is in the right assembly.
    Right,
    /// The start is in the wrong assembly.
    Wrong,
}

impl Doubt {
    /// Whether both assemblies are tracked.
    pub(super) fn is_open(&self) -> bool {
        matches!(self, Self::Open(_))
    }

    /// Both assemblies, while they are tracked.
    fn branches(&mut self) -> Option<&mut Branches> {
        if let Self::Open(branches) = self { Some(branches) } else { None }
    }

    /// Motion in the other assembly, while it is tracked.
    pub(super) fn other(&self) -> Option<&Alternative> {
        if let Self::Open(branches) = self { Some(&branches.other) } else { None }
    }

    /// Starts to track both assemblies at the first samples of both encoders; ends the doubt if the assemblies coincide.
    pub(super) fn begin(&mut self, machine: &Machine, motion: &LinkState) {
        if matches!(self, Self::Pending) {
            let other = Alternative::of_start(machine, motion);
            let open = |other| Self::Open(Branches { other, witnesses: witnesses(machine), evidence: 0.0 });
            *self = other.map_or(Self::Ended, open);
        }
    }

    /// Closes the loop of the other motion again after lengths have changed. Ends the doubt if it cannot be closed.
    pub(super) fn close(&mut self, linkage: &Linkage) {
        if self.branches().is_some_and(|branches| !linkage.close(&mut branches.other.motion)) {
            *self = Self::Ended;
        }
    }

    /// Restarts the comparison.
    pub(super) fn restart(&mut self, machine: &Machine) {
        if let Some(branches) = self.branches() {
            branches.restart(machine);
        }
    }

    /// Receives a sample of encoder i about the estimate, before the update of the estimate.
    pub(super) fn receive(&mut self, i: usize, sample: &Innovation) {
        if let Some(branches) = self.branches() {
            branches.witnesses[0].receive(i, sample);
        }
    }

    /// Applies a correction of the estimate by `error`, which turns the tangent basis by `turn`.
    pub(super) fn follow(&mut self, error: &Error, turn: &Matrix2<f64>) {
        if let Some(branches) = self.branches() {
            branches.witnesses[0].correct(error, turn);
        }
    }

    /// Measurement update of the other motion by `samples` and of its witness by `seen`, the samples that the estimate's witness has
    /// received. Called after the update of the estimate. Returns the motion that replaces the estimate, if any.
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

    /// Time update by h seconds, after the estimate's `step` from one motion to the next under its unknown force. Returns the log-odds of
    /// the other assembly if the doubt ends undecided, because both assemblies coincide at a direct singularity.
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
            // The motion in the other assembly cannot continue.
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

    /// Restarts both witnesses, without evidence.
    fn restart(&mut self, machine: &Machine) {
        (self.witnesses, self.evidence) = (witnesses(machine), 0.0);
    }

    /// Updates the evidence and returns the verdict.
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
            // Neither assembly explains the samples.
            self.restart(machine);
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

/// Witnesses without samples, with the errors of a start and an unknown force of any size.
fn witnesses(machine: &Machine) -> [Witness; 2] {
    let [angles, rates, _] = machine.start_variances();
    let force = (DOUBT_FORCE * machine.torque_scale()).powi(2);
    [Witness::new(Error::zeros(), independent([angles, rates, force])); 2]
}
