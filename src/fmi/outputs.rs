//! Variables ← observers: every output is computed when it is read, and what several outputs share only once.

use std::cell::OnceCell;

use nalgebra::Vector2;

use crate::mechanism;
use crate::observers::{self, ConstraintNorms, Energies, Jacobians, Motion, Singularity};
use crate::simulation::{Inputs, Simulation, State};
use crate::variables::{
    Assembly, EnumerationOutput, IntegerOutput, RealOutput, SingularityKind, Slot, Value, Variable, WorkingMode,
};

/// What has been computed since the last step or change of inputs.
#[derive(Debug, Default)]
pub(super) struct Cache {
    /// The state for inputs that are not those of the last step.
    other: OnceCell<Option<State>>,
    motion: OnceCell<Motion>,
    reactions: OnceCell<[Vector2<f64>; 5]>,
    energies: OnceCell<Energies>,
    jacobians: OnceCell<Jacobians>,
    singularity: OnceCell<Singularity>,
    norms: OnceCell<ConstraintNorms>,
}

/// The left and the right link of a pair, as positions among the four links.
pub(super) const PROXIMAL: [usize; 2] = [0, 3];
pub(super) const DISTAL: [usize; 2] = [1, 2];

/// The outputs of a simulation for the present inputs.
pub(super) struct Outputs<'a> {
    pub(super) simulation: &'a Simulation,
    pub(super) inputs: &'a Inputs,
    pub(super) cache: &'a Cache,
}

impl Outputs<'_> {
    /// The value of an output; `None` for any other variable.
    pub(super) fn read(&self, variable: &Variable) -> Option<Value> {
        match variable.slot {
            Slot::RealOutput(v) => Some(Value::Real(self.real(v))),
            Slot::IntegerOutput(v) => Some(Value::Integer(self.integer(v))),
            Slot::EnumerationOutput(v) => Some(Value::Integer(self.enumeration(v))),
            Slot::RealParameter(_)
            | Slot::RealInput(_)
            | Slot::IntegerParameter(_)
            | Slot::BooleanParameter(_)
            | Slot::EnumerationParameter(_) => None,
        }
    }

    fn real(&self, variable: RealOutput) -> f64 {
        use RealOutput as V;
        match variable {
            V::Theta(i) => self.motion().theta[PROXIMAL[i]],
            V::Omega(i) => self.motion().omega[PROXIMAL[i]],
            V::Alpha(i) => self.motion().alpha[PROXIMAL[i]],
            V::PassiveTheta(i) => self.motion().theta[DISTAL[i]],
            V::PassiveOmega(i) => self.motion().omega[DISTAL[i]],
            V::TipX => self.motion().tip.x,
            V::TipY => self.motion().tip.y,
            V::TipVx => self.motion().tip_velocity.x,
            V::TipVy => self.motion().tip_velocity.y,
            V::TipAx => self.motion().tip_acceleration.x,
            V::TipAy => self.motion().tip_acceleration.y,
            V::ElbowX(i) => self.motion().elbows[i].x,
            V::ElbowY(i) => self.motion().elbows[i].y,
            V::ReactionFx(i) => self.reactions()[i].x,
            V::ReactionFy(i) => self.reactions()[i].y,
            V::EnergyKinetic => self.energies().kinetic,
            V::EnergyPotential => self.energies().potential,
            V::EnergyInput => self.energies().input,
            V::EnergyDissipated => self.energies().dissipated,
            V::EnergyError => self.energies().error,
            V::ServoTorque(i) => observers::servo_torques(self.simulation.model(), self.state())[i],
            V::ContactFx => observers::contact_force(self.simulation.model(), self.state()).x,
            V::ContactFy => observers::contact_force(self.simulation.model(), self.state()).y,
            V::SingularDetJx => self.jacobians().det_jx,
            V::SingularDetJq => self.jacobians().det_jq,
            V::SingularSigmaJx => self.jacobians().sigma_jx,
            V::SingularSigmaJq => self.jacobians().sigma_jq,
            V::SingularSigmaPhi => self.singularity().sigma_phi,
            V::SolverPositionError => self.norms().position,
            V::SolverVelocityError => self.norms().velocity,
            V::SolverErrorEstimate => self.simulation.state().core.error_estimate,
        }
    }

    fn integer(&self, variable: IntegerOutput) -> i32 {
        let counters = self.simulation.state().core.counters;
        let count = match variable {
            IntegerOutput::SolverSteps => counters.steps,
            IntegerOutput::SolverSubsteps => counters.substeps,
            IntegerOutput::SolverIterations => counters.iterations,
            IntegerOutput::SolverRejected => counters.rejected,
            IntegerOutput::SolverRescued => counters.rescued,
            IntegerOutput::SolverRestarts => counters.restarts,
            IntegerOutput::SolverLaunches => counters.launches,
            IntegerOutput::SolverVertexPasses => counters.vertex_passes,
            IntegerOutput::SingularPassesDirect => counters.mode_changes[0],
            IntegerOutput::SingularPassesInverse(i) => counters.mode_changes[1 + i],
        };
        // fmi2Integer has 32 bits: a counter that has grown past them stays at the largest value.
        i32::try_from(count).unwrap_or(i32::MAX)
    }

    fn enumeration(&self, variable: EnumerationOutput) -> i32 {
        match variable {
            EnumerationOutput::SingularType => match self.singularity().kind {
                observers::SingularityKind::None => SingularityKind::None as i32,
                observers::SingularityKind::Direct => SingularityKind::Direct as i32,
                observers::SingularityKind::Inverse => SingularityKind::Inverse as i32,
                observers::SingularityKind::Combined => SingularityKind::Combined as i32,
                observers::SingularityKind::Constraint => SingularityKind::Constraint as i32,
            },
            EnumerationOutput::ModeAssembly => match self.jacobians().assembly {
                mechanism::Assembly::Plus => Assembly::Plus as i32,
                mechanism::Assembly::Minus => Assembly::Minus as i32,
            },
            EnumerationOutput::ModeWorking => match self.jacobians().working {
                [true, true] => WorkingMode::PlusPlus as i32,
                [true, false] => WorkingMode::PlusMinus as i32,
                [false, true] => WorkingMode::MinusPlus as i32,
                [false, false] => WorkingMode::MinusMinus as i32,
            },
        }
    }

    /// The present state with the accelerations and multipliers that belong to the present inputs, which the master
    /// may have changed since the last step.
    pub(super) fn state(&self) -> &State {
        let other = self.cache.other.get_or_init(|| self.simulation.state_for(self.inputs));
        other.as_ref().unwrap_or(self.simulation.state())
    }

    pub(super) fn motion(&self) -> &Motion {
        self.cache.motion.get_or_init(|| observers::motion(self.simulation.model(), self.state()))
    }

    fn reactions(&self) -> &[Vector2<f64>; 5] {
        self.cache.reactions.get_or_init(|| observers::reactions(self.state()))
    }

    fn energies(&self) -> &Energies {
        self.cache.energies.get_or_init(|| observers::energies(self.simulation.model(), self.state()))
    }

    fn singularity(&self) -> &Singularity {
        self.cache.singularity.get_or_init(|| observers::singularity(self.simulation.model(), self.state()))
    }

    fn jacobians(&self) -> &Jacobians {
        self.cache.jacobians.get_or_init(|| observers::jacobians(self.simulation.model(), self.state()))
    }

    fn norms(&self) -> &ConstraintNorms {
        self.cache.norms.get_or_init(|| observers::constraint_norms(self.simulation.model(), self.state()))
    }
}
