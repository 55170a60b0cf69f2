//! The five-bar in its four absolute link angles with the two closure equations of the tip: the coordinates of the error-controlled
//! methods.
//!
//! Per leg (σ = +1 left, −1 right), with l_P the arm from motor axis to elbow, a the arms to the centres of mass, b_D that from the
//! distal centre of mass to the tip, n̂ the direction turned by +90°:
//!
//! ```text
//! M = [ I_P + m_P a_P² + m_D l_P²   m_D l_P·a_D     ]      Φ   = Σ σ (ground + l_P + a_D + b_D)
//!     [ m_D l_P·a_D                 I_D + m_D a_D²  ]      Φ_q = σ [ n̂(l_P)   n̂(a_D + b_D) ]
//! ```
//!
//! Force laws see the motion of joints and tip, and their wrenches act on the links directly (`src/dynamics/`).

mod factor;
mod loads;
mod weight_acceleration;

use super::five_bar::FiveBar;
use super::inertia::Inertia;
use super::model::Model;
use crate::effects::Mode;
use crate::integrator::{AccelerationTangents, Kkt, Passage, State, StickingConstraint, System, Work};
use crate::mechanism::constraints::{directions, directions_corrected, directions_turned};
use crate::mechanism::coordinates::{D_THETA, D_X, D_Y, E_X, E_Y, G_X, G_Y, P_THETA, P_X, P_Y, TIP_X, TIP_Y, legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, SIGMA, are_small, both, sum};
use crate::mechanism::vertex::{self, Branch};
use crate::mechanism::{BRANCH_ARM, ClosureBranch, ClosureTerms, Coordinates, Mechanism, Multipliers, Pose};
use crate::vector::Vector;
use factor::{Factor, at_tip};
use weight_acceleration::TrigBase;
pub(super) use weight_acceleration::WeightAcceleration;

/// Number of link angles.
pub const ANGLES: usize = 4;
/// Number of closure equations.
pub const CLOSURES: usize = 2;
/// Link angles, or quantities per link, in the order proximal left and right, distal left and right.
pub type Angles = Vector<ANGLES>;

/// Index of the pair of proximal links in [`Angles`].
pub(super) const PROXIMAL: usize = 0;
/// Index of the pair of distal links in [`Angles`].
pub(super) const DISTAL: usize = 1;

/// Indices in [`Angles`] of links 1 to 4 (left proximal, left distal, right distal, right proximal).
pub const LINK_INDICES: [usize; 4] = [2 * PROXIMAL, 2 * DISTAL, 2 * DISTAL + 1, 2 * PROXIMAL + 1];

/// Link angles out of the twelve coordinates.
#[inline]
pub fn angles_of(x: &Coordinates) -> Angles {
    angles([legs_of(x, P_THETA), legs_of(x, D_THETA)])
}

/// Pairs of the proximal and of the distal links.
#[inline(always)]
pub(super) fn legs(x: &Angles) -> [Legs; 2] {
    [legs_of(x, PROXIMAL), legs_of(x, DISTAL)]
}

/// Angles or what belongs to them from those of the proximal and of the distal links.
#[inline]
pub(super) fn angles([p, d]: [Legs; 2]) -> Angles {
    let mut angles = Angles::ZERO;
    set_legs(&mut angles, PROXIMAL, p);
    set_legs(&mut angles, DISTAL, d);
    angles
}

/// A five-bar seen in its link angles.
#[derive(Clone, Copy, Debug)]
pub struct AngleSystem<'a> {
    five_bar: FiveBar<'a>,
    mechanism: &'a Mechanism,
    inertia: &'a Inertia,
    /// Whether the weight is the only load, so that the twelve coordinates are not needed.
    only_weight: bool,
    /// Whether the weight is the only load and the closure is that of the tip, not of a branch.
    uses_weight_acceleration: bool,
    /// Closure branch on which the motion stays, where there are several.
    closure_branch: Option<ClosureBranch>,
    /// Signed link lengths in Φ_q, m; 0 on a closure branch.
    sigma_length: [Legs; 2],
    /// Constant part of Φ_q on a closure branch, m; 0 otherwise.
    constant: &'a [Legs2; 2],
}

impl<'a> AngleSystem<'a> {
    /// Five-bar in its link angles, of a model under given inputs.
    #[inline]
    pub fn new(five_bar: FiveBar<'a>) -> Self {
        let FiveBar { model, inputs, mode, .. } = five_bar;
        let only_weight = model.effects.is_empty() && !inputs.load();
        let mechanism = &model.mechanism;
        let inertia = &model.inertia;
        let free = Self {
            five_bar,
            mechanism,
            inertia,
            only_weight,
            uses_weight_acceleration: only_weight,
            closure_branch: None,
            sigma_length: [Legs::ZERO; 2],
            constant: &ClosureTerms::OPEN.constant,
        };
        free.in_mode(mode)
    }

    /// System in a given mode, on the mode's closure branch.
    #[inline]
    pub(super) fn in_mode(self, mode: Mode) -> Self {
        let ClosureTerms { open, constant } = mode.closure_branch.map_or(ClosureTerms::OPEN, ClosureBranch::terms);
        let Mechanism { a_p, b_p, a_d, sigma_b_d, .. } = *self.mechanism;
        let sigma_length = [*open * (SIGMA * (a_p + b_p)), *open * (SIGMA * a_d + sigma_b_d)];
        Self {
            five_bar: self.five_bar.on(mode),
            uses_weight_acceleration: self.only_weight && mode.closure_branch.is_none(),
            closure_branch: mode.closure_branch,
            sigma_length,
            constant,
            ..self
        }
    }

    /// System in its twelve coordinates.
    pub(super) fn five_bar(&self) -> &FiveBar<'a> {
        &self.five_bar
    }

    /// Model of the system.
    pub(super) fn model(&self) -> &'a Model {
        self.five_bar.model
    }

    /// e of the saddle-point systems in the link angles, 1/kg.
    pub(super) fn regularization_by_angles(&self) -> f64 {
        self.five_bar.model.regularization_by_angles
    }

    /// Φ_q of the closure, or of the closure branch on which the motion stays.
    #[inline(always)]
    pub(super) fn phi_q(&self, pose: &Pose) -> [Legs2; 2] {
        let ([p, d], [on_p, on_d]) = (self.links(pose), self.constant);
        [Legs2 { x: on_p.x - p.y, y: on_p.y + p.x }, Legs2 { x: on_d.x - d.y, y: on_d.y + d.x }]
    }

    /// Vectors along the links with the signs of the legs in the closure, m; 0 on a closure branch.
    #[inline(always)]
    fn links(&self, pose: &Pose) -> [Legs2; 2] {
        let [p, d] = self.sigma_length;
        [pose.u_p.scaled(p), pose.u_d.scaled(d)]
    }

    /// Deviation of angles from a closure branch, m.
    #[cold]
    #[inline(never)]
    fn off_branch(&self, closure_branch: ClosureBranch, q: Angles) -> Vector<CLOSURES> {
        closure_branch.apart([legs_of(&q, PROXIMAL), legs_of(&q, DISTAL)]).map(|angle| BRANCH_ARM * angle).into()
    }

    /// Whether the motion stays on a closure branch, whose derivatives are constant.
    pub(super) fn is_on_branch(&self) -> bool {
        self.closure_branch.is_some()
    }

    /// Displacement from the nearest vertex, rad, if one is near. None with coaxial motors, where all links in line are no isolated
    /// configuration: they turn together.
    #[inline]
    pub(super) fn offset(&self, q: &Angles) -> Option<Angles> {
        if self.mechanism.geometry.base_distance == 0.0 {
            return None;
        }
        let [proximal, distal] = vertex::offset([legs_of(q, PROXIMAL), legs_of(q, DISTAL)])?;
        let mut offset = Angles::ZERO;
        set_legs(&mut offset, PROXIMAL, proximal);
        set_legs(&mut offset, DISTAL, distal);
        Some(offset)
    }

    /// Closure branch along which the forces start the motion from rest in a vertex (Gauss's principle of least constraint).
    pub(super) fn branch_of_least_constraint(&self, q: &Angles) -> Option<Branch<Angles>> {
        let pose = self.pose(q);
        let in_order = |x: &Angles| LINK_INDICES.map(|i| x[i]);
        let force = in_order(&self.forces(q, &pose, &Angles::ZERO));
        let mass = LINK_INDICES.map(|i| in_order(&self.mass_times(&pose, &Angles::unit(i))));
        let branch = vertex::least_constraint(&self.mechanism.geometry, in_order(q), force, mass)?;
        let mut direction = Angles::ZERO;
        for (i, value) in LINK_INDICES.into_iter().zip(branch.direction) {
            direction[i] = value;
        }
        Some(Branch { direction, alternatives: branch.alternatives })
    }

    /// q̈ and λ of the twelve coordinates and the power, W, without sticking contacts: link by link from the angles and the force at the
    /// tip.
    pub(super) fn balance(
        &self,
        [q, v]: [&Angles; 2],
        pose: &Pose,
        [x, rates]: [&Coordinates; 2],
    ) -> (Coordinates, Multipliers, Work) {
        let (applied, power) = self.five_bar.forces_and_power(x, pose, rates);
        let mass = self.factor_mass(pose, self.regularization_by_angles());
        let torques = self.with_centripetal(pose.torques_of(&applied), pose, v);
        let (a, tip) = mass.solve(&torques, &-self.phi_q_dot_times(pose, v));
        let accelerations = pose.velocities(legs(&a)) + pose.centripetal(legs(v));
        // Force on a link less its mass times acceleration: the joints supply the difference.
        let left = applied - self.mechanism.mass_times(&accelerations);
        let mut lambda = Multipliers::ZERO;
        (lambda[TIP_X], lambda[TIP_Y]) = (tip[0], tip[1]);
        for (tip, [ground, elbow], [on_p, on_d]) in [(tip[0], [G_X, E_X], [P_X, D_X]), (tip[1], [G_Y, E_Y], [P_Y, D_Y])] {
            let from_elbow = legs_of(&left, on_d) - SIGMA * both(tip);
            set_legs(&mut lambda, elbow, from_elbow);
            set_legs(&mut lambda, ground, legs_of(&left, on_p) + from_elbow);
        }
        let from_rest = self.acceleration_from_rest(q, v).map(|a| pose.velocities(legs(&a)));
        (from_rest.unwrap_or(accelerations), lambda, power)
    }
}

impl System<ANGLES, CLOSURES> for AngleSystem<'_> {
    type Pose = Pose;
    type TrigBase = TrigBase;
    type Mass = Factor;

    fn pose(&self, q: &Angles) -> Pose {
        self.mechanism.pose_at(legs(q))
    }

    #[inline(always)]
    fn pose_in_place(&self, q: &Angles) -> Pose {
        self.mechanism.pose_along(directions(legs(q)))
    }

    #[inline(always)]
    fn updated_pose(&self, (q, pose): (&Angles, &Pose), by: &Angles) -> Pose {
        self.mechanism.pose_along(directions_corrected((legs(q), [pose.u_p, pose.u_d]), legs(by)))
    }

    #[inline]
    fn trig_base(&self, pose: &Pose) -> TrigBase {
        self.model().weight_acceleration.trig_base([pose.u_p, pose.u_d])
    }

    #[inline(always)]
    fn pose_from_base(&self, (q, trig_base): (&Angles, &TrigBase), by: &Angles) -> Pose {
        self.mechanism.pose_along(directions_turned((legs(q), trig_base.directions), legs(by)))
    }

    #[inline]
    fn phi(&self, q: &Angles, pose: &Pose) -> Vector<CLOSURES> {
        if let Some(closure_branch) = self.closure_branch {
            return self.off_branch(closure_branch, *q);
        }
        let [p, d] = self.links(pose);
        [sum(SIGMA * self.mechanism.ground_x + p.x + d.x), sum(p.y + d.y)].into()
    }

    #[inline]
    fn phi_q_times(&self, pose: &Pose, v: &Angles) -> Vector<CLOSURES> {
        at_tip(&self.phi_q(pose), v)
    }

    #[inline]
    fn phi_q_dot_times(&self, pose: &Pose, v: &Angles) -> Vector<CLOSURES> {
        // Derivative of n̂: centripetal acceleration −l ω².
        let (w_p, w_d) = (legs_of(v, PROXIMAL), legs_of(v, DISTAL));
        let mut squares = Angles::ZERO;
        set_legs(&mut squares, PROXIMAL, w_p * w_p);
        set_legs(&mut squares, DISTAL, w_d * w_d);
        -at_tip(&self.links(pose), &squares)
    }

    #[inline]
    fn mass_times(&self, pose: &Pose, x: &Angles) -> Angles {
        self.inertia.mass(pose).times(x)
    }

    #[inline]
    fn forces(&self, q: &Angles, pose: &Pose, v: &Angles) -> Angles {
        self.loaded_torques_and_power(*q, [pose.u_p, pose.u_d], *v).0
    }

    #[inline(always)]
    fn acceleration_under_gravity(&self, trig_base: &TrigBase, by: &Angles, v: &Angles) -> Option<Angles> {
        (self.uses_weight_acceleration && are_small(legs(by)))
            .then(|| self.model().weight_acceleration.acceleration(trig_base, legs(by), legs(v)))
    }

    #[inline(always)]
    fn forces_and_power(&self, q: &Angles, pose: &Pose, v: &Angles) -> (Angles, Work) {
        if self.only_weight {
            return (self.with_centripetal(self.weight([pose.u_p, pose.u_d]), pose, v), Work::default());
        }
        self.loaded_torques_and_power(*q, [pose.u_p, pose.u_d], *v)
    }

    #[inline]
    fn factor_mass(&self, pose: &Pose, regularization: f64) -> Factor {
        Factor::new(self.inertia, pose, self.phi_q(pose), regularization)
    }

    #[inline]
    fn has_stiff_forces(&self) -> bool {
        self.five_bar.has_stiff_forces()
    }

    #[inline]
    fn configuration_signs(&self, pose: &Pose) -> u8 {
        self.five_bar.configuration_signs(pose)
    }

    #[inline]
    fn has_sticking(&self) -> bool {
        self.five_bar.has_sticking()
    }

    fn sticking_constraint(&self, q: &Angles, pose: &Pose, v: &Angles) -> StickingConstraint<ANGLES> {
        self.friction_reaction_in_angles(q, pose, v)
    }

    fn with_friction_reaction(&self, q: Angles, v: Angles, free: (Angles, Vector<CLOSURES>)) -> (Angles, Vector<CLOSURES>) {
        super::stick_slip::with_friction_reaction(self, [q, v], free, self.regularization_by_angles())
    }

    fn project_sticking(&self, q: Angles, v: Angles) -> Angles {
        let (x, rates) = self.coordinates(&self.pose(&q), &q, &v);
        angles_of(&super::stick_slip::project_sticking(&self.five_bar, x, rates))
    }

    fn acceleration_tangents(
        &self,
        at: &State<ANGLES, CLOSURES>,
        pose: &Pose,
        regularization: f64,
    ) -> Option<AccelerationTangents<ANGLES>> {
        Some(self.tangents_of_acceleration(at, pose, regularization))
    }

    #[inline]
    fn follows_work(&self) -> bool {
        self.five_bar.follows_work()
    }

    #[inline]
    fn power(&self, q: &Angles, pose: &Pose, v: &Angles) -> Work {
        self.five_bar.acting(&self.motion(pose, q, v)).1
    }

    #[inline]
    fn error_norm(&self, x: &Angles) -> f64 {
        x.max_norm()
    }

    #[inline]
    fn length_scale(&self) -> f64 {
        self.five_bar.length_scale()
    }
}
