//! Hypotheses: motions that the encoders cannot distinguish from the estimate at once. They are the alternative answers to one open
//! question, until samples decide.
//!
//! | question | alternatives | compared with |
//! | --- | --- | --- |
//! | after a vertex, which way? | straight on, turned to either side | the estimate |
//! | in a slow passage of a direct singularity, across or back? | the motion with nearly no unknown force | its mirror image |
//! | after such a passage, a vertex or a restart, in which assembly? | motions with nearly no unknown force in the estimate's assembly and in the other one | each other |
//!
//! Motor angles do not distinguish the assemblies; only the later motion does, and slowly. A suitable unknown force explains either
//! assembly, and the models of the estimate allow such changing forces, so their evidence does not decide. The compared motions therefore
//! have nearly no unknown force.

use arrayvec::ArrayVec;
use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::Matrix2;

use super::belief::{Bank, Belief, persistence};
use super::encoder::Measurement;
use super::error_state::{Error, FORCE, Transition, turn_errors};
use super::flow::{self, Scene};
use super::machine::Machine;
use super::propagation::Propagation;
use super::tangent::{Frame, LinkState, Linkage, Links, MEASURED, Pair};
use super::tuning::{
    AFTER_VERTEX, DISTINGUISHABLE, DIVERGENCE_TIME, IMMEDIATE_EVIDENCE, INITIAL_FORCE_SIGMA, LARGEST_ODDS_AFTER_CROSSING,
    LARGEST_RATE, LARGEST_TURN, LATERAL_OFFSET, LEAST_BASIS_OVERLAP, LEAST_INITIAL_ODDS, LEAST_MOTOR_DETERMINANT,
    LEAST_ODDS_TO_OPEN, LEAST_RATE_CHANGE, LEAST_SINGULAR_VALUE, LIKELY_MODELS, MODELS, MOST_FINE_STEPS, NEAR_SINGULARITY,
    NEAR_VERTEX, NEGLIGIBLE_ODDS, QUIET_FORCE_SCALE, QUIET_MODELS, REPLACEMENT_FORCE_VARIANCE, REST_RATE, SLOW_PASSAGE,
    START_DISTANCE, TURNING_STEPS, WHICH_ASSEMBLY,
};
use crate::copies::clone_by_fields;
use crate::mechanism::coordinates::THETA;
use crate::mechanism::{Assembly, Start, close};

/// Largest number of alternatives after a vertex.
const MOST: usize = 3;

/// Motion tracked in parallel to the estimate, with its errors.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Alternative {
    pub(super) motion: LinkState,
    pub(super) belief: Belief,
}

/// How an alternative moves.
#[derive(Clone, Copy)]
pub(super) enum Moves<'a> {
    /// Straight on through a vertex, with this unknown force.
    Straight(&'a Links),
    /// Under this unknown force.
    Under(&'a Links),
    /// With nearly no unknown force, and with the transition of the estimate if the motion is close to the estimate.
    Quiet(Option<&'a Propagation>),
}

impl Moves<'_> {
    /// Unknown force, its torque scale relative to the estimate's, and prior probabilities of the models.
    fn force(self) -> (Links, f64, &'static [f64; MODELS]) {
        match self {
            Self::Straight(force) | Self::Under(force) => (*force, 1.0, &LIKELY_MODELS),
            Self::Quiet(_) => (Links::zeros(), QUIET_FORCE_SCALE, &QUIET_MODELS),
        }
    }
}

/// Way from a vertex.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Way {
    other: Alternative,
    /// Whether it goes straight on through the vertex.
    straight: bool,
    /// Log-likelihood relative to the estimate.
    evidence: f64,
}

/// Question about the branch of the motion, with the motions that may answer it.
#[derive(Clone, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
#[expect(clippy::large_enum_variant, reason = "a step allocates nothing")]
enum Question {
    /// None is open.
    #[default]
    None,
    /// Which way from a vertex? There is at least one way; all have the same age, s.
    Vertex { ways: ArrayVec<Way, MOST>, age: f64 },
    /// Across a direct singularity or back, in a slow passage? `odds` is the largest log-likelihood so far of the mirror image of the quiet
    /// motion.
    Passage { passing: Alternative, odds: f64 },
    /// In which assembly? Quiet motions in the estimate's assembly and in the other one, the log-likelihood of the second relative to the
    /// first, and the age of the question, s.
    Assemblies { own: Alternative, other: Alternative, evidence: f64, age: f64 },
}

/// The open question, and the evidence for later questions.
#[derive(Debug, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Hypotheses {
    question: Question,
    /// Time since the last vertex, s.
    since_vertex: f64,
    /// Whether the estimate approaches a vertex.
    approaches_vertex: bool,
    /// Largest log-likelihood of the other side during the present passage of a singularity: −1000 far from a singularity, 0 if the side is
    /// unknown.
    mirror_odds: f64,
    /// Evidence for a restart, s: accumulated time with samples far from the estimate, minus the time with samples near it.
    lost: f64,
}

clone_by_fields!(Hypotheses { question, since_vertex, approaches_vertex, mirror_odds, lost });

impl Default for Hypotheses {
    fn default() -> Self {
        Self { question: Question::None, since_vertex: f64::MAX, approaches_vertex: false, mirror_odds: NEGLIGIBLE_ODDS, lost: 0.0 }
    }
}

impl Hypotheses {
    /// Whether several motions are tracked, after a vertex or in both assemblies.
    pub(super) fn are_open(&self) -> bool {
        matches!(self.question, Question::Vertex { .. } | Question::Assemblies { .. })
    }

    /// Whether motions with nearly no unknown force are tracked.
    pub(super) fn are_quiet(&self) -> bool {
        matches!(self.question, Question::Passage { .. } | Question::Assemblies { .. })
    }

    /// Whether the branch is known: the time since the last vertex exceeds the lifetime of a question about it.
    pub(super) fn is_branch_known(&self) -> bool {
        self.since_vertex > AFTER_VERTEX.lifetime
    }

    /// Opens a question if the estimate leaves a vertex, because no sample has revealed on which side the vertex was passed. `to` is the
    /// estimate at the end of the macro step. Called before the time update.
    pub(super) fn open_after_vertex(
        &mut self,
        machine: &Machine,
        (motion, belief): (&LinkState, &Belief),
        scene: &impl Scene,
        step: &Propagation,
        to: &LinkState,
    ) {
        let (before, after) = (step.from.smallest, step.to.smallest);
        let near = before.min(after) < NEAR_VERTEX;
        // Forces cannot change a rate by so much in one step.
        let fastest = motion.fastest();
        let turned = near
            && fastest > REST_RATE
            && (to.omega - motion.omega).iter().any(|change| change.abs() > LEAST_RATE_CHANGE * fastest);
        let leaves = near && (turned || self.approaches_vertex && after > before);
        self.approaches_vertex = near && !leaves && after < before;
        if leaves && !matches!(self.question, Question::Vertex { .. }) {
            let straight =
                turned.then_some(Way { other: Alternative { motion: *motion, belief: *belief }, straight: true, evidence: 0.0 });
            let aside = |side: f64| turned_aside(&machine.linkage, scene, (motion, belief), side * LATERAL_OFFSET);
            self.question = Question::of_ways([straight, aside(1.0), aside(-1.0)].into_iter().flatten().collect(), 0.0);
        }
    }

    /// Time update by a macro step of h seconds, after the time update of the estimate. `coasts`: no samples are used.
    pub(super) fn step(
        &mut self,
        machine: &Machine,
        (motion, belief): (&LinkState, &Belief),
        scene: &impl Scene,
        (step, coasts): (&Propagation, bool),
        h: f64,
    ) {
        self.since_vertex = (if step.held { 0.0 } else { self.since_vertex } + h).min(f64::MAX);
        let goes_on = |other: &mut Alternative, moves: Moves| other.propagate(machine, scene, moves, h).is_some();
        let stays = match &mut self.question {
            Question::None => true,
            Question::Passage { .. } | Question::Assemblies { .. } if coasts || step.held => false,
            Question::Passage { passing, .. } => goes_on(passing, Moves::Quiet(Some(step))),
            Question::Assemblies { own, other, age, .. } => {
                *age += h;
                *age < WHICH_ASSEMBLY.lifetime && goes_on(own, Moves::Quiet(Some(step))) && goes_on(other, Moves::Quiet(None))
            }
            Question::Vertex { ways, age } => {
                *age += h;
                let open = ways.len();
                ways.retain(|Way { other, straight, .. }| {
                    let moves = if *straight { Moves::Straight(&belief.force) } else { Moves::Under(&belief.force) };
                    *age < AFTER_VERTEX.lifetime && goes_on(other, moves)
                });
                if ways.len() < open {
                    ways.retain(|way| way.evidence > AFTER_VERTEX.refuted);
                }
                !ways.is_empty()
            }
        };
        if !stays {
            self.question = Question::None;
        }
        match () {
            // Without samples nothing decides between assemblies.
            () if coasts => self.mirror_odds = NEGLIGIBLE_ODDS,
            () if step.held || matches!(self.question, Question::Vertex { .. }) => self.mirror_odds = 0.0,
            () => self.follow_passage(machine, (motion, belief), &step.to),
        }
    }

    /// Tracks the passage of a direct singularity, and opens the question of the assembly after it.
    fn follow_passage(&mut self, machine: &Machine, (motion, belief): (&LinkState, &Belief), at: &Frame) {
        let quiet = || Alternative::quiet(machine, motion, belief);
        if let Question::Passage { passing, odds } = &mut self.question {
            let now = mirror_odds(&passing.motion, &passing.belief, &machine.linkage.frame(&passing.motion.theta));
            *odds = odds.max(now).clamp(NEGLIGIBLE_ODDS, 0.0);
        }
        let [side, rate] = motion.side().into();
        if side.abs() < DISTINGUISHABLE {
            if rate.abs() < SLOW_PASSAGE {
                match self.question {
                    // The motion returns to the singularity before a decision: the likelier alternative continues through it.
                    Question::Assemblies { own, other, evidence, .. } => {
                        let evidence = evidence.clamp(NEGLIGIBLE_ODDS, 0.0 - NEGLIGIBLE_ODDS);
                        self.mirror_odds = evidence.min(0.0);
                        let passing = if evidence > 0.0 { other } else { own };
                        self.question = Question::Passage { passing, odds: -evidence.abs() };
                    }
                    Question::None if self.mirror_odds == NEGLIGIBLE_ODDS => {
                        self.question = Question::Passage { passing: quiet(), odds: NEGLIGIBLE_ODDS };
                    }
                    Question::None | Question::Passage { .. } | Question::Vertex { .. } => (),
                }
            }
            self.mirror_odds = self.mirror_odds.max(mirror_odds(motion, belief, at)).clamp(NEGLIGIBLE_ODDS, 0.0);
            return;
        }
        let prior = std::mem::replace(&mut self.mirror_odds, NEGLIGIBLE_ODDS);
        let passed = if let Question::Passage { passing, odds } = self.question { Some((passing, odds)) } else { None };
        if passed.is_some() {
            self.question = Question::None;
        }
        if prior > LEAST_ODDS_TO_OPEN {
            let (own, odds) = match passed {
                Some((passed, odds)) => (passed, odds.clamp(LEAST_INITIAL_ODDS, LARGEST_ODDS_AFTER_CROSSING)),
                None => (quiet(), prior.max(LEAST_INITIAL_ODDS)),
            };
            self.question = match own.mirrored(machine) {
                None => Question::None,
                // The estimate is in the mirrored assembly; the next samples replace it.
                Some(mirrored) if own.motion.side()[0] * side < 0.0 => {
                    let evidence = (-odds).max(WHICH_ASSEMBLY.decided + 1.0);
                    Question::Assemblies { own: mirrored, other: own, evidence, age: 0.0 }
                }
                Some(mirrored) => Question::Assemblies { own, other: mirrored, evidence: odds, age: 0.0 },
            };
        }
    }

    /// Way that the first samples after a vertex clearly favour.
    pub(super) fn favoured(&self, linkage: &Linkage, belief: &Belief, samples: &[Option<Measurement>; 2]) -> Option<usize> {
        let Question::Vertex { ways, .. } = &self.question else { return None };
        let favour = ways.iter().map(|Way { other, .. }| {
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

    /// Measurement update of the alternatives; `likelihood` is the log-likelihood of the samples in the estimate. Returns the alternative that
    /// replaces the estimate, if any.
    pub(super) fn correct(&mut self, linkage: &Linkage, samples: &[Option<Measurement>; 2], likelihood: f64) -> Option<usize> {
        let told = |other: &mut Alternative| other.update(linkage, samples).map(|(told, ..)| told);
        let (stays, decided) = match &mut self.question {
            Question::None => (true, None),
            Question::Passage { passing, .. } => (told(passing).is_some_and(f64::is_finite), None),
            Question::Assemblies { own, other, evidence, .. } => {
                let told = told(own).zip(told(other)).filter(|(own, _)| own.is_finite());
                *evidence += told.map_or(0.0, |(own, other)| other - own);
                let stays = told.is_some() && *evidence > WHICH_ASSEMBLY.refuted;
                (stays, (stays && *evidence > WHICH_ASSEMBLY.decided).then_some(1))
            }
            Question::Vertex { ways, .. } => {
                ways.retain(|Way { other, evidence, .. }| {
                    let told = told(other);
                    *evidence += told.map_or(0.0, |told| told - likelihood);
                    told.is_some() && *evidence > AFTER_VERTEX.refuted
                });
                (!ways.is_empty(), largest(ways.iter().map(|way| way.evidence), AFTER_VERTEX.decided))
            }
        };
        if !stays {
            self.question = Question::None;
        }
        decided
    }

    /// Replaces the estimate by an alternative. After a vertex, estimate and alternative are exchanged. If the question is the assembly,
    /// the quiet motions in both assemblies continue in parallel to the new estimate.
    pub(super) fn take_over(&mut self, which: usize, machine: &Machine, (motion, belief): (&mut LinkState, &mut Belief)) {
        match &mut self.question {
            Question::None | Question::Passage { .. } => (),
            Question::Assemblies { own, other, evidence, .. } => {
                let mut bank = other.belief.bank.with_priors(LIKELY_MODELS);
                bank.inflate([0.0, 0.0, REPLACEMENT_FORCE_VARIANCE * machine.torque_scale().powi(2)]);
                (*motion, *belief) = (other.motion, Belief { bank, ..other.belief });
                std::mem::swap(own, other);
                *evidence = 0.0 - *evidence;
            }
            Question::Vertex { ways, .. } => {
                let ahead = ways[which].evidence;
                ways.iter_mut().for_each(|way| way.evidence -= ahead);
                let Way { other, straight, evidence } = &mut ways[which];
                std::mem::swap(motion, &mut other.motion);
                std::mem::swap(belief, &mut other.belief);
                (*evidence, *straight) = (-ahead, false);
            }
        }
    }

    /// Records that the side of the estimate is undecided (`doubt.rs`); `odds` is the log-likelihood of the other side.
    pub(super) fn doubt_side(&mut self, odds: f64) {
        self.mirror_odds = self.mirror_odds.max(odds.clamp(NEGLIGIBLE_ODDS, 0.0));
    }

    /// Closes the loops of all alternatives again after lengths have changed. Drops those that cannot be closed.
    pub(super) fn close(&mut self, linkage: &Linkage) {
        let close = |other: &mut Alternative| linkage.close(&mut other.motion);
        let stays = match &mut self.question {
            Question::None => true,
            Question::Passage { passing, .. } => close(passing),
            Question::Assemblies { own, other, .. } => close(own) && close(other),
            Question::Vertex { ways, .. } => {
                ways.retain(|way| close(&mut way.other));
                !ways.is_empty()
            }
        };
        if !stays {
            self.question = Question::None;
        }
    }

    /// Counts samples: those far from the estimate (`off`) add `passed` seconds, others subtract them. Returns whether the estimate is
    /// lost.
    pub(super) fn is_lost(&mut self, off: bool, passed: f64) -> bool {
        self.lost = (self.lost + if off { passed } else { -passed }).max(0.0);
        self.lost >= DIVERGENCE_TIME
    }

    /// No question yet, for an estimate that may be on either side of a direct singularity. Both assemblies will be tracked.
    pub(super) fn of_unknown_side() -> Self {
        Self { mirror_odds: 0.0, ..Self::default() }
    }

    /// Whether stored values are possible.
    pub(super) fn is_sound(&self, linkage: &Linkage) -> bool {
        self.since_vertex >= 0.0
            && self.lost.is_finite()
            && (NEGLIGIBLE_ODDS..=0.0).contains(&self.mirror_odds)
            && match &self.question {
                Question::None => true,
                Question::Vertex { ways, age } => {
                    let is_sound = |way: &Way| way.evidence.is_finite() && way.other.is_sound(linkage);
                    !ways.is_empty() && (0.0..=AFTER_VERTEX.lifetime).contains(age) && ways.iter().all(is_sound)
                }
                Question::Passage { passing, odds } => (NEGLIGIBLE_ODDS..=0.0).contains(odds) && passing.is_sound(linkage),
                Question::Assemblies { own, other, evidence, age } => {
                    evidence.is_finite()
                        && (0.0..=WHICH_ASSEMBLY.lifetime).contains(age)
                        && [own, other].into_iter().all(|of| of.is_sound(linkage))
                }
            }
    }
}

impl Question {
    /// The question which way from a vertex, with this age, s; no question if there is no way.
    fn of_ways(ways: ArrayVec<Way, MOST>, age: f64) -> Self {
        if ways.is_empty() { Self::None } else { Self::Vertex { ways, age } }
    }
}

impl Alternative {
    /// Whether a stored alternative is possible.
    pub(super) fn is_sound(&self, linkage: &Linkage) -> bool {
        self.belief.is_sound(linkage, &self.motion)
    }

    /// Motion of the estimate with nearly no unknown force.
    fn quiet(machine: &Machine, motion: &LinkState, belief: &Belief) -> Self {
        let sigma = INITIAL_FORCE_SIGMA * machine.torque_scale();
        let bank = belief.bank.with_priors(QUIET_MODELS).with_force(sigma * sigma);
        let belief = Belief { force: Links::zeros(), bank };
        Self { motion: *motion, belief }
    }

    /// Motion in the other assembly, with equal angles and rates of the motors and the uncertainty of a start. `None` if the assemblies
    /// cannot be distinguished.
    pub(super) fn of_start(machine: &Machine, motion: &LinkState) -> Option<Self> {
        let mirrored = mirror_image(machine, motion).filter(|_| is_distinguishable(motion))?;
        Some(Self { motion: mirrored, belief: Belief::new(machine.start_variances()) })
    }

    /// Alternative in the mirrored assembly with equal angles and rates of the motors.
    fn mirrored(&self, machine: &Machine) -> Option<Self> {
        let Self { motion, .. } = self;
        let mirrored = mirror_image(machine, motion)?;
        // Maps errors to the other tangent basis so that the errors of the motors are equal.
        let [from, to] = [motion, &mirrored].map(|of| machine.linkage.frame(&of.theta).motors());
        let turn = to.try_inverse().filter(|_| to.determinant().abs() >= LEAST_MOTOR_DETERMINANT)? * from;
        let mut f = Transition::identity();
        turn_errors(&turn, &mut f);
        f.fixed_view_mut::<2, 2>(FORCE, FORCE).copy_from(&Matrix2::identity());
        let mut belief = Belief { force: Links::zeros(), ..self.belief };
        belief.bank.transform(&f);
        Some(Self { motion: mirrored, belief })
    }

    /// Time update by h seconds. Returns the step; `None` if the motion cannot continue.
    pub(super) fn propagate(&mut self, machine: &Machine, scene: &impl Scene, moves: Moves, h: f64) -> Option<Propagation> {
        let (linkage, (force, scale, models)) = (&machine.linkage, moves.force());
        let from = linkage.frame(&self.motion.theta);
        let close = if let Moves::Quiet(close) = moves { close } else { None };
        let close = close.filter(|close| from.basis_map_to(&close.from).determinant().abs() >= LEAST_BASIS_OVERLAP);
        let (end, step) = if let Some(close) = close {
            let (end, to) = linkage.closed(flow::motion(scene, &self.motion, &force, h, close.steps))?;
            (end, close.transferred(&from, &to))
        } else {
            let turn = h * self.motion.fastest() / from.smallest.max(LEAST_SINGULAR_VALUE);
            let fine = (turn / LARGEST_TURN).ceil().clamp(1.0, MOST_FINE_STEPS) as u32;
            let flow = flow::flow::<0>(linkage, scene, &self.motion, &from, &force, h, fine);
            let (end, to) = if matches!(moves, Moves::Straight(_)) && from.smallest < NEAR_VERTEX {
                straight_on(linkage, &self.motion, h)?
            } else if linkage.posture(&flow.end.theta).gram(linkage.length).1 < NEAR_VERTEX {
                // Next to a vertex J is nearly singular, so the loop is not closed.
                (flow.end, linkage.frame(&flow.end.theta))
            } else {
                linkage.closed(flow.end)?
            };
            (end, Propagation::along(&flow, scene.mass(&self.motion.theta), &from, (&end, &to), h))
        };
        let (scale, stay) = (scale * machine.torque_scale(), persistence(h, machine.parameters.switch_time));
        self.belief.bank.predict(&step.f, &step.noise(h), [scale, 0.0, 0.0], stay, models);
        self.motion = end;
        Some(step)
    }

    /// Measurement update; returns the log-likelihood, the injected error and the map between the tangent bases; `None` if the loop cannot
    /// be closed.
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
            // Inside the dead zone of a reading all motions are equally likely, so the log-likelihood omits −½ ln of the variance.
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

/// Log-likelihood of the mirror state next to a direct singularity, from s = sin(θ₃ − θ₂), ṡ and their covariance. The mirror state has
/// opposite s and ṡ; motor angles do not distinguish it.
fn mirror_odds(motion: &LinkState, belief: &Belief, at: &Frame) -> f64 {
    let slope = libm::cos(motion.theta[2] - motion.theta[1]);
    let row = (at.basis.row(2) - at.basis.row(1)) * slope;
    let covariance = belief.bank.covariance();
    let element = |i: usize, k: usize| (row * covariance.fixed_view::<2, 2>(i, k) * row.transpose())[0];
    let (xx, xy, yy) = (element(0, 0), element(0, 2), element(2, 2));
    let [s, rate] = motion.side().into();
    // Half the normalised square of the distance between both states, which is twice the distance from the singularity.
    -2.0 * (s * s * yy - 2.0 * s * rate * xy + rate * rate * xx) / (xx * yy - xy * xy).max(f64::MIN_POSITIVE)
}

fn assembly_of(motion: &LinkState) -> Assembly {
    if motion.side()[0] > 0.0 { Assembly::Plus } else { Assembly::Minus }
}

/// Whether a motion is so far from direct singularities that forces distinguish the assemblies.
pub(super) fn is_distinguishable(motion: &LinkState) -> bool {
    motion.side()[0].abs() >= NEAR_SINGULARITY
}

/// State of the other assembly with equal angles and rates of the motors.
fn mirror_image(machine: &Machine, motion: &LinkState) -> Option<LinkState> {
    let assembly = if assembly_of(motion) == Assembly::Plus { Assembly::Minus } else { Assembly::Plus };
    closed_by_motors(machine, MEASURED.map(|link| Pair::new(motion.theta[link], motion.omega[link])), assembly)
}

/// State of an assembly with these angles, rad, and rates, rad/s, of the motors.
fn closed_by_motors(machine: &Machine, [left, right]: [Pair; 2], assembly: Assembly) -> Option<LinkState> {
    let start = Start { theta: [left[0], right[0]], omega: [left[1], right[1]], assembly };
    let (q, v) = close(&machine.geometry, &start).ok()?;
    Some(LinkState::new(THETA.map(|i| q[i]), THETA.map(|i| v[i])))
}

/// State h seconds later at constant rates; `None` if the loop cannot be closed after the vertex.
fn straight_on(linkage: &Linkage, motion: &LinkState, h: f64) -> Option<(LinkState, Frame)> {
    // The loop is not closed next to the vertex: J is nearly singular and would falsify the rates.
    let along = LinkState { theta: motion.theta + motion.omega * h, omega: motion.omega };
    let frame = linkage.frame(&along.theta);
    if frame.smallest >= NEAR_VERTEX { linkage.closed(along) } else { Some((along, frame)) }
}

/// Motion with these angles, rad, and rates, rad/s, of the encoders' axes, in the assembly of the estimate if possible. `None` if the loop
/// cannot be closed or the assemblies coincide.
pub(super) fn started_by_motors(machine: &Machine, motion: &LinkState, axes: [Pair; 2]) -> Option<LinkState> {
    let own = assembly_of(motion);
    let other = if own == Assembly::Plus { Assembly::Minus } else { Assembly::Plus };
    let started = [own, other].into_iter().find_map(|assembly| closed_by_motors(machine, axes, assembly))?;
    (started.side()[0].abs() >= DISTINGUISHABLE && machine.linkage.is_closed(&started)).then_some(started)
}

/// Motion that passes a vertex at the lateral distance `aside`, rad: integrated backward, displaced and integrated forward; `None` if that
/// fails.
fn turned_aside(linkage: &Linkage, scene: &impl Scene, (motion, belief): (&LinkState, &Belief), aside: f64) -> Option<Way> {
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
    let other = Alternative { motion: turned, belief: Belief { bank, ..*belief } };
    Some(Way { other, straight: false, evidence: 0.0 })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::simulation::bindings::default_parameters;

    /// Motions that go straight on next to a vertex are valid stored states at any rates.
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
