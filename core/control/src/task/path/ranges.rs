//! Ranges and defaults of the numbers that several kinds of paths have.

use crate::error::{ControlError, check_range};

/// Lowest and highest speed of a path, m/s.
pub(crate) const SPEED_M_PER_S: (f64, f64) = (0.001, 0.25);
/// Shortest and longest pause, s.
pub(crate) const PAUSE_S: (f64, f64) = (0.0, 60.0);
/// Smallest and largest height of the tool above the surface between strokes, m. A lost surface is
/// searched for over a little more than the largest.
pub(crate) const LIFT_M: (f64, f64) = (0.005, 0.02);
/// Largest coordinate of a point, m.
pub(super) const REACH_M: f64 = 2.0;

/// Height above the surface between strokes, m.
pub(crate) fn default_lift() -> f64 {
    0.01
}

/// Speed above the surface, m/s.
pub(crate) fn default_travel() -> f64 {
    0.05
}

/// Checks that the coordinates of a point are within reach.
pub(crate) fn check_point(key: &str, point: &[f64; 2]) -> Result<(), ControlError> {
    check_range(key, point[0], -REACH_M, REACH_M)?;
    check_range(key, point[1], -REACH_M, REACH_M)
}
