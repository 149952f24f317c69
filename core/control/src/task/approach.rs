//! `[approach]` of a task file, and `[plane]`, which is relative to it.

use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};
use crate::task::direction::{Direction, ToolAxis};

/// Approach to the surface.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ApproachSpec {
    /// Direction towards the surface.
    pub direction: Direction,
    /// Speed of the approach, m/s; reduced further if the expected stiffness requires it.
    pub speed_m_per_s: f64,
    /// Distance without contact after which the approach gives up, m.
    pub distance_max_m: f64,
    /// Stiffest contact expected, N/m: bounds the speed so that the first impact stays small.
    /// `None`: the preset's value.
    pub stiffness_expected_n_per_m: Option<f64>,
    /// Whether the tool's tip is stated as soft: no contact of it is stiff.
    #[serde(skip)]
    pub soft_tip: bool,
}

impl Default for ApproachSpec {
    fn default() -> Self {
        Self {
            direction: Direction::Axis(ToolAxis::ToolZ),
            speed_m_per_s: 0.005,
            distance_max_m: 0.08,
            stiffness_expected_n_per_m: None,
            soft_tip: false,
        }
    }
}

impl ApproachSpec {
    /// Checks that every number is in its range.
    pub(super) fn check(&self) -> Result<(), ControlError> {
        self.direction.check("approach.direction")?;
        check_range("approach.speed_m_per_s", self.speed_m_per_s, 0.0005, 0.05)?;
        check_range("approach.distance_max_m", self.distance_max_m, 0.001, 1.0)?;
        if let Some(k) = self.stiffness_expected_n_per_m {
            check_range("approach.stiffness_expected_n_per_m", k, 100.0, 200_000.0)?;
        }
        Ok(())
    }
}

/// Orientation of the path's plane. Its z axis is against the approach direction; the path is drawn
/// in x and y.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlaneSpec {
    /// Direction of the path's x axis, projected into the plane.
    pub x_axis: Direction,
}

impl Default for PlaneSpec {
    fn default() -> Self {
        Self {
            x_axis: Direction::Axis(ToolAxis::ToolX),
        }
    }
}
