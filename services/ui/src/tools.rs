//! What the program that runs the page does for it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::teacher::Teacher;

/// Writes the report of a recording, and returns its file.
pub type Reporter = Arc<dyn Fn(&Path) -> Result<PathBuf, String> + Send + Sync>;
/// Carries out a step of the payload's calibration. Blocks for some seconds at most.
pub type Calibrator = Arc<dyn Fn(CalibrationStep) -> Calibration + Send + Sync>;

/// What the program that runs the page does for it; what is `None` is not offered.
#[derive(Clone, Default)]
pub struct Tools {
    /// Writes reports.
    pub report: Option<Reporter>,
    /// Calibrates the payload.
    pub calibrate: Option<Calibrator>,
    /// Teaches tasks by hand.
    pub teach: Option<Arc<dyn Teacher>>,
}

/// A step of the payload's calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CalibrationStep {
    /// Forgets the poses so far.
    Begin,
    /// Takes the readings of the present pose.
    Pose,
}

impl CalibrationStep {
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Begin => "begin",
            Self::Pose => "pose",
        }
    }
}

/// State of the calibration after a step.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Calibration {
    /// Whether the step was done.
    pub done: bool,
    /// Why it was not, or what is missing still.
    pub message: String,
    /// Number of poses taken.
    pub poses: usize,
    /// Number of poses that should be taken.
    pub wanted: usize,
    /// Lines for the cell file, once the poses determine the payload.
    pub cell_file: Option<String>,
    /// Doubts about the result.
    pub warnings: Vec<String>,
}
