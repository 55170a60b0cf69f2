//! The fast linear solve of the conserving step: [A J_bᵀ; J₁ −e] leg by leg, as `two_leg.rs` does with Φ_q on both sides.
//!
//! J_b is the discrete Jacobian, with the directions in the middle of the step, J₁ that of its end (`src/mechanism/secant.rs`), so that
//! the dual matrix S = J₁ A⁻¹ J_bᵀ + e is not symmetric. With μ = 1/m, the inertias I′ of A and
//!
//! ```text
//! U = s/I_P′ n̂₁ n̂_mᵀ of the proximal, V = s/I_D′ n̂₁ n̂_mᵀ of the distal link        U² = t U,  t = s/I_P′ c
//! ```
//!
//! its blocks along a leg, ground – elbow – tip, are S_GG = μ_P + e + a²U, S_GE = S_EG = −μ_P + ab U,
//! S_EE = μ_P + μ_D + e + b²U + a_D²V, S_EQ = S_QE = σμ_D − a_D b_D V, S_QQ = Σ (μ_D + b_D²V) + e. As U is of rank one, the ground joint
//! leaves the elbow a block of the same form:
//!
//! ```text
//! S_GG⁻¹ = α (1 − γU),  S_EG S_GG⁻¹ = −αμ_P + ηU,  E = S_EE − S_EG S_GG⁻¹ S_GE = ε + κU + a_D²V
//! ```

use crate::mechanism::coordinates::{D_THETA, D_X, E_X, E_Y, G_X, G_Y, P_THETA, P_X, TIP_X, TIP_Y, legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, SIGMA, both, sum};
use crate::mechanism::secant::Secant;
use crate::mechanism::{Coordinates, Mechanism, Multipliers};

/// A matrix of each leg, by rows.
#[derive(Clone, Copy, Debug)]
struct Square {
    xx: Legs,
    xy: Legs,
    yx: Legs,
    yy: Legs,
}

impl Square {
    /// diagonal·1 + factor·p qᵀ.
    #[inline(always)]
    fn new(diagonal: Legs, factor: Legs, p: Legs2, q: Legs2) -> Self {
        let p = p.scaled(factor);
        Self { xx: diagonal + p.x * q.x, xy: p.x * q.y, yx: p.y * q.x, yy: diagonal + p.y * q.y }
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        Self { xx: self.xx + other.xx, xy: self.xy + other.xy, yx: self.yx + other.yx, yy: self.yy + other.yy }
    }

    #[inline(always)]
    fn inverse(self) -> Self {
        let reciprocal = both(1.0) / (self.xx * self.yy - self.xy * self.yx);
        Self { xx: self.yy * reciprocal, xy: -self.xy * reciprocal, yx: -self.yx * reciprocal, yy: self.xx * reciprocal }
    }

    #[inline(always)]
    fn times(self, v: Legs2) -> Legs2 {
        Legs2 { x: self.xx * v.x + self.xy * v.y, y: self.yx * v.x + self.yy * v.y }
    }

    #[inline(always)]
    fn times_square(self, other: Self) -> Self {
        let (first, second) = (self.times(Legs2 { x: other.xx, y: other.yx }), self.times(Legs2 { x: other.xy, y: other.yy }));
        Self { xx: first.x, xy: second.x, yx: first.y, yy: second.y }
    }
}

/// What of it depends on the machine only.
#[derive(Clone, Copy, Debug)]
pub struct LegConstants {
    mechanism: Mechanism,
    /// 1/m and 1/I in the order of the coordinates.
    mobility: [Legs; 6],
}

impl LegConstants {
    /// Of a mechanism.
    pub fn new(mechanism: &Mechanism) -> Self {
        Self { mechanism: *mechanism, mobility: mechanism.mass_diagonal().map(|m| both(1.0) / m) }
    }

    /// M⁻¹ x.
    #[inline(always)]
    pub fn apply_inverse_mass(&self, x: &Coordinates) -> Coordinates {
        scaled(&self.mobility, x)
    }
}

#[inline(always)]
fn scaled(mobility: &[Legs; 6], x: &Coordinates) -> Coordinates {
    let mut result = Coordinates::ZERO;
    for (i, mobility) in mobility.iter().enumerate() {
        set_legs(&mut result, i, *mobility * legs_of(x, i));
    }
    result
}

/// The factorised matrix.
#[derive(Clone, Copy, Debug)]
pub struct SecantLegs {
    secant: Secant,
    /// 1/m and 1/I′.
    mobility: [Legs; 6],
    /// n̂₁ and n̂_m of the proximal links, and the factor of U.
    across: [Legs2; 2],
    u: Legs,
    /// α, γ, −αμ_P, η.
    ground: [Legs; 4],
    elbow_inverse: Square,
    /// T E⁻¹ and E⁻¹ T of T = S_EQ.
    to_tip: Square,
    from_tip: Square,
    /// Inverse of the tip's block by rows.
    tip_inverse: [f64; 4],
}

impl SecantLegs {
    /// Factorises for the inertias I′ of A (proximal, distal), kg·m², and e, 1/kg.
    #[inline(always)]
    pub fn factor(constants: &LegConstants, secant: &Secant, [proximal, distal]: [Legs; 2], regularization: f64) -> Self {
        let LegConstants { mechanism, mut mobility } = *constants;
        let Mechanism { a_p: a, b_p: b, a_d, sigma_b_d, .. } = mechanism;
        let e = both(regularization);
        mobility[P_THETA] = both(1.0) / proximal;
        mobility[D_THETA] = both(1.0) / distal;
        let (mu, mu_d) = (mobility[P_X], mobility[D_X]);
        let Secant { middle, end, sinc, cos } = secant;

        // Ground.
        let across = [end.u_p.turned(), middle.u_p.turned()];
        let u = sinc[0] * mobility[P_THETA];
        let (t, ab) = (u * cos[0], a * b);
        let alpha = both(1.0) / (mu + e);
        let gamma = a * a / (mu + e + a * a * t);
        let carried = -alpha * mu;
        let eta = alpha * (ab + gamma * mu - gamma * ab * t);
        let kappa = b * b - (ab * carried - mu * eta + ab * eta * t);

        // Elbow.
        let (p, q) = (end.u_d.turned(), middle.u_d.turned());
        let v = sinc[1] * mobility[D_THETA];
        let elbow = Square::new(mu + mu_d + e + mu * carried, kappa * u, across[0], across[1]);
        let elbow_inverse = elbow.plus(Square::new(both(0.0), a_d * a_d * v, p, q)).inverse();
        // σ b_D carries the leg's sign already.
        let elbow_tip = Square::new(SIGMA * mu_d, -a_d * sigma_b_d * v, p, q);
        let to_tip = elbow_tip.times_square(elbow_inverse);
        let from_tip = elbow_inverse.times_square(elbow_tip);

        // Tip.
        let own = Square::new(mu_d, sigma_b_d * sigma_b_d * v, p, q);
        let taken = to_tip.times_square(elbow_tip);
        let [xx, xy] = [sum(own.xx - taken.xx) + regularization, sum(own.xy - taken.xy)];
        let [yx, yy] = [sum(own.yx - taken.yx), sum(own.yy - taken.yy) + regularization];
        let reciprocal = 1.0 / (xx * yy - xy * yx);
        Self {
            secant: *secant,
            mobility,
            across,
            u,
            ground: [alpha, gamma, carried, eta],
            elbow_inverse,
            to_tip,
            from_tip,
            tip_inverse: [yy * reciprocal, -xy * reciprocal, -yx * reciprocal, xx * reciprocal],
        }
    }

    /// U x.
    #[inline(always)]
    fn across_proximal(&self, x: Legs2) -> Legs2 {
        let [p, q] = self.across;
        p.scaled(self.u * q.dot(x))
    }

    /// S⁻¹ r.
    #[inline(always)]
    pub fn dual(&self, r: &Multipliers) -> Multipliers {
        let [alpha, gamma, carried, eta] = self.ground;
        let ground = Legs2 { x: legs_of(r, G_X), y: legs_of(r, G_Y) };
        let across = self.across_proximal(ground);
        let elbow = Legs2 {
            x: legs_of(r, E_X) - (carried * ground.x + eta * across.x),
            y: legs_of(r, E_Y) - (carried * ground.y + eta * across.y),
        };

        let at_tip = self.to_tip.times(elbow);
        let (x, y) = (r[TIP_X] - sum(at_tip.x), r[TIP_Y] - sum(at_tip.y));
        let [xx, xy, yx, yy] = self.tip_inverse;
        let tip = Legs2 { x: both(xx * x + xy * y), y: both(yx * x + yy * y) };

        let (free, back) = (self.elbow_inverse.times(elbow), self.from_tip.times(tip));
        let elbow = Legs2 { x: free.x - back.x, y: free.y - back.y };
        // α (1 − γU) r_G − (−αμ + ηU) y_E.
        let own = Legs2 { x: alpha * ground.x - carried * elbow.x, y: alpha * ground.y - carried * elbow.y };
        let both_across = Legs2 { x: alpha * gamma * ground.x + eta * elbow.x, y: alpha * gamma * ground.y + eta * elbow.y };
        let across = self.across_proximal(both_across);

        let mut result = Multipliers::ZERO;
        set_legs(&mut result, G_X, own.x - across.x);
        set_legs(&mut result, G_Y, own.y - across.y);
        set_legs(&mut result, E_X, elbow.x);
        set_legs(&mut result, E_Y, elbow.y);
        result[TIP_X] = tip.x.to_array()[0];
        result[TIP_Y] = tip.y.to_array()[0];
        result
    }

    /// Solves A x + J_bᵀ y = b, J₁ x − e y = c.
    #[inline(always)]
    pub fn solve(&self, b: &Coordinates, c: &Multipliers) -> (Coordinates, Multipliers) {
        let unconstrained = scaled(&self.mobility, b);
        let y = self.dual(&(self.secant.end.phi_q_times(&unconstrained) - *c));
        (unconstrained - scaled(&self.mobility, &self.secant.discrete_transposed_times(&y)), y)
    }
}
