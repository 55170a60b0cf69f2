//! The energy-conserving step with its loop cut at the tip: its equations in the rotations of the links.
//!
//! Two open legs, each ground – elbow – tip, satisfy the joints of the ground and the elbows for any increments Δθ of the link angles and
//! any rates, and the position rows of (37) in `docs/conserving.md` give the forces of these joints. There remain Λ and ν of the tip among
//! ten multipliers, and of (37) the angle rows and the tip's closure. With ℓ = a + b of the proximal and L of the distal link, the moments
//! of inertia
//!
//! ```text
//! A = m_P a² + m_D ℓ²,   B = m_D ℓ a_D,   D = m_D a_D²        moment(p, d) = (A p + B d, B p + D d)
//! ```
//!
//! ω̂ = ½h ω₁ of the rates at the step's end and first moments of displacements (m_P a times that of a proximal plus m_D ℓ times that of a
//! distal centre of mass, and m_D a_D times the latter), these equations are
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
//! The equations (ν) are linear in ω̂ and ν. Newton's method for Δθ and Λ in (f) has a matrix of the same form, with s for c and the
//! geometric stiffness of the joint forces: 2×2 in each leg, bordered by 2×2 of the tip ([`BorderedMatrix`]).

mod bordered;
mod open_legs;

use crate::dynamics::{StepLevers, TipArm};
use crate::effects::Slopes;
use crate::mechanism::coordinates::{D_THETA, E_X, E_Y, G_X, G_Y, P_THETA, TIP_X, TIP_Y, add_legs, legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, SIGMA, both, sum};
use crate::mechanism::secant::{Secant, StepDirections};
use crate::mechanism::{Coordinates, Multipliers, Pose};
use crate::vector::Vector;
pub use bordered::BorderedMatrix;
pub use open_legs::OpenLegs;
use open_legs::{Moments, angles, centres};

/// Number of unknowns of the cut loop.
pub const CUT_UNKNOWNS: usize = 8;
/// Unknowns of the cut loop: Δθ of the proximal and of the distal links, rad, Λ and ν of the tip.
pub type CutUnknowns = Vector<CUT_UNKNOWNS>;
/// Index of Δθ of the proximal links among the pairs of [`CutUnknowns`].
const PROXIMAL: usize = 0;
/// Index of Δθ of the distal links among the pairs of [`CutUnknowns`].
const DISTAL: usize = 1;
/// Index of Λ of the tip among the pairs of [`CutUnknowns`].
const LAMBDA: usize = 2;
/// Index of ν of the tip among the pairs of [`CutUnknowns`].
const NU: usize = 3;

/// The unknowns of the cut loop from the increments d and all Λ and ν.
#[inline(always)]
pub fn cut_unknowns(d: &Coordinates, [lambda, nu]: [&Multipliers; 2]) -> CutUnknowns {
    let mut x = CutUnknowns::ZERO;
    set_legs(&mut x, PROXIMAL, legs_of(d, P_THETA));
    set_legs(&mut x, DISTAL, legs_of(d, D_THETA));
    set_legs(&mut x, LAMBDA, Legs::new([lambda[TIP_X], lambda[TIP_Y]]));
    set_legs(&mut x, NU, Legs::new([nu[TIP_X], nu[TIP_Y]]));
    x
}

/// The largest |Δθ|, rad.
#[inline(always)]
pub fn largest_turn(x: &CutUnknowns) -> f64 {
    let [left, right] = legs_of(x, PROXIMAL).abs().fast_max(legs_of(x, DISTAL).abs()).to_array();
    if left > right { left } else { right }
}

/// Difference of two moments, link by link.
#[inline(always)]
fn minus([p, d]: Moments, [other_p, other_d]: Moments) -> Moments {
    [p.minus(other_p), d.minus(other_d)]
}

/// A vector of the tip copied to both legs.
#[inline(always)]
fn at_tip([x, y]: [f64; 2]) -> Legs2 {
    Legs2 { x: both(x), y: both(y) }
}

/// A step of the cut loop: its initial state and length.
#[derive(Clone, Copy)]
pub struct OpenStep<'a> {
    legs: &'a OpenLegs,
    pose: &'a Pose,
    /// Coordinates q₀, m and rad.
    pub q: &'a Coordinates,
    /// Velocities q̇₀, m/s and rad/s.
    v: &'a Coordinates,
    /// Length of the step, s.
    pub h: f64,
    /// First moment k₀ of ½h q̇₀, kg·m².
    initial_moment: Moments,
    /// Initial half-step rotations ½h ω₀, rad.
    initial_rotations: [Legs; 2],
}

/// Motion of the open legs over a step for given unknowns: all joints but the tip satisfy their constraints.
#[derive(Clone, Copy, Debug)]
pub struct OpenMotion {
    /// Directions of the links in the middle and at the end of the step.
    directions: StepDirections,
    /// The unknowns; ν belongs to the rates of this motion.
    pub x: CutUnknowns,
    /// Final half-step rotations ω̂ = ½h ω₁, rad.
    half: [Legs; 2],
    /// Velocity defect y, kg·m².
    velocity_defect: Moments,
    /// Difference k₀ − w of first moments, kg·m².
    moment_change: Moments,
    /// Columns of the tip's closure, σ(ℓ, L) n̂₁, m.
    ends: [Legs2; 2],
    /// Residual of the tip's closure, m.
    gap: [f64; 2],
    /// Residual of ½h times the rate of the tip's closure, m.
    rate: [f64; 2],
}

/// Residual of the equations (f) under given forces.
#[derive(Clone, Copy, Debug)]
pub struct OpenResidual {
    /// Joint load g by links.
    joint_load: Moments,
    /// Residual f of the angle rows, kg·m².
    left: [Legs; 2],
}

/// The larger magnitude; NaN if the second is.
#[inline(always)]
fn larger([x, y]: [f64; 2]) -> f64 {
    if x.abs() > y.abs() { x.abs() } else { y.abs() }
}

/// Normals n̂ of directions û.
#[inline(always)]
fn normals([p, d]: [Legs2; 2]) -> [Legs2; 2] {
    [p.turned(), d.turned()]
}

/// Vectors times scalars, link by link.
#[inline(always)]
fn scaled([p, d]: [Legs2; 2], [by_p, by_d]: [Legs; 2]) -> [Legs2; 2] {
    [p.scaled(by_p), d.scaled(by_d)]
}

impl<'a> OpenStep<'a> {
    /// A step of h seconds from q₀ and q̇₀.
    #[inline(always)]
    pub fn new(legs: &'a OpenLegs, pose: &'a Pose, [q, v]: [&'a Coordinates; 2], h: f64) -> Self {
        let half = both(0.5 * h);
        let initial_moment = legs.moment_of_centres(centres(v)).map(|moment| moment.scaled(half));
        Self { legs, pose, q, v, h, initial_moment, initial_rotations: angles(v).map(|rate| half * rate) }
    }

    /// The bordered matrix for ω̂ or Δθ: inertias of the angle rows, in which joint forces act along `factors` n̂_m.
    #[inline(always)]
    fn bordered(
        &self,
        (turned, ends): (&StepDirections, &[Legs2; 2]),
        inertias: [[Legs; 2]; 2],
        factors: [Legs; 2],
        e: f64,
    ) -> BorderedMatrix {
        let [own, shared, last] = self.legs.moment;
        let ([by_p, by_d], [cos_p, cos_d]) = (factors, turned.cos);
        let ([middle_p, middle_d], [end_p, end_d]) = (turned.middle, turned.end);
        let matrix = [
            // The product n̂_m·n̂₁ of one link is its c.
            [inertias[0][0] + by_p * cos_p * own, inertias[0][1] + by_p * shared * middle_p.dot(end_d)],
            [inertias[1][0] + by_d * shared * middle_d.dot(end_p), inertias[1][1] + by_d * cos_d * last],
        ];
        let [length_p, length_d] = self.legs.sigma_length;
        BorderedMatrix::new(matrix, scaled(normals(turned.middle), [by_p * length_p, by_d * length_d]), ends, e)
    }

    /// The motion with the Δθ of `x`, which does not depend on Λ. The ν of `x` is an initial guess: the rate equation is satisfied up to e
    /// times the correction of ν.
    #[inline(always)]
    pub fn motion(&self, mut x: CutUnknowns, e: f64) -> OpenMotion {
        let &Self { legs, initial_rotations: [begun_p, begun_d], .. } = self;
        let mechanism = &legs.mechanism;
        let turns @ [turn_p, turn_d] = [legs_of(&x, PROXIMAL), legs_of(&x, DISTAL)];
        let directions = StepDirections::new(self.pose, turns);
        let (across, end) = (normals(directions.middle), normals(directions.end));
        let ends = scaled(end, legs.sigma_length);
        let ([sinc_p, sinc_d], [cos_p, cos_d]) = (directions.sinc, directions.cos);

        let way = minus(legs.moment(scaled(across, [sinc_p * turn_p, sinc_d * turn_d])), self.initial_moment);
        let nu = legs_of(&x, NU);
        let [velocity_defect_p, velocity_defect_d] = minus(way, legs.levers(at_tip(nu.to_array())));
        let right = [
            mechanism.inertia_p * (turn_p - begun_p) + cos_p * across[0].dot(velocity_defect_p),
            mechanism.inertia_d * (turn_d - begun_d) + cos_d * across[1].dot(velocity_defect_d),
        ];
        let none = both(0.0);
        let inertias = [[mechanism.inertia_p, none], [none, mechanism.inertia_d]];
        let bordered = self.bordered((&directions, &ends), inertias, directions.cos, e);
        let (half, change) = bordered.solve(right, &ends, [0.0; 2]);
        set_legs(&mut x, NU, nu + Legs::new(change));
        let turning = legs.moment(scaled(end, half));
        let velocity_defect = minus(minus([velocity_defect_p, velocity_defect_d], turning), legs.levers(at_tip(change)));

        let [p, d] = scaled(directions.end, legs.sigma_length);
        let gap = [sum(p.x + d.x + SIGMA * mechanism.ground_x), sum(p.y + d.y)];
        let rate = change.map(|change| e * change);
        OpenMotion { directions, x, half, velocity_defect, moment_change: minus(self.initial_moment, turning), ends, gap, rate }
    }

    /// Directions and factors of the step d of a motion.
    #[inline(always)]
    pub fn secant(&self, motion: &OpenMotion) -> Secant {
        self.legs.mechanism.secant_along(&motion.directions)
    }

    /// Increments d = q₁ − q₀ of a motion, m and rad.
    #[inline(always)]
    pub fn way(&self, motion: &OpenMotion) -> Coordinates {
        let turns = [legs_of(&motion.x, PROXIMAL), legs_of(&motion.x, DISTAL)];
        let mechanism = &self.legs.mechanism;
        let end = mechanism.coordinates(&mechanism.pose_along(motion.directions.end), [Legs::ZERO; 2]);
        let mut d = end - *self.q;
        set_legs(&mut d, P_THETA, turns[0]);
        set_legs(&mut d, D_THETA, turns[1]);
        d
    }

    /// Final velocities q̇₁ of a motion, m/s and rad/s.
    #[inline(always)]
    pub fn rates(&self, motion: &OpenMotion) -> Coordinates {
        let per_second = both(2.0 / self.h);
        self.legs.mechanism.pose_along(motion.directions.end).velocities(motion.half.map(|half| per_second * half))
    }

    /// Residual of a motion under mean forces Q̄, N and N·m.
    #[inline(always)]
    pub fn balance(&self, motion: &OpenMotion, forces: &Coordinates) -> OpenResidual {
        let &Self { legs, initial_rotations: [begun_p, begun_d], h, .. } = self;
        let mechanism = &legs.mechanism;
        let applied = 0.5 * h * h * *forces;
        let OpenMotion {
            directions,
            x,
            half: [half_p, half_d],
            velocity_defect: [velocity_defect_p, velocity_defect_d],
            moment_change: [moment_change_p, moment_change_d],
            ..
        } = motion;
        let [load_p, load_d] = legs.moment_of_forces(centres(&applied));
        let [lever_p, lever_d] = legs.levers(at_tip(legs_of(x, LAMBDA).to_array()));
        let joint_load @ [joint_load_p, joint_load_d] =
            [load_p.plus(*moment_change_p).minus(lever_p), load_d.plus(*moment_change_d).minus(lever_d)];
        let ([along_p, along_d], [sinc_p, sinc_d]) = (directions.middle, directions.sinc);
        let [torque_p, torque_d] = angles(&applied);
        let half = both(0.5);
        let turning_p = half * (*half_p + begun_p) * along_p.dot(*velocity_defect_p) - along_p.turned().dot(joint_load_p);
        let turning_d = half * (*half_d + begun_d) * along_d.dot(*velocity_defect_d) - along_d.turned().dot(joint_load_d);
        let left = [
            mechanism.inertia_p * (*half_p - begun_p) - torque_p + sinc_p * turning_p,
            mechanism.inertia_d * (*half_d - begun_d) - torque_d + sinc_d * turning_d,
        ];
        OpenResidual { joint_load, left }
    }

    /// Norms of the residuals: of f as an angle, rad; of the tip's closure and of ½h times its rate, m.
    #[inline(always)]
    pub fn left(&self, OpenMotion { gap, rate, .. }: &OpenMotion, OpenResidual { left: [p, d], .. }: &OpenResidual) -> [f64; 3] {
        let [mobility_p, mobility_d] = self.legs.turn_mobility;
        let offset = (mobility_p * *p).abs().fast_max((mobility_d * *d).abs()).to_array();
        [larger(offset), larger(*gap), larger(*rate)]
    }

    /// Slopes of the mean forces as moments of inertia of each leg, kg·m²: by rows (proximal, distal) of momentum and columns of Δθ and ω̂,
    /// which change together.
    #[inline(always)]
    pub fn inertias_of(&self, motion: &OpenMotion, slopes: &Slopes, arm: &TipArm) -> [[Legs; 2]; 2] {
        let left = |[p, d]: [Legs2; 2]| [p, d].map(|lever| [lever.x.to_array()[0], lever.y.to_array()[0]]);
        let rows = scaled(scaled(normals(motion.directions.middle), motion.directions.sinc), self.legs.sigma_length);
        let levers = StepLevers { rows: left(rows), columns: left(motion.ends) };
        slopes.on_legs(arm, &levers, [0.5 * self.h * self.h, self.h])
    }

    /// The matrix of Newton's increments with these loads.
    #[inline(always)]
    pub fn factor(&self, motion: &OpenMotion, balance: &OpenResidual, loads: [[Legs; 2]; 2], e: f64) -> BorderedMatrix {
        let (OpenMotion { directions, x, ends, .. }, [joint_load_p, joint_load_d]) = (motion, balance.joint_load);
        let mechanism = &self.legs.mechanism;
        let ([along_p, along_d], [sinc_p, sinc_d]) = (directions.middle, directions.sinc);
        let [[pp, pd], [dp, dd]] = loads;
        // s n̂_m turns by half of Δθ, and s falls: its derivative is −Δθ/12 but for the third order.
        let stiffness = |along: Legs2, joint_load: Legs2, turn: Legs| {
            both(0.5) * along.dot(joint_load) + both(1.0 / 12.0) * turn * along.turned().dot(joint_load)
        };
        let inertias = [
            [mechanism.inertia_p + pp + sinc_p * stiffness(along_p, joint_load_p, legs_of(x, PROXIMAL)), pd],
            [dp, mechanism.inertia_d + dd + sinc_d * stiffness(along_d, joint_load_d, legs_of(x, DISTAL))],
        ];
        self.bordered((directions, ends), inertias, directions.sinc, e)
    }

    /// Newton's increments of Δθ and Λ. Λ is solved with the gap left out, since closing the gap changes no rates.
    #[inline(always)]
    pub fn correction(
        &self,
        OpenMotion { gap, ends, .. }: &OpenMotion,
        balance: &OpenResidual,
        matrix: &BorderedMatrix,
    ) -> CutUnknowns {
        let [left_p, left_d] = balance.left;
        let ([p, d], lambda) = matrix.solve([-left_p, -left_d], ends, *gap);
        let mut change = CutUnknowns::ZERO;
        set_legs(&mut change, PROXIMAL, p);
        set_legs(&mut change, DISTAL, d);
        set_legs(&mut change, LAMBDA, Legs::new(lambda));
        change
    }

    /// The motion with rates and Λ that satisfy (f) at its Δθ: the last linear correction.
    #[inline(always)]
    pub fn with_rates(&self, motion: &OpenMotion, balance: &OpenResidual, matrix: &BorderedMatrix) -> OpenMotion {
        let [left_p, left_d] = balance.left;
        let ([p, d], lambda) = matrix.solve([-left_p, -left_d], &motion.ends, [0.0; 2]);
        let mut x = motion.x;
        add_legs(&mut x, LAMBDA, Legs::new(lambda));
        OpenMotion { x, half: [motion.half[0] + p, motion.half[1] + d], ..*motion }
    }

    /// Multipliers Λ and ν of all joints under mean forces Q̄, N and N·m.
    pub fn multipliers(&self, motion: &OpenMotion, forces: &Coordinates) -> [Multipliers; 2] {
        let (x, mechanism) = (&motion.x, &self.legs.mechanism);
        let z = 0.5 * self.h * (*self.v + self.rates(motion));
        // From the tip to the ground: the force at each joint is that of the next joint plus the load of the link between.
        let along = |taken: &Coordinates, tip: Legs| {
            let [proximal, distal] = centres(taken);
            let tip = tip.to_array();
            let elbow = distal.minus(at_tip(tip).scaled(SIGMA));
            let ground = proximal.plus(elbow);
            let mut joints = Multipliers::ZERO;
            set_legs(&mut joints, G_X, ground.x);
            set_legs(&mut joints, G_Y, ground.y);
            set_legs(&mut joints, E_X, elbow.x);
            set_legs(&mut joints, E_Y, elbow.y);
            [joints[TIP_X], joints[TIP_Y]] = tip;
            joints
        };
        let taken = 0.5 * self.h * self.h * *forces - mechanism.mass_times(&(z - self.h * *self.v));
        let velocity_defect = mechanism.mass_times(&(self.way(motion) - z));
        [along(&taken, legs_of(x, LAMBDA)), along(&velocity_defect, legs_of(x, NU))]
    }
}
