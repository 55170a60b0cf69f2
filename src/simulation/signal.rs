//! Inputs that change while the simulation advances.

use crate::effects::Inputs;

/// Inputs as polynomials of the time s since the beginning of an advance: u + u′ s + u″ s²/2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Signal {
    /// u, in the units of [`Inputs`].
    pub value: Inputs,
    /// u′ and u″, in those per s and per s².
    pub derivatives: [Inputs; ORDERS],
}

/// Orders of derivatives that a [`Signal`] has.
pub const ORDERS: usize = 2;

impl Signal {
    /// The inputs `elapsed` seconds after the beginning.
    pub fn at(&self, elapsed: f64) -> Inputs {
        let [rate, curvature] = &self.derivatives;
        self.value.plus(elapsed, rate).plus(elapsed * elapsed / 2.0, curvature)
    }

    /// Whether the inputs are held.
    pub fn is_held(&self) -> bool {
        self.derivatives == [Inputs::default(); ORDERS]
    }

    /// What follows an advance of `elapsed` seconds, unless the master says otherwise: the inputs reached, held.
    pub fn after(&self, elapsed: f64) -> Self {
        if self.is_held() { *self } else { Self { value: self.at(elapsed), ..Self::default() } }
    }
}
