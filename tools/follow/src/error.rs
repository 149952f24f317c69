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
    #[error("not ready after {waited:.0?}: {reason}")]
    NotReady {
        /// How long they were waited for.
        waited: Duration,
        /// What is missing, in words.
        reason: String,
    },
    /// The controller did not start the task in time: its last answer, or why there was none.
    #[error("the controller does not start the task: {0}")]
    NotStarted(String),
    /// A stop was requested while the cell was not ready yet.
    #[error("stopped before the task began")]
    Stopped,
    /// The controller publishes nothing any more.
    #[error("the controller has said nothing for {0:?}: see `tangent status`")]
    Silent(Duration),
    /// The tool was not retracted in time after a stop.
    #[error("the arm did not retract within {0:?}")]
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
