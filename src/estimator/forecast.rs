//! Forecasts by motions around the estimate: sigma points of the error's covariance (Julier and Uhlmann, Proc. IEEE 92 (2004) 401), one
//! in each direction of its square root and one opposite, moved by the equations of motion themselves.

use borsh::{BorshDeserialize, BorshSerialize};

use super::bank::Matrix;
use super::linkage::{Linkage, Links, Pair};
use super::track::{Track, wrapped};
use super::transition::{self, ERRORS, Loads, Scene};
use super::{Constants, track};

/// Motions beside that of the estimate.
pub const POINTS: usize = 2 * ERRORS;

/// One of them.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Point {
    theta: Links,
    omega: Links,
    /// The force that acts on it beyond that on the estimate, as inputs.
    force: [f64; 4],
}

/// The motions, once no samples come.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Forecast {
    points: Option<[Point; POINTS]>,
}

/// A scene with a force beside.
struct Pushed<'a, S> {
    scene: &'a S,
    linkage: &'a Linkage,
    force: [f64; 4],
}

impl<S: Scene> Scene for Pushed<'_, S> {
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

    fn is_steep(&self) -> bool {
        self.scene.is_steep()
    }
}

impl Point {
    /// Some seconds on; unchanged where that cannot be computed.
    fn step(&mut self, linkage: &Linkage, scene: &impl Scene, h: f64) {
        let scene = Pushed { scene, linkage, force: self.force };
        let steps = transition::steps(linkage, &scene, (&self.theta, &self.omega), h);
        let (theta, omega) = transition::motion(linkage, &scene, (self.theta, self.omega), h, steps);
        if let Some((theta, omega, _)) = linkage.closed(theta, omega) {
            (self.theta, self.omega) = (theta, omega);
        }
    }

    fn tip(&self, linkage: &Linkage) -> Pair {
        linkage.tip(&self.theta)
    }
}

/// Around an estimate.
#[inline(never)]
fn around(track: &Track, linkage: &Linkage) -> [Point; POINTS] {
    let frame = linkage.frame(&track.theta);
    let inputs = track::by_inputs(linkage, &frame);
    let root = cholesky(&track.covariance());
    std::array::from_fn(|k| {
        let size = if k < ERRORS { 1.0 } else { -1.0 } * (ERRORS as f64).sqrt();
        let error: [f64; ERRORS] = std::array::from_fn(|i| size * root[i][k % ERRORS]);
        // As far as the loop can be closed.
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
    })
}

/// L of P = L Lᵀ; 0 in columns of which nothing is left.
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
    /// Samples have come.
    pub(super) fn end(&mut self) {
        self.points = None;
    }

    /// The motions go on with that of the estimate, which is still where it was.
    pub(super) fn step(&mut self, track: &Track, linkage: &Linkage, scene: &impl Scene, h: f64) {
        for point in self.points.get_or_insert_with(|| around(track, linkage)) {
            point.step(linkage, scene, h);
        }
    }

    /// Standard deviations of angles and rates about the estimate.
    pub(super) fn sigmas(&self, track: &Track) -> Option<[Links; 2]> {
        let points = self.points.as_ref()?;
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
        let points = self.points.as_ref()?;
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
        self.points
            .iter()
            .flatten()
            .all(|point| point.force.iter().all(|x| x.is_finite()) && linkage.is_closed(&point.theta, &point.omega))
    }
}

/// Part of the motions around the estimate, itself included, that meet a direct singularity within the horizon: sin(θ₃ − θ₂) changes its
/// sign. The inputs and the unknown force are held; `step` seconds are looked at at once.
pub(super) fn singularity_probability(
    track: &Track,
    forecast: &Forecast,
    constants: &Constants,
    scene: &impl Scene,
    step: f64,
) -> f64 {
    let linkage = &constants.linkage;
    let points = forecast.points.unwrap_or_else(|| around(track, linkage));
    let side = linkage.posture(&track.theta).side();
    let count = (constants.parameters.horizon / step).ceil().max(0.0) as u64;
    let meets = |mut point: Point| {
        // On the other side already: it has been met.
        (0..=count).any(|_| {
            let met = !(linkage.posture(&point.theta).side() * side > 0.0);
            point.step(linkage, scene, step);
            met
        })
    };
    let own = Point { theta: track.theta, omega: track.omega, force: [0.0; 4] };
    let met = points.into_iter().chain([own]).filter(|point| meets(*point)).count();
    met as f64 / (POINTS + 1) as f64
}
