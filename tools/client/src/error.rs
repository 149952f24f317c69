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
    /// A topic has no messages.
    #[error("no message on `{topic}` within {waited_s} s{suggestion}; {known}")]
    Silent {
        /// The topic.
        topic: String,
        /// Time waited, s.
        waited_s: f64,
        /// Names the nearest topic, or empty.
        suggestion: String,
        /// All topics with messages, as text.
        known: String,
    },
    /// No service of this cell answers, while others do.
    #[error(
        "no service of cell `{cell}` is on this network{suggestion}; {known}; the name is [cell] name in the cell file"
    )]
    NoSuchCell {
        /// The cell's name.
        cell: String,
        /// Names the nearest cell, or empty.
        suggestion: String,
        /// All cells with services, as text.
        known: String,
    },
    /// The bus refuses.
    #[error(transparent)]
    Bus(#[from] BusError),
}
