//! What dry friction that sticks does in a state: which grips hold, and by what force. In the twelve coordinates; what the link angles ask
//! is carried over.

use arrayvec::ArrayVec;

use super::angles::{Angles, ByAngles};
use super::five_bar::FiveBar;
use crate::effects::grips::{Balance, GRIPS, Grasp, Grasps, Grip, Grips, Way};
use crate::effects::{Slide, Slides, lowest, slow};
use crate::integrator::{Held, Kkt, System};
use crate::mechanism::{COORDINATES, Coordinates, Multipliers, Pose, SceneError};
use crate::vector::Vector;

impl FiveBar<'_> {
    /// The grips that there are.
    fn grasps(&self, q: &Coordinates, pose: &Pose, v: &Coordinates) -> Grasps<COORDINATES> {
        let (at, mut grasps) = (self.context(q, pose, v), Grasps::new());
        for effect in &self.model.effects {
            effect.add_grasps(&at, &mut grasps);
        }
        grasps
    }

    fn slow(&self) -> f64 {
        slow(self.model.error_tolerance)
    }
}

/// Up to so many times the rate at which a grip rests a mechanism that friction can hold is at rest: what it still moves is below all
/// tolerances.
const AT_REST: f64 = 1e3;

/// Up to so many times that rate a grip may begin to hold: a step ends beyond a border by some part of it.
const RESTS: f64 = 2.0;

/// What the grips do in a state, by itself.
#[cold]
#[inline(never)]
pub(super) fn resolved(system: &FiveBar<'_>, q: &Coordinates, v: &Coordinates) -> Grips {
    let pose = system.pose(q);
    let grasps = system.grasps(q, &pose, v);
    let slow = system.slow();
    if v.max_norm() <= AT_REST * slow {
        let at_rest = balance(system, q, &Coordinates::ZERO, &|_| true);
        if at_rest.can_rest() {
            return Grips::resting(at_rest.places.into_iter());
        }
    }
    let mut grips = moving(&grasps);
    let rests = |grasp: &Grasp<COORDINATES>| grasp.rate.abs() <= RESTS * slow;
    if grasps.iter().any(rests) {
        balance(system, q, v, &rests).moving(&mut grips);
    }
    grips
}

/// Whether what slips turns and turns back between two states: by the cubic through the rates and accelerations at both.
#[cold]
#[inline(never)]
pub(super) fn turns_between(system: &FiveBar<'_>, ends: [[&Coordinates; 3]; 2], duration: f64, slow: f64) -> bool {
    let grasps = |[q, v, _]: [&Coordinates; 3]| system.grasps(q, &system.pose(q), v);
    let (from, to) = (grasps(ends[0]), grasps(ends[1]));
    let pairs = from.iter().zip(&to).filter(|(from, to)| from.place == to.place);
    pairs.into_iter().any(|(from, to)| {
        let Grip::Slips(way) = system.sides.grips.at(from.place) else { return false };
        let change =
            |grasp: &Grasp<COORDINATES>, [.., a]: [&Coordinates; 3]| way.sign() * duration * (grasp.row.dot(a) + grasp.drift);
        let rates = [from, to].map(|grasp| way.sign() * grasp.rate);
        let changes = [change(from, ends[0]), change(to, ends[1])];
        // Between its ends a cubic is lower than both by no more than this part of the slopes that lead there.
        const DEEPEST: f64 = 4.0 / 27.0;
        let dip = DEEPEST * ((-changes[0]).max(0.0) + changes[1].max(0.0));
        rates[0].min(rates[1]) - dip < -slow && lowest(rates, changes) < -slow
    })
}

/// All slip.
#[cold]
#[inline(never)]
fn moving(grasps: &Grasps<COORDINATES>) -> Grips {
    let mut grips = Grips::OPEN;
    for grasp in grasps {
        grips.set(grasp.place, Grip::Slips(Way::of(grasp.rate)));
    }
    grips
}

/// What some grips, which can hold something, have to hold while the others slip.
#[cold]
#[inline(never)]
fn balance(system: &FiveBar<'_>, q: &Coordinates, v: &Coordinates, rests: &dyn Fn(&Grasp<COORDINATES>) -> bool) -> Balance {
    let pose = system.pose(q);
    let grasps = system.grasps(q, &pose, v);
    let resting: ArrayVec<Grasp<COORDINATES>, GRIPS> =
        grasps.iter().filter(|grasp| grasp.bound > 0.0 && rests(grasp)).copied().collect();
    let mut grips = moving(&grasps);
    for grasp in &resting {
        grips.set(grasp.place, Grip::Holds(Way::Forward));
    }
    let mass = system.factor_mass(&pose, system.model.regularization);
    let forces = system.on(system.sides.with_grips(grips)).forces(q, &pose, v);
    let (a, _) = mass.solve(&forces, &-system.phi_q_dot_times(&pose, v));
    let mut balance = Balance::default();
    for (i, grasp) in resting.iter().enumerate() {
        let (by_torque, _) = mass.solve(&grasp.row, &Vector::ZERO);
        balance.places.push(grasp.place);
        balance.bounds[i] = grasp.bound;
        balance.change[i] = grasp.row.dot(&a) + grasp.drift;
        for (j, other) in resting.iter().enumerate() {
            balance.mobility[j][i] = other.row.dot(&by_torque);
        }
    }
    balance
}

/// What friction holds.
#[cold]
#[inline(never)]
pub(super) fn held(system: &FiveBar<'_>, q: &Coordinates, pose: &Pose, v: &Coordinates) -> Held<COORDINATES> {
    let grasps = system.grasps(q, pose, v);
    if system.sides.grips.at_rest() {
        let torques = balance(system, q, v, &|_| true).resting_torques();
        let able = grasps.iter().filter(|grasp| grasp.bound > 0.0);
        let force = able.zip(torques).fold(Coordinates::ZERO, |force, (grasp, torque)| force + torque * grasp.row);
        return Held::All { force };
    }
    let Some(first) = first(&system.sides.grips, &grasps) else { return Held::Nothing };
    let force = shares(&system.sides.grips, &grasps).fold(Coordinates::ZERO, |force, (grasp, share)| force + share * grasp.row);
    Held::Direction { row: first.row, drift: first.drift, force }
}

/// The first grip that holds.
fn first<'a>(grips: &Grips, grasps: &'a Grasps<COORDINATES>) -> Option<&'a Grasp<COORDINATES>> {
    grasps.iter().find(|grasp| matches!(grips.at(grasp.place), Grip::Holds(_)))
}

/// The grips that hold one motion, with what each does per torque of the first: all of them use the same part of their bounds.
fn shares<'a>(grips: &'a Grips, grasps: &'a Grasps<COORDINATES>) -> impl Iterator<Item = (&'a Grasp<COORDINATES>, f64)> {
    let first = first(grips, grasps);
    grasps.iter().filter_map(move |grasp| {
        let Grip::Holds(way) = grips.at(grasp.place) else { return None };
        let leader = first?;
        let share = if grasp.place == leader.place { 1.0 } else { way.sign() * grasp.bound / leader.bound };
        Some((grasp, share))
    })
}

/// By what torques the grips hold, N·m, and the tip's by what force, N, with these accelerations.
#[cold]
#[inline(never)]
pub(super) fn holding(system: &FiveBar<'_>, q: &Coordinates, v: &Coordinates) -> [f64; GRIPS] {
    let pose = system.pose(q);
    let grasps = system.grasps(q, &pose, v);
    let mut holding = [0.0; GRIPS];
    if system.sides.grips.at_rest() {
        let balance = balance(system, q, v, &|_| true);
        for (place, torque) in balance.places.iter().zip(balance.resting_torques()) {
            holding[*place] = torque;
        }
        return holding;
    }
    let Held::Direction { row, drift, force } = held(system, q, &pose, v) else { return holding };
    let mass = system.factor_mass(&pose, system.model.regularization);
    let (a, _) = mass.solve(&system.forces(q, &pose, v), &-system.phi_q_dot_times(&pose, v));
    let mobility = row.dot(&mass.solve(&force, &Vector::ZERO).0);
    let part = if mobility > 0.0 { -(row.dot(&a) + drift) / mobility } else { 0.0 };
    for (grasp, share) in shares(&system.sides.grips, &grasps) {
        holding[grasp.place] = part * share;
    }
    holding
}

/// q̈ and λ with the forces by which friction holds, from those without, in any coordinates; e is that of their saddle-point systems.
#[cold]
#[inline(never)]
pub(super) fn balanced_with_held<const N: usize, const M: usize>(
    system: &impl System<N, M>,
    [q, v]: [Vector<N>; 2],
    (a, lambda): (Vector<N>, Vector<M>),
    regularization: f64,
) -> (Vector<N>, Vector<M>) {
    let pose = system.pose(&q);
    let mass = system.factor_mass(&pose, regularization);
    match system.held(&q, &pose, &v) {
        Held::Nothing => (a, lambda),
        Held::Direction { row, drift, force } => {
            let (by_force, by_force_lambda) = mass.solve(&force, &Vector::ZERO);
            let mobility = row.dot(&by_force);
            let part = if mobility > 0.0 { -(row.dot(&a) + drift) / mobility } else { 0.0 };
            (a + part * by_force, lambda + part * by_force_lambda)
        }
        Held::All { force } => {
            let (_, lambda) = mass.solve(&(system.forces(&q, &pose, &v) + force), &Vector::ZERO);
            (Vector::ZERO, lambda)
        }
    }
}

impl ByAngles<'_> {
    /// What friction holds, in the angles.
    #[cold]
    #[inline(never)]
    pub(super) fn held_in_angles(&self, q: &Angles, pose: &Pose, v: &Angles) -> Held<{ super::angles::ANGLES }> {
        let (x, rates) = self.coordinates(pose, q, v);
        match held(self.five_bar(), &x, pose, &rates) {
            Held::Nothing => Held::Nothing,
            Held::Direction { row, drift, force } => Held::Direction {
                // A row is a force as well: what it misses is how the velocities of the coordinates turn with the links.
                row: self.carried_over(pose, &row),
                drift: drift + row.dot(&self.turning(pose, v)),
                force: self.carried_over(pose, &force),
            },
            Held::All { force } => Held::All { force: self.carried_over(pose, &force) },
        }
    }
}

/// q̇ without what friction holds, by the shortest way in the mass metric.
#[cold]
#[inline(never)]
pub(super) fn let_hold(system: &FiveBar<'_>, q: Coordinates, v: Coordinates) -> Coordinates {
    if system.sides.grips.at_rest() {
        return Coordinates::ZERO;
    }
    let pose = system.pose(&q);
    let Held::Direction { row, force, .. } = held(system, &q, &pose, &v) else { return v };
    let (by_force, _) = system.factor_mass(&pose, system.model.regularization).solve(&force, &Vector::ZERO);
    let mobility = row.dot(&by_force);
    if mobility > 0.0 { v - row.dot(&v) / mobility * by_force } else { v }
}

/// The grips as they are now, for those who watch for what they do next.
#[cold]
#[inline(never)]
pub(super) fn slides(system: &FiveBar<'_>, q: &Coordinates, pose: &Pose, v: &Coordinates) -> Slides {
    let grasps = system.grasps(q, pose, v);
    let watched = system.sides.grips.hold() && !system.sides.grips.at_rest();
    let holding = if watched { holding(system, q, v) } else { [0.0; GRIPS] };
    let slide = |grasp: &Grasp<COORDINATES>| Slide {
        place: grasp.place,
        rate: grasp.rate,
        load: [holding[grasp.place], grasp.bound],
        arms: grasp.arms,
    };
    grasps.iter().map(slide).collect()
}

/// How q̈ and λ change where joints are held, from how they would without: what holds sees to it that their accelerations stay 0. Refused
/// where all is held, or the tip.
pub(super) fn varied(
    system: &FiveBar<'_>,
    [q, v]: [&Coordinates; 2],
    (a, lambda): (Coordinates, Multipliers),
) -> Result<(Coordinates, Multipliers), SceneError> {
    let grips = system.sides.grips;
    if !grips.hold() {
        return Ok((a, lambda));
    }
    if grips.at_rest() || matches!(grips.at(GRIPS - 1), Grip::Holds(_)) {
        return Err(SceneError(
            "friction holds the tip or all that could move, and derivatives are told only where joints alone are held and something moves."
                .into(),
        ));
    }
    let pose = system.pose(q);
    let Held::Direction { row, force, .. } = held(system, q, &pose, v) else { return Ok((a, lambda)) };
    let (by_force, by_force_lambda) = system.factor_mass(&pose, system.model.regularization).solve(&force, &Vector::ZERO);
    let mobility = row.dot(&by_force);
    let part = if mobility > 0.0 { -row.dot(&a) / mobility } else { 0.0 };
    Ok((a + part * by_force, lambda + part * by_force_lambda))
}

/// Whether a run can have left a state with its grips as they are; where they have only just stopped, it still moves a little.
#[cold]
#[inline(never)]
pub(super) fn are_possible(system: &FiveBar<'_>, q: &Coordinates, v: &Coordinates, just_stopped: bool) -> bool {
    /// A grip does what it does up to some times what may be overlooked.
    const FAR: f64 = 100.0;
    let grips = &system.sides.grips;
    if grips.at_rest() {
        let all = balance(system, q, &Coordinates::ZERO, &|_| true);
        let slowest = if just_stopped { AT_REST * system.slow() } else { 0.0 };
        return v.max_norm() <= slowest && all.can_rest() && *grips == Grips::resting(all.places.into_iter());
    }
    let slides = slides(system, q, &system.pose(q), v);
    let far = FAR * system.slow();
    let there = |place: usize| slides.iter().any(|slide| slide.place == place);
    let held = |grasp: &Grasp<COORDINATES>| matches!(grips.at(grasp.place), Grip::Holds(_));
    balance(system, q, v, &held).is_one()
        && (0..GRIPS).all(|place| there(place) || grips.at(place) == Grip::Open)
        && slides.iter().all(|slide| match grips.at(slide.place) {
            Grip::Open => false,
            Grip::Slips(way) => way.sign() * slide.rate >= -far,
            Grip::Holds(_) => slide.rate.abs() <= far && slide.load[0].abs() <= (1.0 + 1e-3) * slide.load[1].abs() + 1e-9,
        })
}
