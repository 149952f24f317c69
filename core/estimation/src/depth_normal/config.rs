//! Settings of `depth_normal`.

use serde::{Deserialize, Serialize};

use crate::EstimationError;
use crate::ranges::check_ranges;

/// Largest side of a cell, pixels.
pub(super) const CELL_PX_MAX: usize = 32;

/// The `[depth_normal]` table.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthNormalConfig {
    /// Side of a cell, pixels. Sums are kept per cell, and every cell gets a normal.
    pub cell_px: usize,
    /// Depths outside this range are treated as missing, m.
    pub range_m: [f64; 2],
    /// Noise of inverse depth, standard deviation, 1/m: the range noise of a stereo camera divided
    /// by the square of the depth. Covariances use the noise measured in the images instead; edges
    /// are detected with this value.
    pub inverse_depth_sd_per_m: f64,
    /// Noise of depth that does not grow with it, standard deviation, m: rounding to millimetres.
    pub depth_sd_m: f64,
    /// Largest angle between a surface's normal and the ray, rad; a steeper surface is an edge.
    pub steepest_rad: f64,
    /// Largest reach of a window from its cell, cells.
    pub window_cells_max: usize,
    /// Largest disagreement between the slopes of growing windows, standard deviations.
    pub consistency_sd: f64,
    /// Largest angle between neighbouring cells of one surface, rad, in addition to
    /// `bend_max_per_m`.
    pub crease_rad: f64,
    /// Largest curvature of one surface, 1/m: allows for the rotation of the normal from cell to
    /// cell.
    pub bend_max_per_m: f64,
    /// Largest angle between a segment's cells and its mean, rad.
    pub segment_spread_rad: f64,
    /// Smallest and largest radius of the patch that is fitted at the tool, m.
    pub patch_radius_m: [f64; 2],
    /// Largest disagreement between its slopes and those of smaller patches, standard deviations.
    pub patch_consistency_sd: f64,
    /// Depth error that is correlated over many pixels and constant over frames, m. It comes from
    /// the beat between the steps of disparity and of millimetres.
    pub ripple_sd_m: f64,
    /// Rate of change of curvature along surfaces, standard deviation, 1/m²: determines the error
    /// that a patch may hide.
    pub bend_change_sd_per_m2: f64,
    /// Smallest number of cells in a patch.
    pub patch_cells_min: usize,
    /// Length of the map ahead of the tool, m.
    pub ahead_m: f64,
    /// Distance between stations of the map ahead, m.
    pub ahead_step_m: f64,
}

impl Default for DepthNormalConfig {
    fn default() -> Self {
        Self {
            cell_px: 8,
            range_m: [0.05, 4.0],
            inverse_depth_sd_per_m: 0.006,
            depth_sd_m: 0.0003,
            steepest_rad: 1.3,
            window_cells_max: 8,
            consistency_sd: 1.5,
            crease_rad: 0.06,
            bend_max_per_m: 20.0,
            segment_spread_rad: 0.35,
            patch_radius_m: [0.015, 0.05],
            patch_consistency_sd: 2.0,
            ripple_sd_m: 0.00002,
            bend_change_sd_per_m2: 100.0,
            patch_cells_min: 12,
            ahead_m: 0.08,
            ahead_step_m: 0.005,
        }
    }
}

impl DepthNormalConfig {
    /// Rejects values that cannot work.
    ///
    /// # Errors
    /// [`EstimationError::OutOfRange`] names the key, the value and what is allowed.
    pub fn check(&self) -> Result<(), EstimationError> {
        let [near, far] = self.range_m;
        let [small, large] = self.patch_radius_m;
        check_ranges(&[
            (
                "depth_normal.cell_px",
                self.cell_px as f64,
                3.0,
                CELL_PX_MAX as f64,
            ),
            ("depth_normal.range_m[0]", near, 1e-3, 100.0),
            ("depth_normal.range_m[1]", far, near, 100.0),
            (
                "depth_normal.inverse_depth_sd_per_m",
                self.inverse_depth_sd_per_m,
                1e-6,
                1.0,
            ),
            ("depth_normal.depth_sd_m", self.depth_sd_m, 0.0, 0.1),
            ("depth_normal.steepest_rad", self.steepest_rad, 0.1, 1.55),
            (
                "depth_normal.window_cells_max",
                self.window_cells_max as f64,
                1.0,
                64.0,
            ),
            (
                "depth_normal.consistency_sd",
                self.consistency_sd,
                0.5,
                10.0,
            ),
            ("depth_normal.crease_rad", self.crease_rad, 1e-3, 1.6),
            (
                "depth_normal.patch_consistency_sd",
                self.patch_consistency_sd,
                0.5,
                10.0,
            ),
            ("depth_normal.bend_max_per_m", self.bend_max_per_m, 0.0, 1e4),
            (
                "depth_normal.segment_spread_rad",
                self.segment_spread_rad,
                1e-3,
                3.2,
            ),
            ("depth_normal.patch_radius_m[0]", small, 1e-4, 10.0),
            ("depth_normal.patch_radius_m[1]", large, small, 10.0),
            ("depth_normal.ripple_sd_m", self.ripple_sd_m, 0.0, 0.01),
            (
                "depth_normal.bend_change_sd_per_m2",
                self.bend_change_sd_per_m2,
                1e-3,
                1e6,
            ),
            (
                "depth_normal.patch_cells_min",
                self.patch_cells_min as f64,
                8.0,
                1e4,
            ),
            ("depth_normal.ahead_step_m", self.ahead_step_m, 1e-4, 1.0),
            ("depth_normal.ahead_m", self.ahead_m, 0.0, 10.0),
        ])
    }

    /// Difference of inverse depth between neighbouring pixels beyond which they belong to
    /// different surfaces: `[0] + [1] w`, 1/m. `sd_found` is the measured noise of the frame, 1/m;
    /// it is used if it exceeds the configured noise.
    pub(super) fn jump(&self, focal_px: f64, sd_found: f64) -> [f64; 2] {
        [
            6.0 * self.inverse_depth_sd_per_m.max(sd_found),
            self.steepest_rad.tan() / focal_px,
        ]
    }
}
