//! Inputs that change while the simulation advances.

use crate::effects::Inputs;

/// Inputs as polynomials of the time s since the beginning of an advance: u + u′ s + u″ s²/2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Signal {
    /// u, in the units of [`Inputs`].
    pub value: Inputs,
    /// u′ and u″, unless all of them are 0.
    derivatives: Option<[Inputs; ORDERS]>,
}

/// Orders of derivatives that a [`Signal`] has.
pub const ORDERS: usize = 2;

impl Signal {
    /// Inputs that stay.
    pub fn held(value: Inputs) -> Self {
        Self { value, derivatives: None }
    }

    /// Inputs with u′ and u″, in their units per s and per s².
    pub fn new(value: Inputs, derivatives: [Inputs; ORDERS]) -> Self {
        Self { value, derivatives: (derivatives != [Inputs::default(); ORDERS]).then_some(derivatives) }
    }

    /// u′ and u″.
    pub fn derivatives(&self) -> [Inputs; ORDERS] {
        self.derivatives.unwrap_or_default()
    }

    /// The inputs `elapsed` seconds after the beginning.
    pub fn at(&self, elapsed: f64) -> Inputs {
        self.derivatives
            .map_or(self.value, |[rate, curvature]| self.value.plus(elapsed, &rate).plus(elapsed * elapsed / 2.0, &curvature))
    }

    /// Whether the inputs are held.
    pub fn is_held(&self) -> bool {
        self.derivatives.is_none()
    }

    /// Holds from now on what it is after an advance of `elapsed` seconds: what follows unless the master says otherwise.
    pub fn end(&mut self, elapsed: f64) {
        if !self.is_held() {
            *self = Self::held(self.at(elapsed));
        }
    }
}
