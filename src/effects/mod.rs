//! One file per effect a scene may call for.

pub mod gravity;

/// The parameters of every effect, whether the scene calls for it or not.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// See [`gravity`].
    pub gravity: gravity::Parameters,
}

/// What the master sets: held over a communication step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Motor torques on the left and right proximal link, N·m.
    pub tau: [f64; 2],
    /// External force on the tip, N.
    pub tip_force: [f64; 2],
}
