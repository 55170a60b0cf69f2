//! Equations of motion in the four absolute link angles, with the two closure equations of the tip.
//!
//! Per leg (σ = +1 left, −1 right), l_P is the arm from motor axis to elbow, a_P and a_D are the arms to the centres of mass, b_D is the
//! arm from the distal centre of mass to the tip, and n̂(·) rotates by +90°:
//!
//! ```text
//! M = [ I_P + m_P a_P² + m_D l_P²   m_D l_P·a_D     ]      Φ   = Σ σ (ground + l_P + a_D + b_D)
//!     [ m_D l_P·a_D                 I_D + m_D a_D²  ]      Φ_q = σ [ n̂(l_P)   n̂(a_D + b_D) ]
//!
//! M α + Φ_qᵀλ = Q + m_D l_P × a_D [ω_D²; −ω_P²],      Φ_q α − e λ = −Φ̇_q ω
//! ```
//!
//! M is 2 × 2 in each leg, so the saddle-point system reduces to a Schur complement with two rows.

use crate::integrator::Kkt;
use crate::mechanism::coordinates::{angles_by_leg, centres, legs_of, set_legs};
use crate::mechanism::legs::{Legs, Legs2, SIGMA, both, largest, sum};
use crate::mechanism::placement::{ByLink, by_links};
use crate::mechanism::{ClosureBranch, ClosureTerms, Coordinates, Mechanism, Pose};
use crate::vector::Vector;

/// Number of link angles.
pub const ANGLES: usize = 4;
/// Number of closure equations.
pub const CLOSURES: usize = 2;
/// Link angles, or other quantities per link, in the order proximal left, proximal right, distal left, distal right.
pub type Angles = Vector<ANGLES>;
/// Quantities at the tip: closure equations or the force.
pub type AtTip = Vector<CLOSURES>;

/// Pair index of the proximal links in [`Angles`].
pub const PROXIMAL: usize = 0;
/// Pair index of the distal links in [`Angles`].
pub const DISTAL: usize = 1;

/// Indices in [`Angles`] of links 1 to 4 (left proximal, left distal, right distal, right proximal).
pub const LINK_INDICES: [usize; 4] = [2 * PROXIMAL, 2 * DISTAL, 2 * DISTAL + 1, 2 * PROXIMAL + 1];

/// Link angles from the twelve coordinates.
pub fn angles_of(x: &Coordinates) -> Angles {
    angles(angles_by_leg(x))
}

/// Splits into pairs: proximal links, distal links.
#[inline(always)]
pub fn legs(x: &Angles) -> [Legs; 2] {
    [legs_of(x, PROXIMAL), legs_of(x, DISTAL)]
}

/// Reorders to links 1 to 4.
pub fn in_link_order(x: &Angles) -> [f64; 4] {
    by_links(legs(x))
}

/// Joins the pairs of the proximal and the distal links.
#[inline(always)]
pub fn angles([p, d]: [Legs; 2]) -> Angles {
    let mut angles = Angles::ZERO;
    set_legs(&mut angles, PROXIMAL, p);
    set_legs(&mut angles, DISTAL, d);
    angles
}

/// Sums of two quantities over both legs.
#[inline(always)]
fn sums([x, y]: [Legs; 2]) -> Legs {
    let ([x_left, x_right], [y_left, y_right]) = (x.to_array(), y.to_array());
    Legs::new([x_left, y_left]) + Legs::new([x_right, y_right])
}

/// Exchanges the two entries of a pair.
#[inline(always)]
fn exchanged(x: Legs) -> Legs {
    let [one, other] = x.to_array();
    Legs::new([other, one])
}

/// The product Φ_q v: a 2 × 4 matrix, stored by links, times link quantities.
#[inline(always)]
fn at_tip([p, d]: &[Legs2; 2], [on_p, on_d]: [Legs; 2]) -> Legs {
    sums([p.x * on_p + d.x * on_d, p.y * on_p + d.y * on_d])
}

/// Constant part of the mass matrix in the link angles.
#[derive(Clone, Copy, Debug)]
pub struct Inertia {
    /// P = I_P + m_P a_P² + m_D l_P², kg·m².
    proximal: Legs,
    /// D = I_D + m_D a_D², kg·m².
    distal: Legs,
    /// m_D l_P a_D, kg·m². Its product with the cosine of the angle between the links is the coupling.
    carried: Legs,
    /// 1/P, 1/(kg·m²).
    mobility: Legs,
    /// Ratio `carried`/P.
    carried_per_p: Legs,
    /// δ = D − C²/P of a stretched leg, with the coupling C, kg·m², as a sum of positive terms; in other postures (m_D l_P × a_D)²/P adds
    /// to it.
    stretched: Legs,
}

impl Inertia {
    /// Computes the constant part of the mass matrix of a mechanism.
    pub fn new(mechanism: &Mechanism) -> Self {
        let &Mechanism { mass_p, mass_d, inertia_p, inertia_d, a_p, b_p, a_d, .. } = mechanism;
        let (own, swung) = (inertia_p + mass_p * a_p * a_p, mass_d * (a_p + b_p) * (a_p + b_p));
        let (proximal, distal) = (own + swung, inertia_d + mass_d * a_d * a_d);
        let stretched = (own * distal + swung * inertia_d) / proximal;
        let carried = mass_d * (a_p + b_p) * a_d;
        Self { proximal, distal, carried, mobility: both(1.0) / proximal, carried_per_p: carried / proximal, stretched }
    }

    /// Coupling m_D l_P·a_D of the links of a leg, kg·m².
    #[inline(always)]
    fn coupling(&self, pose: &Pose) -> Legs {
        self.carried * pose.u_p.dot(pose.u_d)
    }

    /// m_D l_P × a_D, kg·m²: torque on the other link of the leg per squared rate.
    #[inline(always)]
    fn centripetal(&self, pose: &Pose) -> Legs {
        self.carried * pose.u_p.cross(pose.u_d)
    }

    /// Product M x.
    #[inline(always)]
    pub fn mass_times(&self, pose: &Pose, x: &Angles) -> Angles {
        let ([p, d], coupling) = (legs(x), self.coupling(pose));
        angles([self.proximal * p + coupling * d, coupling * p + self.distal * d])
    }

    /// Kinetic energy by legs, J, at link rates, rad/s.
    #[inline(always)]
    pub fn kinetic_energy(&self, pose: &Pose, rates: &Angles) -> Legs {
        let ([p, d], coupling) = (legs(rates), self.coupling(pose));
        both(0.5) * (self.proximal * (p * p) + self.distal * (d * d)) + coupling * (p * d)
    }

    /// Torques on the links, N·m, plus the centripetal torques of the distal centre of mass at link rates, rad/s.
    #[inline(always)]
    pub fn with_centripetal(&self, [on_p, on_d]: [Legs; 2], pose: &Pose, rates: &Angles) -> Angles {
        let ([w_p, w_d], centripetal) = (legs(rates), self.centripetal(pose));
        angles([on_p + centripetal * (w_d * w_d), on_d - centripetal * (w_p * w_p)])
    }
}

/// A constant force in the link angles, by links, N·m: the cross product of a link's direction with this force is the torque on the link.
#[derive(Clone, Copy, Debug)]
pub struct Weight([Legs2; 2]);

impl Weight {
    /// From a constant force on the centres of mass, N. The proximal link carries the force on the distal link at its elbow.
    pub fn new(mechanism: &Mechanism, force: &Coordinates) -> Self {
        let &Mechanism { a_p, b_p, a_d, .. } = mechanism;
        let [on_p, on_d] = centres(force);
        let (own, hung) = (on_p.scaled(a_p), on_d.scaled(a_p + b_p));
        Self([own + hung, on_d.scaled(a_d)])
    }

    /// Torques on the links, N·m.
    #[inline(always)]
    pub fn torques(&self, pose: &Pose) -> ByLink {
        [pose.u_p.cross(self.0[0]), pose.u_d.cross(self.0[1])]
    }

    /// Work of the force from the motor axes, by legs, J.
    #[inline(always)]
    pub fn work(&self, pose: &Pose) -> Legs {
        pose.u_p.dot(self.0[0]) + pose.u_d.dot(self.0[1])
    }

    /// Stiffness of the links, N·m/rad, because their arms turn.
    pub fn stiffness(&self, pose: &Pose) -> ByLink {
        [pose.u_p.dot(self.0[0]), pose.u_d.dot(self.0[1])]
    }
}

/// The two equations that constrain the motion: the closure of the tip, or the branch of the closure on which the motion remains. Functions
/// that use these equations are compiled twice: with `MIRRORED` for branches with mirrored pairs, because their rows depend on the
/// direction of the mirror axis, and without it for all others.
#[derive(Clone, Copy, Debug)]
pub struct Closure {
    /// Signed link lengths in Φ_q, m; 0 on a closure branch with opposite pairs.
    sigma_length: [Legs; 2],
    /// Constant part of Φ_q on a closure branch, m; 0 otherwise.
    constant: &'static [Legs2; 2],
    /// Weights of both mirrored pairs, on a closure branch with mirrored pairs.
    mirrored: Option<&'static [[Legs; 2]; 2]>,
}

impl Closure {
    /// The closure of the tip, or of a branch.
    #[inline(always)]
    pub fn new(mechanism: &Mechanism, branch: Option<ClosureBranch>) -> Self {
        let ClosureTerms { open, constant, mirrored } = branch.map_or(ClosureTerms::OPEN, ClosureBranch::terms);
        let &Mechanism { a_p, b_p, a_d, sigma_b_d, .. } = mechanism;
        let sigma_length = [*open * (SIGMA * (a_p + b_p)), *open * (SIGMA * a_d + sigma_b_d)];
        Self { sigma_length, constant, mirrored: mirrored.as_ref() }
    }

    /// Whether the equations belong to a closure branch with mirrored pairs.
    #[inline(always)]
    pub fn is_mirrored(&self) -> bool {
        self.mirrored.is_some()
    }

    /// Vectors along the links, with the signs of the legs in the closure, m; 0 on a closure branch with opposite pairs.
    #[inline(always)]
    fn links(&self, pose: &Pose) -> [Legs2; 2] {
        let [p, d] = self.sigma_length;
        [pose.u_p.scaled(p), pose.u_d.scaled(d)]
    }

    /// Rows of the equations, by links, from the components x and y at the tip. With mirrored pairs the second row is the component along
    /// their mirror axis.
    #[inline(always)]
    fn rows<const MIRRORED: bool>(&self, pose: &Pose, at_tip: [Legs2; 2]) -> [Legs2; 2] {
        let Some(&[one, other]) = self.mirrored.filter(|_| MIRRORED) else { return at_tip };
        // The longer pair gives the normal of the axis: its links are never parallel to the axis, so the sum does not vanish.
        let length = |[p, d]: [Legs; 2]| largest((p * self.sigma_length[0]).abs().max((d * self.sigma_length[1]).abs()));
        let [on_p, on_d] = if length(one) > length(other) { one } else { other };
        let normal = pose.u_p.scaled(on_p) + pose.u_d.scaled(on_d);
        let [x, y] = [sum(normal.x), sum(normal.y)];
        let length = (x * x + y * y).sqrt();
        let [x, y] = [-y / length, x / length].map(both);
        at_tip.map(|vector| Legs2 { x: Legs::ZERO, y: vector.x * x + vector.y * y })
    }

    /// Gap Φ of the tip, m. On a closure branch with mirrored pairs only its component along the mirror axis is nonzero, in the second
    /// entry.
    #[inline(always)]
    pub fn gap<const MIRRORED: bool>(&self, mechanism: &Mechanism, pose: &Pose) -> AtTip {
        let [p, d] = self.rows::<MIRRORED>(pose, self.links(pose));
        [sum(SIGMA * mechanism.ground_x + p.x + d.x), sum(p.y + d.y)].into()
    }

    /// Φ_q by links, m.
    #[inline(always)]
    pub fn phi_q<const MIRRORED: bool>(&self, pose: &Pose) -> [Legs2; 2] {
        let ([p, d], [on_p, on_d]) = (self.rows::<MIRRORED>(pose, self.links(pose).map(Legs2::turned)), *self.constant);
        [on_p + p, on_d + d]
    }

    /// Φ_q v.
    #[inline(always)]
    pub fn phi_q_times<const MIRRORED: bool>(&self, pose: &Pose, v: &Angles) -> AtTip {
        at_tip(&self.phi_q::<MIRRORED>(pose), legs(v)).to_array().into()
    }

    /// Φ̇_q ω: the derivative of n̂ gives a centripetal acceleration −l ω². The turning of a mirror axis adds nothing if the loop is
    /// closed.
    #[inline(always)]
    pub fn phi_q_dot_times<const MIRRORED: bool>(&self, pose: &Pose, v: &Angles) -> AtTip {
        let squares = legs(v).map(|w| w * w);
        (-at_tip(&self.rows::<MIRRORED>(pose, self.links(pose)), squares)).to_array().into()
    }
}

/// Factors of the saddle-point matrix. The proximal angle is eliminated first, then the distal angle. Let p and d be the columns of Φ_q,
/// χ = C/P and r = d − χ p; then the Schur complement is S = Σ (p pᵀ/P + r rᵀ/δ) + e.
#[derive(Clone, Copy, Debug)]
pub struct Factor {
    /// 1/P and 1/δ, 1/(kg·m²).
    mobility: [Legs; 2],
    /// χ.
    chi: Legs,
    /// p/P and r/δ: accelerations per unit force at the tip.
    by_tip: [Legs2; 2],
    /// Parts of S⁻¹ for both components: diagonal of the adjugate, off-diagonal entry, and 1 over the determinant.
    dual: [Legs; 3],
}

impl Factor {
    /// Factorises at a pose, for e, 1/kg.
    #[inline(always)]
    pub fn new<const MIRRORED: bool>(inertia: &Inertia, closure: &Closure, pose: &Pose, regularization: f64) -> Self {
        let ([p, d], across) = (closure.phi_q::<MIRRORED>(pose), inertia.centripetal(pose));
        let (per_p, chi) = (inertia.mobility, inertia.carried_per_p * pose.u_p.dot(pose.u_d));
        let per_r = both(1.0) / (inertia.stretched + per_p * across * across);
        let r = d - p.scaled(chi);
        let by_tip @ [on_p, on_r] = [p.scaled(per_p), r.scaled(per_r)];
        let diagonal = sums([p.x * on_p.x + r.x * on_r.x, p.y * on_p.y + r.y * on_r.y]) + both(regularization);
        let beside = p.x * on_p.y + r.x * on_r.y;
        let (other, beside) = (exchanged(diagonal), beside + exchanged(beside));
        let reciprocal = both(1.0) / (diagonal * other - beside * beside);
        Self { mobility: [per_p, per_r], chi, by_tip, dual: [other, beside, reciprocal] }
    }

    /// Product S⁻¹ x.
    #[inline(always)]
    fn dual_times(&self, x: Legs) -> Legs {
        let [diagonal, beside, reciprocal] = self.dual;
        (diagonal * x - beside * exchanged(x)) * reciprocal
    }

    /// Accelerations with the force at the tip, from the accelerations of the free links (intermediate values of the elimination).
    #[inline(always)]
    fn constrained(&self, [free_p, free_r]: [Legs; 2], tip: Legs) -> Angles {
        let [x, y] = tip.to_array().map(both);
        let [on_p, on_r] = self.by_tip;
        let d = free_r - (on_r.x * x + on_r.y * y);
        angles([free_p - (on_p.x * x + on_p.y * y) - self.chi * d, d])
    }
}

impl Kkt<ANGLES, CLOSURES> for Factor {
    #[inline(always)]
    fn solve(&self, b: &Angles, c: &AtTip) -> (Angles, AtTip) {
        let ([p, d], [per_p, per_r]) = (legs(b), self.mobility);
        let r = d - self.chi * p;
        let tip = self.dual_times(at_tip(&self.by_tip, [p, r]) - Legs::new(**c));
        (self.constrained([per_p * p, per_r * r], tip), tip.to_array().into())
    }

    #[inline(always)]
    fn correction(&self, c: &AtTip) -> Angles {
        self.constrained([Legs::ZERO; 2], -self.dual_times(Legs::new(**c)))
    }
}

/// Equations of motion at link angles and rates, factorised once; torques are the right-hand sides:
///
/// ```text
/// let pose = mechanism.pose_at(legs(&angles));
/// let at = Equations::<false>::new(&inertia, &closure, &pose, &rates, e);
/// let (accelerations, tip_force) = at.solve(torques);                  // Q on the links, by legs
/// let near = at.linearised(&accelerations, &tip_force, [K, C]);      // slopes of Q
/// let change = near.change([&d_angles, &d_rates], &d_torques);         // δα and δλ
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Equations<'a, const MIRRORED: bool = false> {
    inertia: &'a Inertia,
    closure: &'a Closure,
    pose: &'a Pose,
    rates: &'a Angles,
    factor: Factor,
}

impl<'a, const MIRRORED: bool> Equations<'a, MIRRORED> {
    /// Equations at a pose and at link rates, rad/s, with e of the saddle-point system, 1/kg.
    pub fn new(inertia: &'a Inertia, closure: &'a Closure, pose: &'a Pose, rates: &'a Angles, regularization: f64) -> Self {
        Self { inertia, closure, pose, rates, factor: Factor::new::<MIRRORED>(inertia, closure, pose, regularization) }
    }

    /// Accelerations, rad/s², and the force of the tip's closure, N, or the multipliers of a closure branch, for torques on the links by
    /// legs, N·m.
    pub fn solve(&self, torques: [Legs; 2]) -> (Angles, AtTip) {
        let &Self { inertia, closure, pose, rates, factor } = self;
        factor.solve(&inertia.with_centripetal(torques, pose, rates), &-closure.phi_q_dot_times::<MIRRORED>(pose, rates))
    }

    /// Change of the accelerations, rad/s², for additional torques on the links, N·m.
    pub fn by_torques(&self, torques: &Angles) -> Angles {
        self.factor.solve(torques, &AtTip::ZERO).0
    }

    /// Linearises the solution `(α, λ)` of these equations. Stiffness K = −∂Q/∂θ, N·m/rad, and damping C = −∂Q/∂ω, N·m·s/rad, are those of
    /// the torques Q on links 1 to 4, including weight. On a branch with mirrored pairs the turn of the mirror axis is left out: its term
    /// is parallel to the first row and changes only λ₁.
    pub fn linearised(&self, a: &Angles, lambda: &AtTip, [stiffness, damping]: [[[f64; 4]; 4]; 2]) -> Linearised {
        let &Self { inertia, closure, pose, rates, factor } = self;
        let (mut by_q, mut by_v) = ([Angles::ZERO; ANGLES], [Angles::ZERO; ANGLES]);
        for (i, row) in LINK_INDICES.into_iter().enumerate() {
            for (j, column) in LINK_INDICES.into_iter().enumerate() {
                by_q[column][row] = -stiffness[i][j];
                by_v[column][row] = -damping[i][j];
            }
        }
        // Derivatives of mass matrix, centripetal torques and the arms of the closure, leg by leg.
        let ([w_p, w_d], [a_p, a_d]) = (legs(rates), legs(a));
        let (coupling, slope) = (inertia.coupling(pose), inertia.centripetal(pose));
        let on_p = (coupling * w_d * w_d + slope * a_d).to_array();
        let on_d = (slope * a_p - coupling * w_p * w_p).to_array();
        let (turn_p, turn_d) = ((both(2.0) * slope * w_d).to_array(), (both(2.0) * slope * w_p).to_array());
        let arms = closure.links(pose);
        let [along_p, along_d] =
            closure.rows::<MIRRORED>(pose, arms).map(|r| (r.x * both(lambda[0]) + r.y * both(lambda[1])).to_array());
        for leg in 0..2 {
            let (p, d) = (2 * PROXIMAL + leg, 2 * DISTAL + leg);
            by_q[p][p] += along_p[leg] - on_p[leg];
            by_q[d][p] += on_p[leg];
            by_q[p][d] -= on_d[leg];
            by_q[d][d] += along_d[leg] + on_d[leg];
            by_v[d][p] += turn_p[leg];
            by_v[p][d] -= turn_d[leg];
        }
        let (mut closure_by_q, mut closure_by_v) = ([AtTip::ZERO; ANGLES], [AtTip::ZERO; ANGLES]);
        let rows = closure.rows::<MIRRORED>(pose, arms).into_iter().zip(closure.rows::<MIRRORED>(pose, arms.map(Legs2::turned)));
        for (place, (r, n)) in [PROXIMAL, DISTAL].into_iter().zip(rows) {
            let (w, a) = (legs_of(rates, place), legs_of(a, place));
            let turned = [r.x * a + n.x * w * w, r.y * a + n.y * w * w].map(|x| x.to_array());
            let quickened = [both(2.0) * r.x * w, both(2.0) * r.y * w].map(|x| x.to_array());
            for leg in 0..2 {
                closure_by_q[2 * place + leg] = turned.map(|x| x[leg]).into();
                closure_by_v[2 * place + leg] = quickened.map(|x| x[leg]).into();
            }
        }
        Linearised { factor, by_q, by_v, closure_by_q, closure_by_v }
    }
}

/// The equations of motion linearised at a state:
///
/// ```text
/// M δα + Φ_qᵀ δλ = −K δθ − C δω + δQ + δc − δM α − δΦ_qᵀ λ,      Φ_q δα − e δλ = Σ (r α + n̂(r) ω²) δθ + 2 r ω δω
/// ```
///
/// Here r is the arm of each link in the closure, including its sign, and c are the centripetal torques. Implicit steps in the link angles,
/// the propagation of errors and directional derivatives use this linearisation. It does not include reactions of sticking contacts.
#[derive(Clone, Copy, Debug)]
pub struct Linearised {
    factor: Factor,
    /// Derivatives of the right-hand sides with respect to angles and to rates, by columns.
    by_q: [Angles; ANGLES],
    by_v: [Angles; ANGLES],
    closure_by_q: [AtTip; ANGLES],
    closure_by_v: [AtTip; ANGLES],
}

impl Linearised {
    /// Changes δα of the accelerations, rad/s², and δλ of the tip's force, N, for changes δθ, rad, and δω, rad/s, that keep the loop
    /// closed, and additional torques δQ, N·m, beyond the slopes.
    pub fn change(&self, [q, v]: [&Angles; 2], torques: &Angles) -> (Angles, AtTip) {
        use crate::matrix::combination;
        let right = *torques + combination(&self.by_q, q) + combination(&self.by_v, v);
        self.factor.solve(&right, &(combination(&self.closure_by_q, q) + combination(&self.closure_by_v, v)))
    }

    /// ∂α/∂θ, 1/s², and ∂α/∂ω, 1/s, by columns.
    pub fn columns(&self) -> [[Angles; ANGLES]; 2] {
        let solved = |b: &[Angles; ANGLES], c: &[AtTip; ANGLES]| std::array::from_fn(|i| self.factor.solve(&b[i], &c[i]).0);
        [solved(&self.by_q, &self.closure_by_q), solved(&self.by_v, &self.closure_by_v)]
    }
}
