//! Why a step could not be done.

use std::fmt;

/// Why a step could not be done.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StepError {
    /// Newton did not meet its tolerance.
    NotConverged {
        /// Iterations spent.
        iterations: u32,
        /// Largest constraint violation left, m.
        violation: f64,
        /// What was asked for, m.
        tolerance: f64,
        /// Largest last correction of a coordinate, m or rad, which is judged as well.
        correction: f64,
    },
    /// The tangent matrix is not positive: the step is too long for this posture and load.
    IndefiniteTangent,
    /// The equations of a conserving step were not solved by plain Newton's method, and no rescue is allowed.
    NoRootWithin {
        /// Iterations spent.
        iterations: u32,
    },
    /// Nor was there a shorter way that keeps the energy.
    FallbackFailed,
    /// A value became NaN or infinite.
    NotFinite,
    /// Close to a vertex a sub-step changed the energy.
    EnergyChange {
        /// By this part of the kinetic energy.
        part: f64,
    },
    /// The local error is too large however short the sub-step.
    StepTooShort {
        /// The last sub-step tried, s.
        substep: f64,
        /// Its local error, rad; NaN if it failed altogether.
        error: f64,
    },
    /// The local error, or sub-steps that failed, asked for more iterations or evaluations than one macro step may have.
    TooMuchWork {
        /// The bound.
        most: u32,
        /// The last sub-step tried, s.
        substep: f64,
        /// Its local error, rad; infinite if it failed altogether.
        error: f64,
    },
}

impl fmt::Display for StepError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotConverged { iterations, violation, tolerance, correction } => write!(
                f,
                "the iteration did not converge: after {iterations} iterations the constraints are violated by {violation:.3e} m \
                 (allowed {tolerance:.3e} m) and the last correction was {correction:.3e} m or rad"
            ),
            Self::NoRootWithin { iterations } => {
                write!(
                    f,
                    "the step's equations were not solved in {iterations} iterations, and solver.maxWork = 0 allows no fallback"
                )
            }
            Self::FallbackFailed => f.write_str(
                "the step's equations were not solved within solver.maxWork, and the last fallback stage found no shorter step that conserves energy",
            ),
            Self::IndefiniteTangent => {
                f.write_str("the tangent matrix is not positive definite: the step is too long for this posture and load")
            }
            Self::EnergyChange { part } => {
                write!(f, "near a constraint singularity a sub-step changed the kinetic energy by {part:.3e} (relative)")
            }
            Self::NotFinite => f.write_str("a coordinate, velocity or acceleration is not finite"),
            Self::StepTooShort { substep, error } => {
                write!(f, "a sub-step of only {substep:.3e} s still {}", LocalError(*error))
            }
            Self::TooMuchWork { most, substep, error } => write!(
                f,
                "a macro step needs more iterations and evaluations than solver.maxWork = {most} allows: the last sub-step, of {substep:.3e} s, {}",
                LocalError(*error)
            ),
        }
    }
}

impl std::error::Error for StepError {}

/// What became of a sub-step by its local error, rad.
struct LocalError(f64);

impl fmt::Display for LocalError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(error) = self;
        if error.is_finite() { write!(f, "had a local error of {error:.3e} rad") } else { f.write_str("failed") }
    }
}

#[cfg(test)]
mod tests {
    use super::StepError;

    #[test]
    fn sub_steps_that_failed_have_no_local_error() {
        let said = |error| StepError::TooMuchWork { most: 9, substep: 1e-6, error }.to_string();
        assert!(said(1e-7).ends_with("the last sub-step, of 1.000e-6 s, had a local error of 1.000e-7 rad"), "{}", said(1e-7));
        for error in [f64::INFINITY, f64::NAN] {
            assert!(said(error).ends_with("the last sub-step, of 1.000e-6 s, failed"), "{}", said(error));
        }
    }
}
