//! Reasons for which the service cannot start.

use std::io;
use std::net::SocketAddr;

use tangent_runtime::BusError;

/// The service cannot start.
#[derive(Debug, thiserror::Error)]
pub enum FoxgloveError {
    /// The bus refused a topic.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The address cannot be listened at.
    #[error(
        "[foxglove] address = \"{address}\": {reason}; is another viewer's server running there? Choose another port, or \
         0 for any free one"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Why.
        reason: String,
    },
    /// The system cannot start the threads that serve the viewers.
    #[error("starting the threads that serve the viewers")]
    Threads {
        /// Error of the operating system.
        #[from]
        source: io::Error,
    },
}
