//! Forecast of the covariance by sigma points: motions displaced by ± each column of its square root and integrated by the equations of
//! motion (Julier and Uhlmann, Proc. IEEE 92 (2004) 401).

use borsh::{BorshDeserialize, BorshSerialize};
use nalgebra::{Cholesky, Matrix2, Matrix4, Matrix4x2};

use super::belief::Belief;
use super::error_state::{FORCE, MOVING};
use super::flow::{self, Scene, unit_forces};
use super::machine::{Machine, Parameters};
use super::stored;
use super::tangent::{Frame, LinkState, Linkage, Links, Pair, wrapped};
use super::tuning::{FORECAST_MASS_WALK, LEAST_SIGMA, MOST_CHECKS, MOST_STEPS_OF_POINT};
use super::unknown_commands::{Step, Unknown};

/// Number of sigma points.
const POINTS: usize = 2 * MOVING;

#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct Point {
    motion: LinkState,
    /// Force in addition to the estimate's force, as inputs, N·m and N.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    force: Links,
}

/// Sigma points with the random walk of the unknown force.
#[derive(Clone, Copy, Debug, PartialEq, BorshSerialize, BorshDeserialize)]
struct SigmaPoints {
    points: [Point; POINTS],
    /// Covariance of the part of the force that is independent of the other errors, on the tangent basis, (N·m)².
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    force: Matrix2<f64>,
    /// Variance rates of the force, 1/s: relative to the squared torque scale, and to the squared inertia torques.
    walk: [f64; 2],
    /// Inputs that exert a unit of each force on the tangent basis.
    #[borsh(serialize_with = "stored::write", deserialize_with = "stored::read")]
    inputs: Matrix4x2<f64>,
}

/// Forecast, with sigma points while no samples arrive.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub(super) struct Forecast {
    sigma_points: Option<SigmaPoints>,
    /// Errors by commands that are unknown.
    commands: Option<Unknown>,
}

impl Point {
    /// Integrates over h seconds under the estimate's force and the point's own. Keeps the state if the loop cannot be closed. Returns the
    /// number of Runge–Kutta steps.
    fn step(&mut self, linkage: &Linkage, scene: &impl Scene, force: &Links, h: f64) -> u32 {
        let force = force + self.force;
        let near = scene.linearised(&self.motion, &force, &Matrix4x2::zeros());
        let steps = flow::steps(&linkage.frame(&self.motion.theta), &near, scene, (&self.motion, h));
        if let Some((motion, _)) = linkage.closed(flow::motion(scene, &self.motion, &force, h, steps)) {
            self.motion = motion;
        }
        steps
    }
}

impl SigmaPoints {
    /// Sigma points around an estimate; `walk` are the variance rates of the force.
    fn around(linkage: &Linkage, motion: &LinkState, belief: &Belief, walk: [f64; 2]) -> Self {
        let frame = linkage.frame(&motion.theta);
        let inputs = unit_forces(linkage, &frame);
        let root = root(belief.bank.covariance().fixed_view::<MOVING, MOVING>(0, 0).into_owned());
        let points = std::array::from_fn(|k| {
            let error = root.column(k % MOVING) * displacement(k);
            // Largest of three displacements for which the loop can be closed.
            let moved = [1.0, 0.5, 0.25].into_iter().find_map(|part| {
                let part: [f64; 4] = std::array::from_fn(|i| part * error[i]);
                linkage.closed(frame.displaced(motion, part)).map(|(moved, _)| moved)
            });
            Point { motion: moved.unwrap_or(*motion), force: inputs * error.fixed_rows::<2>(FORCE) }
        });
        let own = root.fixed_view::<2, 2>(FORCE, FORCE);
        Self { points, force: own * own.transpose(), walk, inputs }
    }

    /// Time update of all sigma points. `scales`: torque scale and inertia torques, N·m.
    fn step(&mut self, linkage: &Linkage, scene: &impl Scene, force: &Links, (h, scales): (f64, [f64; 2])) {
        let grown: f64 = self.walk.iter().zip(scales).map(|(walk, scale)| walk * scale * scale * h).sum();
        self.force += Matrix2::identity() * grown;
        self.spread_force();
        for point in &mut self.points {
            point.step(linkage, scene, force, h);
        }
    }

    /// Scales the force of each point in a force direction to the present standard deviation of the force, so that the points follow its
    /// random walk.
    fn spread_force(&mut self) {
        let root = root(self.force);
        for (k, point) in self.points.iter_mut().enumerate() {
            if let Some(column) = (k % MOVING).checked_sub(FORCE) {
                point.force = self.inputs * root.column(column) * displacement(k);
            }
        }
    }

    fn is_sound(&self, linkage: &Linkage) -> bool {
        let numbers = self.inputs.iter().chain(&self.force).chain(&self.walk);
        numbers.into_iter().all(|x| x.is_finite())
            && self.force.diagonal().iter().chain(&self.walk).all(|variance| *variance >= 0.0)
            && self.points.iter().all(|point| point.force.iter().all(|x| x.is_finite()) && linkage.is_closed(&point.motion))
    }
}

/// Displacement of sigma point `k` in columns of the square root.
fn displacement(k: usize) -> f64 {
    if k < MOVING { (MOVING as f64).sqrt() } else { -(MOVING as f64).sqrt() }
}

/// Square root L of P = L Lᵀ. A variance that is 0, because a direction is known exactly, or negative by round-off, is replaced by a
/// negligible one.
fn root<const N: usize>(p: nalgebra::SMatrix<f64, N, N>) -> nalgebra::SMatrix<f64, N, N> {
    Cholesky::new_with_substitute(p, LEAST_SIGMA * LEAST_SIGMA).map_or_else(nalgebra::SMatrix::zeros, |factor| factor.l())
}

impl Forecast {
    /// Ends the forecast: samples have arrived. Returns the covariance of the errors of angles and rates by commands that were unknown.
    pub(super) fn end(&mut self) -> Option<Matrix4<f64>> {
        std::mem::take(self).commands.map(|unknown| *unknown.covariance())
    }

    /// Covariance of the errors of angles and rates by commands that are, or were, unknown.
    pub(super) fn by_commands(&self) -> Option<&Matrix4<f64>> {
        self.commands.as_ref().map(Unknown::covariance)
    }

    /// Time update of the errors by commands; see [`Unknown::after`].
    pub(super) fn step_commands<S: Scene>(&mut self, parameters: &Parameters, step: &Step<'_, S>, unknown: (bool, f64)) {
        self.commands = Some(Unknown::after(self.commands, parameters, step, unknown));
    }

    /// Time update of the sigma points, before the time update of the estimate.
    pub(super) fn step(
        &mut self,
        machine: &Machine,
        (motion, belief): (&LinkState, &Belief),
        scene: &impl Scene,
        over: (f64, [f64; 2]),
    ) {
        let linkage = &machine.linkage;
        self.sigma_points
            .get_or_insert_with(|| SigmaPoints::around(linkage, motion, belief, [belief.bank.walk(), FORECAST_MASS_WALK]))
            .step(linkage, scene, &belief.force, over);
    }

    /// Standard deviations of angles, rad, and rates, rad/s, about the estimate at a frame.
    pub(super) fn sigmas(&self, motion: &LinkState, frame: &Frame) -> Option<[Links; 2]> {
        let SigmaPoints { points, .. } = self.sigma_points.as_ref()?;
        let root_mean = |off: &dyn Fn(&LinkState) -> Links, by_commands: Links| -> Links {
            let squares: Links = points.iter().map(|point| off(&point.motion)).map(|off| off.component_mul(&off)).sum();
            (squares / POINTS as f64 + by_commands).map(f64::sqrt)
        };
        let by_commands = |first: usize| {
            let variances = |covariance: &Matrix4<f64>| {
                (frame.basis * covariance.fixed_view::<2, 2>(first, first) * frame.basis.transpose()).diagonal()
            };
            self.by_commands().map_or_else(Links::zeros, variances)
        };
        let angles = root_mean(&|at| (at.theta - motion.theta).map(wrapped), by_commands(0));
        Some([angles, root_mean(&|at| at.omega - motion.omega, by_commands(2))])
    }

    /// Covariance of the tip about the estimate, m².
    pub(super) fn tip_covariance(&self, motion: &LinkState, linkage: &Linkage) -> Option<Matrix2<f64>> {
        let SigmaPoints { points, .. } = self.sigma_points.as_ref()?;
        let centre = linkage.tip(&motion.theta);
        let squares = points.iter().map(|point| {
            let off: Pair = linkage.tip(&point.motion.theta) - centre;
            off * off.transpose()
        });
        let about = squares.sum::<Matrix2<f64>>() / POINTS as f64;
        let by_commands = |covariance: &Matrix4<f64>| {
            let tip = linkage.frame(&motion.theta).tip();
            about + tip * covariance.fixed_view::<2, 2>(0, 0) * tip.transpose()
        };
        Some(self.by_commands().map_or(about, by_commands))
    }

    pub(super) fn is_sound(&self, linkage: &Linkage) -> bool {
        self.sigma_points.iter().all(|sigma_points| sigma_points.is_sound(linkage)) && self.commands.iter().all(Unknown::is_sound)
    }

    /// Fraction of sigma points, estimate included, with a change of sign of sin(θ₃ − θ₂) within the horizon, under inputs that include the
    /// unknown force; `scene` is a function of the time from now, s. `step` is the time between two checks, s; it becomes longer if there
    /// would be more than [`MOST_CHECKS`] checks. If a point turns so fast that it needs more steps than [`MOST_STEPS_OF_POINT`] allows, it
    /// counts as meeting a singularity.
    pub(super) fn singularity_probability<S: Scene>(
        &self,
        machine: &Machine,
        (motion, belief): (&LinkState, &Belief),
        scene: impl Fn(f64) -> S,
        step: f64,
    ) -> f64 {
        let linkage = &machine.linkage;
        // The force is constant here: its random walk keeps covariances consistent, but would blur the prediction of a singularity.
        let mut sigma_points = self.sigma_points.unwrap_or_else(|| SigmaPoints::around(linkage, motion, belief, [0.0; 2]));
        let side = motion.side()[0];
        // A point on the other side has already passed the singularity.
        let is_across = |point: &Point| {
            let now = point.motion.side()[0] * side;
            now.is_nan() || now <= 0.0
        };
        let horizon = machine.parameters.horizon.max(0.0);
        let checks = (horizon / step).ceil().min(MOST_CHECKS) as u64;
        let step = step.max(horizon / MOST_CHECKS);
        let most = MOST_STEPS_OF_POINT * checks as f64 * flow::steps_at_rest(&scene(0.0), step);
        sigma_points.spread_force();
        let own = Point { motion: *motion, force: Links::zeros() };
        let points = sigma_points.points.into_iter().chain([own]);
        let meets = |mut point: Point| {
            let mut steps = 0.0;
            is_across(&point)
                || (0..checks).any(|check| {
                    let scene = scene((check as f64 + 0.5) * step);
                    steps += f64::from(point.step(linkage, &scene, &Links::zeros(), step));
                    is_across(&point) || steps > most
                })
        };
        points.filter(|point| meets(*point)).count() as f64 / (POINTS + 1) as f64
    }
}
