//! Errors that prevent the service from starting.

use tangent_runtime::BusError;

/// What prevents the service from starting.
#[derive(Debug, thiserror::Error)]
pub enum Ros2Error {
    /// The cell's network has certificates, and no other network is named.
    #[error(
        "ros2: with [zenoh.tls] the cell's router admits no program of ROS 2: start a router for ROS 2 (rmw_zenohd), \
         and name it in ros2.connect, for instance [\"tcp/127.0.0.1:7448\"]"
    )]
    NoNetwork,
    /// A network refused a topic or a service.
    #[error("ros2: {0}")]
    Bus(#[from] BusError),
    /// A thread could not be started.
    #[error("ros2: starting a thread: {0}")]
    Thread(#[from] std::io::Error),
}
