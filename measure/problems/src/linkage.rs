//! Bodies in x, y, θ, joined by revolutes: any number, any topology.
//!
//! Coordinates: x, y of the centre of mass in m and the angle θ in rad, counter-clockwise, body by body. Each joint gives two constraint
//! equations, in the order of the list. Forces are gravity, constant torques and springs to the ground. All are conservative, so that the
//! tangent is exact, symmetric, and has one 3×3 block per body.

mod factor;
mod pose;

pub use factor::Factor;
pub use pose::Pose;

use fivebar::integrator::{Events, Implicit, Kkt, Passage, Path, StepError, System, TangentPoint, Work};
use fivebar::vector::Vector;
pub(crate) use pose::rotated;
use pose::{Side, quarter_turn};

/// A point in the plane or a vector, m.
pub type Planar = [f64; 2];

/// A rigid body.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    /// Mass, kg.
    pub mass: f64,
    /// Moment of inertia about the centre of mass, kg m².
    pub inertia: f64,
    /// Constant torque from the ground, N m.
    pub torque: f64,
}

/// One of the two points joined by a revolute.
#[derive(Clone, Copy, Debug)]
pub enum End {
    /// A point of the ground, m.
    Ground(Planar),
    /// A point of a body, relative to its centre of mass in the body's axes, m.
    Body(usize, Planar),
}

/// A linear spring between a point of a body and a point of the ground.
#[derive(Clone, Copy, Debug)]
pub struct Spring {
    /// Index of the body.
    pub body: usize,
    /// Attachment point on the body, relative to its centre of mass in the body's axes, m.
    pub at: Planar,
    /// Attachment point on the ground, m.
    pub ground: Planar,
    /// Stiffness, N/m.
    pub stiffness: f64,
    /// Free length, m.
    pub length: f64,
}

/// The system: N = 3 · bodies coordinates, M = 2 · revolutes equations. In the list two joints of the same body must be less than W/2
/// places apart, so that a row of the dual matrix has W entries up to its diagonal.
#[derive(Clone, Debug)]
pub struct Linkage<const N: usize, const M: usize, const W: usize> {
    /// The bodies, N/3.
    pub bodies: Vec<Body>,
    /// The revolutes, M/2.
    pub joints: Vec<[End; 2]>,
    /// Springs, at most one per body.
    pub springs: Vec<Spring>,
    /// Gravity, m/s².
    pub gravity: Planar,
    /// Largest magnitude of a coordinate, m.
    pub size: f64,
}

/// The 3×3 block of a body.
type Block = [[f64; 3]; 3];

impl<const N: usize, const M: usize, const W: usize> Linkage<N, M, W> {
    /// Kinetic and potential energy, J; for a constant torque the potential is −torque · θ.
    pub fn energy(&self, q: &Vector<N>, v: &Vector<N>) -> f64 {
        let bodies: f64 = (self.bodies.iter().zip(q.chunks_exact(3)).zip(v.chunks_exact(3)))
            .map(|((body, q), v)| {
                let kinetic = (body.mass * (v[0] * v[0] + v[1] * v[1]) + body.inertia * v[2] * v[2]) / 2.0;
                kinetic - body.mass * (self.gravity[0] * q[0] + self.gravity[1] * q[1]) - body.torque * q[2]
            })
            .sum();
        let springs: f64 = (self.springs.iter())
            .map(|spring| {
                let Stretch { length, .. } = spring.stretch(&q[3 * spring.body..]);
                spring.stiffness / 2.0 * (length - spring.length) * (length - spring.length)
            })
            .sum();
        bodies + springs
    }

    /// M + factor · K of a body.
    fn block(&self, body: usize, q: &Vector<N>, factor: f64) -> Block {
        let Body { mass, inertia, .. } = self.bodies[body];
        let mut block = [[mass, 0.0, 0.0], [0.0, mass, 0.0], [0.0, 0.0, inertia]];
        for spring in self.springs.iter().filter(|spring| spring.body == body) {
            let stiffness = spring.tangent(&q[3 * body..]);
            for (row, stiffness) in block.iter_mut().zip(&stiffness) {
                for (entry, stiffness) in row.iter_mut().zip(stiffness) {
                    *entry += factor * stiffness;
                }
            }
        }
        block
    }
}

/// A spring at a posture: arm from the centre of mass, direction from ground to body, length.
struct Stretch {
    arm: Planar,
    direction: Planar,
    length: f64,
}

impl Spring {
    /// `q` starts with the coordinates of the spring's body.
    fn stretch(&self, q: &[f64]) -> Stretch {
        let arm = rotated(self.at, q[2]);
        let [x, y] = [q[0] + arm[0] - self.ground[0], q[1] + arm[1] - self.ground[1]];
        let length = x.hypot(y);
        Stretch { arm, direction: [x / length, y / length], length }
    }

    /// Force on the body and torque about its centre of mass, N and N m.
    fn force(&self, q: &[f64]) -> [f64; 3] {
        let Stretch { arm, direction, length } = self.stretch(q);
        let [x, y] = direction.map(|u| -self.stiffness * (length - self.length) * u);
        [x, y, arm[0] * y - arm[1] * x]
    }

    /// K = −∂Q/∂q: the second derivative of c/2 (l − l₀)².
    fn tangent(&self, q: &[f64]) -> Block {
        let Stretch { arm, direction: u, length } = self.stretch(q);
        let tension = self.stiffness * (length - self.length);
        let across = tension / length;
        let along = self.stiffness - across;
        let n = quarter_turn(arm);
        // Hessian with respect to the point, then with respect to x, y, θ by the chain rule.
        let h = [[across + along * u[0] * u[0], along * u[0] * u[1]], [along * u[0] * u[1], across + along * u[1] * u[1]]];
        let turned = [h[0][0] * n[0] + h[0][1] * n[1], h[1][0] * n[0] + h[1][1] * n[1]];
        let theta = turned[0] * n[0] + turned[1] * n[1] - tension * (u[0] * arm[0] + u[1] * arm[1]);
        [[h[0][0], h[0][1], turned[0]], [h[1][0], h[1][1], turned[1]], [turned[0], turned[1], theta]]
    }
}

impl<const N: usize, const M: usize, const W: usize> System<N, M> for Linkage<N, M, W> {
    type Pose = Pose<M>;
    type Mass = Factor<N, M, W>;

    fn pose(&self, q: &Vector<N>) -> Pose<M> {
        Pose::new(&self.joints, &q[..])
    }
    fn phi(&self, q: &Vector<N>, pose: &Pose<M>) -> Vector<M> {
        Vector::from_fn(|row| {
            let point = |end: &End, side: &Option<Side>| match (end, side) {
                (_, Some(side)) => q[3 * side.body + row % 2] + side.arm,
                (End::Ground(point), None) => point[row % 2],
                (End::Body(..), None) => unreachable!("the end of a body has a side in the Jacobian"),
            };
            let [first, second] = &self.joints[row / 2];
            let [to_first, to_second] = &pose.rows[row];
            point(first, to_first) - point(second, to_second)
        })
    }
    fn phi_q_times(&self, pose: &Pose<M>, v: &Vector<N>) -> Vector<M> {
        pose.times(v)
    }
    fn phi_q_dot_times(&self, pose: &Pose<M>, v: &Vector<N>) -> Vector<M> {
        pose.dot_times(v)
    }
    fn mass_times(&self, _: &Pose<M>, x: &Vector<N>) -> Vector<N> {
        Vector::from_fn(|i| {
            let body = &self.bodies[i / 3];
            x[i] * if i % 3 == 2 { body.inertia } else { body.mass }
        })
    }
    fn forces(&self, q: &Vector<N>, _: &Pose<M>, _: &Vector<N>) -> (Vector<N>, Work) {
        let mut forces = Vector::from_fn(|i| {
            let body = &self.bodies[i / 3];
            if i % 3 == 2 { body.torque } else { body.mass * self.gravity[i % 3] }
        });
        for spring in &self.springs {
            let first = 3 * spring.body;
            for (sum, force) in forces[first..].iter_mut().zip(spring.force(&q[first..])) {
                *sum += force;
            }
        }
        (forces, Work::default())
    }
    fn factor_mass(&self, pose: &Pose<M>, regularization: f64) -> Factor<N, M, W> {
        let inverses = std::array::from_fn(|i| {
            let Body { mass, inertia, .. } = self.bodies[i / 3];
            let mut row = [0.0; 3];
            row[i % 3] = 1.0 / if i % 3 == 2 { inertia } else { mass };
            row
        });
        Factor::new(pose, inverses, regularization)
    }
    fn error_norm(&self, x: &Vector<N>) -> f64 {
        x.iter().skip(2).step_by(3).fold(0.0, |largest, x| largest.max(x.abs()))
    }
    fn length_scale(&self) -> f64 {
        self.size
    }
}

impl<const N: usize, const M: usize, const W: usize> Implicit<N, M> for Linkage<N, M, W> {
    type General = Self;

    fn general(&self) -> Self {
        self.clone()
    }

    fn phi_q_transposed_times(&self, pose: &Pose<M>, lambda: &Vector<M>) -> Vector<N> {
        pose.transposed_times(lambda)
    }
    fn solve_tangent(
        &self,
        at: &TangentPoint<'_, Pose<M>, N, M>,
        regularization: f64,
        b: &Vector<N>,
        c: &Vector<M>,
    ) -> Result<(Vector<N>, Vector<M>), StepError> {
        let beta = at.h * at.h / 4.0;
        let geometric = at.pose.geometric_stiffness::<N>(at.lambda);
        let mut inverses = [[0.0; 3]; N];
        for body in 0..N / 3 {
            let mut block = self.block(body, at.q, beta);
            block[2][2] += beta * geometric[3 * body + 2];
            let inverse = factor::inverse(&block, 0.1 * self.bodies[body].inertia).ok_or(StepError::IndefiniteTangent)?;
            inverses[3 * body..3 * body + 3].copy_from_slice(&inverse);
        }
        Ok(Factor::<N, M, W>::new(at.pose, inverses, regularization).solve(b, c))
    }
}

impl<const N: usize, const M: usize, const W: usize> Passage<N> for Linkage<N, M, W> {}

impl<const N: usize, const M: usize, const W: usize> Events<N> for Linkage<N, M, W> {
    type Mode = ();
    type GuardValues = ();

    fn guard_values(&self, _: &Vector<N>, _: &Vector<N>) {}

    fn path_bounds(&self, _: &Path<N>) {}

    fn mode_of(&self, _: &Vector<N>, _: &Vector<N>) {}
}
