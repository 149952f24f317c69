//! Errors of the service other than those of the stream, which reconnects by itself.

use tangent_runtime::BusError;
use tangent_sensing::SensingError;

/// Why the service cannot work.
#[derive(Debug, thiserror::Error)]
pub enum NetftError {
    /// The bus refused a topic or a query.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// A parameter of the conditioning is out of range.
    #[error("[sensor] and [tool]: {0}")]
    Conditioning(#[from] SensingError),
    /// The box does not answer.
    #[error(
        "no Net F/T box answers at {address} ({reason}): check its address, its cable and its power"
    )]
    Unreachable {
        /// Host and port.
        address: String,
        /// Error of the system.
        reason: String,
    },
    /// The answer of the box cannot be used.
    #[error("the box at {address} cannot be used: {reason}")]
    Configuration {
        /// Host and port.
        address: String,
        /// The problem.
        reason: String,
    },
    /// A socket or a thread could not be created.
    #[error("{action}: {source}")]
    System {
        /// Attempted action.
        action: &'static str,
        /// Error of the system.
        source: std::io::Error,
    },
}
