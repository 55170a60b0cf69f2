//! The energy-conserving step with its loop cut at the tip: its equations in the rotations of the links.
//!
//! Each of the two open legs runs from ground to elbow to tip. The legs satisfy the constraints at the ground and at the elbows for any
//! increments Δθ and rates of the link angles, and the position rows of (37) in `docs/conserving.md` give the forces of these joints. Of
//! the ten multipliers only Λ and ν of the tip remain; of (37) the angle rows and the tip's closure remain. Let ℓ = a + b be the length of
//! the proximal and L of the distal link, with the moments of inertia
//!
//! ```text
//! A = m_P a² + m_D ℓ²,   B = m_D ℓ a_D,   D = m_D a_D²        moment(p, d) = (A p + B d, B p + D d)
//! ```
//!
//! Let ω̂ = ½h ω₁ with the rates ω₁ at the step's end. Displacements u_P and u_D of the centres of mass have the first moments
//! m_P a u_P + m_D ℓ u_D and m_D a_D u_D. With these, the equations are
//!
//! ```text
//! k = moment(s Δθ n̂_m) − k₀,     k₀ of ½h q̇₀          first moment of d − ½h q̇₀
//! w = moment(ω̂ n̂₁)                                     first moment of ½h q̇₁
//! y = k − w − σ(ℓ, L) ν                                 velocity defect with ν
//! g = ½h² Q̄ + k₀ − w − σ(ℓ, L) Λ                        joint load with Λ
//!
//! ν:  I ω̂ + c n̂_m·w + c n̂_m·σ(ℓ, L) ν = I (Δθ − ½h ω₀) + c n̂_m·k,     Σ σ (ℓ n̂₁ ω̂)_P + σ (L n̂₁ ω̂)_D = 0
//! f:  I (ω̂ − ½h ω₀) − s n̂_m·g + ½ s (ω̂ + ½h ω₀) û_m·y − ½h² Q̄_θ = 0
//! ```
//!
//! The equations (ν) are linear in ω̂ and ν. Newton's method for Δθ and Λ in (f) uses a matrix of the same form, with s instead of c and
//! with the geometric stiffness of the joint forces: 2×2 in each leg, bordered by 2×2 of the tip ([`BorderedMatrix`]).

mod bordered;
mod open_legs;
mod whole;

use crate::dynamics::{StepLevers, TipArm};
use crate::effects::Slopes;
use crate::integrator::{CutStep, Discrete, StepIncrement};
use crate::mechanism::coordinates::{TIP_X, TIP_Y, add_legs, angles_by_leg, centres, legs_of, set_angles, set_legs};
use crate::mechanism::legs::{Legs, Legs2, SIGMA, both, largest, sum};
use crate::mechanism::secant::Secant;
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Multipliers, Pose};
use crate::vector::Vector;
pub use bordered::BorderedMatrix;
use bordered::tip_separation;
use open_legs::Moments;
pub use open_legs::OpenLegs;

/// Number of unknowns of the cut loop.
pub const CUT_UNKNOWNS: usize = 8;
/// Unknowns of the cut loop: Δθ of the proximal and of the distal links, rad, then Λ and ν of the tip.
pub type CutUnknowns = Vector<CUT_UNKNOWNS>;
/// Pair index in [`CutUnknowns`]: Δθ of the proximal links.
const PROXIMAL: usize = 0;
/// Pair index in [`CutUnknowns`]: Δθ of the distal links.
const DISTAL: usize = 1;
/// Pair index in [`CutUnknowns`]: Λ of the tip.
const LAMBDA: usize = 2;
/// Pair index in [`CutUnknowns`]: ν of the tip.
const NU: usize = 3;

/// Difference of first moments, link by link.
fn minus([p, d]: Moments, [other_p, other_d]: Moments) -> Moments {
    [p - other_p, d - other_d]
}

/// Copies a vector of the tip to both legs.
fn at_tip([x, y]: [f64; 2]) -> Legs2 {
    Legs2 { x: both(x), y: both(y) }
}

/// Increment of a step, as passed to the evaluation of forces.
pub type Increment<'a> = StepIncrement<'a, Secant, COORDINATES>;

/// A system with slopes of its mean forces.
pub trait MeanSlopes: Discrete<COORDINATES, MULTIPLIERS, CUT_UNKNOWNS, Secant = Secant> {
    /// Slopes of the mean wrench over a step, and the arms of the tip.
    fn slopes_over(&self, step: &Increment<'_>) -> (Slopes, TipArm);
}

/// A step of a system with its loop cut at the tip: initial state and length.
pub struct OpenStep<'a, S> {
    system: &'a S,
    legs: &'a OpenLegs,
    pose: &'a Pose,
    /// Coordinates q₀, m and rad.
    q: &'a Coordinates,
    /// Length of the step, s.
    h: f64,
    /// Factor on the regularisation rates of friction and servos.
    softening: f64,
    /// First moment k₀ of ½h q̇₀, kg·m².
    initial_moment: Moments,
    /// Initial half-step rotations ½h ω₀, rad.
    initial_rotations: [Legs; 2],
}

/// Motion of the open legs over a step for given unknowns. All joints except the tip satisfy their constraints.
#[derive(Clone, Copy, Debug)]
pub struct OpenMotion {
    /// Poses half-way and at the end of the step, and the step's factors.
    pub secant: Secant,
    /// The unknowns, with ν corrected for this motion's rates.
    pub x: CutUnknowns,
    /// Half-step rotations at the end, ω̂ = ½h ω₁, rad.
    half: [Legs; 2],
    /// Velocity defect y, kg·m².
    velocity_defect: Moments,
    /// Difference k₀ − w of first moments, kg·m².
    moment_change: Moments,
    /// Columns of the tip's closure, σ(ℓ, L) n̂₁, m.
    ends: [Legs2; 2],
    /// Residual of the tip's closure, m.
    pub gap: [f64; 2],
    /// Residual of ½h times the rate of the tip's closure, m.
    pub rate: [f64; 2],
}

/// Residual of the equations (f) for given forces.
#[derive(Clone, Copy, Debug)]
pub struct OpenResidual {
    /// Joint load g of each link.
    joint_load: Moments,
    /// Residual f of the angle rows, kg·m².
    pub left: [Legs; 2],
}

/// Normals n̂ to directions û.
fn normals([p, d]: [Legs2; 2]) -> [Legs2; 2] {
    [p.turned(), d.turned()]
}

/// Vectors times scalars, link by link.
fn scaled([p, d]: [Legs2; 2], [by_p, by_d]: [Legs; 2]) -> [Legs2; 2] {
    [p.scaled(by_p), d.scaled(by_d)]
}

impl<'a, S: MeanSlopes> OpenStep<'a, S> {
    /// A step of h seconds from q₀, its pose and q̇₀.
    pub fn new(system: &'a S, legs: &'a OpenLegs, pose: &'a Pose, [q, v]: [&'a Coordinates; 2], h: f64, softening: f64) -> Self {
        let half = both(0.5 * h);
        let initial_moment = legs.moment_of_centres(centres(v)).map(|moment| moment.scaled(half));
        Self { system, legs, pose, q, h, softening, initial_moment, initial_rotations: angles_by_leg(v).map(|rate| half * rate) }
    }

    /// Bordered matrix for ω̂ or Δθ, with inertias of the angle rows; joint forces act along `factors` · n̂_m.
    #[inline(always)]
    fn bordered(
        &self,
        (turned, ends): (&Secant, &[Legs2; 2]),
        inertias: [[Legs; 2]; 2],
        factors: [Legs; 2],
        e: f64,
    ) -> BorderedMatrix {
        let [own, shared, last] = self.legs.moment;
        let ([by_p, by_d], [cos_p, cos_d]) = (factors, turned.cos);
        let ([middle_p, middle_d], [end_p, end_d]) = (turned.middle.along(), turned.end.along());
        let matrix = [
            // For a single link, n̂_m·n̂₁ is its factor c.
            [inertias[0][0] + by_p * cos_p * own, inertias[0][1] + by_p * shared * middle_p.dot(end_d)],
            [inertias[1][0] + by_d * shared * middle_d.dot(end_p), inertias[1][1] + by_d * cos_d * last],
        ];
        let [length_p, length_d] = self.legs.sigma_length;
        BorderedMatrix::new(matrix, scaled(normals(turned.middle.along()), [by_p * length_p, by_d * length_d]), ends, e)
    }

    /// Computes the motion. `solve` gets the matrix for ω̂ and ν, the right-hand side for ω̂ and the columns of the tip's closure; it
    /// returns ω̂, the change of ν and the residual of the rate equation.
    #[inline(always)]
    fn moving(
        &self,
        mut x: CutUnknowns,
        e: f64,
        solve: impl FnOnce(&BorderedMatrix, [Legs; 2], &[Legs2; 2]) -> ([Legs; 2], [f64; 2], [f64; 2]),
    ) -> OpenMotion {
        let &Self { legs, initial_rotations: [begun_p, begun_d], .. } = self;
        let mechanism = &legs.mechanism;
        let turns @ [turn_p, turn_d] = [legs_of(&x, PROXIMAL), legs_of(&x, DISTAL)];
        let secant = mechanism.secant(self.pose, turns);
        let (across, end) = (normals(secant.middle.along()), normals(secant.end.along()));
        let ends = scaled(end, legs.sigma_length);
        let ([sinc_p, sinc_d], [cos_p, cos_d]) = (secant.sinc, secant.cos);

        let way = minus(legs.moment(scaled(across, [sinc_p * turn_p, sinc_d * turn_d])), self.initial_moment);
        let nu = legs_of(&x, NU);
        let [velocity_defect_p, velocity_defect_d] = minus(way, legs.levers(at_tip(nu.to_array())));
        let right = [
            mechanism.inertia_p * (turn_p - begun_p) + cos_p * across[0].dot(velocity_defect_p),
            mechanism.inertia_d * (turn_d - begun_d) + cos_d * across[1].dot(velocity_defect_d),
        ];
        let none = both(0.0);
        let inertias = [[mechanism.inertia_p, none], [none, mechanism.inertia_d]];
        let bordered = self.bordered((&secant, &ends), inertias, secant.cos, e);
        let (half, change, rate) = solve(&bordered, right, &ends);
        set_legs(&mut x, NU, nu + Legs::new(change));
        let turning = legs.moment(scaled(end, half));
        let velocity_defect = minus(minus([velocity_defect_p, velocity_defect_d], turning), legs.levers(at_tip(change)));

        let [p, d] = scaled(secant.end.along(), legs.sigma_length);
        let gap = [sum(p.x + d.x + SIGMA * mechanism.ground_x), sum(p.y + d.y)];
        OpenMotion { secant, x, half, velocity_defect, moment_change: minus(self.initial_moment, turning), ends, gap, rate }
    }

    /// Weighted stiffness and damping k K + c C of the mean forces for weights [k, c], per leg, kg·m². Rows: angle equations of the
    /// proximal and the distal link. Columns: Δθ of these links, if ω̂ changes by the same amount.
    #[inline(always)]
    fn inertias_of(&self, motion: &OpenMotion, slopes: &Slopes, arm: &TipArm, weights: [f64; 2]) -> [[Legs; 2]; 2] {
        if !slopes.couple_links() {
            let ([p, d], none) = (slopes.diagonal(arm, weights), both(0.0));
            return [[p, none], [none, d]];
        }
        let left = |[p, d]: [Legs2; 2]| [p, d].map(|lever| [lever.x.to_array()[0], lever.y.to_array()[0]]);
        let OpenMotion { secant, half, ends, .. } = motion;
        let rows = scaled(scaled(normals(secant.middle.along()), secant.sinc), self.legs.sigma_length);
        let per_second = both(-2.0 / self.h);
        let turning = scaled(scaled(secant.end.along(), self.legs.sigma_length), half.map(|half| per_second * half));
        let levers = StepLevers { rows: left(rows), columns: left(*ends), turning: left(turning) };
        slopes.on_legs(arm, &levers, weights)
    }

    /// Evaluates `of` on the finite step that belongs to a motion of the cut loop.
    fn over<T>(&self, motion: &OpenMotion, of: impl FnOnce(&Increment<'_>) -> T) -> T {
        let [d, v] = self.end(motion);
        of(&StepIncrement { q: self.q, d: &d, v: &v, h: self.h, softening: self.softening, secant: &motion.secant })
    }
}

impl<S: MeanSlopes> CutStep<COORDINATES, MULTIPLIERS, CUT_UNKNOWNS> for OpenStep<'_, S> {
    type Secant = Secant;
    type Motion = OpenMotion;
    type Balance = OpenResidual;
    type Factor = BorderedMatrix;

    fn unknowns_of(d: &Coordinates, lambda: &Multipliers) -> CutUnknowns {
        let mut x = CutUnknowns::ZERO;
        let [proximal, distal] = angles_by_leg(d);
        set_legs(&mut x, PROXIMAL, proximal);
        set_legs(&mut x, DISTAL, distal);
        set_legs(&mut x, LAMBDA, Legs::new([lambda[TIP_X], lambda[TIP_Y]]));
        x
    }

    fn lengthened(x: &CutUnknowns, factor: f64) -> CutUnknowns {
        CutUnknowns::from_fn(|i| if i < 2 * LAMBDA { factor * x[i] } else { factor * factor * x[i] })
    }

    /// The motion does not depend on Λ. The ν of `x` is an initial guess: the rate equation holds up to e times the correction of ν.
    fn motion(&self, x: &CutUnknowns, e: f64) -> OpenMotion {
        self.moving(*x, e, |bordered, right, ends| {
            let (half, change) = bordered.solve(right, ends, [0.0; 2]);
            (half, change, change.map(|change| e * change))
        })
    }

    /// The closure, which loses rank at a vertex, is not solved.
    fn free_motion(&self, x: &CutUnknowns) -> OpenMotion {
        self.moving(*x, 1.0, |bordered, right, ends| {
            let half = bordered.free(right);
            (half, [0.0; 2], tip_separation(ends, half))
        })
    }

    fn balance(&self, motion: &OpenMotion) -> OpenResidual {
        let &Self { legs, initial_rotations: [begun_p, begun_d], h, .. } = self;
        let mechanism = &legs.mechanism;
        let applied = 0.5 * h * h * self.over(motion, |step| self.system.mean_forces(step));
        let OpenMotion {
            secant,
            x,
            half: [half_p, half_d],
            velocity_defect: [velocity_defect_p, velocity_defect_d],
            moment_change: [moment_change_p, moment_change_d],
            ..
        } = motion;
        let [load_p, load_d] = legs.moment_of_forces(centres(&applied));
        let [lever_p, lever_d] = legs.levers(at_tip(legs_of(x, LAMBDA).to_array()));
        let joint_load @ [joint_load_p, joint_load_d] = [load_p + *moment_change_p - lever_p, load_d + *moment_change_d - lever_d];
        let ([along_p, along_d], [sinc_p, sinc_d]) = (secant.middle.along(), secant.sinc);
        let [torque_p, torque_d] = angles_by_leg(&applied);
        let half = both(0.5);
        let turning_p = half * (*half_p + begun_p) * along_p.dot(*velocity_defect_p) - along_p.turned().dot(joint_load_p);
        let turning_d = half * (*half_d + begun_d) * along_d.dot(*velocity_defect_d) - along_d.turned().dot(joint_load_d);
        let left = [
            mechanism.inertia_p * (*half_p - begun_p) - torque_p + sinc_p * turning_p,
            mechanism.inertia_d * (*half_d - begun_d) - torque_d + sinc_d * turning_d,
        ];
        OpenResidual { joint_load, left }
    }

    fn residuals(&self, OpenMotion { gap, rate, .. }: &OpenMotion, OpenResidual { left: [p, d], .. }: &OpenResidual) -> [f64; 3] {
        let [mobility_p, mobility_d] = self.legs.turn_mobility;
        let offset = (mobility_p * *p).abs().fast_max((mobility_d * *d).abs());
        [offset, Legs::new(*gap), Legs::new(*rate)].map(largest)
    }

    /// Δθ and ω̂ change together; ν does not change.
    fn factor(&self, motion: &OpenMotion, balance: &OpenResidual, e: f64) -> BorderedMatrix {
        let (slopes, arm) = self.over(motion, |step| self.system.slopes_over(step));
        let (OpenMotion { secant, x, ends, .. }, [joint_load_p, joint_load_d]) = (motion, balance.joint_load);
        let mechanism = &self.legs.mechanism;
        let ([along_p, along_d], [sinc_p, sinc_d]) = (secant.middle.along(), secant.sinc);
        let [[pp, pd], [dp, dd]] = self.inertias_of(motion, &slopes, &arm, [0.5 * self.h * self.h, self.h]);
        // As Δθ grows, n̂_m turns by half as much, and s falls: ds/dΔθ = −Δθ/12 to second order.
        let stiffness = |along: Legs2, joint_load: Legs2, turn: Legs| {
            both(0.5) * along.dot(joint_load) + both(1.0 / 12.0) * turn * along.turned().dot(joint_load)
        };
        let inertias = [
            [mechanism.inertia_p + pp + sinc_p * stiffness(along_p, joint_load_p, legs_of(x, PROXIMAL)), pd],
            [dp, mechanism.inertia_d + dd + sinc_d * stiffness(along_d, joint_load_d, legs_of(x, DISTAL))],
        ];
        self.bordered((secant, ends), inertias, secant.sinc, e)
    }

    /// Λ is solved without the gap, because closing the gap changes no rates.
    fn newton_update(&self, motion: &OpenMotion, balance: &OpenResidual, matrix: &BorderedMatrix) -> CutUnknowns {
        let (OpenMotion { gap, ends, .. }, [left_p, left_d]) = (motion, balance.left);
        let ([p, d], lambda) = matrix.solve([-left_p, -left_d], ends, *gap);
        let mut change = CutUnknowns::ZERO;
        set_legs(&mut change, PROXIMAL, p);
        set_legs(&mut change, DISTAL, d);
        set_legs(&mut change, LAMBDA, Legs::new(lambda));
        motion.x + change
    }

    fn whole_correction(&self, motion: &OpenMotion, balance: &OpenResidual, e: f64) -> CutUnknowns {
        let (slopes, arm) = self.over(motion, |step| self.system.slopes_over(step));
        self.by_whole_tangent(motion, balance, (&slopes, &arm), e)
    }

    /// Applies the last linear correction to the rates.
    fn with_rates(&self, motion: &OpenMotion, balance: &OpenResidual, matrix: &BorderedMatrix) -> OpenMotion {
        let [left_p, left_d] = balance.left;
        let ([p, d], lambda) = matrix.solve([-left_p, -left_d], &motion.ends, [0.0; 2]);
        let mut x = motion.x;
        add_legs(&mut x, LAMBDA, Legs::new(lambda));
        OpenMotion { x, half: [motion.half[0] + p, motion.half[1] + d], ..*motion }
    }
    fn rotation_norm(x: &CutUnknowns) -> f64 {
        largest(legs_of(x, PROXIMAL).abs().fast_max(legs_of(x, DISTAL).abs()))
    }

    fn unknowns(motion: &OpenMotion) -> CutUnknowns {
        motion.x
    }

    fn end(&self, motion: &OpenMotion) -> [Coordinates; 2] {
        let mut d = self.legs.mechanism.coordinates(&motion.secant.end, [Legs::ZERO; 2]) - *self.q;
        set_angles(&mut d, [legs_of(&motion.x, PROXIMAL), legs_of(&motion.x, DISTAL)]);
        let per_second = both(2.0 / self.h);
        [d, motion.secant.end.velocities(motion.half.map(|half| per_second * half))]
    }

    fn secant(motion: &OpenMotion) -> &Secant {
        &motion.secant
    }
}
