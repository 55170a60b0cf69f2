//! Errors of a step, with the messages that users see.

use std::fmt;

/// Error of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StepError {
    /// Newton's method did not meet its tolerance.
    NotConverged {
        /// Number of iterations taken.
        iterations: u32,
        /// Largest constraint violation left, m.
        violation: f64,
        /// Admissible constraint violation, m.
        tolerance: f64,
        /// Largest last correction of a coordinate, m or rad; corrections have a bound, too.
        correction: f64,
    },
    /// The tangent matrix is not positive definite: the step is too long for this posture and load.
    IndefiniteTangent,
    /// Plain Newton iteration did not solve a conserving step, and `solver.maxWork` = 0 allows no fallback.
    NoRootWithin {
        /// Number of iterations taken.
        iterations: u32,
    },
    /// Neither a root nor an energy-conserving end was found by the fallback stages.
    FallbackFailed,
    /// A value became NaN or infinite.
    NotFinite,
    /// A sub-step near a vertex changed the kinetic energy.
    EnergyChange {
        /// Relative change of the kinetic energy.
        part: f64,
    },
    /// The local error is inadmissible at the shortest sub-step.
    StepTooShort {
        /// Length of the last sub-step tried, s.
        substep: f64,
        /// Local error of that sub-step, rad; NaN if there is no estimate.
        error: f64,
    },
    /// The energy balance of a sub-step is off by more than its error allows.
    Imbalance {
        /// Energy gained beyond the work done, J.
        off: f64,
        /// Largest imbalance allowed, J.
        admissible: f64,
    },
    /// A determinant of the Jacobians changed its sign away from its singularity.
    SignWithoutSingularity {
        /// Index of the determinant, see [`super::System::configuration_signs`].
        determinant: usize,
        /// Sine of the angle from the singularity.
        sine: f64,
        /// Largest sine allowed.
        admissible: f64,
    },
    /// The motion left its branch of the closure.
    BranchChange,
    /// Rejected and failed sub-steps exceeded the work limit of a macro step.
    TooMuchWork {
        /// Limit of iterations and evaluations.
        most: u32,
        /// Length of the last sub-step tried, s.
        substep: f64,
        /// Local error of that sub-step, rad; infinite if there is no estimate.
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
            Self::Imbalance { off, admissible } => write!(
                f,
                "a sub-step changed the energy by {off:.3e} J that no force explains (allowed {admissible:.3e} J): a smaller \
                 solver.errorTolerance or solver.stepSize may help"
            ),
            Self::SignWithoutSingularity { determinant, sine, admissible } => write!(
                f,
                "{} changed sign, yet its sine is {sine:.3e} (allowed {admissible:.3e}): the motion did not pass the singularity",
                DETERMINANTS[*determinant]
            ),
            Self::BranchChange => f.write_str(
                "the motion left its branch of the closure (motors coaxial, links equal in pairs), which a machine cannot do: solver.method \
                 automatic keeps the branch",
            ),
            Self::NotFinite => f.write_str("a coordinate, velocity, acceleration or energy is not finite"),
            Self::StepTooShort { substep, error } => {
                write!(f, "a sub-step of only {substep:.3e} s still {}", LocalError(*error))
            }
            Self::TooMuchWork { most, substep, error } => write!(
                f,
                "a macro step needs more iterations and evaluations than solver.maxWork = {most} allows: the last sub-step, of {substep:.3e} s, {}{}",
                LocalError(*error),
                if *substep < SHORTEST_OF_MOTION { "; so short a sub-step means that a force or a rate is too large" } else { "" }
            ),
        }
    }
}

impl std::error::Error for StepError {}

/// Names of the determinants of the singularities, in the order of their signs.
const DETERMINANTS: [&str; super::CONFIGURATION_SIGNS] =
    ["the determinant of J_x", "the bend of the left elbow", "the bend of the right elbow"];

/// Shortest sub-step that a motion may need, s: in shorter ones no digit changes.
const SHORTEST_OF_MOTION: f64 = 1e-15;

/// Local error of a sub-step, rad, formatted as the end of a sentence.
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
        let absurd = StepError::TooMuchWork { most: 9, substep: 1e-171, error: f64::NAN }.to_string();
        assert!(absurd.ends_with("failed; so short a sub-step means that a force or a rate is too large"), "{absurd}");
        assert!(said(1e-7).ends_with("the last sub-step, of 1.000e-6 s, had a local error of 1.000e-7 rad"), "{}", said(1e-7));
        for error in [f64::INFINITY, f64::NAN] {
            assert!(said(error).ends_with("the last sub-step, of 1.000e-6 s, failed"), "{}", said(error));
        }
    }
}
