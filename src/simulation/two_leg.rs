//! The fast linear solve: two legs side by side, joint by joint.
//!
//! For scenes whose tangents are diagonal in the link angles. The dual (Schur) matrix S = Φ_q A₀⁻¹ Φ_qᵀ + e consists of 2×2 blocks
//! along each leg, ground – elbow – tip; eliminating them in that order needs, with μ = 1/m, I′ the inertias of A₀ and the arms
//! a, b of each link (`docs/method.md`, "The two-leg elimination"):
//!
//! ```text
//! ground   S_GG⁻¹ S_GE = c_r r̂r̂ᵀ + c_n n̂n̂ᵀ          c_r = −μ/(μ+e),  c_n = (ab − μI′) z,  z = 1/((μ+e) I′ + a²)
//! elbow    E = (μ_D + e + a_r) 1 + (a_n − a_r) n̂n̂ᵀ + a_D²/I_D′ n̂_D n̂_Dᵀ
//!          a_r = μe/(μ+e),  a_n = (eμI′ + μ(a+b)² + eb²) z
//! tip      T = σ(μ_D 1 − a_D b_D/I_D′ n̂_D n̂_Dᵀ),  Q = Σ (μ_D 1 + b_D²/I_D′ n̂_D n̂_Dᵀ − Tᵀ E⁻¹ T) + e 1
//! ```
//!
//! Both legs go through the same instructions in the two lanes of a register.

use crate::integrator::{Kkt, combine};
use crate::mechanism::coordinates::{D_THETA, D_X, D_Y, E_X, E_Y, G_X, G_Y, P_THETA, P_X, P_Y, TIP_X, TIP_Y, legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, SIGMA, both, sum};
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Mechanism, Multipliers, Pose};

/// A symmetric 2×2 matrix of each leg.
#[derive(Clone, Copy, Debug)]
struct Symmetric {
    xx: Legs,
    xy: Legs,
    yy: Legs,
}

impl Symmetric {
    /// diagonal·1 + factor·v vᵀ.
    #[inline(always)]
    fn new(diagonal: Legs, factor: Legs, v: Legs2) -> Self {
        Self { xx: diagonal, xy: both(0.0), yy: diagonal }.plus(factor, v)
    }

    /// self + factor·v vᵀ.
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

/// The factorised saddle-point matrix of a five-bar whose A₀ is diagonal.
#[derive(Clone, Copy, Debug)]
pub struct TwoLeg {
    pose: Pose,
    /// 1/m and 1/I′ of the proximal and distal links.
    mobility: [Legs; 6],
    /// S_GG⁻¹ along the proximal link, and across minus along.
    ground_along: Legs,
    ground_excess: Legs,
    /// c_r and c_n − c_r.
    couple_along: Legs,
    couple_excess: Legs,
    elbow_inverse: Symmetric,
    /// E⁻¹ T by columns: what a force at the tip makes of the elbow's.
    gain: [Legs2; 2],
    /// Inverse of the tip's block: xx, xy, yy.
    tip_inverse: [f64; 3],
}

impl TwoLeg {
    /// Factorises for the inertias I′ of A₀ (proximal, distal), kg·m².
    #[inline(always)]
    pub fn factor(mechanism: &Mechanism, pose: &Pose, [inertia_p, inertia_d]: [Legs; 2], softness: f64) -> Self {
        let one = both(1.0);
        let e = both(softness);
        let [mass_x, _, _, mass_d, ..] = mechanism.mass_diagonal();
        let (mu, mu_d) = (one / mass_x, one / mass_d);
        let (compliance_p, compliance_d) = (one / inertia_p, one / inertia_d);
        let (a, b) = (mechanism.a_p, mechanism.b_p);

        // Ground.
        let z = one / ((mu + e) * inertia_p + a * a);
        let ground_along = one / (mu + e);
        let couple_along = -mu * ground_along;
        let couple_excess = (a * b - mu * inertia_p) * z - couple_along;
        let a_r = mu * e * ground_along;
        let a_n = (e * mu * inertia_p + mu * (a + b) * (a + b) + e * b * b) * z;

        // Elbow.
        let (n_p, n_a, n_b) = (pose.u_p.turned(), pose.a_d.turned(), pose.sigma_b_d.turned());
        let elbow_inverse = Symmetric::new(mu_d + e + a_r, a_n - a_r, n_p).plus(compliance_d, n_a).inverse();
        // n_a and n_b are parallel, so that their product is symmetric.
        let w = n_a.scaled(-compliance_d);
        let signed = SIGMA * mu_d;
        let elbow_tip = Symmetric { xx: signed + w.x * n_b.x, xy: w.x * n_b.y, yy: signed + w.y * n_b.y };

        // Tip: Tᵀ E⁻¹ T column by column.
        let gain @ [first, second] = [Legs2 { x: elbow_tip.xx, y: elbow_tip.xy }, Legs2 { x: elbow_tip.xy, y: elbow_tip.yy }]
            .map(|t| elbow_inverse.times(t));
        let own = Symmetric::new(mu_d, compliance_d, n_b);
        let xx = sum(own.xx - (elbow_tip.xx * first.x + elbow_tip.xy * first.y)) + softness;
        let xy = sum(own.xy - (elbow_tip.xx * second.x + elbow_tip.xy * second.y));
        let yy = sum(own.yy - (elbow_tip.xy * second.x + elbow_tip.yy * second.y)) + softness;
        let reciprocal = 1.0 / (xx * yy - xy * xy);

        Self {
            pose: *pose,
            mobility: [mu, mu, compliance_p, mu_d, mu_d, compliance_d],
            ground_along,
            ground_excess: inertia_p * z - ground_along,
            couple_along,
            couple_excess,
            elbow_inverse,
            gain,
            tip_inverse: [yy * reciprocal, -xy * reciprocal, xx * reciprocal],
        }
    }

    /// Factorises with the mass matrix in the corner.
    #[inline(always)]
    pub fn factor_mass(mechanism: &Mechanism, pose: &Pose, softness: f64) -> Self {
        Self::factor(mechanism, pose, [mechanism.inertia_p, mechanism.inertia_d], softness)
    }

    /// A₀⁻¹ x.
    #[inline(always)]
    fn yielded(&self, x: &Coordinates) -> Coordinates {
        let mut result = [0.0; COORDINATES];
        for (i, mobility) in self.mobility.into_iter().enumerate() {
            set_legs(&mut result, i, mobility * legs_of(x, i));
        }
        result
    }

    /// S⁻¹ r.
    #[inline(always)]
    fn dual(&self, r: &Multipliers) -> Multipliers {
        let across = self.pose.u_p.turned();
        // along·v + excess·n̂n̂ᵀv: a matrix that is diagonal in the proximal link's frame.
        let framed = |along: Legs, excess: Legs, v: Legs2| {
            let normal = excess * across.dot(v);
            Legs2 { x: along * v.x + normal * across.x, y: along * v.y + normal * across.y }
        };
        let ground = Legs2 { x: legs_of(r, G_X), y: legs_of(r, G_Y) };
        let carried = framed(self.couple_along, self.couple_excess, ground);
        let elbow = Legs2 { x: legs_of(r, E_X) - carried.x, y: legs_of(r, E_Y) - carried.y };

        let free = self.elbow_inverse.times(elbow);
        let [first, second] = self.gain;
        let (x, y) = (r[TIP_X] - sum(first.dot(elbow)), r[TIP_Y] - sum(second.dot(elbow)));
        let [xx, xy, yy] = self.tip_inverse;
        let (tip_x, tip_y) = (xx * x + xy * y, xy * x + yy * y);

        let (back_x, back_y) = (first.scaled(both(tip_x)), second.scaled(both(tip_y)));
        let elbow = Legs2 { x: free.x - back_x.x - back_y.x, y: free.y - back_x.y - back_y.y };
        let own = framed(self.ground_along, self.ground_excess, ground);
        let carried = framed(self.couple_along, self.couple_excess, elbow);

        let mut y = [0.0; MULTIPLIERS];
        set_legs(&mut y, G_X, own.x - carried.x);
        set_legs(&mut y, G_Y, own.y - carried.y);
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
        let unconstrained = self.yielded(b);
        let velocity = self.pose.phi_q_times(&unconstrained);
        let y = self.dual(&combine([&velocity, c], |[velocity, c]| velocity - c));
        let pull = self.yielded(&self.pose.phi_q_transposed_times(&y));
        (combine([&unconstrained, &pull], |[x, pull]| x - pull), y)
    }

    #[inline(always)]
    fn correction(&self, c: &Multipliers) -> Coordinates {
        self.yielded(&self.pose.phi_q_transposed_times(&self.dual(c)))
    }
}

// The coordinates' order is part of the elimination above.
const _: () = assert!(P_X == 0 && P_Y == 1 && P_THETA == 2 && D_X == 3 && D_Y == 4 && D_THETA == 5);
