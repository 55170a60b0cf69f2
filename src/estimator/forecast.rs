//! Forecast of the covariance by sigma points: motions displaced by ± each column of its square root and integrated by the equations of
//! motion (Julier and Uhlmann, Proc. IEEE 92 (2004) 401).

use borsh::{BorshDeserialize, BorshSerialize};

use super::bank::Matrix;
use super::linkage::{Linkage, Links, Pair};
use super::track::{Track, wrapped};
use super::transition::{self, ERRORS, Loads, Scene};
use super::{Constants, track};

/// Variance rate of the unknown force by errors of masses in a forecast, 1/s, relative to the squared inertia torques: samples have
/// revealed only the mass errors that mattered until now.
const MASS_WALK: f64 = 0.2;
/// Number of sigma points.
pub const POINTS: usize = 2 * ERRORS;

/// A sigma point.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Point {
    theta: Links,
    omega: Links,
    /// Force in addition to that of the estimate, as inputs, N·m and N.
    force: [f64; 4],
}

/// Sigma points with the random walk of the unknown force.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct SigmaPoints {
    points: [Point; POINTS],
    /// Covariance of the part of the force that is independent of the other errors, on the tangent basis, (N·m)²: xx, xy, yy.
    force: [f64; 3],
    /// Variance rates of the force, 1/s: relative to the squared torque scale, and to the squared inertia torques.
    walk: Pair,
    /// Inputs that exert a unit of each force on the tangent basis.
    inputs: [Pair; 4],
}

/// Forecast, with sigma points while no samples arrive.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Forecast {
    sigma_points: Option<SigmaPoints>,
}

/// A scene with an additional force.
struct WithForce<'a, S> {
    scene: &'a S,
    linkage: &'a Linkage,
    force: [f64; 4],
}

impl<S: Scene> Scene for WithForce<'_, S> {
    fn loads(&self, theta: &Links, omega: &Links) -> Loads {
        let mut loads = self.scene.loads(theta, omega);
        loads.torque = self.torque(theta, omega);
        loads
    }

    fn torque(&self, theta: &Links, omega: &Links) -> Links {
        let inputs = self.linkage.posture(theta).inputs();
        let torque = self.scene.torque(theta, omega);
        std::array::from_fn(|i| torque[i] + inputs[i].iter().zip(self.force).map(|(row, force)| row * force).sum::<f64>())
    }

    fn has_stiff_forces(&self) -> bool {
        self.scene.has_stiff_forces()
    }
}

impl Point {
    /// Integrates by h seconds; keeps the state where that fails.
    fn step(&mut self, linkage: &Linkage, scene: &impl Scene, h: f64) {
        let scene = WithForce { scene, linkage, force: self.force };
        let steps = transition::steps(linkage, &linkage.frame(&self.theta), &scene, (&self.theta, &self.omega), h);
        let (theta, omega) = transition::motion(linkage, &scene, (self.theta, self.omega), h, steps);
        if let Some((theta, omega, _)) = linkage.closed(theta, omega) {
            (self.theta, self.omega) = (theta, omega);
        }
    }

    fn tip(&self, linkage: &Linkage) -> Pair {
        linkage.tip(&self.theta)
    }
}

impl SigmaPoints {
    /// Sigma points around an estimate, whose force has these variance rates.
    #[cold]
    #[inline(never)]
    fn around(track: &Track, linkage: &Linkage, walk: Pair) -> Self {
        let frame = linkage.frame(&track.theta);
        let inputs = track::by_inputs(linkage, &frame);
        let root = cholesky(&track.covariance());
        let points = std::array::from_fn(|k| {
            let error = root.map(|row| displacement(k) * row[k % ERRORS]);
            // Largest of three displacements for which the loop can be closed.
            let (theta, omega) = [1.0, 0.5, 0.25]
                .into_iter()
                .find_map(|part| {
                    let (turned, quickened) =
                        (frame.tangent([part * error[0], part * error[1]]), frame.tangent([part * error[2], part * error[3]]));
                    let moved: Links = std::array::from_fn(|i| track.theta[i] + turned[i]);
                    let (theta, omega, _) = linkage.closed(moved, std::array::from_fn(|i| track.omega[i] + quickened[i]))?;
                    Some((theta, omega))
                })
                .unwrap_or((track.theta, track.omega));
            Point { theta, omega, force: inputs.map(|row| row[0] * error[4] + row[1] * error[5]) }
        });
        let [.., [.., x, _], [.., xy, y]] = root;
        Self { points, force: [x * x, x * xy, xy * xy + y * y], walk, inputs }
    }

    /// Time update of all sigma points. The force of a point in a force direction grows in proportion to the standard deviation of the force's
    /// random walk, so that its distribution is that of the walk at each instant. `scales`: torque scale and inertia torques, N·m.
    fn step(&mut self, linkage: &Linkage, scene: &impl Scene, (h, scales): (f64, Pair)) {
        let grown: f64 = self.walk.iter().zip(scales).map(|(walk, scale)| walk * scale * scale * h).sum();
        self.force[0] += grown;
        self.force[2] += grown;
        let [xx, xy, yy] = self.force;
        let x = xx.sqrt();
        let skew = if x > 0.0 { xy / x } else { 0.0 };
        let root = [[x, skew], [0.0, (yy - skew * skew).max(0.0).sqrt()]];
        for (k, point) in self.points.iter_mut().enumerate() {
            if let Some(column) = (k % ERRORS).checked_sub(4) {
                let [x, y] = root[column].map(|element| displacement(k) * element);
                point.force = self.inputs.map(|row| row[0] * x + row[1] * y);
            }
            point.step(linkage, scene, h);
        }
    }

    fn is_sound(&self, linkage: &Linkage) -> bool {
        let [xx, xy, yy] = self.force;
        let numbers = self.inputs.as_flattened().iter().chain(&self.force).chain(&self.walk);
        numbers.into_iter().all(|x| x.is_finite())
            && xx >= 0.0
            && yy >= 0.0
            && xy * xy <= 1.01 * xx * yy
            && self.walk.iter().all(|walk| *walk >= 0.0)
            && self
                .points
                .iter()
                .all(|point| point.force.iter().all(|x| x.is_finite()) && linkage.is_closed(&point.theta, &point.omega))
    }
}

/// Displacement of sigma point `k` in columns of the square root.
fn displacement(k: usize) -> f64 {
    if k < ERRORS { (ERRORS as f64).sqrt() } else { -(ERRORS as f64).sqrt() }
}

/// Cholesky factor L of P = L Lᵀ, with zero columns where P is singular.
#[inline(never)]
fn cholesky(p: &Matrix) -> Matrix {
    let mut l = [[0.0; ERRORS]; ERRORS];
    for i in 0..ERRORS {
        for k in 0..=i {
            let rest = p[i][k] - (0..k).map(|j| l[i][j] * l[k][j]).sum::<f64>();
            l[i][k] = match i == k {
                true => rest.max(0.0).sqrt(),
                false if l[k][k] > 1e-150 => rest / l[k][k],
                false => 0.0,
            };
        }
    }
    l
}

impl Forecast {
    /// Ends the forecast: samples have arrived.
    pub(super) fn end(&mut self) {
        self.sigma_points = None;
    }

    /// Time update of the sigma points, before that of the estimate.
    pub(super) fn step(&mut self, track: &Track, constants: &Constants, scene: &impl Scene, over: (f64, Pair)) {
        let linkage = &constants.linkage;
        self.sigma_points
            .get_or_insert_with(|| SigmaPoints::around(track, linkage, [track.bank.walk(), MASS_WALK]))
            .step(linkage, scene, over);
    }

    /// Standard deviations of angles, rad, and rates, rad/s, about the estimate.
    pub(super) fn sigmas(&self, track: &Track) -> Option<[Links; 2]> {
        let SigmaPoints { points, .. } = self.sigma_points.as_ref()?;
        let root_mean = |off: &dyn Fn(&Point, usize) -> f64| -> Links {
            std::array::from_fn(|i| (points.iter().map(|point| off(point, i).powi(2)).sum::<f64>() / POINTS as f64).sqrt())
        };
        Some([
            root_mean(&|point, i| wrapped(point.theta[i] - track.theta[i])),
            root_mean(&|point, i| point.omega[i] - track.omega[i]),
        ])
    }

    /// Covariance of the tip about the estimate, m²: xx, xy, yy.
    pub(super) fn tip_covariance(&self, track: &Track, linkage: &Linkage) -> Option<[f64; 3]> {
        let SigmaPoints { points, .. } = self.sigma_points.as_ref()?;
        let centre = linkage.tip(&track.theta);
        let mut sum = [0.0; 3];
        for point in points {
            let tip = point.tip(linkage);
            let [x, y] = [tip[0] - centre[0], tip[1] - centre[1]];
            sum = [sum[0] + x * x, sum[1] + x * y, sum[2] + y * y];
        }
        Some(sum.map(|sum| sum / POINTS as f64))
    }

    pub(super) fn is_sound(&self, linkage: &Linkage) -> bool {
        self.sigma_points.iter().all(|sigma_points| sigma_points.is_sound(linkage))
    }
}

/// Fraction of sigma points, estimate included, whose sin(θ₃ − θ₂) changes sign within the horizon, under held inputs and unknown force;
/// `step` is the time between two checks, s.
pub(super) fn singularity_probability(
    track: &Track,
    forecast: &Forecast,
    constants: &Constants,
    scene: &impl Scene,
    step: f64,
) -> f64 {
    let linkage = &constants.linkage;
    let mut sigma_points = forecast.sigma_points.unwrap_or_else(|| SigmaPoints::around(track, linkage, [0.0; 2]));
    // The force is held: its random walk makes covariances consistent, but blurs the prediction of a singularity.
    sigma_points.walk = [0.0; 2];
    let mut own = Point { theta: track.theta, omega: track.omega, force: [0.0; 4] };
    let side = linkage.posture(&track.theta).side();
    let mut met = [false; POINTS + 1];
    let mut look = |sigma_points: &SigmaPoints, own: &Point| {
        for (met, point) in met.iter_mut().zip(sigma_points.points.iter().chain([own])) {
            // A point on the other side has met the singularity already.
            let now = linkage.posture(&point.theta).side() * side;
            *met |= now.is_nan() || now <= 0.0;
        }
    };
    look(&sigma_points, &own);
    for _ in 0..(constants.parameters.horizon / step).ceil().max(0.0) as u64 {
        sigma_points.step(linkage, scene, (step, [0.0; 2]));
        own.step(linkage, scene, step);
        look(&sigma_points, &own);
    }
    met.iter().filter(|met| **met).count() as f64 / met.len() as f64
}
