//! Pose of a mounted part: position and rotation vector.

use nalgebra::{UnitQuaternion, Vector3};
use serde::Deserialize;
use tangent_mechanics::Pose;

use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// A pose as a position and a rotation vector (axis times angle), as a UR pendant shows a TCP.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseConfig {
    /// Position, m.
    #[serde(default)]
    pub translation_m: [f64; 3],
    /// Rotation vector, rad.
    #[serde(default)]
    pub rotation_vector_rad: [f64; 3],
}

impl PoseConfig {
    /// Converts it to a pose between frames.
    pub fn pose<A, B>(&self) -> Pose<A, B> {
        Pose::new(
            Vector3::from(self.translation_m),
            UnitQuaternion::from_scaled_axis(Vector3::from(self.rotation_vector_rad)),
        )
    }

    pub(super) fn check(&self, checker: &Checker<'_>, key: &str) -> Result<(), ConfigError> {
        let translation = format!("{key}.translation_m");
        checker.ranges(&translation, &self.translation_m, -5.0..=5.0, "m")?;
        let rotation = format!("{key}.rotation_vector_rad");
        let turn = std::f64::consts::TAU;
        checker.ranges(&rotation, &self.rotation_vector_rad, -turn..=turn, "rad")
    }
}
