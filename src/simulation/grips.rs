//! What dry friction that sticks does in a state, in any coordinates: which grips hold, and by what force.

use arrayvec::ArrayVec;

use crate::effects::grips::{Balance, GRIPS, Grasp, Grasps, Grip, Grips, Way};
use crate::effects::{Slide, Slides, slow};
use crate::integrator::{Held, Kkt, System};
use crate::vector::Vector;

/// A five-bar in some coordinates, as its grips see it.
pub(super) trait Gripping<const N: usize, const M: usize>: System<N, M> + Sized {
    /// The grips that there are.
    fn grasps(&self, q: &Vector<N>, pose: &Self::Pose, v: &Vector<N>) -> Grasps<N>;
    /// What they do.
    fn grips(&self) -> &Grips;
    /// The same system where they do something else.
    fn with_grips(&self, grips: Grips) -> Self;
    /// e of its saddle-point systems, 1/kg.
    fn regularization(&self) -> f64;
    /// The error tolerance, rad.
    fn tolerance(&self) -> f64;
}

/// Up to so many times the rate at which a grip rests a mechanism that friction can hold is at rest: what it still moves is below all
/// tolerances.
const AT_REST: f64 = 1e3;

/// What the grips do in a state, by itself.
#[cold]
pub(super) fn resolved<const N: usize, const M: usize>(system: &impl Gripping<N, M>, q: &Vector<N>, v: &Vector<N>) -> Grips {
    let pose = system.pose(q);
    let grasps = system.grasps(q, &pose, v);
    let slow = slow(system.tolerance());
    if v.max_norm() <= AT_REST * slow {
        let at_rest = balance(system, q, &Vector::ZERO, |_| true);
        if at_rest.can_rest() {
            return Grips::resting(at_rest.places.into_iter());
        }
    }
    let mut grips = moving(&grasps);
    if grasps.iter().any(|grasp| grasp.rate.abs() <= slow) {
        balance(system, q, v, |grasp| grasp.rate.abs() <= slow).moving(&mut grips);
    }
    grips
}

/// All slip.
fn moving<const N: usize>(grasps: &Grasps<N>) -> Grips {
    let mut grips = Grips::OPEN;
    for grasp in grasps {
        grips.set(grasp.place, Grip::Slips(Way::of(grasp.rate)));
    }
    grips
}

/// What some grips, which can hold something, have to hold while the others slip.
fn balance<const N: usize, const M: usize>(
    system: &impl Gripping<N, M>,
    q: &Vector<N>,
    v: &Vector<N>,
    rests: impl Fn(&Grasp<N>) -> bool,
) -> Balance {
    let pose = system.pose(q);
    let grasps = system.grasps(q, &pose, v);
    let resting: ArrayVec<Grasp<N>, GRIPS> = grasps.iter().filter(|grasp| grasp.bound > 0.0 && rests(grasp)).copied().collect();
    let mut grips = moving(&grasps);
    for grasp in &resting {
        grips.set(grasp.place, Grip::Holds(Way::Forward));
    }
    let mass = system.factor_mass(&pose, system.regularization());
    let forces = system.with_grips(grips).forces(q, &pose, v);
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
pub(super) fn held<const N: usize, const M: usize, S: Gripping<N, M>>(
    system: &S,
    q: &Vector<N>,
    pose: &S::Pose,
    v: &Vector<N>,
) -> Held<N> {
    let grasps = system.grasps(q, pose, v);
    if system.grips().at_rest() {
        let torques = balance(system, q, v, |_| true).resting_torques();
        let able = grasps.iter().filter(|grasp| grasp.bound > 0.0);
        let force = able.zip(torques).fold(Vector::ZERO, |force, (grasp, torque)| force + torque * grasp.row);
        return Held::All { force };
    }
    let Some(first) = first(system.grips(), &grasps) else { return Held::Nothing };
    let force = shares(system.grips(), &grasps).fold(Vector::ZERO, |force, (grasp, share)| force + share * grasp.row);
    Held::Direction { row: first.row, drift: first.drift, force }
}

/// The first grip that holds.
fn first<'a, const N: usize>(grips: &Grips, grasps: &'a Grasps<N>) -> Option<&'a Grasp<N>> {
    grasps.iter().find(|grasp| matches!(grips.at(grasp.place), Grip::Holds(_)))
}

/// The grips that hold one motion, with what each does per torque of the first: all of them use the same part of their bounds.
fn shares<'a, const N: usize>(grips: &'a Grips, grasps: &'a Grasps<N>) -> impl Iterator<Item = (&'a Grasp<N>, f64)> {
    let first = first(grips, grasps);
    grasps.iter().filter_map(move |grasp| {
        let Grip::Holds(way) = grips.at(grasp.place) else { return None };
        let leader = first?;
        let share = if grasp.place == leader.place { 1.0 } else { way.sign() * grasp.bound / leader.bound };
        Some((grasp, share))
    })
}

/// By what torques the grips hold, N·m, and the tip's by what force, N, with these accelerations.
pub(super) fn holding<const N: usize, const M: usize>(system: &impl Gripping<N, M>, q: &Vector<N>, v: &Vector<N>) -> [f64; GRIPS] {
    let pose = system.pose(q);
    let grasps = system.grasps(q, &pose, v);
    let mut holding = [0.0; GRIPS];
    if system.grips().at_rest() {
        let balance = balance(system, q, v, |_| true);
        for (place, torque) in balance.places.iter().zip(balance.resting_torques()) {
            holding[*place] = torque;
        }
        return holding;
    }
    let Held::Direction { row, drift, force } = held(system, q, &pose, v) else { return holding };
    let mass = system.factor_mass(&pose, system.regularization());
    let (a, _) = mass.solve(&system.forces(q, &pose, v), &-system.phi_q_dot_times(&pose, v));
    let mobility = row.dot(&mass.solve(&force, &Vector::ZERO).0);
    let part = if mobility > 0.0 { -(row.dot(&a) + drift) / mobility } else { 0.0 };
    for (grasp, share) in shares(system.grips(), &grasps) {
        holding[grasp.place] = part * share;
    }
    holding
}

/// q̈ and λ with the forces by which friction holds, from those without.
#[cold]
#[inline(never)]
pub(super) fn balanced_with_held<const N: usize, const M: usize>(
    system: &impl Gripping<N, M>,
    q: Vector<N>,
    v: Vector<N>,
    (a, lambda): (Vector<N>, Vector<M>),
) -> (Vector<N>, Vector<M>) {
    let pose = system.pose(&q);
    let mass = system.factor_mass(&pose, system.regularization());
    match held(system, &q, &pose, &v) {
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

/// q̇ without what friction holds, by the shortest way in the mass metric.
#[cold]
#[inline(never)]
pub(super) fn let_hold<const N: usize, const M: usize>(system: &impl Gripping<N, M>, q: Vector<N>, v: Vector<N>) -> Vector<N> {
    if system.grips().at_rest() {
        return Vector::ZERO;
    }
    let pose = system.pose(&q);
    let Held::Direction { row, force, .. } = held(system, &q, &pose, &v) else { return v };
    let (by_force, _) = system.factor_mass(&pose, system.regularization()).solve(&force, &Vector::ZERO);
    let mobility = row.dot(&by_force);
    if mobility > 0.0 { v - row.dot(&v) / mobility * by_force } else { v }
}

/// The grips as they are now, for those who watch for what they do next.
pub(super) fn slides<const N: usize, const M: usize>(system: &impl Gripping<N, M>, q: &Vector<N>, v: &Vector<N>) -> Slides {
    let grasps = system.grasps(q, &system.pose(q), v);
    let watched = system.grips().hold() && !system.grips().at_rest();
    let holding = if watched { holding(system, q, v) } else { [0.0; GRIPS] };
    let slide = |grasp: &Grasp<N>| Slide {
        place: grasp.place,
        rate: grasp.rate,
        load: [holding[grasp.place], grasp.bound],
        arms: grasp.arms,
    };
    grasps.iter().map(slide).collect()
}

/// Whether a run can have left a state with its grips as they are; where they have only just stopped, it still moves a little.
#[cold]
pub(super) fn are_possible<const N: usize, const M: usize>(
    system: &impl Gripping<N, M>,
    q: &Vector<N>,
    v: &Vector<N>,
    just_stopped: bool,
) -> bool {
    /// A grip does what it does up to some times what may be overlooked.
    const FAR: f64 = 100.0;
    let grips = system.grips();
    if grips.at_rest() {
        let all = balance(system, q, &Vector::ZERO, |_| true);
        let slowest = if just_stopped { AT_REST * slow(system.tolerance()) } else { 0.0 };
        return v.max_norm() <= slowest && all.can_rest() && *grips == Grips::resting(all.places.into_iter());
    }
    let slides = slides(system, q, v);
    let far = FAR * slow(system.tolerance());
    let there = |place: usize| slides.iter().any(|slide| slide.place == place);
    let held = |grasp: &Grasp<N>| matches!(grips.at(grasp.place), Grip::Holds(_));
    balance(system, q, v, held).is_one()
        && (0..GRIPS).all(|place| there(place) || grips.at(place) == Grip::Open)
        && slides.iter().all(|slide| match grips.at(slide.place) {
            Grip::Open => false,
            Grip::Slips(way) => way.sign() * slide.rate >= -far,
            Grip::Holds(_) => slide.rate.abs() <= far && slide.load[0].abs() <= (1.0 + 1e-3) * slide.load[1].abs() + 1e-9,
        })
}
