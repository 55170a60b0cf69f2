//! Closed loop in its four link angles: closure, Jacobian J, null space N, mass matrix, Newton steps onto the closure.
//!
//! ```text
//! Φ = Σ sᵢ lᵢ ûᵢ − (d, 0)        J = [ sᵢ lᵢ n̂ᵢ ]        s = (+, +, −, −)
//! J⁺ = Jᵀ(JJᵀ)⁻¹                 I − J⁺J = N Nᵀ
//! ```
//!
//! J has rank 2 in direct and inverse singularities, and loses rank in vertices alone, with all links in line. N thus exists wherever the
//! encoders determine the motion.

use std::ops::Deref;

use super::posture::Posture;
use crate::mechanism::Geometry;
use crate::mechanism::legs::{Legs, sin_cos};

/// Angles, rates or torques of links 1 to 4.
pub type Links = [f64; 4];

/// Two components on the tangent basis or in the plane.
pub type Pair = [f64; 2];

/// Signs of the links in the closure.
pub(super) const CLOSURE_SIGNS: Links = [1.0, 1.0, -1.0, -1.0];

/// Proximal and distal link of the left and right leg.
pub const LEGS: [[usize; 2]; 2] = [[0, 1], [3, 2]];

/// Links whose angles the encoders measure.
pub const MEASURED: [usize; 2] = [0, 3];

/// Newton steps onto the closure: largest number, and tolerance relative to the mean length.
const NEWTON_LIMITS: (usize, f64) = (8, 1e-13);

/// Smallest singular value of J over the mean length below which branches of a vertex cannot be told apart.
pub(super) const NEAR_VERTEX: f64 = 0.03;

/// Largest closure error of a stored state relative to the mean length: anywhere, and next to a vertex, which motions cross straight.
const CLOSURE_TOLERANCES: [f64; 2] = [1e-4, 1e-2];

/// Scalar product.
#[inline]
pub(super) fn dot(x: &Links, y: &Links) -> f64 {
    x[0] * y[0] + x[1] * y[1] + x[2] * y[2] + x[3] * y[3]
}

/// Constant data of the mechanism.
#[derive(Clone, Debug, PartialEq)]
pub struct Linkage {
    /// Signed lengths sᵢ lᵢ, m.
    arm: Links,
    base: f64,
    /// Diagonal of M in the link angles, kg·m².
    inertia: Links,
    /// m_D l_P a_D of the left and right leg, kg·m².
    pub(super) carried: Pair,
    /// Mean length of the links, m.
    pub(super) length: f64,
    /// Torque that carries the machine's own weight, N·m: the mean over the legs of (m_P a_P + m_D l_P)·9.81 m/s².
    pub(super) weight_torque: f64,
}

impl Linkage {
    /// Constant data of a geometry that includes the masses of payload and rotors.
    pub fn new(geometry: &Geometry) -> Self {
        let links = geometry.links;
        let mut inertia = [0.0; 4];
        let (mut carried, mut moment) = ([0.0; 2], 0.0);
        for (leg, [p, d]) in LEGS.into_iter().enumerate() {
            inertia[p] =
                links[p].inertia + links[p].mass * links[p].com * links[p].com + links[d].mass * links[p].length * links[p].length;
            inertia[d] = links[d].inertia + links[d].mass * links[d].com * links[d].com;
            carried[leg] = links[d].mass * links[p].length * links[d].com;
            moment += (links[p].mass * links[p].com.abs() + links[d].mass * links[p].length) / 2.0;
        }
        Self {
            arm: std::array::from_fn(|i| CLOSURE_SIGNS[i] * links[i].length),
            base: geometry.base_distance,
            inertia,
            carried,
            length: links.iter().map(|link| link.length).sum::<f64>() / 4.0,
            weight_torque: 9.81 * moment,
        }
    }

    /// Posture at link angles, rad.
    #[inline(never)]
    pub fn posture(&self, theta: &Links) -> Posture {
        let (sin_p, cos_p) = sin_cos(Legs::new([theta[0], theta[3]]));
        let (sin_d, cos_d) = sin_cos(Legs::new([theta[1], theta[2]]));
        let ([x0, x3], [y0, y3]) = (cos_p.to_array(), sin_p.to_array());
        let ([x1, x2], [y1, y2]) = (cos_d.to_array(), sin_d.to_array());
        Posture { directions: [[x0, y0], [x1, y1], [x2, y2], [x3, y3]], arm: self.arm }
    }

    /// Tangent space at link angles, rad.
    #[inline(never)]
    pub fn frame(&self, theta: &Links) -> Frame {
        Frame::new(self, self.posture(theta))
    }

    /// Mass matrix times a vector.
    #[inline(never)]
    pub(super) fn mass_times(&self, at: &Posture, x: &Links) -> Links {
        let mut product: Links = std::array::from_fn(|i| self.inertia[i] * x[i]);
        for (leg, [p, d]) in LEGS.into_iter().enumerate() {
            let coupling = self.carried[leg] * at.cosine(p, d);
            product[p] += coupling * x[d];
            product[d] += coupling * x[p];
        }
        product
    }

    /// Entries of M⁻¹ of each leg, 1/(kg·m²): proximal, distal, coupling.
    #[inline(never)]
    pub(super) fn mobility(&self, at: &Posture) -> [[f64; 3]; 2] {
        [0, 1].map(|leg| {
            let [p, d] = LEGS[leg];
            let (a, b, c) = (self.inertia[p], self.inertia[d], self.carried[leg] * at.cosine(p, d));
            let determinant = a * b - c * c;
            [b / determinant, a / determinant, -c / determinant]
        })
    }

    /// Least effective inertia of each link, kg·m², with its neighbour free.
    pub(super) fn least_inertia(&self, at: &Posture) -> Links {
        let mut least = self.inertia;
        for ([p, d], [own_p, own_d, _]) in LEGS.into_iter().zip(self.mobility(at)) {
            least[p] = 1.0 / own_p;
            least[d] = 1.0 / own_d;
        }
        least
    }

    /// Newton iteration from angles, rad, and rates, rad/s, to the nearest closed ones; `None` where it fails.
    #[inline(never)]
    pub fn closed(&self, mut theta: Links, omega: Links) -> Option<(Links, Links, Frame)> {
        for _ in 0..NEWTON_LIMITS.0 {
            let posture = self.posture(&theta);
            let gap = self.gap(&posture);
            let size = gap[0].abs().max(gap[1].abs());
            if size <= NEWTON_LIMITS.1 * self.length {
                let frame = Frame::new(self, posture);
                let back = frame.least_squares(frame.end_velocity(&omega));
                let omega: Links = std::array::from_fn(|i| omega[i] - back[i]);
                return (theta.iter().chain(&omega).all(|x| x.is_finite())).then_some((theta, omega, frame));
            }
            if !size.is_finite() || size > self.length {
                return None;
            }
            let back = posture.least_squares(&posture.gram(self.length).0, gap);
            theta = std::array::from_fn(|i| theta[i] - back[i]);
        }
        None
    }

    /// Position of the tip, m.
    pub fn tip(&self, theta: &Links) -> Pair {
        let u = self.posture(theta).directions;
        [0, 1].map(|k| self.arm[0] * u[0][k] + self.arm[1] * u[1][k])
    }

    /// Whether angles and rates close the loop, up to the errors of low-accuracy settings and of straight motions through a vertex.
    #[cold]
    pub fn is_closed(&self, theta: &Links, omega: &Links) -> bool {
        let at = self.frame(theta);
        let open = CLOSURE_TOLERANCES[usize::from(at.smallest < NEAR_VERTEX)] * self.length;
        let ([x, y], [v, w]) = (self.gap(&at), at.end_velocity(omega));
        let fastest = omega.iter().fold(0.0_f64, |most, rate| most.max(rate.abs()));
        x.abs().max(y.abs()) < open && v.abs().max(w.abs()) <= open * (1.0 + fastest)
    }

    /// Closure gap Φ, m.
    fn gap(&self, at: &Posture) -> Pair {
        let u = &at.directions;
        let sum = |k: usize| (0..4).map(|i| self.arm[i] * u[i][k]).sum::<f64>();
        [sum(0) - self.base, sum(1)]
    }
}

/// A posture with its tangent space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    posture: Posture,
    /// Components xx, xy, yy of (JJᵀ)⁻¹, 1/m².
    inverse_gram: [f64; 3],
    /// Smallest singular value of J over the mean length: 0 in a vertex.
    pub smallest: f64,
    /// Tangent basis N: two orthonormal directions of motion of the closed loop.
    pub basis: [Links; 2],
}

impl Deref for Frame {
    type Target = Posture;

    fn deref(&self) -> &Posture {
        &self.posture
    }
}

impl Frame {
    fn new(linkage: &Linkage, posture: Posture) -> Self {
        let (inverse_gram, smallest) = posture.gram(linkage.length);
        let mut frame = Self { posture, inverse_gram, smallest, basis: [[0.0; 4]; 2] };
        frame.basis = frame.null_space();
        frame
    }

    /// Null space by Gram–Schmidt on the columns of I − J⁺J, the longest first.
    fn null_space(&self) -> [Links; 2] {
        let column = |k: usize| {
            let [x, y] = self.directions[k];
            let back = self.least_squares([-self.arm[k] * y, self.arm[k] * x]);
            let mut column = back.map(|value| -value);
            column[k] += 1.0;
            column
        };
        let columns = [column(0), column(1), column(2), column(3)];
        // The squared length of a column equals its diagonal element of the projector.
        let longest = |of: &dyn Fn(usize) -> f64| (1..4).fold(0, |best, k| if of(k) > of(best) { k } else { best });
        let unit = |x: Links| {
            let length = dot(&x, &x).sqrt();
            x.map(|value| value / length)
        };
        let first = unit(columns[longest(&|k| columns[k][k])]);
        let rest = |k: usize| columns[k][k] - first[k] * first[k];
        let second = columns[longest(&rest)];
        // Orthogonalised twice, because once leaves the round-off of nearly parallel columns.
        let across = |x: Links| {
            let along = dot(&first, &x);
            std::array::from_fn(|i| x[i] - along * first[i])
        };
        [first, unit(across(across(second)))]
    }

    /// Least-squares solution J⁺ r.
    pub(super) fn least_squares(&self, gap: Pair) -> Links {
        self.posture.least_squares(&self.inverse_gram, gap)
    }

    /// Coordinates Nᵀ x.
    pub fn coordinates(&self, x: &Links) -> Pair {
        [dot(&self.basis[0], x), dot(&self.basis[1], x)]
    }

    /// Vector N x.
    pub fn tangent(&self, [first, second]: Pair) -> Links {
        std::array::from_fn(|i| self.basis[0][i] * first + self.basis[1][i] * second)
    }

    /// Map N'ᵀ N from this tangent basis to another.
    pub(super) fn basis_map_to(&self, other: &Self) -> [Pair; 2] {
        other.basis.map(|row| self.basis.map(|column| dot(&row, &column)))
    }

    /// Derivatives of the tip position with respect to the tangent coordinates, m: rows x and y.
    pub fn tip(&self) -> [Pair; 2] {
        let [first, second] = self.basis.map(|direction| self.tip_velocity(&direction));
        [[first[0], second[0]], [first[1], second[1]]]
    }
}
