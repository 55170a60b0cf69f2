//! Gravity.

/// Gravity's parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Whether the scene has gravity.
    pub enabled: bool,
    /// Gravitational acceleration, m/s².
    pub g: f64,
    /// Tilt of the mechanism's plane, rad: 0 = flat.
    pub tilt: f64,
    /// Direction of the in-plane part, rad from +x.
    pub direction: f64,
}
