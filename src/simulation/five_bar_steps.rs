//! The five-bar over a finite step, as the conserving method sees it: discrete derivatives of the joints' constraints
//! (`src/mechanism/secant.rs`) and mean forces of the effects.

use super::five_bar::FiveBar;
use crate::effects::{StepContext, Tangents};
use crate::integrator::{Chord, CutStep, Discrete, Work};
use crate::linear::LinearSolve;
use crate::linear::cut_loop::{Closed, CutUnknowns, OpenBalance, OpenMotion, OpenStep, cut_unknowns, largest_turn};
use crate::linear::secant_newton::{StepPoint, StepTangents, newton};
use crate::mechanism::coordinates::{D_THETA, P_THETA, THETA, legs_of};
use crate::mechanism::secant::Secant;
use crate::mechanism::{COORDINATES, Coordinates, MULTIPLIERS, Multipliers, Pose};

type Step<'a> = Chord<'a, Secant, COORDINATES>;

impl<const BARE: bool> FiveBar<'_, BARE> {
    #[inline(always)]
    fn over<'b>(&'b self, step: &Step<'b>) -> StepContext<'b> {
        let &Chord { q, d, v, h, softening, secant } = step;
        let inertia = &self.model.typical_inertia;
        StepContext { q, d, v, h, softening, secant, inputs: self.inputs, turns: self.turns, inertia }
    }

    #[inline(never)]
    fn with_mean_effects(&self, step: &Step<'_>, mut forces: Coordinates) -> Coordinates {
        let over = self.over(step);
        for effect in &self.model.effects {
            effect.add_mean_forces(&over, &mut forces);
        }
        forces
    }
}

/// The same with its loop cut at the tip.
pub struct CutFiveBar<'a, const BARE: bool> {
    system: &'a FiveBar<'a, BARE>,
    step: OpenStep<'a>,
}

impl<const BARE: bool> CutFiveBar<'_, BARE> {
    /// Of the step as the forces see it what `of` makes.
    #[inline(always)]
    fn over<T>(&self, motion: &OpenMotion, of: impl FnOnce(&Step<'_>) -> T) -> T {
        let &OpenStep { q, h, .. } = &self.step;
        let (secant, [d, v]) = (self.secant(motion), self.end(motion));
        of(&Chord { q, d: &d, v: &v, h, softening: 1.0, secant: &secant })
    }
}

impl<const BARE: bool> CutStep<COORDINATES, MULTIPLIERS> for CutFiveBar<'_, BARE> {
    type Unknowns = CutUnknowns;
    type Secant = Secant;
    type Motion = OpenMotion;
    type Balance = OpenBalance;
    type Factor = Closed;

    #[inline(always)]
    fn motion(&self, x: &CutUnknowns, regularization: f64) -> OpenMotion {
        self.step.motion(*x, regularization)
    }

    #[inline(always)]
    fn balance(&self, motion: &OpenMotion) -> OpenBalance {
        self.step.balance(motion, &self.over(motion, |step| self.system.mean_forces(step)))
    }

    #[inline(always)]
    fn left(&self, motion: &OpenMotion, balance: &OpenBalance) -> [f64; 3] {
        self.step.left(motion, balance)
    }

    #[inline(always)]
    fn factor(&self, motion: &OpenMotion, balance: &OpenBalance, regularization: f64) -> Closed {
        let h = self.step.h;
        let mut loads = Diagonal { half_square: 0.5 * h * h, inertias: Coordinates::ZERO };
        self.over(motion, |step| {
            let over = self.system.over(step);
            self.system.inputs.add_mean_tangents(&over, &mut loads);
            if !BARE {
                for effect in &self.system.model.effects {
                    effect.add_mean_tangents(&over, &mut loads);
                }
            }
        });
        let stiffness = [legs_of(&loads.inertias, P_THETA), legs_of(&loads.inertias, D_THETA)];
        self.step.factor(motion, balance, stiffness, regularization)
    }

    #[inline(always)]
    fn improved(&self, motion: &OpenMotion, balance: &OpenBalance, factor: &Closed) -> CutUnknowns {
        motion.x + self.step.correction(motion, balance, factor)
    }

    #[inline(always)]
    fn with_rates(&self, motion: &OpenMotion, balance: &OpenBalance, factor: &Closed) -> OpenMotion {
        self.step.with_rates(motion, balance, factor)
    }

    #[inline(always)]
    fn turn(x: &CutUnknowns) -> f64 {
        largest_turn(x)
    }

    #[inline(always)]
    fn unknowns(motion: &OpenMotion) -> CutUnknowns {
        motion.x
    }

    #[inline(always)]
    fn end(&self, motion: &OpenMotion) -> [Coordinates; 2] {
        [self.step.way(motion), self.step.rates(motion)]
    }

    #[inline(always)]
    fn secant(&self, motion: &OpenMotion) -> Secant {
        self.step.secant(motion)
    }

    fn multipliers(&self, motion: &OpenMotion) -> [Multipliers; 2] {
        self.step.multipliers(motion, &self.over(motion, |step| self.system.mean_forces(step)))
    }
}

impl<const BARE: bool> Discrete<COORDINATES, MULTIPLIERS> for FiveBar<'_, BARE> {
    type Secant = Secant;
    type CutUnknowns = CutUnknowns;
    type Cut<'a>
        = CutFiveBar<'a, BARE>
    where
        Self: 'a;

    #[inline(always)]
    fn secant(&self, begin: &Pose, d: &Coordinates) -> Secant {
        let mechanism = &self.model.mechanism;
        if BARE { mechanism.secant_in_place(begin, d) } else { mechanism.secant(begin, d) }
    }

    #[inline(always)]
    fn end(secant: &Secant) -> &Pose {
        &secant.end
    }

    #[inline(always)]
    fn discrete_transposed_times(&self, secant: &Secant, multipliers: &Multipliers) -> Coordinates {
        secant.discrete_transposed_times(multipliers)
    }

    #[inline(always)]
    fn mean_transposed_times(&self, secant: &Secant, multipliers: &Multipliers) -> Coordinates {
        secant.mean_transposed_times(multipliers)
    }

    #[inline(always)]
    fn turning_transposed_times(&self, secant: &Secant, z: &Coordinates, multipliers: &Multipliers) -> Coordinates {
        secant.turning_transposed_times(z, multipliers)
    }

    #[inline(always)]
    fn apply_inverse_mass(&self, x: &Coordinates) -> Coordinates {
        self.model.solver.legs().apply_inverse_mass(x)
    }

    #[inline(always)]
    fn mean_forces(&self, step: &Step<'_>) -> Coordinates {
        let mut forces = self.model.weight;
        self.inputs.add_mean_forces(&self.over(step), &mut forces);
        if BARE || self.model.effects.is_empty() { forces } else { self.with_mean_effects(step, forces) }
    }

    fn work_over(&self, step: &Step<'_>) -> Work {
        let over = self.over(step);
        let mut work = Work { input: self.inputs.input_over(&over), dissipated: 0.0 };
        for effect in &self.model.effects {
            work.input += effect.input_over(&over);
            work.dissipated += effect.dissipated_over(&over);
        }
        work
    }

    #[inline(always)]
    fn cut<'a>(&'a self, begin: &'a Pose, at: [&'a Coordinates; 2], h: f64) -> CutFiveBar<'a, BARE> {
        CutFiveBar { system: self, step: self.model.solver.legs().begin(begin, at, h) }
    }

    #[inline(always)]
    fn cut_unknowns(&self, d: &Coordinates, multipliers: [&Multipliers; 2]) -> CutUnknowns {
        cut_unknowns(d, multipliers)
    }

    #[inline(always)]
    fn alternates(&self) -> bool {
        BARE || self.model.conservative && self.model.solver.linear_solve() == LinearSolve::TwoLeg
    }

    fn newton(
        &self,
        step: &Step<'_>,
        multipliers: [&Multipliers; 2],
        residuals: (&Coordinates, &Multipliers, &Multipliers),
        regularization: f64,
    ) -> (Coordinates, [Multipliers; 2]) {
        let &Chord { d, v, h, secant, .. } = step;
        let over = self.over(step);
        let mut forces = StepTangents::new(h);
        self.inputs.add_mean_tangents(&over, &mut forces);
        for effect in &self.model.effects {
            effect.add_mean_tangents(&over, &mut forces);
        }
        let at = StepPoint { secant, d, w: &(h * *v), multipliers, forces: &forces, regularization };
        newton(&self.model.mechanism, &at, residuals)
    }

    fn has_friction(&self) -> bool {
        self.model.effects.iter().any(|effect| !effect.conservative())
    }
}

/// ½h² K of loads that couple no links and depend on no rates: only of the angles.
struct Diagonal {
    half_square: f64,
    inertias: Coordinates,
}

impl Tangents for Diagonal {
    #[inline(always)]
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        debug_assert!(row == column && THETA.contains(&row));
        self.inertias[row] += self.half_square * value;
    }

    #[inline(always)]
    fn damping(&mut self, _row: usize, _column: usize, _value: f64) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::Inputs;
    use crate::fmi::bindings::{default_inputs, default_parameters};
    use crate::integrator::{System, velocity_correction};
    use crate::mechanism::closure;
    use crate::simulation::{Model, Simulation};

    /// A machine in which nothing is equal, a pose of it and increments that turn its links by up to 0.4 rad.
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

    /// All effects on, the tip in the plane, the left axis in its stop, a step of 1 ms at some rad/s.
    fn loaded() -> (Model, Inputs, [Coordinates; 3]) {
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

    /// Collects tangents as they are.
    struct Tangible([[[f64; COORDINATES]; COORDINATES]; 2]);

    impl Tangents for Tangible {
        fn stiffness(&mut self, row: usize, column: usize, value: f64) {
            self.0[0][row][column] += value;
        }

        fn damping(&mut self, row: usize, column: usize, value: f64) {
            self.0[1][row][column] += value;
        }
    }

    /// Force times displacement is what potentials lose, inputs put in and dissipation takes.
    #[test]
    fn mean_forces_do_the_work_of_energies() {
        let (model, inputs, [q, d, v]) = loaded();
        let turns = [0; 4];
        let system = FiveBar::<false>::new(&model, &inputs, &turns);
        let secant = system.secant(&system.pose(&q), &d);
        let step = Chord { q: &q, d: &d, v: &v, h: 1e-3, softening: 1.0, secant: &secant };
        let work = system.work_over(&step);
        let none = Inputs::default();
        let unloaded = FiveBar::<false>::new(&model, &none, &turns);
        let potential = |q: &Coordinates| unloaded.potential_energy(q, &system.pose(q));
        let gained = potential(&(q + d)) - potential(&q);
        let total = system.mean_forces(&step).dot(&d);
        assert!(work.input.abs() > 1e-5 && work.dissipated.abs() > 1e-5 && gained.abs() > 1e-5);
        // Round-off of the energy of a plane pressed in by half a metre, some 100 J.
        assert!((total + gained + work.dissipated - work.input).abs() < 1e-12, "{total} {gained} {work:?}");
    }

    /// Against central differences, of the increments and of the rates at the end.
    #[test]
    fn mean_tangents_are_derivatives() {
        let (model, inputs, [q, d, v]) = loaded();
        let turns = [0; 4];
        let system = FiveBar::<false>::new(&model, &inputs, &turns);
        let begin = system.pose(&q);
        let forces = |d: &Coordinates, v: &Coordinates| {
            let secant = system.secant(&begin, d);
            system.mean_forces(&Chord { q: &q, d, v, h: 1e-3, softening: 1.0, secant: &secant })
        };
        let secant = system.secant(&begin, &d);
        let step = Chord { q: &q, d: &d, v: &v, h: 1e-3, softening: 1.0, secant: &secant };
        let over = system.over(&step);
        let mut tangents = Tangible([[[0.0; COORDINATES]; COORDINATES]; 2]);
        inputs.add_mean_tangents(&over, &mut tangents);
        for effect in &model.effects {
            effect.add_mean_tangents(&over, &mut tangents);
        }
        for column in 0..COORDINATES {
            let unit = Coordinates::unit(column);
            let numeric = [
                (forces(&(d + -1e-8 * unit), &v) - forces(&(d + 1e-8 * unit), &v)) / 2e-8,
                (forces(&d, &(v + -1e-5 * unit)) - forces(&d, &(v + 1e-5 * unit))) / 2e-5,
            ];
            for (kind, numeric) in numeric.iter().enumerate() {
                for row in 0..COORDINATES {
                    let (got, want) = (tangents.0[kind][row][column], numeric[row]);
                    // Round-off of forces of up to 1e3 N over 1e-8 m; the arm's third order.
                    assert!((got - want).abs() < 1e-4 * (1.0 + want.abs()), "{kind} {row} {column}: {got} {want}");
                }
            }
        }
    }

    /// Along Newton's increments the step's equations change by the negative of what they leave: the tangent is the whole one, by central
    /// differences of equations that are written down here once more.
    #[test]
    fn the_whole_tangent_is_the_derivative_of_the_equations() {
        let (model, inputs, [q, d, v0]) = loaded();
        let (turns, h) = ([0; 4], 1e-3);
        let system = FiveBar::<false>::new(&model, &inputs, &turns);
        let begin = system.pose(&q);
        let left = |d: &Coordinates, [lambda, nu]: [&Multipliers; 2]| {
            let secant = system.secant(&begin, d);
            let z = *d - system.apply_inverse_mass(&secant.mean_transposed_times(nu));
            let v = (2.0 / h) * z - v0;
            let step = Chord { q: &q, d, v: &v, h, softening: 1.0, secant: &secant };
            let inertia = system.mass_times(&secant.end, &(z - h * v0));
            let joints = secant.discrete_transposed_times(lambda) + 0.5 * secant.turning_transposed_times(&z, nu);
            let f = inertia + joints - 0.5 * h * h * system.mean_forces(&step);
            (f, system.phi(&(q + *d), &secant.end), secant.end.phi_q_times(&(h * v)), v)
        };
        let (lambda, nu) = (1e-3 * numbers(1.0), 1e-4 * numbers(2.0));
        let (f, phi, rate, v) = left(&d, [&lambda, &nu]);
        let secant = system.secant(&begin, &d);
        let step = Chord { q: &q, d: &d, v: &v, h, softening: 1.0, secant: &secant };
        let (by_d, [by_lambda, by_nu]) = system.newton(&step, [&lambda, &nu], (&f, &phi, &rate), 0.0);
        let along = |part: f64| left(&(d + part * by_d), [&(lambda + part * by_lambda), &(nu + part * by_nu)]);
        let part = 1e-5;
        let (more, less) = (along(part), along(-part));
        let worst = |change: &[f64], left: &[f64]| {
            change.iter().zip(left).fold(0.0f64, |worst, (change, left)| worst.max((change / (2.0 * part) + left).abs()))
                / left.iter().fold(0.0f64, |largest, left| largest.max(left.abs()))
        };
        // Round-off over 1e-5, and friction's and the plane's slopes, which change along the way.
        for (change, left) in
            [(&(more.0 - less.0)[..], &f[..]), (&(more.1 - less.1)[..], &phi[..]), (&(more.2 - less.2)[..], &rate[..])]
        {
            assert!(worst(change, left) < 1e-6, "{:?} {left:?}", change.iter().map(|x| x / (2.0 * part)).collect::<Vec<_>>());
        }
    }

    /// Along d the discrete derivatives give exactly what the constraints and their Jacobian change by.
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
            (secant.turning_transposed_times(&z, &lambda).dot(&d), lambda.dot(&turned)),
        ] {
            assert!((got - want).abs() < 1e-15, "{got} {want}");
        }
        // Directions turned twice by half the step, against those of the angles at its end.
        assert!((system.phi(&(q + d), &secant.end) - system.phi(&(q + d), &end)).max_norm() < 1e-15);
    }

    /// With the loop cut, whatever the unknowns: the joints but the tip's are met, all rows of z and the positions' rows of momentum
    /// vanish, and what is said to be left is what (37), written down here for all coordinates, leaves.
    #[test]
    fn the_cut_loop_has_the_equations_of_all_coordinates() {
        let (model, q, _) = step();
        let (inputs, turns, h) = (Inputs { tau: [0.01, 0.02], tip_force: [0.03, -0.04], ..default_inputs() }, [0; 4], 1e-3);
        let system = FiveBar::<false>::new(&model, &inputs, &turns);
        let begin = system.pose(&q);
        let (v0, _) = closure_rates(&system, &begin);
        let cut = system.cut(&begin, [&q, &v0], h);
        for size in [1e-3, 0.1] {
            let x = CutUnknowns::from_fn(|i| size * (1.0 + i as f64).cos() * if i < 4 { 1.0 } else { 1e-3 });
            let motion = cut.motion(&x, 1e-9);
            let ([d, v], secant) = (cut.end(&motion), cut.secant(&motion));
            let [lambda, nu] = cut.multipliers(&motion);
            let z = 0.5 * h * (v0 + v);
            let chord = Chord { q: &q, d: &d, v: &v, h, softening: 1.0, secant: &secant };
            let inertia = system.mass_times(&secant.end, &(z - h * v0));
            let joints = secant.discrete_transposed_times(&lambda) + 0.5 * secant.turning_transposed_times(&z, &nu);
            let f = inertia + joints - 0.5 * h * h * system.mean_forces(&chord);
            let moved = system.mass_times(&secant.end, &(d - z)) - secant.mean_transposed_times(&nu);
            let (phi, rates) = (system.phi(&(q + d), &secant.end), secant.end.phi_q_times(&(0.5 * h * v)));

            let balance = cut.balance(&motion);
            let [offset, gap, rate] = cut.left(&motion, &balance);
            let largest = |x: &[f64]| x.iter().fold(0.0f64, |largest, x| largest.max(x.abs()));
            // Round-off of turns of `size` of links with some 1e-3 kg·m² and some 0.1 kg.
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

    /// Rates that meet the constraints of a pose.
    fn closure_rates(system: &FiveBar<'_>, begin: &Pose) -> (Coordinates, f64) {
        let v = Coordinates::from_fn(|i| 3.0 * (0.3 + i as f64).cos());
        let mass = system.factor_mass(begin, 0.0);
        let v = v + velocity_correction(system, begin, &mass, &v);
        (v, begin.phi_q_times(&v).max_norm())
    }

    /// In turn Newton's method contracts as `docs/conserving.md` says, by (hω)².
    #[test]
    fn in_turn_it_contracts_by_the_square_of_the_turn() {
        let (inputs, turns) = (default_inputs(), [0; 4]);
        let simulation = Simulation::new(&default_parameters(), &inputs).expect("the start of the paper's fall");
        let (model, q) = (simulation.model(), simulation.state().core.q);
        let system = FiveBar::<false>::new(model, &inputs, &turns);
        let begin = system.pose(&q);
        let (v0, open) = closure_rates(&system, &begin);
        assert!(open < 1e-14);
        for h in [1e-3, 4e-3] {
            let cut = system.cut(&begin, [&q, &v0], h);
            let mut x = system.cut_unknowns(&(h * v0), [&Multipliers::ZERO; 2]);
            let mut left = Vec::new();
            for _ in 0..4 {
                let motion = cut.motion(&x, 1e-9);
                let balance = cut.balance(&motion);
                let [offset, gap, _] = cut.left(&motion, &balance);
                left.push(offset + gap);
                x = cut.improved(&motion, &balance, &cut.factor(&motion, &balance, 1e-9));
            }
            let turn = h * v0.max_norm();
            // The first finds the joint forces, of which nothing was known. 30: measured 17 and 0.4, by the arms of this pose.
            let allowed = |before: f64| (30.0 * turn * turn * before).max(1e-16);
            assert!(left[2] < allowed(left[1]) && left[3] < allowed(left[2]), "{left:?} {turn}");
        }
    }
}
