//! A direction in a task file.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use tangent_mechanics::Pose;

use crate::error::ControlError;

/// A direction: an axis of the tool where the task starts, or a vector in base axes.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_control::{Direction, ToolAxis};
/// use tangent_mechanics::{Base, Pose, Tool};
///
/// // A tool that points down.
/// let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
/// let base_from_tool = Pose::<Base, Tool>::new(Vector3::zeros(), down);
/// let along_tool = Direction::Axis(ToolAxis::ToolZ).in_base(&base_from_tool);
/// let in_base = Direction::Vector([0.0, 0.0, -2.0]).in_base(&base_from_tool);
/// assert!((along_tool - in_base).norm() < 1e-12);
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Direction {
    /// `tool_x`, `tool_y` or `tool_z`.
    Axis(ToolAxis),
    /// Vector in base axes, of any length but zero.
    Vector([f64; 3]),
}

/// An axis of the tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)]
pub enum ToolAxis {
    ToolX,
    ToolY,
    ToolZ,
}

impl Direction {
    /// Unit vector in base axes.
    pub fn in_base<A, B>(&self, base_from_tool: &Pose<A, B>) -> Vector3<f64> {
        match self {
            Self::Axis(ToolAxis::ToolX) => base_from_tool.rotate(&Vector3::x()),
            Self::Axis(ToolAxis::ToolY) => base_from_tool.rotate(&Vector3::y()),
            Self::Axis(ToolAxis::ToolZ) => base_from_tool.rotate(&Vector3::z()),
            Self::Vector(v) => Vector3::from(*v).normalize(),
        }
    }

    /// Checks that a vector has a direction; `key` is that of the task file.
    pub(super) fn check(&self, key: &str) -> Result<(), ControlError> {
        match self {
            Self::Axis(_) => Ok(()),
            Self::Vector(v) => {
                let norm = Vector3::from(*v).norm();
                if norm.is_finite() && norm > 1e-9 {
                    return Ok(());
                }
                Err(ControlError::range(
                    key,
                    format!("{v:?}"),
                    "`tool_x`, `tool_y`, `tool_z` or a vector that is not zero",
                ))
            }
        }
    }
}
