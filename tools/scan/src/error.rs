//! Errors of making a scan.

use std::path::PathBuf;

use tangent_estimator::EstimatorError;
use tangent_recorder::RecorderError;
use tangent_runtime::BusError;

/// Why there is no scan. Each error says what to do.
#[derive(Debug, thiserror::Error)]
pub enum ScanError {
    /// The recording cannot be read.
    #[error(transparent)]
    Recording(#[from] RecorderError),
    /// The bus refuses a topic.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The settings of the tool in the camera's view are not usable.
    #[error(transparent)]
    Settings(#[from] EstimatorError),
    /// The cell has no camera.
    #[error("the cell file has no [camera]: name the cell with the depth camera with --cell")]
    NoCamera,
    /// The cell's camera gives no depth.
    #[error(
        "camera.kind in the cell file is \"target\", and a scan needs \"depth\": name the cell with the depth \
         camera with --cell"
    )]
    NoDepth,
    /// Something is missing in the recording.
    #[error(
        "{file}: no {missing}: record with the services `camera` (kind = \"depth\") and `rtde` or \
         `franka`, and with `recorder.exclude = [\"simulator/image\"]` in the cell file, since depth \
         images are not recorded by default"
    )]
    Missing {
        /// The recording.
        file: PathBuf,
        /// What is missing.
        missing: &'static str,
    },
    /// No image gave points.
    #[error("{from}: no depth image was placed: {}", .reasons.join("; "))]
    Nothing {
        /// Name of the recording or the cell.
        from: String,
        /// What was missing, and why images were left out.
        reasons: Vec<String>,
    },
}
