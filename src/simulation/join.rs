//! Impact of mass that joins the tip during a run, or leaves it.
//!
//! In the link angles the tip velocity is J_t ω. A mass m at rest brings no momentum, and the joint impulses ι keep the loop closed:
//!
//! ```text
//! M₁ ω₁ + Φ_qᵀ ι = M₀ ω₀,   Φ_q ω₁ = 0,   M₁ = M₀ + m J_tᵀ J_t
//! ```
//!
//! The impact is perfectly inelastic: the kinetic energy lost is dissipated. Mass that moves with the tip brings the momentum m J_tᵀ J_t
//! ω₀, and mass that leaves takes it away. In both cases rates do not change, and the energy counts as input work.

use super::angles::{AngleSystem, Angles, angles_of, legs};
use super::{Model, State};
use crate::dynamics::angles::in_link_order;
use crate::effects::payload::Join;
use crate::integrator::{Kkt, System, Work};
use crate::mechanism::coordinates::link_angles;
use crate::mechanism::{Coordinates, closure};
use crate::vector::Vector;

/// Jump of the state between two models: new coordinates and velocities if masses change, because the coordinates depend on the centre of
/// mass; and input work and dissipated energy, J.
pub(super) fn discontinuity(present: &State, before: &Model, after: &Model, join: Join) -> (Option<[Coordinates; 2]>, Work) {
    let potential = present.potential_energy(before);
    let mass = |model: &Model| model.mechanism.geometry.mean_mass();
    if before.mechanism.geometry == after.mechanism.geometry {
        return (None, Work { input: present.potential_energy(after) - potential, dissipated: 0.0 });
    }
    let impact = join == Join::AtRest && mass(after) > mass(before);
    let rates = if impact { after_impact(present, before, after) } else { angles_of(&present.core.v) };
    let (q, v) = closure::assemble(&after.mechanism.geometry, link_angles(&present.core.q), in_link_order(&rates));
    let mut state = *present;
    (state.core.q, state.core.v) = (q, v);
    let gained = state.kinetic_energy(after) - present.kinetic_energy(before);
    let lifted = state.potential_energy(after) - potential;
    let work = if impact { Work { input: lifted, dissipated: -gained } } else { Work { input: lifted + gained, dissipated: 0.0 } };
    (Some([q, v]), work)
}

/// Rates of the links after mass at rest has joined, rad/s.
fn after_impact(present: &State, before: &Model, after: &Model) -> Angles {
    let State { core, inputs, turns, .. } = present;
    let (q, v) = (angles_of(&core.q), angles_of(&core.v));
    let pose = |model: &Model| model.mechanism.pose_at(legs(&q));
    let system = AngleSystem::of(after, inputs, turns);
    let after_pose = pose(after);
    let factor = system.factor_mass(&after_pose, after.regularization_by_angles);
    let (rates, _) = factor.solve(&before.inertia.mass_times(&pose(before), &v), &Vector::ZERO);
    // A second solve removes the closure rate that the regularisation leaves.
    let (correction, _) = factor.solve(&Angles::ZERO, &(Vector::ZERO - system.phi_q_times(&after_pose, &rates)));
    rates + correction
}
