//! How forces and potentials change with what they depend on: products with the tangents that the implicit steps use.

use super::{Effect, ForceContext, Inputs, Tangents};
use crate::mechanism::Coordinates;

/// A small change of what a [`ForceContext`] holds, or a derivative of it.
#[derive(Clone, Copy, Debug)]
pub struct Perturbation {
    /// Of the coordinates.
    pub q: Coordinates,
    /// Of the velocities.
    pub v: Coordinates,
    /// Of the inputs.
    pub inputs: Inputs,
}

/// Takes tangents as their products with a change: −K δq − C δv.
struct Products<'a> {
    change: &'a Perturbation,
    forces: Coordinates,
}

impl Tangents for Products<'_> {
    fn stiffness(&mut self, row: usize, column: usize, value: f64) {
        self.forces[row] -= value * self.change.q[column];
    }

    fn damping(&mut self, row: usize, column: usize, value: f64) {
        self.forces[row] -= value * self.change.v[column];
    }
}

impl Inputs {
    /// How the generalised force of the loads changes.
    pub fn force_change(&self, at: &ForceContext, change: &Perturbation) -> Coordinates {
        let mut products = Products { change, forces: Coordinates::ZERO };
        self.add_tangents(at, &mut (&mut products as &mut dyn Tangents));
        // The force is linear in the loads.
        change.inputs.add_forces(at, &mut products.forces);
        products.forces
    }
}

impl Effect {
    /// How the generalised force changes.
    pub fn force_change(&self, at: &ForceContext, change: &Perturbation) -> Coordinates {
        let mut products = Products { change, forces: Coordinates::ZERO };
        self.add_tangents(at, &mut (&mut products as &mut dyn Tangents));
        self.add_input_change(at, &change.inputs, &mut products.forces);
        products.forces
    }

    /// How the potential energy changes, J.
    pub fn potential_change(&self, at: &ForceContext, change: &Perturbation) -> f64 {
        // A motion along δq passes the potential at the rate that input, dissipation and the force's power leave.
        let moving = ForceContext { v: &change.q, ..*at };
        let mut forces = Coordinates::ZERO;
        self.add_forces(&moving, &mut forces);
        let power = forces.dot(&change.q);
        self.input_power(&moving) - self.dissipation(&moving) - power
    }
}
