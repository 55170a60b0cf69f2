//! The methods with their settings; the columns of the matrix.

use fivebar::simulation::{Method, Parameters};

/// A method with its step or tolerance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Setting {
    /// i3-ALP with error-controlled sub-steps at the default tolerance.
    Default,
    /// i3-ALP with error-controlled sub-steps at this local error, rad.
    Tolerance(f64),
    /// i3-ALP with fixed steps of this length, s.
    Fixed(f64),
    /// i3-ALP as printed, with steps of this length, s.
    Printed(f64),
    /// Runge-Kutta of order 4 with projection, with steps of this length, s.
    Rk4(f64),
    /// The conserving step, of this length, s.
    Conserving(f64),
    /// Runge-Kutta of order 8 with this error tolerance, rad.
    Dop853(f64),
    /// The method that chooses the cheapest kind of step, with this error tolerance, rad.
    Automatic(f64),
}

impl Setting {
    /// The tighter tolerance of the battery, rad.
    pub const TIGHT: Self = Self::Tolerance(3e-10);
    /// Much tighter than any judged setting, for starts and reference motions.
    pub const REFERENCE: Self = Self::Tolerance(1e-11);
    /// The explicit method at the battery's tolerance, rad.
    pub const EXPLICIT: Self = Self::Dop853(1e-10);
    /// The method that chooses its scheme, at the battery's tolerance, rad.
    pub const AUTOMATIC: Self = Self::Automatic(1e-10);
    /// The conserving step that judges every case, s; falls are judged at all of its step lengths.
    pub const CONSERVING: Self = Self::Conserving(1e-3);
    /// The columns of the matrix.
    pub const ALL: [Self; 13] = [
        Self::Default,
        Self::TIGHT,
        Self::EXPLICIT,
        Self::AUTOMATIC,
        Self::Conserving(2.5e-4),
        Self::CONSERVING,
        Self::Conserving(4e-3),
        Self::Fixed(1e-3),
        Self::Fixed(1e-4),
        Self::Printed(1e-3),
        Self::Printed(1e-4),
        Self::Rk4(1e-3),
        Self::Rk4(1e-4),
    ];

    /// Applies the setting to a scene. Settings without a step keep the scene's longest macro step.
    pub fn apply(self, parameters: &mut Parameters) {
        let settings = &mut parameters.settings;
        let step = match self {
            Self::Default => return,
            Self::Tolerance(tolerance) => {
                settings.error_tolerance = tolerance;
                return;
            }
            Self::Dop853(tolerance) => {
                (settings.method, settings.error_tolerance) = (Method::Dop853, tolerance);
                return;
            }
            Self::Automatic(tolerance) => {
                (settings.method, settings.error_tolerance) = (Method::Automatic, tolerance);
                return;
            }
            Self::Fixed(step) => {
                settings.adaptive = false;
                step
            }
            Self::Conserving(step) => {
                settings.method = Method::I3alpConserving;
                step
            }
            Self::Printed(step) => {
                settings.method = Method::I3alpPrinted;
                step
            }
            Self::Rk4(step) => {
                settings.method = Method::Rk4;
                step
            }
        };
        settings.step_size = step;
    }

    /// Name of the method in `solver.method`.
    pub fn method(self) -> &'static str {
        match self {
            Self::Default | Self::Tolerance(_) | Self::Fixed(_) => "i3alp",
            Self::Printed(_) => "i3alpPrinted",
            Self::Conserving(_) => "i3alpConserving",
            Self::Rk4(_) => "rk4",
            Self::Dop853(_) => "dop853",
            Self::Automatic(_) => "automatic",
        }
    }

    /// Step or tolerance.
    pub fn label(self) -> String {
        match self {
            Self::Default => "default tolerance".into(),
            Self::Tolerance(tolerance) | Self::Dop853(tolerance) | Self::Automatic(tolerance) => {
                format!("tolerance {tolerance:e} rad")
            }
            Self::Fixed(step) => format!("fixed {} ms", 1e3 * step),
            Self::Printed(step) | Self::Conserving(step) | Self::Rk4(step) => format!("{} ms", 1e3 * step),
        }
    }
}
