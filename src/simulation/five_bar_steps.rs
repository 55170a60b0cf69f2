//! The five-bar over a finite step, as the conserving method needs it: discrete derivatives of the joint constraints
//! (`src/mechanism/secant.rs`) and mean forces of the effects.

use super::cut_five_bar::CutFiveBar;
use super::five_bar::FiveBar;
use crate::dynamics::TipArm;
use crate::effects::{FiniteMotion, Slopes, Wrench};
use crate::integrator::{Discrete, StepIncrement, Work};
use crate::linear::LinearSolve;
use crate::linear::cut_loop::{CutUnknowns, OpenStep, cut_unknowns, lengthened};
use crate::mechanism::coordinates::angles_by_leg;
use crate::mechanism::secant::Secant;
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Multipliers, Pose};

pub(super) type Step<'a> = StepIncrement<'a, Secant, COORDINATES>;

impl<const BARE: bool> FiveBar<'_, BARE> {
    fn over(&self, step: &Step<'_>) -> FiniteMotion<'_> {
        let &StepIncrement { q, d, v, h, softening, secant } = step;
        self.conditions().finite_motion([q, d, v], secant, (h, softening), self.model.typical_inertia)
    }

    /// Mean wrench of the loads and the effects over a step, and its work.
    #[inline(never)]
    fn acting_over(&self, over: FiniteMotion) -> (Wrench, Work) {
        let mut wrench = self.inputs.wrench();
        let mut work = Work { input: wrench.power(&over.changes, over.change), dissipated: 0.0 };
        for effect in &self.model.effects {
            let [input, dissipated] = effect.act_over(&over, &mut wrench);
            work += Work { input, dissipated };
        }
        (wrench, work)
    }

    /// Slopes of the mean wrench over a step, with the arms of the tip.
    pub(super) fn slopes_over(&self, step: &Step<'_>) -> (Slopes, TipArm) {
        let mut slopes = Slopes { force: self.inputs.tip_force, ..Slopes::default() };
        if !BARE && !self.model.effects.is_empty() {
            self.add_slopes_over(self.over(step), &mut slopes);
        }
        (slopes, TipArm::of_step(step.secant, step.d, step.v))
    }

    #[inline(never)]
    fn add_slopes_over(&self, over: FiniteMotion, slopes: &mut Slopes) {
        for effect in &self.model.effects {
            effect.add_slopes_over(&over, slopes);
        }
    }
}

impl<const BARE: bool> Discrete<COORDINATES, MULTIPLIERS> for FiveBar<'_, BARE> {
    type Secant = Secant;
    type CutUnknowns = CutUnknowns;
    type Cut<'a>
        = CutFiveBar<'a, BARE>
    where
        Self: 'a;

    fn secant(&self, begin: &Pose, d: &Coordinates) -> Secant {
        self.model.mechanism.secant(begin, angles_by_leg(d))
    }

    fn end(secant: &Secant) -> &Pose {
        &secant.end
    }

    fn mean_forces(&self, step: &Step<'_>) -> Coordinates {
        let wrench = if BARE || self.model.effects.is_empty() { self.inputs.wrench() } else { self.acting_over(self.over(step)).0 };
        let mut forces = self.model.weight;
        wrench.add_to(TipArm::of_step(step.secant, step.d, step.v).row, &mut forces);
        forces
    }

    fn work_over(&self, step: &Step<'_>) -> Work {
        self.acting_over(self.over(step)).1
    }

    fn cut<'a>(&'a self, begin: &'a Pose, at: [&'a Coordinates; 2], h: f64, softening: f64) -> CutFiveBar<'a, BARE> {
        CutFiveBar { system: self, step: OpenStep::new(self.model.solver.legs(), begin, at, h), softening }
    }

    fn cut_unknowns(&self, d: &Coordinates, lambda: &Multipliers) -> CutUnknowns {
        cut_unknowns(d, lambda)
    }

    fn lengthened(x: &CutUnknowns, factor: f64) -> CutUnknowns {
        lengthened(x, factor)
    }

    fn allows_staggering(&self) -> bool {
        BARE || self.model.solver.linear_solve() != LinearSolve::Dense
    }

    fn is_conservative(&self) -> bool {
        self.model.effects.iter().all(|effect| effect.conservative())
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::dynamics::INNER;
    use crate::effects::Inputs;
    use crate::fmi::bindings::{default_inputs, default_parameters};
    use crate::integrator::System;
    use crate::mechanism::closure;
    use crate::simulation::Model;

    /// A mechanism without symmetries, a pose, and increments that turn its links by up to 0.4 rad.
    pub(in crate::simulation) fn step() -> (Model, Coordinates, Coordinates) {
        let mut parameters = default_parameters();
        for (i, link) in parameters.geometry.links.iter_mut().enumerate() {
            let part = 1.0 + 0.2 * i as f64;
            (link.mass, link.inertia, link.com) = (part * link.mass, link.inertia / part, 0.07 * part);
        }
        let model = Model::new(&parameters).expect("a machine");
        let (q, _) = closure::assemble(&parameters.geometry, [1.2, 0.3, 2.5, 1.9], [0.0; 4]);
        let d = Coordinates::from_fn(|i| 0.4 * (1.0 + i as f64).sin());
        (model, q, d)
    }

    fn numbers(seed: f64) -> Multipliers {
        Multipliers::from_fn(|i| (seed + 3.0 * i as f64).cos())
    }

    /// All effects active, the tip in the plane, the left axis in its stop, and a step of 1 ms at some rad/s.
    pub(in crate::simulation) fn loaded() -> (Model, Inputs, [Coordinates; 3]) {
        let mut parameters = default_parameters();
        let effects = &mut parameters.effects;
        for enabled in [
            &mut effects.viscous.enabled,
            &mut effects.friction.enabled,
            &mut effects.spring.enabled,
            &mut effects.stop.enabled,
            &mut effects.contact.enabled,
            &mut effects.servo.enabled,
        ] {
            *enabled = true;
        }
        (effects.stop.upper, effects.contact.offset) = ([1.15, 3.0], 1.0);
        let model = Model::new(&parameters).expect("a machine");
        let inputs = Inputs { tau: [0.1, 0.2], tip_force: [0.3, -0.4], servo_theta: [1.3, 2.0], servo_omega: [0.1, 0.2] };
        let (q, _) = closure::assemble(&parameters.geometry, [1.2, 0.3, 2.5, 1.9], [0.0; 4]);
        let d = Coordinates::from_fn(|i| 4e-3 * (1.0 + i as f64).sin());
        let v = Coordinates::from_fn(|i| 5.0 * (1.1 + i as f64).sin());
        (model, inputs, [q, d, v])
    }

    /// Force times displacement is what potentials lose, inputs put in and dissipation takes.
    #[test]
    fn mean_forces_do_the_work_of_energies() {
        let (model, inputs, [q, d, v]) = loaded();
        let turns = [0; 4];
        let system = FiveBar::<false>::new(&model, &inputs, &turns);
        let secant = system.secant(&system.pose(&q), &d);
        let step = StepIncrement { q: &q, d: &d, v: &v, h: 1e-3, softening: 1.0, secant: &secant };
        let work = system.work_over(&step);
        let none = Inputs::default();
        let unloaded = FiveBar::<false>::new(&model, &none, &turns);
        let potential = |q: &Coordinates| unloaded.potential_energy(q, &system.pose(q));
        let gained = potential(&(q + d)) - potential(&q);
        let total = system.mean_forces(&step).dot(&d);
        assert!(work.input.abs() > 1e-5 && work.dissipated.abs() > 1e-5 && gained.abs() > 1e-5);
        // Tolerance: round-off of the energy of a plane pressed in by half a metre, some 100 J.
        assert!((total + gained + work.dissipated - work.input).abs() < 1e-12, "{total} {gained} {work:?}");
    }

    /// Mean tangents equal central differences with respect to the increments and to the rates at the end of the step.
    #[test]
    fn mean_tangents_are_derivatives() {
        let (model, inputs, [q, d, v]) = loaded();
        let turns = [0; 4];
        let system = FiveBar::<false>::new(&model, &inputs, &turns);
        let begin = system.pose(&q);
        let forces = |d: &Coordinates, v: &Coordinates| {
            let secant = system.secant(&begin, d);
            system.mean_forces(&StepIncrement { q: &q, d, v, h: 1e-3, softening: 1.0, secant: &secant })
        };
        let secant = system.secant(&begin, &d);
        let step = StepIncrement { q: &q, d: &d, v: &v, h: 1e-3, softening: 1.0, secant: &secant };
        let (slopes, arm) = system.slopes_over(&step);
        let inner = [[1.0, 0.0], [0.0, 1.0]].map(|weights| slopes.inner(&arm, weights));
        let place = |i: usize| INNER.iter().position(|inner| *inner == i);
        let tangent = |kind: usize, row, column| match (place(row), place(column)) {
            (Some(row), Some(column)) => inner[kind][row][column],
            _ => 0.0,
        };
        for column in 0..COORDINATES {
            let unit = Coordinates::unit(column);
            let numeric = [
                (forces(&(d + -1e-8 * unit), &v) - forces(&(d + 1e-8 * unit), &v)) / 2e-8,
                (forces(&d, &(v + -1e-5 * unit)) - forces(&d, &(v + 1e-5 * unit))) / 2e-5,
            ];
            for (kind, numeric) in numeric.iter().enumerate() {
                for row in 0..COORDINATES {
                    let (got, want) = (tangent(kind, row, column), numeric[row]);
                    // Round-off of forces of up to 1e3 N over 1e-8 m; the arm's third order.
                    assert!((got - want).abs() < 1e-4 * (1.0 + want.abs()), "{kind} {row} {column}: {got} {want}");
                }
            }
        }
    }

    /// Along d the discrete derivatives equal the differences of the constraints and of their Jacobian.
    #[test]
    fn discrete_derivatives_are_differences() {
        let (model, q, d) = step();
        let (inputs, turns) = (default_inputs(), [0; 4]);
        let system = FiveBar::<false>::new(&model, &inputs, &turns);
        let (begin, end) = (system.pose(&q), system.pose(&(q + d)));
        let secant = system.secant(&begin, &d);
        let (lambda, z) = (numbers(1.0), Coordinates::from_fn(|i| (i as f64).cos()));
        let change = system.phi(&(q + d), &end) - system.phi(&q, &begin);
        let mean = 0.5 * (end.phi_q_times(&z) + begin.phi_q_times(&z));
        let turned = end.phi_q_times(&z) - begin.phi_q_times(&z);
        for (got, want) in [
            (secant.discrete_transposed_times(&lambda).dot(&d), lambda.dot(&change)),
            (secant.mean_transposed_times(&lambda).dot(&z), lambda.dot(&mean)),
            (secant.discrete_hessian_times(&z, &lambda).dot(&d), lambda.dot(&turned)),
        ] {
            assert!((got - want).abs() < 1e-15, "{got} {want}");
        }
        // Directions turned twice by half the increment equal those of the angles at the end of the step.
        assert!((system.phi(&(q + d), &secant.end) - system.phi(&(q + d), &end)).max_norm() < 1e-15);
    }
}
