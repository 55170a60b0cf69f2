//! Inputs that change within an advance, as quadratic polynomials of time.

use borsh::{BorshDeserialize, BorshSerialize};

use super::StepFailure;
use crate::effects::Inputs;

/// Inputs as polynomials u + u′ s + u″ s²/2 of the time s since the beginning of an advance, s.
#[derive(Clone, Copy, Debug, Default, PartialEq, BorshSerialize, BorshDeserialize)]
pub struct Signal {
    /// Value u at the beginning, in the units of [`Inputs`].
    pub value: Inputs,
    /// Derivatives u′ and u″, unless all of them are 0.
    derivatives: Option<[Inputs; ORDERS]>,
}

/// Number of derivatives of a [`Signal`].
pub const ORDERS: usize = 2;

impl Signal {
    /// Constant inputs.
    pub fn held(value: Inputs) -> Self {
        Self { value, derivatives: None }
    }

    /// Inputs with u′ and u″, in their units per s and per s².
    pub fn new(value: Inputs, derivatives: [Inputs; ORDERS]) -> Self {
        Self { value, derivatives: (derivatives != [Inputs::default(); ORDERS]).then_some(derivatives) }
    }

    /// Derivatives u′ and u″, 0 for constant inputs.
    pub fn derivatives(&self) -> [Inputs; ORDERS] {
        self.derivatives.unwrap_or_default()
    }

    /// The servo references alone; loads are 0.
    pub(super) fn references(&self) -> Self {
        let derivatives = self.derivatives.map(|derivatives| derivatives.map(|of| of.references()));
        Self::new(self.value.references(), derivatives.unwrap_or_default())
    }

    /// Inputs `elapsed` seconds after the beginning.
    pub fn at(&self, elapsed: f64) -> Inputs {
        self.derivatives
            .map_or(self.value, |[rate, curvature]| self.value.plus(elapsed, &rate).plus(elapsed * elapsed / 2.0, &curvature))
    }

    /// Makes `steps` macro steps of h seconds, each with the inputs at its middle.
    pub(super) fn over(
        &self,
        (h, steps): (f64, u64),
        mut step: impl FnMut(&Inputs) -> Result<(), StepFailure>,
    ) -> Result<(), StepFailure> {
        for k in 0..steps {
            let begin = k as f64 * h;
            step(&self.at(begin + h / 2.0)).map_err(|failure| failure.after(begin))?;
        }
        Ok(())
    }

    /// Whether the inputs are constant.
    pub fn is_held(&self) -> bool {
        self.derivatives.is_none()
    }

    /// Replaces the polynomial by its value after `elapsed` seconds, which remains until the master sets other inputs.
    pub fn end(&mut self, elapsed: f64) {
        if !self.is_held() {
            *self = Self::held(self.at(elapsed));
        }
    }
}
