//! What the service has to know, out of the cell file.

use std::path::PathBuf;

use tangent_runtime::CellConfig;
use tangent_runtime::config::{Calibration, CameraKind};

use crate::CameraError;

/// Everything [`crate::run`] needs.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Key of the driver's images.
    pub topic: String,
    /// A recording whose images are played on `topic`, and the topic in it; none for a driver.
    pub recording: Option<(PathBuf, Option<String>)>,
    /// What the images show.
    pub kind: CameraKind,
    /// Key of the driver's calibration.
    pub info_topic: Option<String>,
    /// As the cell file has it; none: as the driver says.
    pub calibration: Option<Calibration>,
    /// Images passed on for viewers, per second; 0: none.
    pub pass_on_hz: f64,
    /// SCHED_FIFO priority of the service's thread; `None` for normal scheduling.
    pub realtime_priority: Option<u8>,
}

impl Config {
    /// From the cell file's `[camera]`.
    ///
    /// # Errors
    /// A cell without one.
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
