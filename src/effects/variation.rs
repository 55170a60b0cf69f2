//! Directional derivatives of forces and potentials, δQ = −K δq − C δv + ∂Q/∂u δu, by the tangents of the implicit steps.

use super::{Effect, ForceContext, Inputs, Tangents};
use crate::mechanism::Coordinates;

/// A variation of the state and inputs of a [`ForceContext`], or their derivative along a parameter.
#[derive(Clone, Copy, Debug)]
pub struct Perturbation {
    /// Variation δq of the coordinates, m and rad.
    pub q: Coordinates,
    /// Variation δv of the velocities, m/s and rad/s.
    pub v: Coordinates,
    /// Variation δu of the inputs.
    pub inputs: Inputs,
}

/// Collects the products −K δq − C δv, N and N·m.
struct TangentProducts<'a> {
    change: &'a Perturbation,
    forces: Coordinates,
}

impl Tangents for TangentProducts<'_> {
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        self.forces[row] -= value * self.change.q[column];
    }

    fn damping(&mut self, row: usize, column: usize, value: f64) {
        self.forces[row] -= value * self.change.v[column];
    }
}

impl Inputs {
    /// Variation of the generalised force of the loads, N and N·m.
    pub fn force_change(&self, at: &ForceContext, change: &Perturbation) -> Coordinates {
        let mut products = TangentProducts { change, forces: Coordinates::ZERO };
        self.add_tangents(at, &mut (&mut products as &mut dyn Tangents));
        // The force is linear in the loads.
        change.inputs.add_forces(at, &mut products.forces);
        products.forces
    }
}

impl Effect {
    /// Variation of the generalised force, N and N·m.
    pub fn force_change(&self, at: &ForceContext, change: &Perturbation) -> Coordinates {
        let mut products = TangentProducts { change, forces: Coordinates::ZERO };
        self.add_tangents(at, &mut (&mut products as &mut dyn Tangents));
        self.add_input_change(at, &change.inputs, &mut products.forces);
        products.forces
    }

    /// Variation of the potential energy, J.
    pub fn potential_change(&self, at: &ForceContext, change: &Perturbation) -> f64 {
        // With velocity δq: dU/dt = input − dissipation − power of the force.
        let moving = ForceContext { v: &change.q, ..*at };
        let mut forces = Coordinates::ZERO;
        self.add_forces(&moving, &mut forces);
        let power = forces.dot(&change.q);
        self.input_power(&moving) - self.dissipation(&moving) - power
    }
}
