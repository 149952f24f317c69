//! Settings of the service, from the cell file.

use std::path::PathBuf;

use tangent_runtime::CellConfig;
use tangent_runtime::config::{Calibration, CameraKind};

use crate::CameraError;

/// Settings of [`crate::run`].
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Key of the driver's images.
    pub topic: String,
    /// A recording whose images are played on `topic`, and the topic in it; `None` for a driver.
    pub recording: Option<(PathBuf, Option<String>)>,
    /// Content of the images.
    pub kind: CameraKind,
    /// Key of the driver's calibration.
    pub info_topic: Option<String>,
    /// Calibration in the cell file; `None`: the driver's is used.
    pub calibration: Option<Calibration>,
    /// Rate of the images passed on for viewers, Hz; 0: none.
    pub pass_on_hz: f64,
    /// SCHED_FIFO priority of the service's thread; `None` for normal scheduling.
    pub realtime_priority: Option<u8>,
}

impl Config {
    /// Settings from the cell file's `[camera]`.
    ///
    /// # Errors
    /// The cell has no camera.
    pub fn from_cell(cell: &CellConfig) -> Result<Self, CameraError> {
        let camera = cell.camera.as_ref().ok_or(CameraError::NoCamera)?;
        Ok(Self {
            topic: camera.topic.clone(),
            recording: camera
                .recording
                .clone()
                .map(|file| (file, camera.recording_topic.clone())),
            kind: camera.kind,
            info_topic: camera.info_topic.clone(),
            calibration: camera.calibration(),
            pass_on_hz: camera.pass_on_hz,
            realtime_priority: cell
                .realtime
                .enabled
                .then_some(cell.realtime.camera_priority),
        })
    }
}
