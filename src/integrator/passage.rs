//! Passage through vertices: singular postures where the constraints lose rank and branches of the configuration space cross.
//!
//! A method asks its system once per step. There are three answers: no vertex is near, the step is limited, or the system has passed the
//! vertex and returns the state behind it (`docs/vertices.md`).

use super::{Events, State, StepEnd, StepError, System, Work};
use crate::vector::Vector;

/// Thresholds for a straight passage through a vertex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassageLimits {
    /// Radius of the ball around a vertex inside which motions on a ray are straight, rad.
    pub radius: f64,
    /// Largest distance, rad, by which a motion on a ray misses the vertex (impact parameter).
    pub impact_parameter: f64,
    /// Longest straight motion with dissipative forces, s, because they are evaluated only at its ends.
    pub longest_with_dissipation: f64,
}

impl PassageLimits {
    /// Thresholds for an error tolerance, rad. A motion through a vertex misses it by the accumulated local errors of thousands of steps,
    /// so the impact parameter grows with the tolerance.
    pub fn for_error_tolerance(tolerance: f64) -> Self {
        let impact_parameter = (1e4 * tolerance).clamp(1e-7, 1e-4);
        Self { radius: impact_parameter.sqrt().min(1e-3), impact_parameter, longest_with_dissipation: f64::INFINITY }
    }
}

/// State at the beginning of a step.
#[derive(Clone, Copy, Debug)]
pub struct Departure<'a, const N: usize> {
    /// Coordinates q, m and rad.
    pub q: &'a Vector<N>,
    /// Velocities q̇, m/s and rad/s.
    pub v: &'a Vector<N>,
    /// Whether the motion is already on a ray through a vertex.
    pub on_ray: bool,
    /// Longest step, s.
    pub rest: f64,
}

/// Decision of the system about the next step.
#[derive(Clone, Copy, Debug)]
pub enum Approach<const N: usize> {
    /// No vertex is near.
    Clear,
    /// The step is limited.
    Limited(StepLimits),
    /// The system has moved straight, along a ray through the vertex or from rest at the vertex.
    Passed(Transit<N>),
}

/// Limits on a step near a vertex.
#[derive(Clone, Copy, Debug)]
pub struct StepLimits {
    /// Longest step, s.
    pub longest: f64,
    /// Round-off of the local error, rad; shorter steps would not reduce it.
    pub round_off: f64,
    /// Factor on e of the saddle-point systems. e must stay small compared with the smallest eigenvalue of S, which falls with the square
    /// of the distance to the vertex.
    pub regularization: f64,
    /// Energy before the step, if the step has to conserve it: close to a vertex, round-off in the direction of the velocity changes the
    /// energy.
    pub energy: Option<EnergyBalance>,
}

impl StepLimits {
    /// No limits, far from every vertex.
    pub const NONE: Self = Self { longest: f64::INFINITY, round_off: 0.0, regularization: 1.0, energy: None };
}

/// Energy before a step, and its rate of change.
#[derive(Clone, Copy, Debug)]
pub struct EnergyBalance {
    /// Kinetic plus potential energy, J.
    pub energy: f64,
    /// Power of the forces without a potential, W.
    pub power: f64,
}

/// Motion through a vertex or bifurcation, computed by the system.
#[derive(Clone, Copy, Debug)]
pub struct Transit<const N: usize> {
    /// Coordinates q at its end, m and rad.
    pub q: Vector<N>,
    /// Velocities q̇ at its end, m/s and rad/s.
    pub v: Vector<N>,
    /// Duration, s.
    pub duration: f64,
    /// Whether the motion ends inside the ball, where nothing is projected.
    pub on_ray: bool,
    /// Whether the motion has passed the vertex.
    pub passed: bool,
    /// For a start from rest at the vertex: whether forces drive the motion, and the number of other possible branches.
    pub from_rest: Option<(bool, u32)>,
    /// Acceleration q̈ at the end and work, J, if the equations of motion do not determine them.
    pub known: Option<(Vector<N>, Work)>,
}

/// A system's knowledge about its vertices; by default there are none.
pub trait Passage<const N: usize> {
    /// Decides about the step that begins at this state.
    fn approach(&self, _limits: &PassageLimits, _from: &Departure<'_, N>) -> Approach<N> {
        Approach::Clear
    }

    /// Whether a failed step of h seconds begins or ends near a bifurcation of the constraints.
    fn is_near_bifurcation(&self, _q: &Vector<N>, _v: &Vector<N>, _h: f64) -> bool {
        false
    }

    /// Length of the next step, s, of at most `longest`, that the system has to compute itself, because the motion is on a branch of the
    /// constraints and so near a bifurcation that the coordinates do not determine the branch. `h` is the expected length of a step, s.
    fn must_cross(&self, _q: &Vector<N>, _v: &Vector<N>, _h: f64, _longest: f64) -> Option<f64> {
        None
    }

    /// Factor on q̇ at the end of a step of h seconds that restores the energy. Fails if the energy has changed too much.
    fn energy_scale(&self, _before: &EnergyBalance, _q: &Vector<N>, _v: &Vector<N>, _h: f64) -> Result<f64, StepError> {
        Ok(1.0)
    }

    /// Whether q is far enough from every vertex for a projection, which divides round-off by the smallest singular value of Φ_q.
    fn can_project(&self, _q: &Vector<N>) -> bool {
        true
    }

    /// Energy that a step from q and q̇ must conserve, if the state is so close to a vertex that round-off alone would change it.
    fn energy_to_keep(&self, _q: &Vector<N>, _v: &Vector<N>) -> Option<EnergyBalance> {
        None
    }

    /// Whether a vertex is so near that a motion may be on a ray through it.
    fn is_near_vertex(&self, _q: &Vector<N>) -> bool {
        false
    }

    /// Acceleration q̈ at rest exactly at a vertex, on the branch of least constraint: the equations of motion have several solutions
    /// there. `None` elsewhere.
    fn acceleration_from_rest(&self, _q: &Vector<N>, _v: &Vector<N>) -> Option<Vector<N>> {
        None
    }
}

impl<const N: usize, const M: usize> State<N, M> {
    /// State from which the next step, of at most `rest` seconds, starts.
    pub(super) fn departure(&self, rest: f64) -> Departure<'_, N> {
        Departure { q: &self.q, v: &self.v, on_ray: self.on_ray, rest }
    }

    /// Moves the state to the end of a transit, with q̈ and λ from equilibrium there. Returns the mode in which the motion continues. A
    /// transit has no mode: at both ends the power follows from the state.
    pub(super) fn pass_through<S: System<N, M> + Events<N>>(
        &mut self,
        system: &S,
        transit: &Transit<N>,
        regularization: f64,
    ) -> Result<S::Mode, StepError> {
        if system.features().events {
            self.power = system.forces(&self.q, &system.pose(&self.q), &self.v).1;
        }
        let mut end_state = StepEnd::out_of_line(system, [transit.q, transit.v], regularization).finite()?;
        if let Some((a, work)) = transit.known {
            end_state.a = a;
            self.work += work;
        } else {
            self.work = self.work.plus(transit.duration / 2.0, self.power).plus(transit.duration / 2.0, end_state.power);
        }
        self.jerk = Vector::ZERO;
        self.take_over(&end_state);
        self.on_ray = transit.on_ray;
        self.counters.vertex_passes += u64::from(transit.passed);
        if let Some((driven, alternatives)) = transit.from_rest {
            self.alternatives = alternatives;
            self.counters.launches += u64::from(driven);
        }
        let mode = system.mode_of(&self.q, &self.v);
        if system.features().events {
            self.power = system.on(mode).forces(&self.q, &system.pose(&self.q), &self.v).1;
        }
        Ok(mode)
    }
}
