//! Why a task does not start, or cannot be followed to its end.

use std::time::Duration;

use tangent_runtime::BusError;

/// A task was not started, or its end was not seen.
#[derive(Debug, thiserror::Error)]
pub enum FollowError {
    /// The controller refuses the task, and would refuse it again.
    #[error("task: {0}")]
    Refused(String),
    /// Robot or sensor were not ready in time.
    #[error("not ready after {:.0} s: {reason}", .waited.as_secs_f64())]
    NotReady {
        /// Time waited.
        waited: Duration,
        /// What is missing, in words.
        reason: String,
    },
    /// The controller did not start the task in time: its last answer, or why there was none.
    #[error("the controller did not start the task: {0}")]
    NotStarted(String),
    /// A stop was requested while the cell was not ready yet.
    #[error("stopped before the task began")]
    Stopped,
    /// The controller publishes nothing any more.
    #[error("no message from the controller for {:.1} s: see `tangent status`", .0.as_secs_f64())]
    Silent(Duration),
    /// The tool was not retracted in time after a stop.
    #[error("the arm did not retract within {:.1} s", .0.as_secs_f64())]
    NotRetracted(Duration),
    /// The bus refuses.
    #[error(transparent)]
    Bus(#[from] BusError),
}

impl FollowError {
    /// Whether the task has to be changed. Everything else is a failure of the cell.
    pub fn is_usage(&self) -> bool {
        match self {
            Self::Refused(_) => true,
            Self::NotReady { .. } | Self::NotStarted(_) | Self::Stopped => false,
            Self::Silent(_) | Self::NotRetracted(_) | Self::Bus(_) => false,
        }
    }
}
