//! Hypotheses: motions that encoders do not tell from the estimate at once, each with its evidence and age, until samples decide.
//!
//! | question | hypotheses | compared with |
//! | --- | --- | --- |
//! | behind a vertex, which way? | straight on, turned to either side | the estimate |
//! | in a slow passage of a direct singularity, across or back? | the motion under nearly no unknown force | its mirror image |
//! | in which assembly, after that, a vertex or a restart? | nearly no unknown force in the estimate's, and in the mirrored one | each other |
//!
//! Motor angles do not distinguish the assemblies; only the later motion does, and slowly. An unknown force explains either, and the models
//! of the estimate admit forces that change, so their evidence does not decide: hence nearly no unknown force.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::Matrix2;

use super::belief::{Bank, Belief};
use super::constants::{
    AFTER_VERTEX, DISTINGUISHABLE, DIVERGENCE_TIME, HypothesisRules, IMMEDIATE_EVIDENCE, INITIAL_FORCE_SIGMA,
    LARGEST_ODDS_AFTER_CROSSING, LARGEST_RATE, LARGEST_TURN, LATERAL_OFFSET, LEAST_BASIS_OVERLAP, LEAST_INITIAL_ODDS,
    LEAST_MOTOR_DETERMINANT, LEAST_ODDS_TO_OPEN, LEAST_RATE_CHANGE, LEAST_SINGULAR_VALUE, LIKELY_MODELS, MOST_FINE_STEPS,
    NEAR_SINGULARITY, NEAR_VERTEX, NEGLIGIBLE_ODDS, OF_START, QUIET, QUIET_MODELS, REPLACEMENT_FORCE_VARIANCE, REST_RATE,
    SLOW_PASSAGE, START_DISTANCE, TURNING_STEPS,
};
use super::encoder::Measurement;
use super::error_state::{Error, FORCE, Transition, turn_errors};
use super::flow::{self, Scene};
use super::parameters::Constants;
use super::propagation::Propagation;
use super::tangent::{Frame, LinkState, Linkage, Links, MEASURED, Pair};
use crate::copies::clone_by_fields;
use crate::mechanism::coordinates::THETA;
use crate::mechanism::{Assembly, Start, close};

/// Largest number of hypotheses.
const MOST: usize = 3;

/// Kind of a hypothesis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, BorshSerialize, BorshDeserialize)]
pub(super) enum Kind {
    /// Straight on through a vertex, under the estimate's unknown force.
    Straight,
    /// Turned in a vertex, under the estimate's unknown force.
    Turned,
    /// Under nearly no unknown force.
    Quiet,
    /// In the other assembly than the start, under an unknown force of its own.
    Mirrored,
}

impl Kind {
    fn rules(self) -> &'static HypothesisRules {
        match self {
            Self::Quiet => &QUIET,
            Self::Mirrored => &OF_START,
            Self::Straight | Self::Turned => &AFTER_VERTEX,
        }
    }
}

/// Motion beside the estimate.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Hypothesis {
    kind: Kind,
    pub(super) motion: LinkState,
    pub(super) belief: Belief,
    /// Log-likelihood relative to what it is compared with; of a passage, of the mirror image relative to the motion.
    evidence: f64,
    /// Age, s.
    age: f64,
}

/// Open hypotheses, and what is known for those to come.
#[derive(Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Hypotheses {
    list: ArrayVec<Hypothesis, MOST>,
    /// Time since the last vertex, s.
    since_vertex: f64,
    /// Whether the estimate approaches a vertex.
    approaches_vertex: bool,
    /// Largest log-likelihood of the other side during the present passage of a singularity: −1000 far from one, 0 where the side is
    /// unknown.
    mirror_odds: f64,
    /// Evidence of a restart: accumulated time with samples far from the estimate minus that with near ones, s.
    lost: f64,
}

clone_by_fields!(Hypotheses { list, since_vertex, approaches_vertex, mirror_odds, lost });

impl Default for Hypotheses {
    fn default() -> Self {
        Self { list: ArrayVec::new(), since_vertex: f64::MAX, approaches_vertex: false, mirror_odds: NEGLIGIBLE_ODDS, lost: 0.0 }
    }
}

impl Hypotheses {
    /// Whether several motions are followed: behind a vertex, or in both assemblies.
    pub(super) fn are_open(&self) -> bool {
        self.are_after_vertex() || self.list.len() > 1
    }

    fn are_after_vertex(&self) -> bool {
        self.list.first().is_some_and(|first| first.kind != Kind::Quiet)
    }

    /// Whether those that are followed move under nearly no unknown force.
    pub(super) fn are_quiet(&self) -> bool {
        self.list.first().is_some_and(|first| first.kind == Kind::Quiet)
    }

    /// Whether the branch is known: the last vertex was left longer ago than a hypothesis lives.
    pub(super) fn is_branch_known(&self) -> bool {
        self.since_vertex > AFTER_VERTEX.lifetime
    }

    /// Opens hypotheses where the estimate, whose macro step ends at `to` with frame `end`, leaves a vertex, since no sample has told on
    /// which side it was passed. Called before the time update.
    pub(super) fn open_after_vertex(
        &mut self,
        constants: &Constants,
        (motion, belief): (&LinkState, &Belief),
        scene: &impl Scene,
        step: &Propagation,
        to: &LinkState,
    ) {
        let (before, after) = (step.from.smallest, step.to.smallest);
        let near = before.min(after) < NEAR_VERTEX;
        // Forces do not change a rate by as much in a step.
        let fastest = motion.fastest();
        let turned = near
            && fastest > REST_RATE
            && (to.omega - motion.omega).iter().any(|change| change.abs() > LEAST_RATE_CHANGE * fastest);
        let leaves = near && (turned || self.approaches_vertex && after > before);
        self.approaches_vertex = near && !leaves && after < before;
        if leaves && !self.are_after_vertex() {
            let straight =
                turned.then_some(Hypothesis { kind: Kind::Straight, motion: *motion, belief: *belief, evidence: 0.0, age: 0.0 });
            let aside = |side: f64| turned_aside(&constants.linkage, scene, (motion, belief), side * LATERAL_OFFSET);
            self.list = [straight, aside(1.0), aside(-1.0)].into_iter().flatten().collect();
        }
    }

    /// Time update by a macro step of h seconds, after that of the estimate. `coasts`: no samples come.
    pub(super) fn step(
        &mut self,
        constants: &Constants,
        (motion, belief): (&LinkState, &Belief),
        scene: &impl Scene,
        (step, coasts): (&Propagation, bool),
        h: f64,
    ) {
        self.since_vertex = (if step.held { 0.0 } else { self.since_vertex } + h).min(f64::MAX);
        let in_passage = self.list.len() == 1;
        if self.are_quiet() && (coasts || step.held) {
            self.list.clear();
        }
        let mut fails = false;
        for (i, other) in self.list.iter_mut().enumerate() {
            // A hypothesis in the estimate's assembly is close to it.
            let close = (other.kind == Kind::Quiet && i == 0).then_some(step);
            let force = if other.kind == Kind::Quiet { Links::zeros() } else { belief.force };
            other.age += if other.kind == Kind::Quiet && in_passage { 0.0 } else { h };
            let goes_on = other.age < other.kind.rules().lifetime && other.propagate(constants, scene, &force, close, h).is_some();
            if !goes_on {
                (other.evidence, fails) = (f64::NAN, true);
            }
        }
        if fails {
            self.drop_refuted();
        }
        match () {
            // Without samples nothing decides between assemblies.
            () if coasts => self.mirror_odds = NEGLIGIBLE_ODDS,
            () if step.held || self.are_after_vertex() => self.mirror_odds = 0.0,
            () => self.follow_passage(constants, (motion, belief), &step.to),
        }
    }

    /// Follows the passage of a direct singularity, and opens hypotheses in both assemblies behind it.
    fn follow_passage(&mut self, constants: &Constants, (motion, belief): (&LinkState, &Belief), at: &Frame) {
        let quiet = || Hypothesis::quiet(constants, motion, belief);
        if let [passing] = self.list.as_mut_slice() {
            let odds = mirror_odds(&passing.motion, &passing.belief, &constants.linkage.frame(&passing.motion.theta));
            passing.evidence = passing.evidence.max(odds).clamp(NEGLIGIBLE_ODDS, 0.0);
        }
        let [side, rate] = motion.side().into();
        if side.abs() < DISTINGUISHABLE {
            if rate.abs() < SLOW_PASSAGE {
                match *self.list.as_slice() {
                    // The motion returns to the singularity undecided: the likelier hypothesis continues through it.
                    [own, other] => {
                        let evidence = other.evidence.clamp(NEGLIGIBLE_ODDS, 0.0 - NEGLIGIBLE_ODDS);
                        self.mirror_odds = evidence.min(0.0);
                        let likelier = if evidence > 0.0 { other } else { own };
                        self.list = [Hypothesis { evidence: -evidence.abs(), age: 0.0, ..likelier }].into_iter().collect();
                    }
                    [] if self.mirror_odds == NEGLIGIBLE_ODDS => self.list.push(quiet()),
                    _ => (),
                }
            }
            self.mirror_odds = self.mirror_odds.max(mirror_odds(motion, belief, at)).clamp(NEGLIGIBLE_ODDS, 0.0);
            return;
        }
        let prior = std::mem::replace(&mut self.mirror_odds, NEGLIGIBLE_ODDS);
        let passed = if self.list.len() == 1 { self.list.pop() } else { None };
        if prior > LEAST_ODDS_TO_OPEN {
            let (odds, own) = match passed {
                Some(passed) => (passed.evidence.clamp(LEAST_INITIAL_ODDS, LARGEST_ODDS_AFTER_CROSSING), passed),
                None => (prior.max(LEAST_INITIAL_ODDS), quiet()),
            };
            let own = Hypothesis { evidence: 0.0, ..own };
            self.list = own
                .mirrored(constants)
                .into_iter()
                .flat_map(|mirrored| {
                    if own.motion.side()[0] * side < 0.0 {
                        // The estimate is in the mirrored assembly, and the next samples replace it.
                        [mirrored, Hypothesis { evidence: (-odds).max(QUIET.decided + 1.0), ..own }]
                    } else {
                        [own, Hypothesis { evidence: odds, ..mirrored }]
                    }
                })
                .collect();
        }
    }

    /// Hypothesis that the first samples (innovation, angle) after a vertex favour by far.
    pub(super) fn favoured(&self, linkage: &Linkage, belief: &Belief, samples: &[Option<Measurement>; 2]) -> Option<usize> {
        if !self.are_after_vertex() {
            return None;
        }
        let favour = self.list.iter().map(|other| {
            let frame = linkage.frame(&other.motion.theta);
            let told = samples.iter().enumerate().filter_map(|(encoder, sample)| {
                let sample = sample.as_ref()?;
                let about_other = sample.about(encoder, &other.motion, &frame);
                let [own, of_estimate] = [(other.belief.bank, &about_other), (belief.bank, sample)]
                    .map(|(bank, sample)| bank.prediction(&sample.innovation).log_likelihood());
                Some(own - of_estimate)
            });
            told.sum()
        });
        largest(favour, IMMEDIATE_EVIDENCE)
    }

    /// Measurement update of the hypotheses; `likelihood` is the log-likelihood of the samples in the estimate. Returns the hypothesis that
    /// replaces the estimate, if any.
    pub(super) fn correct(&mut self, linkage: &Linkage, samples: &[Option<Measurement>; 2], likelihood: f64) -> Option<usize> {
        let told: ArrayVec<f64, MOST> =
            self.list.iter_mut().map(|other| other.update(linkage, samples).map_or(f64::NAN, |(told, ..)| told)).collect();
        let reference = if self.are_quiet() { told[0] } else { likelihood };
        self.list.iter_mut().zip(told).for_each(|(other, own)| other.evidence += own - reference);
        self.drop_refuted();
        if self.list.len() == 1 && self.are_quiet() {
            return None;
        }
        let decided = self.list.first()?.kind.rules().decided;
        largest(self.list.iter().map(|other| other.evidence), decided)
    }

    /// Drops what the evidence refutes, or what failed and has an evidence that is no number; of two assemblies, both.
    fn drop_refuted(&mut self) {
        let is_refuted = |other: &Hypothesis| other.evidence.is_nan() || other.evidence <= other.kind.rules().refuted;
        if self.list.len() == 1 && self.are_quiet() {
            self.list.retain(|passing| !passing.evidence.is_nan());
        } else if self.are_quiet() && self.list.iter().any(is_refuted) {
            self.list.clear();
        } else {
            self.list.retain(|other| !is_refuted(other));
        }
    }

    /// Lets a hypothesis replace the estimate. Behind a vertex the two change places; of two assemblies both go on beside the new estimate.
    pub(super) fn take_over(&mut self, which: usize, constants: &Constants, (motion, belief): (&mut LinkState, &mut Belief)) {
        let ahead = self.list[which].evidence;
        self.list.iter_mut().for_each(|other| other.evidence -= ahead);
        let other = &mut self.list[which];
        if other.kind == Kind::Quiet {
            let mut bank = other.belief.bank.with_priors(LIKELY_MODELS);
            bank.inflate([0.0, 0.0, REPLACEMENT_FORCE_VARIANCE * constants.torque_scale().powi(2)]);
            (*motion, *belief) = (other.motion, Belief { bank, ..other.belief });
            self.list.swap(0, which);
        } else {
            std::mem::swap(motion, &mut other.motion);
            std::mem::swap(belief, &mut other.belief);
            (other.evidence, other.kind) = (-ahead, Kind::Turned);
        }
    }

    /// Takes over a doubt about the side of the estimate that ends undecided: the log-likelihood of the other one.
    pub(super) fn doubt_side(&mut self, odds: f64) {
        self.mirror_odds = self.mirror_odds.max(odds.clamp(NEGLIGIBLE_ODDS, 0.0));
    }

    /// Counts samples that are `off`, each for `passed` seconds; whether the estimate is lost.
    pub(super) fn is_lost(&mut self, off: bool, passed: f64) -> bool {
        self.lost = (self.lost + if off { passed } else { -passed }).max(0.0);
        self.lost >= DIVERGENCE_TIME
    }

    /// None, of an estimate that may be on either side of a direct singularity: both assemblies are followed from then on.
    pub(super) fn of_unknown_side() -> Self {
        Self { mirror_odds: 0.0, ..Self::default() }
    }

    /// Whether stored hypotheses are possible.
    pub(super) fn is_sound(&self, linkage: &Linkage) -> bool {
        let first = self.list.first().map(|first| first.kind == Kind::Quiet);
        self.since_vertex >= 0.0
            && self.lost.is_finite()
            && (NEGLIGIBLE_ODDS..=0.0).contains(&self.mirror_odds)
            && !(first == Some(true) && self.list.len() == MOST)
            && self
                .list
                .iter()
                .all(|other| first == Some(other.kind == Kind::Quiet) && other.kind != Kind::Mirrored && other.is_sound(linkage))
    }
}

impl Hypothesis {
    /// Whether a stored hypothesis is possible.
    pub(super) fn is_sound(&self, linkage: &Linkage) -> bool {
        self.evidence.is_finite()
            && (0.0..=self.kind.rules().lifetime).contains(&self.age)
            && self.belief.is_sound(linkage, &self.motion)
    }

    /// Motion of the estimate under nearly no unknown force.
    fn quiet(constants: &Constants, motion: &LinkState, belief: &Belief) -> Self {
        let sigma = INITIAL_FORCE_SIGMA * constants.torque_scale();
        let bank = belief.bank.with_priors(QUIET_MODELS).with_force(sigma * sigma);
        let belief = Belief { force: Links::zeros(), bank };
        Self { kind: Kind::Quiet, motion: *motion, belief, evidence: NEGLIGIBLE_ODDS, age: 0.0 }
    }

    /// Whether this is in the other assembly than the start.
    pub(super) fn is_of_start(&self) -> bool {
        self.kind == Kind::Mirrored
    }

    /// Motion in the other assembly than the estimate's, with equal angles and rates of the motors, about which a start is as uncertain. `None`
    /// where the assemblies cannot be told apart.
    pub(super) fn of_start(constants: &Constants, motion: &LinkState) -> Option<Self> {
        let mirrored = mirror_image(constants, motion).filter(|_| is_distinguishable(motion))?;
        let belief = Belief::new(constants.start_variances());
        Some(Self { kind: Kind::Mirrored, motion: mirrored, belief, evidence: 0.0, age: 0.0 })
    }

    /// Hypothesis in the mirrored assembly with equal angles and rates of the motors.
    fn mirrored(&self, constants: &Constants) -> Option<Self> {
        let Self { motion, .. } = self;
        let mirrored = mirror_image(constants, motion)?;
        // Equal errors of the motors on the other tangent basis.
        let [from, to] = [motion, &mirrored].map(|of| constants.linkage.frame(&of.theta).motors());
        let turn = to.try_inverse().filter(|_| to.determinant().abs() >= LEAST_MOTOR_DETERMINANT)? * from;
        let mut f = Transition::identity();
        turn_errors(&turn, &mut f);
        f.fixed_view_mut::<2, 2>(FORCE, FORCE).copy_from(&Matrix2::identity());
        let mut belief = Belief { force: Links::zeros(), ..self.belief };
        belief.bank.transform(&f);
        Some(Self { motion: mirrored, belief, ..*self })
    }

    /// Time update by h seconds under an unknown force, with the transition of a motion that is `close` where that is close enough; `None`
    /// where it fails. Returns the step.
    pub(super) fn propagate(
        &mut self,
        constants: &Constants,
        scene: &impl Scene,
        force: &Links,
        close: Option<&Propagation>,
        h: f64,
    ) -> Option<Propagation> {
        let (linkage, rules) = (&constants.linkage, self.kind.rules());
        let from = linkage.frame(&self.motion.theta);
        let close = close.filter(|close| from.basis_map_to(&close.from).determinant().abs() >= LEAST_BASIS_OVERLAP);
        let (end, step) = if let Some(close) = close {
            let (end, to) = linkage.closed(flow::motion(scene, &self.motion, force, h, close.steps))?;
            (end, close.transferred(&from, &to))
        } else {
            let turn = h * self.motion.fastest() / from.smallest.max(LEAST_SINGULAR_VALUE);
            let fine = (turn / LARGEST_TURN).ceil().clamp(1.0, MOST_FINE_STEPS) as u32;
            let flow = flow::flow::<0>(linkage, scene, (&self.motion, &from), force, (h, fine));
            let (end, to) = if self.kind == Kind::Straight && from.smallest < NEAR_VERTEX {
                straight_on(linkage, &self.motion, h)?
            } else if linkage.posture(&flow.end.theta).gram(linkage.length).1 < NEAR_VERTEX {
                // Next to a vertex J cannot close the loop.
                (flow.end, linkage.frame(&flow.end.theta))
            } else {
                linkage.closed(flow.end)?
            };
            (end, Propagation::along(&flow, scene.mass(&self.motion.theta), &from, (&end, &to), h))
        };
        let (scale, timing) = (rules.force_scale * constants.torque_scale(), (h, constants.parameters.switch_time));
        self.belief.bank.predict(&step.f, &step.noise(h), [scale, 0.0, 0.0], timing, &rules.models);
        self.motion = end;
        Some(step)
    }

    /// Measurement update; returns the log-likelihood, the error that was injected and the map between the tangent bases, `None` where the loop
    /// cannot be closed.
    pub(super) fn update(&mut self, linkage: &Linkage, samples: &[Option<Measurement>; 2]) -> Option<(f64, Error, Matrix2<f64>)> {
        let mut likelihood = 0.0;
        let frame = linkage.frame(&self.motion.theta);
        for (i, sample) in samples.iter().enumerate() {
            let Some(sample) = sample else { continue };
            let Measurement { dead_zone, mut innovation, .. } = sample.about(i, &self.motion, &frame);
            let off = innovation.residual - innovation.row.dot(&self.belief.bank.mean());
            if off.abs() < dead_zone {
                continue;
            }
            innovation.residual -= dead_zone.copysign(off);
            let expected = self.belief.bank.prediction(&innovation);
            // Within the dead zone of a reading all motions are equally likely: the normalisation by the variance is left out.
            likelihood += if dead_zone > 0.0 { -0.5 * expected.nis() } else { expected.log_likelihood() };
            self.belief.bank.update(&expected);
        }
        let (error, turn, _) = self.belief.inject_error(linkage, &frame, &mut self.motion)?;
        Some((likelihood, error, turn))
    }
}

/// Index of the largest number above a bound.
fn largest(numbers: impl Iterator<Item = f64>, least: f64) -> Option<usize> {
    numbers.enumerate().fold((None, least), |best, (k, number)| if number > best.1 { (Some(k), number) } else { best }).0
}

/// Log-likelihood of the mirror state next to a direct singularity, at equal distance and opposite rate, which the motors do not
/// distinguish: by s = sin(θ₃ − θ₂) and ṡ with their covariance.
fn mirror_odds(motion: &LinkState, belief: &Belief, at: &Frame) -> f64 {
    let slope = libm::cos(motion.theta[2] - motion.theta[1]);
    let row = (at.basis.row(2) - at.basis.row(1)) * slope;
    let covariance = belief.bank.covariance();
    let element = |i: usize, k: usize| (row * covariance.fixed_view::<2, 2>(i, k) * row.transpose())[0];
    let (xx, xy, yy) = (element(0, 0), element(0, 2), element(2, 2));
    let [s, rate] = motion.side().into();
    // Half the normalised square of twice the distance.
    -2.0 * (s * s * yy - 2.0 * s * rate * xy + rate * rate * xx) / (xx * yy - xy * xy).max(f64::MIN_POSITIVE)
}

/// Assembly of a state.
fn assembly_of(motion: &LinkState) -> Assembly {
    if motion.side()[0] > 0.0 { Assembly::Plus } else { Assembly::Minus }
}

/// Whether a motion is so far from direct singularities that forces tell the assemblies apart.
pub(super) fn is_distinguishable(motion: &LinkState) -> bool {
    motion.side()[0].abs() >= NEAR_SINGULARITY
}

/// State of the other assembly with equal angles and rates of the motors.
fn mirror_image(constants: &Constants, motion: &LinkState) -> Option<LinkState> {
    let assembly = if assembly_of(motion) == Assembly::Plus { Assembly::Minus } else { Assembly::Plus };
    closed_by_motors(constants, MEASURED.map(|link| Pair::new(motion.theta[link], motion.omega[link])), assembly)
}

/// State of an assembly with these angles, rad, and rates, rad/s, of the motors.
fn closed_by_motors(constants: &Constants, [left, right]: [Pair; 2], assembly: Assembly) -> Option<LinkState> {
    let start = Start { theta: [left[0], right[0]], omega: [left[1], right[1]], assembly };
    let (q, v) = close(&constants.geometry, &start).ok()?;
    Some(LinkState::new(THETA.map(|i| q[i]), THETA.map(|i| v[i])))
}

/// State h seconds later at constant rates; `None` where the loop cannot be closed behind the vertex.
fn straight_on(linkage: &Linkage, motion: &LinkState, h: f64) -> Option<(LinkState, Frame)> {
    // Not closed next to the vertex: J near its rank loss would falsify the rates.
    let along = LinkState { theta: motion.theta + motion.omega * h, omega: motion.omega };
    let frame = linkage.frame(&along.theta);
    if frame.smallest >= NEAR_VERTEX { linkage.closed(along) } else { Some((along, frame)) }
}

/// Motion from the angles, rad, and rates, rad/s, of the encoders' axes, in the assembly of the estimate if possible. `None` if the loop cannot be
/// closed or the assemblies coincide.
pub(super) fn started_by_motors(constants: &Constants, motion: &LinkState, axes: [Pair; 2]) -> Option<LinkState> {
    let own = assembly_of(motion);
    let other = if own == Assembly::Plus { Assembly::Minus } else { Assembly::Plus };
    let started = [own, other].into_iter().find_map(|assembly| closed_by_motors(constants, axes, assembly))?;
    (started.side()[0].abs() >= DISTINGUISHABLE && constants.linkage.is_closed(&started)).then_some(started)
}

/// Motion that passes a vertex at the lateral distance `aside`, rad: integrated back, displaced, and integrated forward; `None` where that
/// fails.
fn turned_aside(linkage: &Linkage, scene: &impl Scene, (motion, belief): (&LinkState, &Belief), aside: f64) -> Option<Hypothesis> {
    let fastest = motion.fastest();
    // At rest in a vertex there is no past motion.
    if fastest < REST_RATE {
        return None;
    }
    let time = START_DISTANCE / fastest;
    let (past, frame) = linkage.closed(flow::motion(scene, motion, &belief.force, -time, TURNING_STEPS))?;
    let along = frame.basis.tr_mul(&past.omega);
    if along.norm() < REST_RATE {
        return None;
    }
    let across = along * (aside / along.norm());
    let (past, _) = linkage.closed(frame.displaced(&past, [-across[1], across[0], 0.0, 0.0]))?;
    let turned = flow::motion(scene, &past, &belief.force, time, TURNING_STEPS);
    if !turned.theta.iter().chain(&turned.omega).all(|x| x.abs() < LARGEST_RATE) || !linkage.is_closed(&turned) {
        return None;
    }
    let mut bank: Bank = belief.bank;
    bank.change_basis(&linkage.frame(&motion.theta).basis_map_to(&linkage.frame(&turned.theta)));
    bank.inflate([aside * aside, (aside / START_DISTANCE * fastest).powi(2), 0.0]);
    Some(Hypothesis { kind: Kind::Turned, motion: turned, belief: Belief { bank, ..*belief }, evidence: 0.0, age: 0.0 })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::simulation::bindings::default_parameters;

    /// Motions that go straight on next to a vertex are states that may be stored, whatever their rates.
    #[test]
    fn straight_motions_may_be_stored() {
        let linkage = Linkage::new(&default_parameters().geometry);
        let mut steps = 0;
        for vertex in [[0.0, 0.0, PI, 0.0], [0.0, 0.0, 0.0, PI], [0.0, PI, PI, PI], [PI, 0.0, PI, PI]] {
            for k in 0..200 {
                let wave = |i: usize, by: f64| libm::sin(by * f64::from(k) + (i * i) as f64);
                let off = LinkState::new(
                    std::array::from_fn(|i| vertex[i] + 0.02 * wave(i, 1.0)),
                    std::array::from_fn(|i| 10.0 * wave(i, 1.7)),
                );
                let Some((mut at, mut frame)) = linkage.closed(off) else { continue };
                while frame.smallest < NEAR_VERTEX
                    && let Some(next) = straight_on(&linkage, &at, 1e-3)
                {
                    (at, frame) = next;
                    assert!(linkage.is_closed(&at), "{at:?}");
                    steps += 1;
                }
            }
        }
        assert!(steps > 1000, "{steps}");
    }
}
