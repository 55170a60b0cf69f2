//! End of a step: projection onto the constraints, scaling to the energy, equilibrium; and straight steps through a vertex.

use std::borrow::Borrow;

use super::trial::{Origin, StepResult};
use super::{DenseStep, Settings};
use crate::integrator::state::StepEnd;
use crate::integrator::{EnergyBalance, Events, Passage, Projection, State, StepError, System, Transit, Work, velocity_correction};
use crate::vector::Vector;

impl Settings {
    /// Projects the end of a step, given with its increment from the origin, and solves for q̈, λ and power there. `energy_target`
    /// is the energy to be conserved with the time since, s; `work` is the work over the step, J.
    #[inline(always)]
    pub(super) fn project_and_evaluate<const N: usize, const M: usize, S: System<N, M> + Passage<N>>(
        &self,
        system: &S,
        from: (&Origin<S::TrigBase, N>, Vector<N>),
        end: [Vector<N>; 2],
        energy_target: Option<(EnergyBalance, f64)>,
        work: Work,
    ) -> Option<StepResult<N, M>> {
        self.project_end::<true, N, M, S>(system, from, end, energy_target, work)
    }

    /// Projects the end of a step without evaluating forces there.
    #[inline]
    pub(super) fn project_without_balance<const N: usize, const M: usize, S: System<N, M> + Passage<N>>(
        &self,
        system: &S,
        from: (&Origin<S::TrigBase, N>, Vector<N>),
        end: [Vector<N>; 2],
        energy_target: Option<(EnergyBalance, f64)>,
    ) -> Option<StepResult<N, M>> {
        self.project_end::<false, N, M, S>(system, from, end, energy_target, Work::default())
    }

    /// Projects the end of a step; evaluates forces there if `BALANCED`.
    #[inline(always)]
    fn project_end<const BALANCED: bool, const N: usize, const M: usize, S: System<N, M> + Passage<N>>(
        &self,
        system: &S,
        (origin, by): (&Origin<S::TrigBase, N>, Vector<N>),
        [mut q, mut v]: [Vector<N>; 2],
        energy_target: Option<(EnergyBalance, f64)>,
        work: Work,
    ) -> Option<StepResult<N, M>> {
        let mut pose = origin.pose_at(system, &by);
        let (iterations, mass) = self.project_in_place(system, &mut pose, &mut q, &mut v).ok()?;
        v = project_to_energy(system, [&q, &v], energy_target).ok()?;
        let end_state = if BALANCED {
            StepEnd::in_balance(system, [q, v], &pose, &mass)
        } else {
            StepEnd::without_balance(system, [q, v], &pose)
        };
        StepResult::after(work, iterations, end_state)
    }

    /// Projects q and q̇ onto the constraints, except close to a vertex, where round-off would be amplified; returns iterations,
    /// pose and mass factor.
    #[inline(never)]
    pub(super) fn project<const N: usize, const M: usize, S: System<N, M> + Passage<N>>(
        &self,
        system: &S,
        q: &mut Vector<N>,
        v: &mut Vector<N>,
    ) -> Result<(u32, S::Pose, S::Mass), StepError> {
        let mut pose = system.pose(q);
        let (iterations, mass) = self.project_in_place(system, &mut pose, q, v)?;
        Ok((iterations, pose, mass))
    }

    /// Projects q and q̇ with the pose at q, inlined into the caller; returns iterations and mass factor.
    #[inline(always)]
    fn project_in_place<const N: usize, const M: usize, S: System<N, M> + Passage<N>>(
        &self,
        system: &S,
        pose: &mut S::Pose,
        q: &mut Vector<N>,
        v: &mut Vector<N>,
    ) -> Result<(u32, S::Mass), StepError> {
        if !system.can_project(q) {
            return Ok((0, system.factor_mass(pose, self.regularization)));
        }
        let projection = Projection::to_round_off(system.length_scale(), self.regularization, self.max_iterations);
        let iterations = projection.position_from(system, pose, q)?;
        let mass = system.factor_mass(pose, self.regularization);
        *v += velocity_correction(system, pose, &mass, v);
        if system.has_sticking() {
            *v = system.project_sticking(*q, *v);
        }
        Ok((iterations, mass))
    }
}

impl<const N: usize, const M: usize, K: Copy + PartialEq> DenseStep<N, M, K> {
    /// Makes a straight step through a vertex. Its power is evaluated in the modes of both ends, because the step has no mode.
    #[cold]
    pub(super) fn pass_through<S: System<N, M> + Passage<N> + Events<N, Mode = K>>(
        &mut self,
        system: &S,
        transit: &Transit<N>,
        settings: &Settings,
    ) -> Result<(), StepError> {
        let power = |system: &S, State { q, v, .. }: &State<N, M>| system.power(q, &system.pose(q), v);
        if system.has_events() {
            self.end.power = power(system, &self.end);
        }
        self.end.pass_through(system, transit, settings.regularization)?;
        (self.length, self.is_linear) = (transit.duration, true);
        self.next_mode_at_end = system.mode_of(&self.end.q, &self.end.v);
        if system.has_events() {
            self.end.power = power(system.on(self.next_mode_at_end).borrow(), &self.end);
        }
        Ok(())
    }
}

/// Velocity q̇ scaled to the energy that was there `h` seconds before, if one is to be conserved.
#[inline]
pub(super) fn project_to_energy<const N: usize>(
    system: &impl Passage<N>,
    [q, v]: [&Vector<N>; 2],
    energy_target: Option<(EnergyBalance, f64)>,
) -> Result<Vector<N>, StepError> {
    let Some((energy, h)) = &energy_target else { return Ok(*v) };
    Ok(system.energy_scale(energy, q, v, *h)? * *v)
}
