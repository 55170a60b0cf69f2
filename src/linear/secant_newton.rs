//! Full Newton system of the energy-conserving step: used where the staggered iteration for Λ and ν contracts slowly, where inertias are
//! of very different size, and in the fallback stages.
//!
//! Newton's increments of the unknowns d, Λ, ν and of z = d − M⁻¹J_cᵀν satisfy, by links (`docs/conserving.md`, (37)),
//!
//! ```text
//! momentum   M Δz + J_bᵀΔΛ + (∂J_bᵀΛ/∂d) Δd + ½ Δ(K_b(z)ᵀν) + K Δd + C Δz = −f
//! z          M Δz = (M − ∂J_cᵀν/∂d) Δd − J_cᵀΔν
//! joints     J₁ Δd = −Φ,      2 J₁ Δz + (∂J₁/∂d w) Δd = −J₁w
//! ```
//!
//! with K and C the tangents of the forces as the step weights them. From the ground to the tip, the joint rows give the positions of Δd
//! and Δz by the rotations of the links; from the tip to the ground, the position rows give the joints' multipliers by those of the tip:
//! without a division. Twelve equations remain, the angle rows of momentum and of z and the tip's closure, for the rotations Δθ, those of
//! z, and ΔΛ and Δν of the tip. The regularisation e weighs increments and so moves no root; with it the matrix is regular also where the
//! closure loses rank.

use crate::dynamics::{INNER_COUNT, TipArm};
use crate::effects::Slopes;
use crate::matrix::Inverse;
use crate::mechanism::coordinates::{D_THETA, E_X, G_X, P_THETA, THETA, TIP_X, TIP_Y, X, Y, legs_of};
use crate::mechanism::legs::{Legs, Legs2};
use crate::mechanism::secant::Secant;
use crate::mechanism::{Coordinates, Mechanism, Multipliers, Pose};
use crate::vector::Vector;

/// Number of equations after the elimination of positions.
const UNKNOWNS: usize = 12;
/// One equation: coefficients of the unknowns (Δθ of links 1 to 4, rotations of z, ΔΛ and Δν of the tip), and the constant.
type Row = Vector<{ UNKNOWNS + 1 }>;
/// Index of Δθ of link 1 in a row.
const TURN: usize = 0;
/// Index of the rotation of z of link 1 in a row.
const MEAN_TURN: usize = 4;
/// Index of ΔΛ of the tip, x, in a row.
const TIP_LAMBDA: usize = 8;
/// Index of Δν of the tip, x, in a row.
const TIP_NU: usize = 10;
/// Index of the constant in a row.
const CONSTANT: usize = UNKNOWNS;

/// A quantity of one leg as an affine function of Δθ of its links, proximal first, of the rotations of z, and 1.
type Affine = Vector<5>;
/// Index of Δθ of the proximal link in an affine function; the distal link follows.
const OWN_TURN: usize = 0;
/// Index of the rotation of z of the proximal link in an affine function; the distal link follows.
const OWN_MEAN_TURN: usize = 2;
/// Index of the constant in an affine function.
const ONE: usize = 4;

/// Links of each leg, proximal first, and the leg's sign in the tip's closure.
const LEGS: [([usize; 2], f64); 2] = [([0, 1], 1.0), ([3, 2], -1.0)];
/// Index of the leg on whose distal link forces on the tip act.
const TIP_LEG: usize = 0;

/// Slopes of the mean forces over a step of h in the coordinates [`crate::dynamics::INNER`], as the step's equations weight them.
#[derive(Clone, Copy, Debug)]
pub struct StepSlopes {
    /// ½h² K by rows, kg and kg·m².
    stiffness: [[f64; INNER_COUNT]; INNER_COUNT],
    /// h C by rows, kg and kg·m².
    damping: [[f64; INNER_COUNT]; INNER_COUNT],
}

impl StepSlopes {
    /// Weighted slopes of a step of h seconds with these arms of the tip.
    pub fn new(slopes: &Slopes, arm: &TipArm, h: f64) -> Self {
        Self { stiffness: slopes.inner(arm, [0.5 * h * h, 0.0]), damping: slopes.inner(arm, [0.0, h]) }
    }
}

/// The point of linearisation.
pub struct StepPoint<'a> {
    /// Directions of the links over the step.
    pub secant: &'a Secant,
    /// Increments d of the coordinates, m and rad.
    pub d: &'a Coordinates,
    /// Final velocities times the step, h q̇₁, m and rad.
    pub w: &'a Coordinates,
    /// Multipliers Λ and ν.
    pub multipliers: [&'a Multipliers; 2],
    /// Of the mean forces.
    pub forces: &'a StepSlopes,
    /// e, 1/kg.
    pub regularization: f64,
}

/// Residuals f, Φ and J₁w of the equations.
pub type Residuals<'a> = (&'a Coordinates, &'a Multipliers, &'a Multipliers);

/// A vector in the plane.
type Planar = [f64; 2];
/// A vector in the plane whose components are affine functions.
type PlanarAffine = [Affine; 2];

/// Arms of both links of a leg, proximal first, m: from the first joint to the centre of mass, and from there to the second joint.
fn arms(pose: &Pose, leg: usize) -> [[Planar; 2]; 2] {
    let sign = LEGS[leg].1;
    let of = |arm: Legs2, sign: f64| [sign * arm.x.to_array()[leg], sign * arm.y.to_array()[leg]];
    [[of(pose.a_p, 1.0), of(pose.b_p, 1.0)], [of(pose.a_d, 1.0), of(pose.sigma_b_d, sign)]]
}

/// A vector rotated by +90°.
fn turned([x, y]: Planar) -> Planar {
    [-y, x]
}

fn dot(a: Planar, b: &PlanarAffine) -> Affine {
    a[0] * b[0] + a[1] * b[1]
}

/// Elimination within one leg.
struct Leg {
    /// Increments of the positions of its links, proximal first, along x and y.
    d: [PlanarAffine; 2],
    /// Increments of z at the positions of the links.
    z: [PlanarAffine; 2],
    /// Increments of the leg's end, in d and in z.
    end: [PlanarAffine; 2],
    /// Increments ΔΛ and Δν of ground and elbow, without −σ times those of the tip.
    multipliers: [[PlanarAffine; 2]; 2],
}

impl Leg {
    /// Eliminates positions by the joint rows J₁ Δd = −Φ and 2 J₁ Δz + … = −J₁w from the ground to the tip, then multipliers by the
    /// position rows from the tip to the ground.
    #[inline(always)]
    fn new(masses: &Coordinates, at: &StepPoint<'_>, leg: usize, (f, phi, rate): Residuals<'_>) -> Self {
        let (links, _) = LEGS[leg];
        let (mut d, mut z) = ([Affine::ZERO; 2], [Affine::ZERO; 2]);
        let mut positions = [[d, z]; 2];
        for (i, arms) in arms(&at.secant.end, leg).into_iter().enumerate() {
            let half_turn = 0.5 * at.w[THETA[links[i]]];
            for axis in [0, 1] {
                let joint = 2 * ([G_X, E_X][i] + axis) + leg;
                d[axis][ONE] -= phi[joint];
                z[axis][ONE] -= 0.5 * rate[joint];
            }
            for (j, arm) in arms.into_iter().enumerate() {
                let across = turned(arm);
                for axis in [0, 1] {
                    d[axis][OWN_TURN + i] += across[axis];
                    z[axis][OWN_MEAN_TURN + i] += across[axis];
                    z[axis][OWN_TURN + i] -= half_turn * arm[axis];
                }
                if j == 0 {
                    positions[i] = [d, z];
                }
            }
        }
        let end = [d, z];
        let ([d, z], mut multipliers) = ([0, 1].map(|of| positions.map(|of_link| of_link[of])), [[[Affine::ZERO; 2]; 2]; 2]);
        let forces = if leg == TIP_LEG { tip_loads(at.forces, &d[1], &z[1]) } else { [Affine::ZERO; 2] };
        for (axis, place) in [X, Y].into_iter().enumerate() {
            let [proximal, distal] = links.map(|link| place[link]);
            let mut lambda = -masses[distal] * z[1][axis] - forces[axis];
            lambda[ONE] -= f[distal];
            multipliers[0][1][axis] = lambda;
            lambda = lambda - masses[proximal] * z[0][axis];
            lambda[ONE] -= f[proximal];
            multipliers[0][0][axis] = lambda;
            let nu = masses[distal] * (d[1][axis] - z[1][axis]);
            multipliers[1][1][axis] = nu;
            multipliers[1][0][axis] = nu + masses[proximal] * (d[0][axis] - z[0][axis]);
        }
        Self { d, z, end, multipliers }
    }

    /// Adds the angle rows of momentum and of z of the leg's links.
    #[inline(always)]
    fn turning(&self, rows: &mut [Row; UNKNOWNS], masses: &Coordinates, at: &StepPoint<'_>, f: &Coordinates, leg: usize) {
        let &StepPoint { secant, d, multipliers: [lambda_now, nu_now], .. } = at;
        let (links, sign) = LEGS[leg];
        let of_leg = |[proximal, distal]: [Legs; 2]| [proximal.to_array()[leg], distal.to_array()[leg]];
        let angles = |x: &Coordinates| of_leg([legs_of(x, P_THETA), legs_of(x, D_THETA)]);
        // Angle entries of Φ_qᵀΛ and Φ_qᵀν in the middle of the step, and their derivatives by the angles.
        let [pull, pull_nu] = [lambda_now, nu_now].map(|y| angles(&secant.middle.phi_q_transposed_times(y)));
        let [turn, turn_nu] = [lambda_now, nu_now].map(|y| of_leg(secant.middle.geometric_stiffness(y).into()));
        let (sinc, cos) = (of_leg(secant.sinc), of_leg(secant.cos));
        let [lambda, nu] = &self.multipliers;
        for (i, arms) in arms(&secant.middle, leg).into_iter().enumerate() {
            let link = links[i];
            let (s, c, inertia, angle) = (sinc[i], cos[i], masses[THETA[link]], d[THETA[link]]);
            let [slope_s, slope_c] = slopes(angle, s, c);
            let z = angle - c * pull_nu[i] / inertia;
            // Columns of Φ_q are −across at both joints of a link, with derivatives +along. The tip's own multipliers follow below.
            let both = [0, 1].map(|axis| arms[0][axis] + arms[1][axis]);
            let across = |y: &[PlanarAffine; 2]| match i {
                0 => dot(turned(arms[0]), &y[0]) + dot(turned(arms[1]), &y[1]),
                _ => dot(turned(arms[0]), &y[1]),
            };
            let along = |y: &[PlanarAffine; 2]| match i {
                0 => dot(arms[0], &y[0]) + dot(arms[1], &y[1]),
                _ => dot(arms[0], &y[1]),
            };
            let turning = 0.5 * z * s;

            let mut momentum = turning * along(nu) - s * across(lambda);
            momentum[OWN_MEAN_TURN + i] += inertia + 0.5 * s * turn_nu[i];
            momentum[OWN_TURN + i] +=
                slope_s * pull[i] + 0.5 * s * turn[i] + 0.5 * z * (slope_s * turn_nu[i] - 0.5 * s * pull_nu[i]);
            momentum[ONE] += f[THETA[link]];
            let mut mean = c * across(nu);
            mean[OWN_TURN + i] += inertia - slope_c * pull_nu[i] - 0.5 * c * turn_nu[i];
            mean[OWN_MEAN_TURN + i] -= inertia;

            let [momentum_row, mean_row] = [MEAN_TURN, TURN].map(|first| first + link);
            add(&mut rows[momentum_row], leg, &momentum);
            add(&mut rows[mean_row], leg, &mean);
            for axis in [0, 1] {
                let across = sign * turned(both)[axis];
                rows[momentum_row][TIP_LAMBDA + axis] += s * across;
                rows[momentum_row][TIP_NU + axis] -= sign * turning * both[axis];
                rows[mean_row][TIP_NU + axis] -= c * across;
            }
            // Tangents of forces: between angles, and of the tip on its link.
            let (stiffness, damping) = (&at.forces.stiffness[2 + link], &at.forces.damping[2 + link]);
            for other in 0..4 {
                rows[momentum_row][TURN + other] += stiffness[2 + other];
                rows[momentum_row][MEAN_TURN + other] += damping[2 + other];
            }
            for axis in [0, 1] {
                if stiffness[axis] != 0.0 || damping[axis] != 0.0 {
                    let load = stiffness[axis] * self.d[1][axis] + damping[axis] * self.z[1][axis];
                    add(&mut rows[momentum_row], leg, &load);
                }
            }
        }
    }
}

/// Adds a quantity of a leg to a row.
fn add(row: &mut Row, leg: usize, affine: &Affine) {
    let (links, _) = LEGS[leg];
    for (i, link) in links.into_iter().enumerate() {
        row[TURN + link] += affine[OWN_TURN + i];
        row[MEAN_TURN + link] += affine[OWN_MEAN_TURN + i];
    }
    row[CONSTANT] += affine[ONE];
}

/// K Δd + C Δz on the position of the tip's link: what acts there depends on the tip's motion alone.
fn tip_loads(forces: &StepSlopes, d: &PlanarAffine, z: &PlanarAffine) -> PlanarAffine {
    [0, 1].map(|row| {
        let (stiffness, damping) = (&forces.stiffness[row], &forces.damping[row]);
        debug_assert!([2, 4, 5].iter().all(|&other| stiffness[other] == 0.0 && damping[other] == 0.0));
        let mut load = stiffness[0] * d[0] + stiffness[1] * d[1] + damping[0] * z[0] + damping[1] * z[1];
        load[OWN_TURN + 1] += stiffness[3];
        load[OWN_MEAN_TURN + 1] += damping[3];
        load
    })
}

/// Newton's increments Δd, m and rad, ΔΛ and Δν; not finite where the matrix is singular.
#[inline(never)]
pub fn newton(mechanism: &Mechanism, at: &StepPoint<'_>, residuals: Residuals<'_>) -> (Coordinates, [Multipliers; 2]) {
    let (f, phi, rate) = residuals;
    let masses = mechanism.mass_times(&[1.0; UNKNOWNS].into());
    let legs = [0, 1].map(|leg| Leg::new(&masses, at, leg, residuals));
    let mut rows = [Row::ZERO; UNKNOWNS];
    for (leg, part) in legs.iter().enumerate() {
        part.turning(&mut rows, &masses, at, f, leg);
        for axis in [0, 1] {
            for (of, row) in [TIP_LAMBDA + axis, TIP_NU + axis].into_iter().enumerate() {
                add(&mut rows[row], leg, &(LEGS[leg].1 * part.end[of][axis]));
            }
        }
    }
    for axis in [0, 1] {
        for (row, left) in [(TIP_LAMBDA + axis, phi[TIP_X + axis]), (TIP_NU + axis, 0.5 * rate[TIP_X + axis])] {
            rows[row][row] = -at.regularization;
            rows[row][CONSTANT] += left;
        }
    }
    let columns = std::array::from_fn(|j| Vector::from_fn(|i| rows[i][j]));
    let right = Vector::from_fn(|i| -rows[i][CONSTANT]);
    // A pivot of 0 gives increments that are not finite.
    let x: Vector<UNKNOWNS> = Inverse::new(columns, 0.0).times(&right);

    let (mut d, mut multipliers) = (Coordinates::ZERO, [Multipliers::ZERO; 2]);
    for (leg, part) in legs.iter().enumerate() {
        let ([p, q], sign) = LEGS[leg];
        let own = Affine::from([x[TURN + p], x[TURN + q], x[MEAN_TURN + p], x[MEAN_TURN + q], 1.0]);
        for (i, link) in [p, q].into_iter().enumerate() {
            d[THETA[link]] = x[TURN + link];
            (d[X[link]], d[Y[link]]) = (part.d[i][0].dot(&own), part.d[i][1].dot(&own));
            for (of, tip) in [TIP_LAMBDA, TIP_NU].into_iter().enumerate() {
                for axis in [0, 1] {
                    let joint = 2 * ([G_X, E_X][i] + axis) + leg;
                    multipliers[of][joint] = part.multipliers[of][i][axis].dot(&own) - sign * x[tip + axis];
                }
            }
        }
    }
    for (of, tip) in [TIP_LAMBDA, TIP_NU].into_iter().enumerate() {
        (multipliers[of][TIP_X], multipliers[of][TIP_Y]) = (x[tip], x[tip + 1]);
    }
    (d, multipliers)
}

/// Derivatives of s = sin(d/2)/(d/2) and of c = cos(d/2) with respect to d.
fn slopes(d: f64, s: f64, c: f64) -> [f64; 2] {
    // For small d the difference c − s cancels, and the series is used.
    let of_s = if d.abs() < 1e-2 { d * (d * d / 480.0 - 1.0 / 12.0) } else { (c - s) / d };
    [of_s, -0.25 * d * s]
}
