//! Reasons why a pose cannot be taken.

use std::path::PathBuf;
use std::time::Duration;

use tangent_recorder::RecorderError;
use tangent_runtime::BusError;
use tangent_schemas::cdr::CdrError;
use tangent_schemas::convert::ConvertError;
use tangent_schemas::standard::WrenchStamped;
use tangent_schemas::{Message, topics};
use tangent_sensing::TareRefusal;

/// A cell or recording gives no usable readings.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    /// No reading arrived.
    #[error(
        "no readings of an arm at rest: are netft and rtde running? `tangent status` shows them"
    )]
    NoReadings,
    /// Fewer readings arrived than the cell file states.
    #[error(
        "only {taken} readings in {:.1} s: [sensor] rate_hz and raw_rate_hz give {wanted_hz} per second",
        .within.as_secs_f64()
    )]
    TooFewReadings {
        /// Number of readings that arrived.
        taken: u32,
        /// Time in which they arrived.
        within: Duration,
        /// Readings per second according to the cell file, Hz.
        wanted_hz: f64,
    },
    /// The arm's state has no pose.
    #[error("arm/state has no usable pose")]
    NoPose(#[source] ConvertError),
    /// The sensor reports a problem.
    #[error("the sensor: {reason} ({status})")]
    Sensor {
        /// What is wrong with its readings.
        reason: &'static str,
        /// Status text of its service.
        status: String,
    },
    /// The arm or the tool moved during the reading.
    #[error(transparent)]
    Moved(#[from] TareRefusal),
    /// The recording has no readings.
    #[error(
        "{} contains no /{} ({}): record with netft and rtde running",
        .0.display(), topics::WRENCH_RAW.key(), WrenchStamped::NAME
    )]
    NothingRecorded(PathBuf),
    /// The recording cannot be read.
    #[error("{0}")]
    Recording(RecorderError),
    /// A recorded message cannot be decoded.
    #[error(transparent)]
    Message(#[from] CdrError),
    /// The bus refuses.
    #[error(transparent)]
    Bus(#[from] BusError),
}

impl CalibrateError {
    /// Whether the user has to change the command: the recording that it names cannot be read.
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::Recording(_))
    }
}
