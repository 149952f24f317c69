//! Where the camera is on the tool, and what it sees of the tool.

use tangent_estimation::depth_normal::Intrinsics;
use tangent_estimator::{DepthSettings, ToolInView};
use tangent_mechanics::{Camera, Pose, Tool};
use tangent_runtime::CellConfig;
use tangent_runtime::config::CameraKind;

use crate::error::ScanError;

/// A depth camera at the flange, as the cell file states it.
#[derive(Clone, Debug)]
pub struct Mounting {
    /// Pose of the camera in axes of the tool.
    pub tool_from_camera: Pose<Tool, Camera>,
    /// The tool in the camera's view, which is left out.
    pub tool: Option<ToolInView>,
}

impl Mounting {
    /// The mounting in a cell file.
    ///
    /// # Errors
    /// The cell has no depth camera, or the settings of `depth_normal` are not valid.
    pub fn from_cell(cell: &CellConfig) -> Result<Self, ScanError> {
        let camera = cell.camera.as_ref().ok_or(ScanError::NoCamera)?;
        if camera.kind != CameraKind::Depth {
            return Err(ScanError::NoDepth);
        }
        Ok(Self {
            tool_from_camera: cell.tool.flange_from_tool().inverse() * camera.flange_from_camera(),
            tool: DepthSettings::from_cell(cell)?.tool,
        })
    }

    /// One entry per pixel, not zero where the tool is in view.
    pub(crate) fn left_out(&self, intrinsics: &Intrinsics, size_px: [u32; 2]) -> Vec<u8> {
        let camera_from_tool = self.tool_from_camera.inverse();
        ToolInView::left_out(self.tool.as_ref(), &camera_from_tool, intrinsics, size_px)
    }
}
