//! The saddle-point systems of the five-bar, [A Φ_qᵀ; Φ_q −e] with A = M or the tangent A₀, and the choice of the linear solve.
//!
//! | file | solves |
//! | --- | --- |
//! | `two_leg.rs` | joint by joint along both legs at once: A is diagonal |
//! | `coupled.rs` | slopes couple links: A is full in six inner coordinates |
//! | `dense.rs` | anything: inertias are far apart |
//! | `cut_loop.rs` | the equations and systems of the conserving step in the turns of the links, with the loop cut at the tip |

pub mod coupled;
pub mod cut_loop;
pub mod dense;
pub mod two_leg;

use nalgebra::{SMatrix, SVector};

use crate::dynamics::{INNER, INNER_COUNT, TipArm};
use crate::effects::Slopes;
use crate::integrator::{Kkt, StepError};
use crate::mechanism::placement::by_links;
use crate::mechanism::{COORDINATES, Coordinates, Geometry, LINKS, MULTIPLIERS, Mechanism, Multipliers, Pose};
use crate::vector::Vector;
use coupled::Coupled;
use cut_loop::OpenLegs;
use dense::Dense;
use two_leg::{Elimination, TwoLeg};

/// Linear solves of the saddle-point system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LinearSolve {
    /// Leg by leg ([`two_leg`]) if no slope of the forces couples links, otherwise by [`coupled`].
    Structured,
    /// General LU, for inertias of very different size; see [`dense`].
    Dense,
}

impl LinearSolve {
    /// Returns the fastest linear solve that the inertias of a machine allow.
    pub fn choose(geometry: &Geometry) -> Self {
        if compliance_spread(geometry) > LARGEST_SPREAD { Self::Dense } else { Self::Structured }
    }
}

/// Largest ratio of compliances for the structured eliminations. Their relative error is ε times the square of the ratio: 1e-8 here. The
/// paper's links have a ratio of 3.
const LARGEST_SPREAD: f64 = 1e4;

/// Ratio of the largest to the smallest compliance at the ends of the links: 1/m or arm²/I, 1/kg.
fn compliance_spread(geometry: &Geometry) -> f64 {
    let compliances = geometry.links.iter().flat_map(|link| {
        let arm = link.com.abs().max((link.length - link.com).abs());
        [1.0 / link.mass, (1.0 / link.mass).max(arm * arm / link.inertia)]
    });
    let (least, most) = compliances.fold((f64::INFINITY, 0.0_f64), |(least, most), x| (least.min(x), most.max(x)));
    most / least
}

/// Smallest tangent A₀ as a fraction of the mass matrix M if it is only checked: below, the step is too long for Newton's method.
const LEAST_INERTIA: f64 = 0.1;

/// Smallest tangent A₀ as a fraction of the mass matrix M if it is modified: keeps Newton's increment a descent direction.
const DESCENT_INERTIA: f64 = 0.3;

/// Treatment of a tangent A₀ that is not sufficiently positive definite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Definiteness {
    /// The solve fails: the step is too long.
    Required,
    /// A₀ is raised until it is sufficiently positive definite, which gives a descent direction.
    Enforced,
}

/// Inputs of the tangent system with A₀ = M + h/2 C + h²/4 (K + ∂(Φ_qᵀλ)/∂q).
pub struct TangentSystem<'a> {
    /// Slopes of the forces at the step's end.
    pub slopes: Slopes,
    /// Lever arms between the tip and the angle of link 2, at the step's end.
    pub arm: TipArm,
    /// Pose at the step's end.
    pub pose: &'a Pose,
    /// Multipliers, N for constraints in m.
    pub lambda: &'a Multipliers,
    /// Length of the step, s.
    pub h: f64,
    /// Regularisation e of the saddle-point matrix, 1/kg.
    pub regularization: f64,
    /// Treatment of a tangent A₀ that is not sufficiently positive definite.
    pub definite: Definiteness,
}

/// A mechanism and its linear solve.
#[derive(Clone, Debug)]
pub struct LinearSolver {
    solve: LinearSolve,
    elimination: Elimination,
    legs: OpenLegs,
}

/// The factorised saddle-point matrix with the diagonal M as its upper left block. With [`LinearSolve::Dense`] each solve factorises the
/// whole matrix instead, because such mechanisms are rare.
#[derive(Clone, Debug)]
pub struct MassFactor<'a, const BARE: bool> {
    solver: &'a LinearSolver,
    two_leg: TwoLeg,
    regularization: f64,
}

impl<const BARE: bool> Kkt<COORDINATES, MULTIPLIERS> for MassFactor<'_, BARE> {
    fn solve(&self, b: &Coordinates, c: &Multipliers) -> (Coordinates, Multipliers) {
        if !BARE && self.solver.solve == LinearSolve::Dense {
            return self.solver.solve_dense_mass(self.two_leg.pose(), self.regularization, b, c);
        }
        self.two_leg.solve(b, c)
    }

    fn correction(&self, c: &Multipliers) -> Coordinates {
        if !BARE && self.solver.solve == LinearSolve::Dense {
            return self.solver.solve_dense_mass(self.two_leg.pose(), self.regularization, &Coordinates::ZERO, c).0;
        }
        self.two_leg.correction(c)
    }
}

/// A matrix over the inner coordinates.
type InnerMatrix = SMatrix<f64, INNER_COUNT, INNER_COUNT>;

/// Solution x and y of a saddle-point system.
type Solution = (Coordinates, Multipliers);

impl LinearSolver {
    /// Creates the solver of a mechanism. Systems with the regularisation e given here, 1/kg, need no new constants.
    pub fn new(solve: LinearSolve, mechanism: &Mechanism, regularization: f64) -> Self {
        Self { solve, elimination: Elimination::new(mechanism, regularization), legs: OpenLegs::new(mechanism) }
    }

    /// Constants of the mechanism for the energy-conserving step, with its loop cut at the tip.
    pub fn legs(&self) -> &OpenLegs {
        &self.legs
    }

    /// The chosen solve.
    pub fn linear_solve(&self) -> LinearSolve {
        self.solve
    }

    /// Factorises the saddle-point matrix with M. `BARE` means that the solve is known at compile time to be leg by leg.
    pub fn factor_mass<const BARE: bool>(&self, pose: &Pose, regularization: f64) -> MassFactor<'_, BARE> {
        MassFactor { solver: self, two_leg: TwoLeg::factor_mass(&self.elimination, pose, regularization), regularization }
    }

    #[inline(never)]
    fn solve_dense_mass(&self, pose: &Pose, regularization: f64, b: &Coordinates, c: &Multipliers) -> Solution {
        Dense::factor(pose, &self.mass_matrix(), regularization).solve(b, c)
    }

    /// Solves the saddle-point system with A₀. Fails under [`Definiteness::Required`] if A₀ is not sufficiently positive definite, or if A₀
    /// cannot be raised.
    #[inline(always)]
    pub fn solve_tangent(&self, of: &TangentSystem<'_>, b: &Coordinates, c: &Multipliers) -> Result<Solution, StepError> {
        match self.solve {
            LinearSolve::Structured if !of.slopes.couple_links() => self.solve_tangent_by_legs(of, b, c),
            LinearSolve::Structured | LinearSolve::Dense => self.solve_full(of, b, c),
        }
    }

    /// Solves the saddle-point system leg by leg, for an A₀ that couples no links. Fails under [`Definiteness::Required`] if A₀ is not
    /// sufficiently positive definite.
    #[inline(always)]
    pub fn solve_tangent_by_legs(&self, of: &TangentSystem<'_>, b: &Coordinates, c: &Multipliers) -> Result<Solution, StepError> {
        Ok(self.factor_two_leg(of)?.solve(b, c))
    }

    /// Returns (M + h/2 C + h²/4 K) x.
    pub fn effective_mass_times(&self, slopes: &Slopes, arm: &TipArm, h: f64, x: &Coordinates) -> Coordinates {
        let mut product = self.elimination.mechanism.mass_times(x);
        for (row, values) in INNER.into_iter().zip(slopes.inner(arm, weights(h))) {
            product[row] += INNER.into_iter().zip(values).map(|(column, value)| value * x[column]).sum::<f64>();
        }
        product
    }

    #[inline(always)]
    fn factor_two_leg(&self, of: &TangentSystem<'_>) -> Result<TwoLeg, StepError> {
        let &TangentSystem { ref slopes, ref arm, pose, lambda, h, regularization, definite } = of;
        let [loads_p, loads_d] = slopes.diagonal(arm, weights(h));
        let beta = h * h / 4.0;
        let (stiffness_p, stiffness_d) = pose.geometric_stiffness(lambda);
        let (mass_p, mass_d) = (self.elimination.mechanism.inertia_p, self.elimination.mechanism.inertia_d);
        let mut inertia_p = mass_p + beta * stiffness_p + loads_p;
        let mut inertia_d = mass_d + beta * stiffness_d + loads_d;
        match definite {
            Definiteness::Enforced => {
                inertia_p = inertia_p.max(DESCENT_INERTIA * mass_p);
                inertia_d = inertia_d.max(DESCENT_INERTIA * mass_d);
            }
            Definiteness::Required => {
                let margin = (inertia_p - LEAST_INERTIA * mass_p).fast_min(inertia_d - LEAST_INERTIA * mass_d);
                let [left, right] = margin.to_array();
                if !(left > 0.0 && right > 0.0) {
                    return Err(StepError::IndefiniteTangent);
                }
            }
        }
        Ok(TwoLeg::factor(&self.elimination, pose, [inertia_p, inertia_d], regularization))
    }

    /// Solves the system with an A₀ that has a full block in the inner coordinates.
    #[inline(never)]
    fn solve_full(&self, of: &TangentSystem<'_>, b: &Coordinates, c: &Multipliers) -> Result<Solution, StepError> {
        let inner = self.inner_tangent(of)?;
        if self.solve == LinearSolve::Dense {
            let mut a0 = self.mass_matrix();
            for (i, row) in INNER.into_iter().enumerate() {
                for (j, column) in INNER.into_iter().enumerate() {
                    a0[(row, column)] = inner[(i, j)];
                }
            }
            return Ok(Dense::factor(of.pose, &a0, of.regularization).solve(b, c));
        }
        let columns = std::array::from_fn(|j| Vector::from_fn(|i| inner[(i, j)]));
        Ok(Coupled::factor(of.pose, &self.masses(), columns, of.regularization).solve(b, c))
    }

    /// Block of A₀ in the inner coordinates, checked or raised to be sufficiently positive definite. The outer coordinates keep their
    /// masses.
    fn inner_tangent(&self, of: &TangentSystem<'_>) -> Result<InnerMatrix, StepError> {
        let &TangentSystem { ref slopes, ref arm, pose, lambda, h, definite, .. } = of;
        let masses = self.masses();
        let mass = InnerMatrix::from_diagonal(&SVector::from(INNER.map(|i| masses[i])));
        let inner = slopes.inner(arm, weights(h));
        let mut a0 = InnerMatrix::from_fn(|i, j| mass[(i, j)] + inner[i][j]);
        for (i, stiffness) in by_links(pose.geometric_stiffness(lambda).into()).into_iter().enumerate() {
            let place = INNER_COUNT - LINKS + i;
            a0[(place, place)] += h * h / 4.0 * stiffness;
        }
        let is_definite = |a0: &InnerMatrix, part: f64| ((a0 + a0.transpose()) / 2.0 - mass * part).cholesky().is_some();
        match definite {
            Definiteness::Required if !is_definite(&a0, LEAST_INERTIA) => return Err(StepError::IndefiniteTangent),
            Definiteness::Required => {}
            // The doubling ends: some multiple of M outweighs any finite tangent.
            Definiteness::Enforced => {
                let mut more = DESCENT_INERTIA;
                while !is_definite(&a0, DESCENT_INERTIA) {
                    a0 += mass * more;
                    more *= 2.0;
                    if !more.is_finite() {
                        return Err(StepError::NotFinite);
                    }
                }
            }
        }
        Ok(a0)
    }

    /// Diagonal of M, kg and kg·m².
    fn masses(&self) -> Coordinates {
        self.elimination.mechanism.mass_times(&[1.0; COORDINATES].into())
    }

    fn mass_matrix(&self) -> SMatrix<f64, COORDINATES, COORDINATES> {
        SMatrix::from_diagonal(&SVector::from(*self.masses()))
    }
}

/// Weights of K and C in A₀ for a step of h seconds.
fn weights(h: f64) -> [f64; 2] {
    [h * h / 4.0, h / 2.0]
}
