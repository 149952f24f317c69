//! Where the camera is on the tool, and what it sees of the tool.

use nalgebra::Vector3;
use tangent_estimation::depth_normal::{Intrinsics, leave_out_rod};
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
        let size_px = size_px.map(|count| count as usize);
        let mut left_out = vec![0; size_px[0].saturating_mul(size_px[1])];
        if let Some(rod) = &self.tool {
            let camera_from_tool = self.tool_from_camera.inverse();
            let tip = camera_from_tool.translation();
            let end: Vector3<f64> = tip - camera_from_tool.z_axis() * rod.length_m;
            leave_out_rod(
                intrinsics,
                size_px,
                [&tip, &end],
                rod.radius_m,
                &mut left_out,
            );
        }
        left_out
    }
}
