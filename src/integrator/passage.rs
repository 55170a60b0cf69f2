//! What a system may know better than an integrator: how its motion goes on close to a vertex of its configuration space, where the
//! constraints lose rank and branches cross.
//!
//! Each method asks once per step, and gets a decision: nothing is near, the step is limited, or the system has passed the vertex and
//! says where it is now. `docs/vertices.md` has the reasons.

use super::{State, StepEnd, StepError, System, Work};
use crate::vector::Vector;

/// How close to a vertex a motion is taken straight through it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassageLimits {
    /// Radius of the ball around a vertex inside which motions on a ray are straight, rad.
    pub radius: f64,
    /// A motion on a ray misses the vertex by less than this impact parameter, rad.
    pub impact_parameter: f64,
    /// Where forces dissipate a straight motion is no longer than this, s: they are known at its ends only.
    pub longest_with_dissipation: f64,
}

impl PassageLimits {
    /// A motion meant to pass through a vertex misses it by what the method's local errors have added up to: thousands of them. So
    /// the impact parameter follows the error tolerance, rad.
    pub fn for_error_tolerance(tolerance: f64) -> Self {
        let impact_parameter = (1e4 * tolerance).clamp(1e-7, 1e-4);
        Self { radius: impact_parameter.sqrt().min(1e-3), impact_parameter, longest_with_dissipation: f64::INFINITY }
    }
}

/// From where, and for how long.
#[derive(Clone, Copy, Debug)]
pub struct Departure<'a, const N: usize> {
    /// Coordinates.
    pub q: &'a Vector<N>,
    /// Velocities.
    pub v: &'a Vector<N>,
    /// Whether the motion is on a ray through a vertex already.
    pub on_ray: bool,
    /// How far the step may go, s.
    pub rest: f64,
}

/// What a vertex makes of the next step.
#[derive(Clone, Copy, Debug)]
pub enum Approach<const N: usize> {
    /// Nothing: none is near.
    Clear,
    /// The step is limited.
    Limited(StepLimits),
    /// The system has gone straight on, along a ray through the vertex or from rest in it.
    Passed(Transit<N>),
}

/// What a step near a vertex has to observe.
#[derive(Clone, Copy, Debug)]
pub struct StepLimits {
    /// Not farther than this, s.
    pub longest: f64,
    /// What round-off alone makes of the local error here, rad. Shorter steps would not get below it.
    pub round_off: f64,
    /// Factor on e of the saddle-point systems, which must stay small against the smallest eigenvalue of S: that falls with the square of
    /// the distance.
    pub regularization: f64,
    /// The energy before the step, where it is to be kept: close to a vertex round-off in the direction of the velocity changes it.
    pub energy: Option<EnergyBalance>,
}

impl StepLimits {
    /// Far from every vertex.
    pub const NONE: Self = Self { longest: f64::INFINITY, round_off: 0.0, regularization: 1.0, energy: None };
}

/// The energy before a step, and how it changes.
#[derive(Clone, Copy, Debug)]
pub struct EnergyBalance {
    /// Kinetic plus potential, J.
    pub energy: f64,
    /// Power of the forces that have no potential, W.
    pub power: f64,
}

/// A motion that the system has made.
#[derive(Clone, Copy, Debug)]
pub struct Transit<const N: usize> {
    /// Coordinates at its end.
    pub q: Vector<N>,
    /// Velocities there.
    pub v: Vector<N>,
    /// How long it took, s.
    pub duration: f64,
    /// Whether it ends inside the ball, where nothing may be projected.
    pub on_ray: bool,
    /// Whether it passed the vertex.
    pub passed: bool,
    /// Where it started from rest in the vertex: whether forces drive it, and the number of other branches that they could.
    pub from_rest: Option<(bool, u32)>,
    /// q̈ at its end and the work on the way where the equations of motion do not tell them.
    pub known: Option<(Vector<N>, Work)>,
}

/// A system's own knowledge of its vertices; by default it has none.
pub trait Passage<const N: usize> {
    /// What a vertex makes of the next step.
    fn approach(&self, _limits: &PassageLimits, _from: &Departure<'_, N>) -> Approach<N> {
        Approach::Clear
    }

    /// Where a step of h seconds leads that a method has tried in vain, for it ends too near to where branches of the constraints meet.
    #[inline(always)]
    fn cross_bifurcation(&self, _q: &Vector<N>, _v: &Vector<N>, _h: f64) -> Option<Transit<N>> {
        None
    }

    /// The factor by which q̇ at the end of a step of h seconds has to be scaled to keep the energy.
    fn energy_scale(&self, _before: &EnergyBalance, _q: &Vector<N>, _v: &Vector<N>, _h: f64) -> Result<f64, StepError> {
        Ok(1.0)
    }

    /// Whether q is far enough from every vertex for a projection, which divides round-off by the smallest singular value of Φ_q.
    fn can_project(&self, _q: &Vector<N>) -> bool {
        true
    }

    /// The energy that a step from q and q̇ has to keep, if they are so close to a vertex that round-off alone would change it.
    fn energy_to_keep(&self, _q: &Vector<N>, _v: &Vector<N>) -> Option<EnergyBalance> {
        None
    }

    /// Whether a vertex is so near that a motion may be on a ray through it.
    fn is_near_vertex(&self, _q: &Vector<N>) -> bool {
        false
    }

    /// q̈ at rest exactly in a vertex, which the equations of motion alone do not single out: that of the branch of least constraint.
    /// `None` elsewhere.
    fn acceleration_from_rest(&self, _q: &Vector<N>, _v: &Vector<N>) -> Option<Vector<N>> {
        None
    }
}

impl<const N: usize, const M: usize> State<N, M> {
    /// What [`Passage::approach`] needs to know.
    #[inline(always)]
    pub(super) fn departure(&self, rest: f64) -> Departure<'_, N> {
        Departure { q: &self.q, v: &self.v, on_ray: self.on_ray, rest }
    }

    /// Goes where a transit has led, with q̈ and λ from equilibrium there.
    #[cold]
    pub(super) fn pass_through<S: System<N, M>>(
        &mut self,
        system: &S,
        transit: &Transit<N>,
        regularization: f64,
    ) -> Result<(), StepError> {
        let mut end_state = StepEnd::out_of_line(system, [transit.q, transit.v], regularization).finite()?;
        if let Some((a, work)) = transit.known {
            end_state.a = a;
            self.work += work;
        } else {
            self.work = self.work.plus(transit.duration / 2.0, self.power).plus(transit.duration / 2.0, end_state.power);
        }
        self.jerk = Vector::ZERO;
        self.arrive(&end_state);
        self.on_ray = transit.on_ray;
        self.counters.vertex_passes += u64::from(transit.passed);
        if let Some((driven, alternatives)) = transit.from_rest {
            self.alternatives = alternatives;
            self.counters.launches += u64::from(driven);
        }
        Ok(())
    }
}
