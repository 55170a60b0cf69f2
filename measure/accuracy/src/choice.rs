//! Methods with their settings; each is a marker in the diagrams.

use hard_cases::Setting;

use crate::Extent;

/// A method with its step or tolerance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// Name of its line in the diagrams.
    pub method: &'static str,
    /// Name of the varied setting: `step` or `tolerance`.
    pub knob: &'static str,
    /// Unit of `value`: s or rad.
    pub unit: &'static str,
    /// Step or tolerance, in `unit`.
    pub value: f64,
    /// Method and settings of the simulation.
    pub setting: Setting,
}

/// A line of a diagram: method, name of the varied setting, its unit, its values, and the setting of each value.
struct Line {
    method: &'static str,
    knob: &'static str,
    unit: &'static str,
    values: &'static [f64],
    setting: fn(f64) -> Setting,
}

/// Divisors and multiples of 1 ms.
const STEPS: &[f64] = &[4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1e-4, 5e-5, 2.5e-5, 1e-5];

const LINES: [Line; 7] = [
    Line {
        method: "dop853",
        knob: "tolerance",
        unit: "rad",
        values: &[1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-14],
        setting: Setting::Dop853,
    },
    Line {
        method: "automatic",
        knob: "tolerance",
        unit: "rad",
        values: &[1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13, 1e-14],
        setting: Setting::Automatic,
    },
    Line {
        method: "i3alp, adaptive",
        knob: "tolerance",
        unit: "rad",
        values: &[1e-5, 1e-6, 1e-7, 1e-8, 3e-9, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13],
        setting: Setting::Tolerance,
    },
    Line { method: "i3alp, fixed step", knob: "step", unit: "s", values: STEPS, setting: Setting::Fixed },
    Line { method: "i3alpConserving", knob: "step", unit: "s", values: STEPS, setting: Setting::Conserving },
    Line { method: "i3alpPrinted", knob: "step", unit: "s", values: STEPS, setting: Setting::Printed },
    Line { method: "rk4", knob: "step", unit: "s", values: STEPS, setting: Setting::Rk4 },
];

impl Choice {
    /// All choices; `Quick`: every third value.
    pub fn all(extent: Extent) -> Vec<Self> {
        let stride = if extent == Extent::Full { 1 } else { 3 };
        let of = |line: &Line| {
            let &Line { method, knob, unit, values, setting } = line;
            values.iter().step_by(stride).map(move |&value| Self { method, knob, unit, value, setting: setting(value) }).collect()
        };
        LINES.iter().flat_map::<Vec<Self>, _>(of).collect()
    }

    /// The cells that identify the choice in every table.
    pub fn cells(&self) -> [String; 4] {
        [self.method.into(), self.knob.into(), format!("{:e}", self.value), self.unit.into()]
    }
}

/// The head of [`Choice::cells`].
pub const HEAD: [&str; 4] = ["method", "knob", "value", "unit"];
