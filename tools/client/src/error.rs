//! Errors of requests to a cell.

use tangent_runtime::BusError;

/// A cell cannot be reached, or does not answer. The error of the bus is the source.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The router of the cell does not answer.
    #[error(
        "cell {cell} cannot be reached; start it with `tangent up`, or `tangent run router` and its services"
    )]
    Unreachable {
        /// The cell's name.
        cell: String,
        /// Error of the bus.
        source: Box<BusError>,
    },
    /// No service answers the request.
    #[error("`{action}` to {key}")]
    NoAnswer {
        /// The requested action.
        action: String,
        /// The key to which it was sent.
        key: String,
        /// Error of the bus.
        source: Box<BusError>,
    },
    /// The bus refuses.
    #[error(transparent)]
    Bus(#[from] BusError),
}
