//! Flow of the motion and of its errors: Runge–Kutta of order 4 on the equations of motion in the link angles and on their variational
//! equations.
//!
//! ```text
//! M α + Jᵀλ = Q + c        M δα + Jᵀδλ = −K δθ − C δω + E δu + δc − δM α − δJᵀ λ
//! J α       = −J̇ ω         J δα        = −δJ α − δ(J̇ ω)
//! ```
//!
//! K and C are the tangents of the implicit steps. The six variations are N in the angles, N in the rates, and the unknown force.

use super::linkage::{Frame, LEGS, Linkage, Links, Pair};
use super::posture::Posture;

/// Number of error components: two of the angles, two of the rates, two of the unknown force.
pub const ERRORS: usize = 6;

/// Derivatives of a quantity with respect to the error components.
type Error = [f64; ERRORS];
/// Derivatives of a link quantity: a row per link, a column per error component.
type Columns = [Error; 4];

/// Least number of steps per second, 1/s: without and with stiff loads.
const LEAST_STEP_RATES: [f64; 2] = [600.0, 2500.0];
/// Steps per time constant of a damper: stability of Runge–Kutta needs 0.36. A spring has one step per reciprocal of its natural frequency.
const STEPS_PER_DAMPER_TIME: f64 = 0.8;
/// Steps per radian of the fastest link in a regular posture.
const STEPS_PER_RADIAN: f64 = 8.0;
/// Largest number of steps in one call.
const MOST_STEPS: f64 = 64.0;

/// Applied torques on the links with their tangents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Loads {
    /// Torques Q, N·m.
    pub torque: Links,
    /// Stiffness K = −∂Q/∂θ, N·m/rad.
    pub stiffness: [Links; 4],
    /// Damping C = −∂Q/∂ω, N·m·s/rad.
    pub damping: [Links; 4],
}

/// Loads of a scene under held inputs.
pub trait Scene {
    /// Loads at link angles, rad, and rates, rad/s.
    fn loads(&self, theta: &Links, omega: &Links) -> Loads;

    /// Torques without tangents, N·m.
    fn torque(&self, theta: &Links, omega: &Links) -> Links;

    /// Whether some load changes steeply.
    fn has_stiff_forces(&self) -> bool;
}

/// End of a propagated motion.
#[derive(Clone, Copy, Debug)]
pub struct Flow {
    /// Link angles, rad.
    pub theta: Links,
    /// Rates, rad/s.
    pub omega: Links,
    /// Number of Runge–Kutta steps.
    pub steps: u32,
    /// Derivatives of the angles with respect to the initial errors.
    pub(super) d_theta: Columns,
    /// Derivatives of the rates with respect to the initial errors.
    pub(super) d_omega: Columns,
}

impl Flow {
    /// Derivatives of the final angles and rates with respect to one of the initial errors.
    pub fn column(&self, error: usize) -> (Links, Links) {
        let of = |columns: &Columns| -> Links { std::array::from_fn(|link| columns[link][error]) };
        (of(&self.d_theta), of(&self.d_omega))
    }
}

/// Integrated state, and its time derivative.
#[derive(Clone, Copy)]
struct Point {
    theta: Links,
    omega: Links,
    d_theta: Columns,
    d_omega: Columns,
}

impl Point {
    fn plus(&self, h: f64, rate: &Self) -> Self {
        let sum = |x: &Links, y: &Links| -> Links { std::array::from_fn(|i| x[i] + h * y[i]) };
        let sums =
            |x: &Columns, y: &Columns| -> Columns { std::array::from_fn(|i| std::array::from_fn(|k| x[i][k] + h * y[i][k])) };
        Self {
            theta: sum(&self.theta, &rate.theta),
            omega: sum(&self.omega, &rate.omega),
            d_theta: sums(&self.d_theta, &rate.d_theta),
            d_omega: sums(&self.d_omega, &rate.d_omega),
        }
    }
}

/// Number of Runge–Kutta steps that h seconds need.
#[inline(never)]
pub fn steps(linkage: &Linkage, at: &Frame, scene: &impl Scene, (theta, omega): (&Links, &Links), h: f64) -> u32 {
    steps_for(linkage, at, &scene.loads(theta, omega), scene.has_stiff_forces(), (omega, h))
}

/// Number of Runge–Kutta steps that h seconds need under given loads.
fn steps_for(linkage: &Linkage, at: &Frame, loads: &Loads, stiff_forces: bool, (omega, h): (&Links, f64)) -> u32 {
    let Loads { stiffness, damping, .. } = loads;
    let inertia = linkage.least_inertia(at);
    let mut rate = LEAST_STEP_RATES[usize::from(stiff_forces)];
    let mut fastest = 0.0_f64;
    for i in 0..4 {
        rate = rate.max(STEPS_PER_DAMPER_TIME * damping[i][i].abs() / inertia[i]).max((stiffness[i][i].abs() / inertia[i]).sqrt());
        fastest = fastest.max(omega[i].abs());
    }
    rate = rate.max(STEPS_PER_RADIAN * fastest / at.smallest.clamp(0.01, 1.0).sqrt());
    (h * rate).ceil().clamp(1.0, MOST_STEPS).max(1.0) as u32
}

/// Motion without variations: h seconds from angles, rad, and rates, rad/s, in equal steps.
#[inline(never)]
pub fn motion(linkage: &Linkage, scene: &impl Scene, (mut theta, mut omega): (Links, Links), h: f64, steps: u32) -> (Links, Links) {
    let h = h / f64::from(steps);
    let plus = |x: &Links, h: f64, y: &Links| -> Links { std::array::from_fn(|i| x[i] + h * y[i]) };
    for _ in 0..steps {
        let a1 = acceleration(linkage, scene, &theta, &omega);
        let (t2, w2) = (plus(&theta, h / 2.0, &omega), plus(&omega, h / 2.0, &a1));
        let a2 = acceleration(linkage, scene, &t2, &w2);
        let (t3, w3) = (plus(&theta, h / 2.0, &w2), plus(&omega, h / 2.0, &a2));
        let a3 = acceleration(linkage, scene, &t3, &w3);
        let (t4, w4) = (plus(&theta, h, &w3), plus(&omega, h, &a3));
        let a4 = acceleration(linkage, scene, &t4, &w4);
        for i in 0..4 {
            theta[i] += h / 6.0 * (omega[i] + 2.0 * (w2[i] + w3[i]) + w4[i]);
            omega[i] += h / 6.0 * (a1[i] + 2.0 * (a2[i] + a3[i]) + a4[i]);
        }
    }
    (theta, omega)
}

/// Motion with variations, in the steps that it needs but at least `least`. `force` holds the inputs that exert a unit of each unknown
/// force.
/// two unknown forces act, by input.
#[inline(never)]
pub fn flow(
    linkage: &Linkage,
    scene: &impl Scene,
    (theta, omega, frame): (&Links, &Links, &Frame),
    force: &[Pair; 4],
    h: f64,
    least: u32,
) -> Flow {
    let mut loads = scene.loads(theta, omega);
    let steps = steps_for(linkage, frame, &loads, scene.has_stiff_forces(), (omega, h)).max(least);
    let mut point = Point { theta: *theta, omega: *omega, d_theta: [[0.0; ERRORS]; 4], d_omega: [[0.0; ERRORS]; 4] };
    for (k, direction) in frame.basis.iter().enumerate() {
        // J δω = −δJ ω: rates that keep the turned links closed.
        let turned = frame.least_squares(frame.inward(omega, direction));
        for i in 0..4 {
            point.d_theta[i][k] = direction[i];
            point.d_omega[i][k] = turned[i];
            point.d_omega[i][2 + k] = direction[i];
        }
    }
    let h = h / f64::from(steps);
    for step in 0..steps {
        let rate_at = |point: &Point| rate(linkage, &scene.loads(&point.theta, &point.omega), force, point);
        if step > 0 {
            loads = scene.loads(&point.theta, &point.omega);
        }
        let k1 = rate(linkage, &loads, force, &point);
        let k2 = rate_at(&point.plus(h / 2.0, &k1));
        let k3 = rate_at(&point.plus(h / 2.0, &k2));
        let k4 = rate_at(&point.plus(h, &k3));
        point = point.plus(h / 6.0, &k1.plus(2.0, &k2).plus(2.0, &k3).plus(1.0, &k4));
    }
    let Point { theta, omega, d_theta, d_omega } = point;
    Flow { theta, omega, steps, d_theta, d_omega }
}

/// Factors of the saddle-point system of M and J.
struct Factor<'a> {
    at: &'a Posture,
    mobility: [[f64; 3]; 2],
    /// Components xx, xy, yy of (J M⁻¹ Jᵀ)⁻¹.
    dual: [f64; 3],
}

impl<'a> Factor<'a> {
    fn new(linkage: &Linkage, at: &'a Posture) -> Self {
        let mobility = linkage.mobility(at);
        let (row_x, row_y) = (at.transposed([1.0, 0.0]), at.transposed([0.0, 1.0]));
        let (x, y) = (solve_mass(&mobility, &row_x), solve_mass(&mobility, &row_y));
        let sum = |a: &Links, b: &Links| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (xx, xy, yy) = (sum(&row_x, &x), sum(&row_x, &y), sum(&row_y, &y));
        // Floor of the determinant: no division by 0 in a vertex.
        let least = 1e-20 * (xx + yy) * (xx + yy);
        let determinant = (xx * yy - xy * xy).max(least);
        Self { at, mobility, dual: [yy / determinant, -xy / determinant, xx / determinant] }
    }

    /// Solution x, y of M x + Jᵀ y = b, J x = c.
    #[inline(never)]
    fn solve(&self, b: &Links, c: Pair) -> (Links, Pair) {
        let free = solve_mass(&self.mobility, b);
        let [x, y] = self.at.end_velocity(&free);
        let (x, y) = (x - c[0], y - c[1]);
        let [xx, xy, yy] = self.dual;
        let lambda = [xx * x + xy * y, xy * x + yy * y];
        let back = solve_mass(&self.mobility, &self.at.transposed(lambda));
        (std::array::from_fn(|i| free[i] - back[i]), lambda)
    }

    /// Solutions x of the saddle-point system for all error components; rows of b by link, of c by direction.
    fn solve_columns(&self, b: &Columns, c: &[Error; 2]) -> Columns {
        let free = solve_mass_columns(&self.mobility, b);
        let [end_x, end_y] = self.at.end_rows(&[1.0; 4]);
        let (x, y) = (sum(end_x, &free), sum(end_y, &free));
        let [xx, xy, yy] = self.dual;
        let (mut l_x, mut l_y) = ([0.0; ERRORS], [0.0; ERRORS]);
        for k in 0..ERRORS {
            let (x, y) = (x[k] - c[0][k], y[k] - c[1][k]);
            (l_x[k], l_y[k]) = (xx * x + xy * y, xy * x + yy * y);
        }
        let mut held = [[0.0; ERRORS]; 4];
        for i in 0..4 {
            for k in 0..ERRORS {
                held[i][k] = end_x[i] * l_x[k] + end_y[i] * l_y[k];
            }
        }
        let back = solve_mass_columns(&self.mobility, &held);
        let mut solution = free;
        for i in 0..4 {
            for k in 0..ERRORS {
                solution[i][k] -= back[i][k];
            }
        }
        solution
    }
}

/// Linear combination Σ fᵢ rowᵢ.
#[inline]
fn sum(factors: Links, rows: &Columns) -> Error {
    let mut sum = [0.0; ERRORS];
    for k in 0..ERRORS {
        sum[k] = factors[0] * rows[0][k] + factors[1] * rows[1][k] + factors[2] * rows[2][k] + factors[3] * rows[3][k];
    }
    sum
}

/// Product M⁻¹ x.
#[inline]
fn solve_mass(mobility: &[[f64; 3]; 2], x: &Links) -> Links {
    let mut product = [0.0; 4];
    for ([p, d], [own_p, own_d, coupling]) in LEGS.into_iter().zip(mobility) {
        product[p] = own_p * x[p] + coupling * x[d];
        product[d] = coupling * x[p] + own_d * x[d];
    }
    product
}

/// Product M⁻¹ with each column.
#[inline]
fn solve_mass_columns(mobility: &[[f64; 3]; 2], x: &Columns) -> Columns {
    let mut product = [[0.0; ERRORS]; 4];
    for ([p, d], [own_p, own_d, coupling]) in LEGS.into_iter().zip(mobility) {
        for k in 0..ERRORS {
            product[p][k] = own_p * x[p][k] + coupling * x[d][k];
            product[d][k] = coupling * x[p][k] + own_d * x[d][k];
        }
    }
    product
}

/// Torques Q + c, with the centripetal ones, N·m.
fn with_coriolis(linkage: &Linkage, at: &Posture, mut torque: Links, omega: &Links) -> Links {
    for (carried, [p, d]) in linkage.carried.into_iter().zip(LEGS) {
        let centripetal = carried * at.sine(p, d);
        torque[p] += centripetal * omega[d] * omega[d];
        torque[d] -= centripetal * omega[p] * omega[p];
    }
    torque
}

#[inline(never)]
fn acceleration(linkage: &Linkage, scene: &impl Scene, theta: &Links, omega: &Links) -> Links {
    let frame = linkage.posture(theta);
    let torque = with_coriolis(linkage, &frame, scene.torque(theta, omega), omega);
    Factor::new(linkage, &frame).solve(&torque, frame.inward(omega, omega)).0
}

/// Time derivative of the integrated state.
#[inline(never)]
fn rate(linkage: &Linkage, loads: &Loads, force: &[Pair; 4], point: &Point) -> Point {
    let Point { theta, omega, d_theta, d_omega } = point;
    let frame = linkage.posture(theta);
    let &Loads { torque, stiffness, damping } = loads;
    let factor = Factor::new(linkage, &frame);
    let (alpha, lambda) = factor.solve(&with_coriolis(linkage, &frame, torque, omega), frame.inward(omega, omega));

    // Negative derivatives of the right-hand side with respect to angles and rates.
    let (mut by_angle, mut by_rate) = (stiffness, damping);
    for (i, tension) in frame.along(lambda).into_iter().enumerate() {
        by_angle[i][i] -= tension;
    }
    for (carried, [p, d]) in linkage.carried.into_iter().zip(LEGS) {
        let (sine, cosine) = (carried * frame.sine(p, d), carried * frame.cosine(p, d));
        let on_p = cosine * omega[d] * omega[d] + sine * alpha[d];
        let on_d = -cosine * omega[p] * omega[p] + sine * alpha[p];
        by_angle[p][p] += on_p;
        by_angle[p][d] -= on_p;
        by_angle[d][p] += on_d;
        by_angle[d][d] -= on_d;
        by_rate[p][d] -= 2.0 * sine * omega[d];
        by_rate[d][p] += 2.0 * sine * omega[p];
    }
    let mut right: Columns = std::array::from_fn(|i| {
        let (turned, quickened) = (sum(by_angle[i], d_theta), sum(by_rate[i], d_omega));
        std::array::from_fn(|k| -turned[k] - quickened[k])
    });
    for (right, row) in right.iter_mut().zip(frame.inputs()) {
        for k in 0..2 {
            right[4 + k] += row.iter().zip(force).map(|(row, force)| row * force[k]).sum::<f64>();
        }
    }
    // Σ sᵢ lᵢ (ûᵢ (αᵢ δθᵢ + 2 ωᵢ δωᵢ) + n̂ᵢ ωᵢ² δθᵢ).
    let [squares, doubled]: [Links; 2] = [std::array::from_fn(|i| omega[i] * omega[i]), omega.map(|rate| 2.0 * rate)];
    let ([inward_x, inward_y], [across_x, across_y]) = (frame.inward_rows(&alpha), frame.end_rows(&squares));
    let quickened = frame.inward_rows(&doubled);
    let by_turn = |inward: Links, across: Links| -> Links { std::array::from_fn(|i| inward[i] + across[i]) };
    let turned = [by_turn(inward_x, across_x), by_turn(inward_y, across_y)];
    let opened = [0, 1].map(|k| {
        let (turned, quickened) = (sum(turned[k], d_theta), sum(quickened[k], d_omega));
        std::array::from_fn(|k| turned[k] + quickened[k])
    });
    let d_alpha = factor.solve_columns(&right, &opened);
    Point { theta: *omega, omega: alpha, d_theta: *d_omega, d_omega: d_alpha }
}
