//! Reasons for which the service cannot start.

use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use tangent_mechanics::ModelError;
use tangent_runtime::BusError;

/// The service cannot start, or a token cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum UiError {
    /// The bus refused a topic.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The arm's model has a value that is not allowed.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The address cannot be listened at.
    #[error(
        "[ui] address = \"{address}\": {source}; is another page served there? Choose another port, or 0 for any free one"
    )]
    Listen {
        /// The address.
        address: SocketAddr,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The address may not be listened at.
    #[error("[ui] address = \"{address}\" is not allowed: {allowed}")]
    Address {
        /// The address.
        address: SocketAddr,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The file of the tokens cannot be used.
    #[error("[ui] tokens = {}: {reason}", file.display())]
    Tokens {
        /// The file.
        file: PathBuf,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// The system cannot start the threads that serve the pages.
    #[error("starting the threads that serve the pages")]
    Threads {
        /// Error of the operating system.
        #[from]
        source: io::Error,
    },
}
