//! Why the service cannot start.

use tangent_runtime::BusError;
use tangent_sensing::TargetDetectorError;

/// What prevents the service from starting.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// The cell has no camera.
    #[error(
        "camera: the cell file has no [camera] section; docs/services/camera.md says what goes into it"
    )]
    NoCamera,
    /// The bus refused a topic.
    #[error("camera: {0}")]
    Bus(#[from] BusError),
    /// The detector cannot be made.
    #[error("camera: {0}")]
    Detector(#[from] TargetDetectorError),
}
