//! Errors that prevent the service from starting.

use tangent_recorder::RecorderError;
use tangent_runtime::BusError;
use tangent_sensing::TargetDetectorError;

/// What prevents the service from starting.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// The cell has no camera.
    #[error("camera: the cell file has no [camera] section; see docs/services/camera.md")]
    NoCamera,
    /// The recording cannot be read.
    #[error("camera: camera.recording: {0}")]
    Recorder(#[from] RecorderError),
    /// The recording has no images.
    #[error("camera: camera.recording: {file}: {reason}")]
    Recording {
        /// Path as configured.
        file: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A thread could not be started.
    #[error("camera: starting a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// The bus refused a topic.
    #[error("camera: {0}")]
    Bus(#[from] BusError),
    /// The detector cannot be created.
    #[error("camera: {0}")]
    Detector(#[from] TargetDetectorError),
}
