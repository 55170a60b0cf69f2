//! The five-bar in its four absolute link angles, the coordinates of the error-controlled methods: `src/dynamics/angles.rs` with the loads
//! of a model.

use super::Inputs;
use super::five_bar::FiveBar;
use super::model::Model;
pub use crate::dynamics::angles::{ANGLES, Angles, CLOSURES, LINK_INDICES, angles_of};
use crate::dynamics::angles::{AtTip, Closure, Equations, Factor, Inertia, in_link_order};
pub(super) use crate::dynamics::angles::{angles, legs};
use crate::effects::Motion;
use crate::hybrid::{Frictional, Mode};
use crate::integrator::{
    AccelerationTangents, CONFIGURATION_SIGNS, Features, Kkt, Passage, State, StickingConstraint, Stuck, System, Work,
};
use crate::mechanism::constraints::directions_turned;
use crate::mechanism::legs::{Legs2, sum};
use crate::mechanism::placement::{by_legs, by_links, joint_forces};
use crate::mechanism::vertex;
use crate::mechanism::{BRANCH_ARM, ClosureBranch, Coordinates, Mechanism, Multipliers, Pose};

/// A five-bar in its link angles.
#[derive(Clone, Copy, Debug)]
pub struct AngleSystem<'a> {
    five_bar: FiveBar<'a>,
    /// Whether the weight is the only load, so that no force law is evaluated.
    only_weight: bool,
    closure: Closure,
}

impl<'a> AngleSystem<'a> {
    /// Five-bar of a model in its link angles, with constant `inputs`; `turns` are the whole turns of the links that the angles omit.
    pub(super) fn of(model: &'a Model, inputs: &'a Inputs, turns: &'a [i64; 4]) -> Self {
        Self::new(FiveBar::new(model, inputs, turns))
    }

    /// A five-bar, with its model and inputs, in its link angles.
    pub fn new(five_bar: FiveBar<'a>) -> Self {
        let FiveBar { model, inputs, mode, .. } = five_bar;
        let closure = Closure::new(&model.mechanism, mode.closure_branch);
        Self { five_bar, only_weight: model.effects.is_empty() && !inputs.load(), closure }
    }

    /// System in this mode, on the mode's closure branch.
    pub(super) fn in_mode(self, mode: Mode) -> Self {
        Self::new(self.five_bar.on(mode))
    }

    /// The same system in its twelve coordinates.
    pub(super) fn five_bar(&self) -> &FiveBar<'a> {
        &self.five_bar
    }

    pub(super) fn model(&self) -> &'a Model {
        self.five_bar.model
    }

    fn mechanism(&self) -> &'a Mechanism {
        &self.model().mechanism
    }

    /// Constant part of the mass matrix.
    fn inertia(&self) -> &'a Inertia {
        &self.model().inertia
    }

    /// Residual of the linear equations of a closure branch, m.
    #[cold]
    #[inline(never)]
    fn off_branch(&self, closure_branch: ClosureBranch, q: Angles) -> AtTip {
        closure_branch.apart(legs(&q)).map(|angle| BRANCH_ARM * angle).into()
    }

    /// Factor of the mass matrix on a closure branch of mirrored pairs; never inlined, so that other motions keep their registers.
    #[cold]
    #[inline(never)]
    fn mirrored_mass(&self, pose: &Pose, regularization: f64) -> Factor {
        Factor::new::<true>(self.inertia(), &self.closure, pose, regularization)
    }

    /// Φ̇_q ω on a closure branch of mirrored pairs; never inlined, so that other motions keep their registers.
    #[cold]
    #[inline(never)]
    fn mirrored_drift(&self, pose: &Pose, v: &Angles) -> AtTip {
        self.closure.phi_q_dot_times::<true>(pose, v)
    }

    /// Displacement from the nearest vertex, rad, if one is near. `None` with coaxial motors: there, postures with all links in line are
    /// not isolated.
    pub(super) fn offset(&self, q: &Angles) -> Option<Angles> {
        if self.mechanism().geometry.base_distance == 0.0 {
            return None;
        }
        vertex::offset(legs(q)).map(angles)
    }

    /// Direction in which the forces start a motion from rest in a vertex (Gauss's principle of least constraint), and the number of other
    /// possible branches.
    pub(super) fn branch_of_least_constraint(&self, q: &Angles) -> Option<(Angles, u32)> {
        let pose = self.pose(q);
        let force = in_link_order(&self.forces(q, &pose, &Angles::ZERO).0);
        let mass = LINK_INDICES.map(|i| in_link_order(&self.mass_times(&pose, &Angles::unit(i))));
        let branch = vertex::least_constraint(&self.mechanism().geometry, in_link_order(q), force, mass)?;
        Some((angles(by_legs(branch.direction)), branch.alternatives))
    }

    /// q̈ and λ of the twelve coordinates and the power, W, if no contact sticks; computed link by link from the angles and the force at
    /// the tip.
    pub(super) fn balance(
        &self,
        [q, v]: [&Angles; 2],
        pose: &Pose,
        [x, rates]: [&Coordinates; 2],
    ) -> (Coordinates, Multipliers, Work) {
        let (applied, power) = self.five_bar.forces(x, pose, rates);
        let mass = self.factor_mass(pose, self.regularization());
        let torques = self.inertia().with_centripetal(pose.torques_of(&applied), pose, v);
        let (a, tip) = mass.solve(&torques, &-self.phi_q_dot_times(pose, v));
        let accelerations = pose.velocities(legs(&a)) + pose.centripetal(legs(v));
        // Applied force on a link minus its mass times acceleration: the joints supply the difference.
        let left = applied - self.mechanism().mass_times(&accelerations);
        let from_rest = self.acceleration_from_rest(q, v).map(|a| pose.velocities(legs(&a)));
        (from_rest.unwrap_or(accelerations), joint_forces(&left, *tip), power)
    }

    /// Kinetic energy, J; potential energy including the constant loads, J; power of the forces without potential, W.
    pub(super) fn energies(&self, q: &Angles, v: &Angles) -> [f64; 3] {
        let pose = self.pose(q);
        let kinetic = self.mass_times(&pose, v).dot(v) / 2.0;
        let x = self.mechanism().coordinates(&pose, legs(q));
        [kinetic, self.five_bar.potential_energy(&x, &pose), self.five_bar.power_without_potential(&self.motion(&pose, q, v))]
    }

    /// Forces in the angles, and their power, if other loads than the weight act. Not inlined, and arguments are passed by value, so that
    /// motions under the weight alone stay in registers.
    #[inline(never)]
    fn loaded_torques_and_power(&self, q: Angles, directions: [Legs2; 2], v: Angles) -> (Angles, Work) {
        let pose = self.mechanism().pose_along(directions);
        let (torques, power) = self.five_bar.torques_and_power(&pose, &self.motion(&pose, &q, &v));
        let forces = self.inertia().with_centripetal(torques, &pose, &v);
        (forces, if self.features().work { power } else { Work::default() })
    }

    /// Potential energy of all forces except the inputs, J. Not inlined for the same reason as [`Self::loaded_torques_and_power`].
    #[inline(never)]
    fn potential_with_effects(&self, q: Angles, directions: [Legs2; 2]) -> f64 {
        let pose = self.mechanism().pose_along(directions);
        let x = self.mechanism().coordinates(&pose, legs(&q));
        self.model().potential(&x, &self.motion(&pose, &q, &Angles::ZERO))
    }

    /// Motion of joints and tip.
    pub(super) fn motion(&self, pose: &Pose, q: &Angles, v: &Angles) -> Motion<'_> {
        self.five_bar.conditions().motion_of_links(self.mechanism(), [legs(q), legs(v)], pose)
    }

    /// The twelve coordinates and their velocities.
    pub fn coordinates(&self, pose: &Pose, q: &Angles, v: &Angles) -> (Coordinates, Coordinates) {
        (self.mechanism().coordinates(pose, legs(q)), pose.velocities(legs(v)))
    }
}

impl System<ANGLES, CLOSURES> for AngleSystem<'_> {
    type Pose = Pose;
    type Mass = Factor;

    fn pose(&self, q: &Angles) -> Pose {
        self.mechanism().pose_at(legs(q))
    }

    #[inline(always)]
    fn pose_near(&self, q: &Angles, pose: &Pose, by: &Angles) -> Pose {
        self.mechanism().pose_along(directions_turned(legs(q), [pose.u_p, pose.u_d], legs(by)))
    }

    fn phi(&self, q: &Angles, pose: &Pose) -> AtTip {
        let gap = match self.closure.is_mirrored() {
            true => self.closure.gap::<true>(self.mechanism(), pose),
            false => self.closure.gap::<false>(self.mechanism(), pose),
        };
        match self.five_bar.mode.closure_branch {
            None => gap,
            Some(closure_branch) => gap + self.off_branch(closure_branch, *q),
        }
    }

    fn phi_q_times(&self, pose: &Pose, v: &Angles) -> AtTip {
        match self.closure.is_mirrored() {
            true => self.closure.phi_q_times::<true>(pose, v),
            false => self.closure.phi_q_times::<false>(pose, v),
        }
    }

    #[inline]
    fn phi_q_dot_times(&self, pose: &Pose, v: &Angles) -> AtTip {
        if self.closure.is_mirrored() {
            return self.mirrored_drift(pose, v);
        }
        self.closure.phi_q_dot_times::<false>(pose, v)
    }

    fn energy(&self, q: &Angles, pose: &Pose, v: &Angles) -> f64 {
        let kinetic = self.inertia().kinetic_energy(pose, v);
        match self.model().effects.is_empty() {
            true => sum(kinetic - self.model().weight_torques.work(pose)),
            false => sum(kinetic) + self.potential_with_effects(*q, [pose.u_p, pose.u_d]),
        }
    }

    fn mass_times(&self, pose: &Pose, x: &Angles) -> Angles {
        self.inertia().mass_times(pose, x)
    }

    #[inline(always)]
    fn forces(&self, q: &Angles, pose: &Pose, v: &Angles) -> (Angles, Work) {
        if self.only_weight {
            let torques = self.model().weight_torques.torques(pose);
            return (self.inertia().with_centripetal(torques, pose, v), Work::default());
        }
        self.loaded_torques_and_power(*q, [pose.u_p, pose.u_d], *v)
    }

    #[inline]
    fn factor_mass(&self, pose: &Pose, regularization: f64) -> Factor {
        if self.closure.is_mirrored() {
            return self.mirrored_mass(pose, regularization);
        }
        Factor::new::<false>(self.inertia(), &self.closure, pose, regularization)
    }

    fn features(&self) -> Features {
        Features { special_constraints: self.closure.is_mirrored(), ..self.five_bar.features() }
    }

    fn configuration_signs(&self, pose: &Pose) -> u8 {
        self.five_bar.configuration_signs(pose)
    }

    fn determinants(&self, pose: &Pose) -> [f64; CONFIGURATION_SIGNS] {
        pose.sines()
    }

    fn stuck(&self) -> Stuck {
        self.five_bar.stuck()
    }

    fn sticking_constraint(&self, q: &Angles, pose: &Pose, v: &Angles) -> StickingConstraint<ANGLES> {
        self.sticking(q, pose, v)
    }

    fn acceleration_tangents(
        &self,
        at: &State<ANGLES, CLOSURES>,
        pose: &Pose,
        regularization: f64,
    ) -> Option<AccelerationTangents<ANGLES>> {
        let State { q, v, a, lambda, .. } = at;
        let (inertia, closure) = (self.inertia(), &self.closure);
        let slopes = self.five_bar.slopes_of_torques(pose, self.motion(pose, q, v), by_links(legs(v)));
        let [by_q, by_v] = match closure.is_mirrored() {
            true => Equations::<true>::new(inertia, closure, pose, v, regularization).linearised(a, lambda, slopes).columns(),
            false => Equations::<false>::new(inertia, closure, pose, v, regularization).linearised(a, lambda, slopes).columns(),
        };
        Some(AccelerationTangents { by_q, by_v })
    }

    fn error_norm(&self, x: &Angles) -> f64 {
        x.max_norm()
    }

    fn length_scale(&self) -> f64 {
        self.five_bar.length_scale()
    }
}
