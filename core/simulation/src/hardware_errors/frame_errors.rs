//! Frames of tool and sensor on the flange: the true one against the one in the cell file.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use tangent_mechanics::{Flange, Pose, Sensor as SensorFrame, Tool};

use crate::plant_error::PlantError;
use crate::tool::ToolConfig;

/// True frames against stated ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrameErrors {
    /// True position of the tip minus the stated one, stated tool axes, m.
    pub tip_position_m: [f64; 3],
    /// Rotation from the stated to the true tool axes, rotation vector, stated tool axes, rad.
    pub tip_rotation_rad: [f64; 3],
    /// Rotation from the stated to the true sensor axes, rotation vector, stated sensor axes, rad.
    pub sensor_rotation_rad: [f64; 3],
}

impl FrameErrors {
    pub(crate) fn check(&self) -> Result<(), PlantError> {
        for (key, values, most, allowed) in [
            (
                "errors.frames.tip_position_m",
                self.tip_position_m,
                0.1,
                "-0.1 to 0.1 m",
            ),
            (
                "errors.frames.tip_rotation_rad",
                self.tip_rotation_rad,
                0.5,
                "-0.5 to 0.5 rad",
            ),
            (
                "errors.frames.sensor_rotation_rad",
                self.sensor_rotation_rad,
                0.5,
                "-0.5 to 0.5 rad",
            ),
        ] {
            for value in values {
                PlantError::unless(key, value, allowed, value.abs() <= most)?;
            }
        }
        Ok(())
    }

    /// True pose of the tool on the flange.
    pub(crate) fn flange_from_tool(&self, stated: &ToolConfig) -> Pose<Flange, Tool> {
        let error = (self.tip_position_m, self.tip_rotation_rad);
        Pose::from_isometry(moved(stated.flange_from_tool.isometry(), error))
    }

    /// True pose of the sensor on the flange.
    pub(crate) fn flange_from_sensor(&self, stated: &ToolConfig) -> Pose<Flange, SensorFrame> {
        let error = ([0.0; 3], self.sensor_rotation_rad);
        Pose::from_isometry(moved(stated.flange_from_sensor.isometry(), error))
    }
}

/// A frame moved and turned in its own axes; bit for bit the same frame if both are zero.
fn moved(frame: Isometry3<f64>, (by, turned): ([f64; 3], [f64; 3])) -> Isometry3<f64> {
    if by == [0.0; 3] && turned == [0.0; 3] {
        return frame;
    }
    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(turned));
    frame * Isometry3::from_parts(Translation3::from(Vector3::from(by)), turn)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_without_error_is_the_stated_one_and_one_with_it_is_off_by_it() {
        let stated = ToolConfig::default();
        let none = FrameErrors::default().flange_from_tool(&stated);
        assert_eq!(*none.isometry(), stated.flange_from_tool.isometry());
        let errors = FrameErrors {
            tip_position_m: [0.001, 0.0, 0.002],
            tip_rotation_rad: [0.0, 0.02, 0.0],
            sensor_rotation_rad: [0.0, 0.0, 0.03],
        };
        let tool = errors.flange_from_tool(&stated);
        let away = tool.translation() - Vector3::from(stated.flange_from_tool.position_m);
        assert!((away - Vector3::new(0.001, 0.0, 0.002)).norm() < 1e-15);
        assert!((tool.rotation().angle() - 0.02).abs() < 1e-12);
        assert!((errors.flange_from_sensor(&stated).rotation().angle() - 0.03).abs() < 1e-12);
    }
}
