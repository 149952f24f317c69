//! A pose as it is written in scenario files.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A pose as written in a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PoseConfig {
    /// Origin, m.
    pub position_m: [f64; 3],
    /// Rotations about the fixed x, then y, then z axis, rad.
    pub roll_pitch_yaw_rad: [f64; 3],
}

impl PoseConfig {
    /// The pose as an isometry.
    pub fn isometry(&self) -> Isometry3<f64> {
        let [roll, pitch, yaw] = self.roll_pitch_yaw_rad;
        Isometry3::from_parts(
            Translation3::from(Vector3::from(self.position_m)),
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        )
    }
}
