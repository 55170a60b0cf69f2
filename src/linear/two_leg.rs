//! The fast linear solve: both legs side by side, joint by joint.
//!
//! It serves scenes whose tangents are diagonal in the link angles. The dual (Schur) matrix S = Φ_q A₀⁻¹ Φ_qᵀ + e consists of 2×2 blocks
//! along each leg: ground, elbow, tip. With μ = 1/m, the inertias I′ of A₀ and the arms a, b of each link, eliminating these blocks in this
//! order needs (`docs/method.md`, "The two-leg elimination"):
//!
//! ```text
//! ground   S_GG⁻¹ S_GE = c_r r̂r̂ᵀ + c_n n̂n̂ᵀ          c_r = −μ/(μ+e),  c_n = (ab − μI′) z,  z = 1/((μ+e) I′ + a²)
//! elbow    E = (μ_D + e + a_r) 1 + (a_n − a_r) n̂n̂ᵀ + a_D²/I_D′ n̂_D n̂_Dᵀ
//!          a_r = μe/(μ+e),  a_n = (eμI′ + μ(a+b)² + eb²) z
//! tip      T = σ(μ_D 1 − a_D b_D/I_D′ n̂_D n̂_Dᵀ),  Q = Σ (μ_D 1 + b_D²/I_D′ n̂_D n̂_Dᵀ − Tᵀ E⁻¹ T) + e 1
//! ```
//!
//! Both legs execute the same instructions, in the two lanes of a register.

use crate::integrator::Kkt;
use crate::mechanism::coordinates::{D_THETA, D_X, D_Y, E_X, E_Y, G_X, G_Y, P_THETA, P_X, P_Y, TIP_X, TIP_Y, legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, SIGMA, both, sum};
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Mechanism, Multipliers, Pose};

/// Symmetric 2×2 matrices, one per leg.
#[derive(Clone, Copy, Debug)]
struct Symmetric {
    xx: Legs,
    xy: Legs,
    yy: Legs,
}

impl Symmetric {
    /// The matrix diagonal·1 + factor·v vᵀ.
    #[inline(always)]
    fn new(diagonal: Legs, factor: Legs, v: Legs2) -> Self {
        Self { xx: diagonal, xy: both(0.0), yy: diagonal }.plus(factor, v)
    }

    /// The sum self + factor·v vᵀ.
    #[inline(always)]
    fn plus(self, factor: Legs, v: Legs2) -> Self {
        let w = v.scaled(factor);
        Self { xx: self.xx + w.x * v.x, xy: self.xy + w.x * v.y, yy: self.yy + w.y * v.y }
    }

    #[inline(always)]
    fn inverse(self) -> Self {
        let reciprocal = both(1.0) / (self.xx * self.yy - self.xy * self.xy);
        Self { xx: self.yy * reciprocal, xy: -self.xy * reciprocal, yy: self.xx * reciprocal }
    }

    #[inline(always)]
    fn times(self, v: Legs2) -> Legs2 {
        Legs2 { x: self.xx * v.x + self.xy * v.y, y: self.xy * v.x + self.yy * v.y }
    }
}

/// Constants of the elimination. They depend only on the mechanism and e, and are computed once, when the scene is prepared.
#[derive(Clone, Copy, Debug)]
pub struct Elimination {
    pub(super) mechanism: Mechanism,
    regularization: f64,
    ground: Ground,
    /// Compliances with A₀ = M.
    mass: Compliance,
}

/// Constants of the proximal links and their ground joints.
#[derive(Clone, Copy, Debug)]
struct Ground {
    /// Mobility μ = 1/m_P, 1/kg.
    mu: Legs,
    /// Coefficient 1/(μ+e) of S_GG⁻¹ along the link, kg.
    along: Legs,
    /// Coefficient c_r.
    couple_along: Legs,
    /// Coefficient a_r, 1/kg.
    elbow_along: Legs,
    /// Term μ + e of z, 1/kg.
    mu_e: Legs,
    /// Term a² of z, m².
    aa: Legs,
    /// Term ab of c_n, m².
    ab: Legs,
    /// Term eμ of a_n, 1/kg².
    e_mu: Legs,
    /// Term μ(a+b)² + eb² of a_n, m²/kg.
    lever: Legs,
}

/// Coefficients of the elimination that depend on the inertias I′ of A₀ but not on the pose.
#[derive(Clone, Copy, Debug)]
struct Compliance {
    /// Mobility 1/I′ of the proximal links, 1/(kg·m²).
    proximal: Legs,
    /// Mobility 1/I′ of the distal links, 1/(kg·m²).
    distal: Legs,
    /// Coefficient of S_GG⁻¹ across the proximal link minus the coefficient along it, kg.
    excess: Legs,
    /// Difference c_n − c_r.
    couple_excess: Legs,
    /// Difference a_n − a_r, 1/kg.
    elbow_excess: Legs,
}

impl Elimination {
    /// Computes the constants of a mechanism for e, 1/kg.
    pub fn new(mechanism: &Mechanism, regularization: f64) -> Self {
        let (e, mu, a, b) = (both(regularization), both(1.0) / mechanism.mass_p, mechanism.a_p, mechanism.b_p);
        let along = both(1.0) / (mu + e);
        let ground = Ground {
            mu,
            along,
            couple_along: -mu * along,
            elbow_along: mu * e * along,
            mu_e: mu + e,
            aa: a * a,
            ab: a * b,
            e_mu: e * mu,
            lever: mu * (a + b) * (a + b) + e * b * b,
        };
        let mass = ground.compliance([mechanism.inertia_p, mechanism.inertia_d]);
        Self { mechanism: *mechanism, regularization, ground, mass }
    }

    /// Returns these constants if they are for this e; otherwise computes constants for it in `other`. i3-ALP as printed in the paper and
    /// steps close to a vertex use an e of their own.
    #[inline(always)]
    fn with<'a>(&'a self, regularization: f64, other: &'a mut Option<Self>) -> &'a Self {
        if regularization == self.regularization { self } else { other.insert(Self::new(&self.mechanism, regularization)) }
    }
}

impl Ground {
    #[inline(always)]
    fn compliance(&self, [inertia_p, inertia_d]: [Legs; 2]) -> Compliance {
        let z = both(1.0) / (self.mu_e * inertia_p + self.aa);
        Compliance {
            proximal: both(1.0) / inertia_p,
            distal: both(1.0) / inertia_d,
            excess: inertia_p * z - self.along,
            couple_excess: (self.ab - self.mu * inertia_p) * z - self.couple_along,
            elbow_excess: (self.e_mu * inertia_p + self.lever) * z - self.elbow_along,
        }
    }
}

/// The factorised saddle-point matrix of a five-bar with diagonal A₀.
#[derive(Clone, Copy, Debug)]
pub struct TwoLeg {
    pose: Pose,
    /// Mobilities 1/m, 1/kg, and 1/I′, 1/(kg·m²), of the proximal and distal links.
    mobility: [Legs; 6],
    /// Coefficient of S_GG⁻¹ along the proximal link, kg.
    ground_along: Legs,
    /// Coefficient of S_GG⁻¹ across the proximal link minus the coefficient along it, kg.
    ground_excess: Legs,
    /// Coefficient c_r.
    couple_along: Legs,
    /// Difference c_n − c_r.
    couple_excess: Legs,
    /// Inverse E⁻¹ of the elbow's block.
    elbow_inverse: Symmetric,
    /// Product E⁻¹ T by columns: how a force at the tip acts on the elbow.
    gain: [Legs2; 2],
    /// Inverse Q⁻¹ of the tip's block: xx, xy, yy.
    tip_inverse: [f64; 3],
}

impl TwoLeg {
    /// Factorises for inertias I′ of A₀ (proximal, distal), kg·m².
    #[inline(always)]
    pub fn factor(elimination: &Elimination, pose: &Pose, inertias: [Legs; 2], regularization: f64) -> Self {
        let mut other = None;
        let elimination = elimination.with(regularization, &mut other);
        Self::eliminate(elimination, &elimination.ground.compliance(inertias), pose)
    }

    /// Factorises with A₀ = M.
    #[inline(always)]
    pub fn factor_mass(elimination: &Elimination, pose: &Pose, regularization: f64) -> Self {
        let mut other = None;
        let elimination = elimination.with(regularization, &mut other);
        Self::eliminate(elimination, &elimination.mass, pose)
    }

    #[inline(always)]
    fn eliminate(elimination: &Elimination, compliance: &Compliance, pose: &Pose) -> Self {
        let Elimination { regularization, ground: Ground { mu, along, couple_along, elbow_along, .. }, .. } = *elimination;
        let mu_d = both(1.0) / elimination.mechanism.mass_d;

        // Eliminates the elbow.
        let (n_p, n_a, n_b) = (pose.u_p.turned(), pose.a_d.turned(), pose.sigma_b_d.turned());
        let elbow_inverse = Symmetric::new(mu_d + both(regularization) + elbow_along, compliance.elbow_excess, n_p)
            .plus(compliance.distal, n_a)
            .inverse();
        // The vectors n_a and n_b are parallel, so their product is symmetric.
        let w = n_a.scaled(-compliance.distal);
        let signed = SIGMA * mu_d;
        let elbow_tip = Symmetric { xx: signed + w.x * n_b.x, xy: w.x * n_b.y, yy: signed + w.y * n_b.y };

        // Eliminates the tip: Tᵀ E⁻¹ T, column by column.
        let gain @ [first, second] = [Legs2 { x: elbow_tip.xx, y: elbow_tip.xy }, Legs2 { x: elbow_tip.xy, y: elbow_tip.yy }]
            .map(|t| elbow_inverse.times(t));
        let own = Symmetric::new(mu_d, compliance.distal, n_b);
        let xx = sum(own.xx - (elbow_tip.xx * first.x + elbow_tip.xy * first.y)) + regularization;
        let xy = sum(own.xy - (elbow_tip.xx * second.x + elbow_tip.xy * second.y));
        let yy = sum(own.yy - (elbow_tip.xy * second.x + elbow_tip.yy * second.y)) + regularization;
        let reciprocal = 1.0 / (xx * yy - xy * xy);

        Self {
            pose: *pose,
            mobility: [mu, mu, compliance.proximal, mu_d, mu_d, compliance.distal],
            ground_along: along,
            ground_excess: compliance.excess,
            couple_along,
            couple_excess: compliance.couple_excess,
            elbow_inverse,
            gain,
            tip_inverse: [yy * reciprocal, -xy * reciprocal, xx * reciprocal],
        }
    }

    /// Pose at which the matrix was factorised.
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// The product A₀⁻¹ x.
    #[inline(always)]
    fn apply_inverse_mass(&self, x: &Coordinates) -> Coordinates {
        let mut result = Coordinates::ZERO;
        for (i, mobility) in self.mobility.into_iter().enumerate() {
            set_legs(&mut result, i, mobility * legs_of(x, i));
        }
        result
    }

    /// The solution S⁻¹ r of the dual system.
    #[inline(always)]
    fn dual(&self, r: &Multipliers) -> Multipliers {
        let across = self.pose.u_p.turned();
        // Product (along·1 + excess·n̂n̂ᵀ) v: the matrix is diagonal in the frame of the proximal link.
        let framed = |along: Legs, excess: Legs, v: Legs2| {
            let normal = excess * across.dot(v);
            v.scaled(along) + across.scaled(normal)
        };
        let ground = Legs2 { x: legs_of(r, G_X), y: legs_of(r, G_Y) };
        let carried = framed(self.couple_along, self.couple_excess, ground);
        let elbow = Legs2 { x: legs_of(r, E_X), y: legs_of(r, E_Y) } - carried;

        let free = self.elbow_inverse.times(elbow);
        let [first, second] = self.gain;
        let (x, y) = (r[TIP_X] - sum(first.dot(elbow)), r[TIP_Y] - sum(second.dot(elbow)));
        let [xx, xy, yy] = self.tip_inverse;
        let (tip_x, tip_y) = (xx * x + xy * y, xy * x + yy * y);

        let elbow = free - first.scaled(both(tip_x)) - second.scaled(both(tip_y));
        let own = framed(self.ground_along, self.ground_excess, ground);
        let ground = own - framed(self.couple_along, self.couple_excess, elbow);

        let mut y = Multipliers::ZERO;
        set_legs(&mut y, G_X, ground.x);
        set_legs(&mut y, G_Y, ground.y);
        set_legs(&mut y, E_X, elbow.x);
        set_legs(&mut y, E_Y, elbow.y);
        y[TIP_X] = tip_x;
        y[TIP_Y] = tip_y;
        y
    }
}

impl Kkt<COORDINATES, MULTIPLIERS> for TwoLeg {
    #[inline(always)]
    fn solve(&self, b: &Coordinates, c: &Multipliers) -> (Coordinates, Multipliers) {
        let unconstrained = self.apply_inverse_mass(b);
        let y = self.dual(&(self.pose.phi_q_times(&unconstrained) - *c));
        (unconstrained - self.apply_inverse_mass(&self.pose.phi_q_transposed_times(&y)), y)
    }

    #[inline(always)]
    fn correction(&self, c: &Multipliers) -> Coordinates {
        self.apply_inverse_mass(&self.pose.phi_q_transposed_times(&self.dual(c)))
    }
}

// The elimination relies on this order of the coordinates.
const _: () = assert!(P_X == 0 && P_Y == 1 && P_THETA == 2 && D_X == 3 && D_Y == 4 && D_THETA == 5);
