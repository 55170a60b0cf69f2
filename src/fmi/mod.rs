//! The semantics of FMI 2.0 without C types: life cycle, variables, communication points, stored states and log of an instance.
//!
//! | file | content |
//! | --- | --- |
//! | `lifecycle.rs` | calls allowed in each state |
//! | `clock.rs` | communication points and the step grid |
//! | `messages.rs` | the log queue and its categories |
//! | `computed.rs` | variables ← observers, computed when read |
//! | `values.rs` | the checks that come before a value is read or written |
//! | `derivatives.rs` | derivatives of inputs and outputs |
//! | `exchange.rs` | the functions of model exchange |
//! | `own.rs` | start values of a unit of one's own |
//! | `location.rs` | folders that fmuResourceLocation may mean |
//! | `instance.rs` | an instance: all of these together |
//! | `snapshot.rs`, `stored.rs` | a copy of an instance to go back to, and its bytes |
//! | `stepping.rs` | a communication step |
//! | `following.rs` | warnings of a communication step in a scene with an estimator |
//! | `status.rs` | the status functions of co-simulation |

pub mod clock;
mod computed;
mod derivatives;
mod exchange;
mod following;
pub mod instance;
pub mod lifecycle;
mod location;
pub mod messages;
mod own;
pub mod snapshot;
mod status;
mod stepping;
mod stored;
mod values;

pub use instance::Instance;
pub use lifecycle::{Call, Kind, Stage};
pub use messages::{Message, Status};
pub use own::{Guid, Unit};
pub use snapshot::Snapshot;

/// A call that was refused or discarded; the instance is unchanged.
#[derive(Clone, Debug, PartialEq)]
pub struct CallError {
    /// Status of the call: [`Status::Discard`] or [`Status::Error`].
    pub status: Status,
    /// One sentence naming the variable, its value and the values allowed.
    pub message: String,
}

impl CallError {
    /// The call is not allowed, or an argument is wrong.
    pub fn error(message: impl Into<String>) -> Self {
        Self { status: Status::Error, message: message.into() }
    }

    /// The call is allowed, but could not be carried out.
    pub fn discard(message: impl Into<String>) -> Self {
        Self { status: Status::Discard, message: message.into() }
    }
}

impl From<crate::mechanism::SceneError> for CallError {
    fn from(refusal: crate::mechanism::SceneError) -> Self {
        Self::error(refusal.0)
    }
}
