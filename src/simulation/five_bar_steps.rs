//! The five-bar over a finite step, for the conserving method: discrete derivatives of the joint constraints (`src/mechanism/secant.rs`),
//! mean forces of the effects, and the step with its loop cut at the tip (`src/linear/cut_loop.rs`).

use super::five_bar::FiveBar;
use crate::dynamics::TipArm;
use crate::effects::{FiniteMotion, Slopes, Wrench};
use crate::integrator::{Discrete, StepIncrement, Work};
use crate::linear::LinearSolve;
use crate::linear::cut_loop::{CUT_UNKNOWNS, Increment, MeanSlopes, OpenStep};
use crate::mechanism::coordinates::angles_by_leg;
use crate::mechanism::secant::Secant;
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Pose};

impl<const BARE: bool> FiveBar<'_, BARE> {
    fn over(&self, step: &Increment<'_>) -> FiniteMotion<'_> {
        let &StepIncrement { q, d, v, h, softening, secant } = step;
        self.conditions().finite_motion([q, d, v], secant, h, softening, self.model.typical_inertia)
    }

    /// Mean wrench of loads and effects over a step, and its work.
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

    #[inline(never)]
    fn add_slopes_over(&self, over: FiniteMotion, slopes: &mut Slopes) {
        for effect in &self.model.effects {
            effect.add_slopes_over(&over, slopes);
        }
    }
}

impl<const BARE: bool> Discrete<COORDINATES, MULTIPLIERS, CUT_UNKNOWNS> for FiveBar<'_, BARE> {
    type Secant = Secant;
    type Cut<'a>
        = OpenStep<'a, Self>
    where
        Self: 'a;

    fn secant(&self, begin: &Pose, d: &Coordinates) -> Secant {
        self.model.mechanism.secant(begin, angles_by_leg(d))
    }

    fn end(secant: &Secant) -> &Pose {
        &secant.end
    }

    fn mean_forces(&self, step: &Increment<'_>) -> Coordinates {
        let wrench = if BARE || self.model.effects.is_empty() { self.inputs.wrench() } else { self.acting_over(self.over(step)).0 };
        let mut forces = self.model.weight;
        wrench.add_to(TipArm::of_step(step.secant, step.d, step.v).row, &mut forces);
        forces
    }

    fn work_over(&self, step: &Increment<'_>) -> Work {
        self.acting_over(self.over(step)).1
    }

    fn cut<'a>(&'a self, begin: &'a Pose, at: [&'a Coordinates; 2], h: f64, softening: f64) -> OpenStep<'a, Self> {
        OpenStep::new(self, self.model.solver.legs(), begin, at, h, softening)
    }

    fn allows_staggering(&self) -> bool {
        BARE || self.model.solver.linear_solve() != LinearSolve::Dense
    }

    fn is_conservative(&self) -> bool {
        self.model.conservative
    }
}

impl<const BARE: bool> MeanSlopes for FiveBar<'_, BARE> {
    fn slopes_over(&self, step: &Increment<'_>) -> (Slopes, TipArm) {
        let mut slopes = Slopes { force: self.inputs.tip_force, ..Slopes::default() };
        if !BARE && !self.model.effects.is_empty() {
            self.add_slopes_over(self.over(step), &mut slopes);
        }
        (slopes, TipArm::of_step(step.secant, step.d, step.v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::INNER;
    use crate::effects::{Inputs, NAMES};
    use crate::integrator::{CutStep, System, velocity_correction};
    use crate::linear::cut_loop::CutUnknowns;
    use crate::mechanism::coordinates::{D_THETA, P_THETA, THETA, legs_of};
    use crate::mechanism::placement::joint_forces;
    use crate::mechanism::{Multipliers, closure};
    use crate::simulation::bindings::{default_inputs, default_parameters};
    use crate::simulation::{Model, Simulation};

    /// A mechanism without symmetries, a pose, and increments that turn its links by up to 0.4 rad.
    fn step() -> (Model, Coordinates, Coordinates) {
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
    fn loaded() -> (Model, Inputs, [Coordinates; 3]) {
        let mut parameters = default_parameters();
        let effects = &mut parameters.effects;
        for name in NAMES {
            *effects.switch(name).expect("an effect") = true;
        }
        (effects.stop.upper, effects.contact.offset) = ([1.15, 3.0], 1.0);
        let model = Model::new(&parameters).expect("a machine");
        let inputs = Inputs { tau: [0.1, 0.2], tip_force: [0.3, -0.4], servo_theta: [1.3, 2.0], servo_omega: [0.1, 0.2] };
        let (q, _) = closure::assemble(&parameters.geometry, [1.2, 0.3, 2.5, 1.9], [0.0; 4]);
        let d = Coordinates::from_fn(|i| 4e-3 * (1.0 + i as f64).sin());
        let v = Coordinates::from_fn(|i| 5.0 * (1.1 + i as f64).sin());
        (model, inputs, [q, d, v])
    }

    /// Force times displacement equals the energy that potentials lose and inputs add, minus dissipation.
    #[test]
    fn mean_forces_do_the_work_of_energies() {
        let (model, inputs, [q, d, v]) = loaded();
        let turns = [0; 4];
        let system = FiveBar::new(&model, &inputs, &turns);
        let secant = system.secant(&system.pose(&q), &d);
        let step = StepIncrement { q: &q, d: &d, v: &v, h: 1e-3, softening: 1.0, secant: &secant };
        let work = system.work_over(&step);
        let none = Inputs::default();
        let unloaded = FiveBar::new(&model, &none, &turns);
        let potential = |q: &Coordinates| unloaded.potential_energy(q, &system.pose(q));
        let gained = potential(&(q + d)) - potential(&q);
        let total = system.mean_forces(&step).dot(&d);
        assert!(work.input.abs() > 1e-5 && work.dissipated.abs() > 1e-5 && gained.abs() > 1e-5);
        // Tolerance: round-off of the energy of a plane pressed in by half a metre, about 100 J.
        assert!((total + gained + work.dissipated - work.input).abs() < 1e-12, "{total} {gained} {work:?}");
    }

    /// Mean tangents equal central differences with respect to the increments and the rates at the end of the step.
    #[test]
    fn mean_tangents_are_derivatives() {
        let (model, inputs, [q, d, v]) = loaded();
        let turns = [0; 4];
        let system = FiveBar::new(&model, &inputs, &turns);
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
                    // Tolerance: round-off of forces of up to 1e3 N over 1e-8 m, and the third order of the arm.
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
        let system = FiveBar::new(&model, &inputs, &turns);
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

    /// For any unknowns of the cut loop, all joints except the tip are closed, and all rows of z and the position rows of momentum vanish.
    /// The reported residuals are the residuals of (37), written here in all coordinates.
    #[test]
    fn the_cut_loop_has_the_equations_of_all_coordinates() {
        let (model, q, _) = step();
        let (inputs, turns, h) = (Inputs { tau: [0.01, 0.02], tip_force: [0.03, -0.04], ..default_inputs() }, [0; 4], 1e-3);
        let system = FiveBar::new(&model, &inputs, &turns);
        let begin = system.pose(&q);
        let (v0, _) = closure_rates(&system, &begin);
        let cut = system.cut(&begin, [&q, &v0], h, 1.0);
        for size in [1e-3, 0.1] {
            let x = CutUnknowns::from_fn(|i| size * (1.0 + i as f64).cos() * if i < 4 { 1.0 } else { 1e-3 });
            let motion = cut.motion(&x, 1e-9);
            let ([d, v], secant) = (cut.end(&motion), motion.secant);
            let z = 0.5 * h * (v0 + v);
            let chord = StepIncrement { q: &q, d: &d, v: &v, h, softening: 1.0, secant: &secant };
            // From the tip to the ground, the force at each joint is the force at the next joint plus the load of the link between them.
            let taken = 0.5 * h * h * system.mean_forces(&chord) - system.mass_times(&secant.end, &(z - h * v0));
            let lambda = joint_forces(&taken, [motion.x[4], motion.x[5]]);
            let nu = joint_forces(&system.mass_times(&secant.end, &(d - z)), [motion.x[6], motion.x[7]]);
            let inertia = system.mass_times(&secant.end, &(z - h * v0));
            let joints = secant.discrete_transposed_times(&lambda) + 0.5 * secant.discrete_hessian_times(&z, &nu);
            let f = inertia + joints - 0.5 * h * h * system.mean_forces(&chord);
            let moved = system.mass_times(&secant.end, &(d - z)) - secant.mean_transposed_times(&nu);
            let (phi, rates) = (system.phi(&(q + d), &secant.end), secant.end.phi_q_times(&(0.5 * h * v)));

            let balance = cut.balance(&motion);
            let [offset, gap, rate] = cut.residuals(&motion, &balance);
            let largest = |x: &[f64]| x.iter().fold(0.0f64, |largest, x| largest.max(x.abs()));
            // Round-off of increments of `size` rad of links with about 1e-3 kg·m² and 0.1 kg.
            let round_off = 1e-15 * size;
            let angles: Vec<f64> = THETA.iter().map(|i| f[*i]).collect();
            assert!(f.norm() - angles.iter().map(|x| x * x).sum::<f64>().sqrt() < round_off, "{f:?}");
            assert!(moved.max_norm() < round_off, "{moved:?}");
            assert!(largest(&phi[..8]) < 1e-15 && largest(&rates[..8]) < 1e-15, "{phi:?} {rates:?}");
            assert!((largest(&phi[8..]) - gap).abs() < 1e-15 && gap > 1e-2 * size);
            assert!((largest(&rates[8..]) - rate).abs() < 1e-15, "{rates:?} {rate}");
            let mechanism = &model.mechanism;
            let lengths = [mechanism.a_p + mechanism.b_p, mechanism.a_d];
            let about_joint = [
                mechanism.inertia_p + mechanism.mass_p * mechanism.a_p * mechanism.a_p + mechanism.mass_d * lengths[0] * lengths[0],
                mechanism.inertia_d + mechanism.mass_d * lengths[1] * lengths[1],
            ];
            let turned: Vec<f64> = [P_THETA, D_THETA]
                .iter()
                .zip(about_joint)
                .flat_map(|(angles, inertia)| (legs_of(&f, *angles) / inertia).to_array())
                .collect();
            assert!((largest(&turned) - offset).abs() < 1e-12 * offset, "{turned:?} {offset}");
        }
    }

    /// Central differences of the residuals along the Newton increment of the whole tangent are minus the residuals, with all effects
    /// active.
    #[test]
    fn the_whole_tangent_is_the_derivative_of_the_equations() {
        let (model, inputs, [q, _, v0]) = loaded();
        let (turns, h) = ([0; 4], 1e-3);
        let system = FiveBar::new(&model, &inputs, &turns);
        let begin = system.pose(&q);
        let cut = system.cut(&begin, [&q, &v0], h, 1.0);
        let left = |x: &CutUnknowns| {
            let motion = cut.free_motion(x);
            let balance = cut.balance(&motion);
            let [p, d] = balance.left.map(|left| left.to_array());
            ([p[0], p[1], d[0], d[1]], motion.gap, motion.rate, cut.whole_correction(&motion, &balance, 0.0))
        };
        let x = CutUnknowns::from_fn(|i| (1.0 + i as f64).sin() * if i < 4 { 4e-3 } else { 1e-3 });
        let (f, gap, rate, change) = left(&x);
        let part = 1e-5;
        let [more, less] = [part, -part].map(|part| left(&(x + part * change)));
        let worst = |more: &[f64], less: &[f64], left: &[f64]| {
            let sums = more.iter().zip(less).zip(left).map(|((more, less), left)| (more - less) / (2.0 * part) + left);
            let largest = |x: f64, y: f64| x.max(y.abs());
            sums.fold(0.0, largest) / left.iter().copied().fold(0.0, largest)
        };
        // Tolerance: round-off over 1e-5, and the slopes of friction and plane, which change along the increment.
        for (more, less, left) in
            [(&more.0[..], &less.0[..], &f[..]), (&more.1[..], &less.1[..], &gap[..]), (&more.2[..], &less.2[..], &rate[..])]
        {
            assert!(worst(more, less, left) < 1e-6, "{more:?} {less:?} {left:?}");
        }
    }

    /// Rates that satisfy the constraints of a pose, and their residual, m/s.
    fn closure_rates(system: &FiveBar<'_>, begin: &Pose) -> (Coordinates, f64) {
        let v = Coordinates::from_fn(|i| 3.0 * (0.3 + i as f64).cos());
        let mass = system.factor_mass(begin, 0.0);
        let v = v + velocity_correction(system, begin, &mass, &v);
        (v, begin.phi_q_times(&v).max_norm())
    }

    /// The staggered Newton iteration contracts by (hω)², as `docs/conserving.md` states.
    #[test]
    fn in_turn_it_contracts_by_the_square_of_the_turn() {
        let (inputs, turns) = (default_inputs(), [0; 4]);
        let simulation = Simulation::new(&default_parameters(), &inputs).expect("the start of the paper's fall");
        let (model, q) = (simulation.model(), simulation.state().core.q);
        let system = FiveBar::new(model, &inputs, &turns);
        let begin = system.pose(&q);
        let (v0, open) = closure_rates(&system, &begin);
        assert!(open < 1e-14);
        for h in [1e-3, 4e-3] {
            let cut = system.cut(&begin, [&q, &v0], h, 1.0);
            let mut x = OpenStep::<FiveBar<'_>>::unknowns_of(&(h * v0), &Multipliers::ZERO);
            let mut left = Vec::new();
            for _ in 0..4 {
                let motion = cut.motion(&x, 1e-9);
                let balance = cut.balance(&motion);
                let [offset, gap, _] = cut.residuals(&motion, &balance);
                left.push(offset + gap);
                x = cut.newton_update(&motion, &balance, &cut.factor(&motion, &balance, 1e-9));
            }
            let turn = h * v0.max_norm();
            // The first iteration starts without joint forces. Measured factors are 17 and 0.4, from the arms of this pose; 30 are allowed.
            let allowed = |before: f64| (30.0 * turn * turn * before).max(1e-16);
            assert!(left[2] < allowed(left[1]) && left[3] < allowed(left[2]), "{left:?} {turn}");
        }
    }
}
