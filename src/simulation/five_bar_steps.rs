//! The five-bar over a finite step, as the conserving method sees it: discrete derivatives of the joints' constraints
//! (`src/mechanism/secant.rs`) and mean forces of the effects.

use super::five_bar::FiveBar;
use crate::effects::{StepContext, Tangents};
use crate::integrator::{Chord, Discrete, NewtonSettings, SecantFactor, Work};
use crate::linear::secant_legs::SecantLegs;
use crate::linear::secant_newton::{StepPoint, StepTangents, newton};
use crate::mechanism::coordinates::{D_THETA, P_THETA, THETA, legs_of};
use crate::mechanism::legs::both;
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

impl SecantFactor<COORDINATES, MULTIPLIERS> for SecantLegs {
    #[inline(always)]
    fn solve(&self, b: &Coordinates, c: &Multipliers) -> (Coordinates, Multipliers) {
        SecantLegs::solve(self, b, c)
    }

    #[inline(always)]
    fn dual(&self, r: &Multipliers) -> Multipliers {
        SecantLegs::dual(self, r)
    }
}

impl<const BARE: bool> Discrete<COORDINATES, MULTIPLIERS> for FiveBar<'_, BARE> {
    type Secant = Secant;
    type Factor = SecantLegs;

    #[inline(always)]
    fn secant(&self, begin: &Pose, d: &Coordinates) -> Secant {
        self.model.mechanism.secant(begin, d)
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
    fn alternates(&self) -> bool {
        BARE || self.model.is_bare()
    }

    /// A is diagonal but for what is of the order of ν: masses, and the inertias with the stiffness of joint forces and of a force on the
    /// tip.
    #[inline(always)]
    fn factor_secant(&self, step: &Step<'_>, (lambda, pull): (&Multipliers, &Coordinates), regularization: f64) -> SecantLegs {
        let &Chord { d, h, secant, .. } = step;
        let mechanism = &self.model.mechanism;
        let (stiffness_p, stiffness_d) = secant.middle.geometric_stiffness(lambda);
        let mut tip = TipStiffness { half_square: 0.5 * h * h, inertia: 0.0 };
        self.inputs.add_mean_tangents(&self.over(step), &mut tip);
        // Of s, whose derivative is −d/12 but for the third order.
        let shortening = |angles| both(-1.0 / 12.0) * legs_of(d, angles) * legs_of(pull, angles);
        let proximal = mechanism.inertia_p + both(0.5) * secant.sinc[0] * stiffness_p + shortening(P_THETA);
        let distal = mechanism.inertia_d + both(0.5) * secant.sinc[1] * stiffness_d + shortening(D_THETA);
        let carrier = crate::mechanism::legs::Legs::new([tip.inertia, 0.0]);
        SecantLegs::factor(self.model.solver.legs(), secant, [proximal, distal + carrier], regularization)
    }

    fn newton(
        &self,
        step: &Step<'_>,
        multipliers: [&Multipliers; 2],
        residuals: (&Coordinates, &Multipliers, &Multipliers),
        settings: NewtonSettings,
    ) -> (Coordinates, [Multipliers; 2]) {
        let &Chord { d, v, h, secant, .. } = step;
        let NewtonSettings { regularization, both_levels } = settings;
        let over = self.over(step);
        let mut forces = StepTangents::new(h);
        self.inputs.add_mean_tangents(&over, &mut forces);
        for effect in &self.model.effects {
            effect.add_mean_tangents(&over, &mut forces);
        }
        let at = StepPoint { secant, d, w: &(h * *v), multipliers, forces: &forces, regularization, both_levels };
        newton(&self.model.mechanism, &at, residuals)
    }

    fn has_friction(&self) -> bool {
        self.model.effects.iter().any(|effect| !effect.conservative())
    }
}

/// ½h² K of a force on the tip: only in the angle of link 2.
struct TipStiffness {
    half_square: f64,
    inertia: f64,
}

impl Tangents for TipStiffness {
    #[inline(always)]
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        debug_assert!(row == column && row == THETA[1]);
        self.inertia += self.half_square * value;
    }

    #[inline(always)]
    fn damping(&mut self, _row: usize, _column: usize, _value: f64) {}
}
