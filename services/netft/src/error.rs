//! What can go wrong beside the stream, which never gives up.

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
        "no Net F/T box answers at {address} ({reason}): check its address, its cable and that it has power"
    )]
    Unreachable {
        /// Host and port.
        address: String,
        /// What the system says.
        reason: String,
    },
    /// The box answers something that cannot be used.
    #[error("the box at {address} cannot be used: {reason}")]
    Configuration {
        /// Host and port.
        address: String,
        /// What is wrong.
        reason: String,
    },
    /// A socket or a thread could not be had.
    #[error("{action}: {source}")]
    System {
        /// What was tried.
        action: &'static str,
        /// What the system says.
        source: std::io::Error,
    },
}
