//! `[tool]`: the parts that the sensor carries.

use nalgebra::Vector3;
use serde::Deserialize;
use tangent_mechanics::{Flange, Pose, Tool};

use super::{PoseConfig, TipConfig};
use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// `[tool]`: all parts that the sensor carries.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolConfig {
    /// Mass beyond the sensor, kg.
    pub mass_kg: f64,
    /// Centre of mass, sensor axes, m.
    pub com_in_sensor_m: [f64; 3],
    /// Moments of inertia about the centre of mass, sensor axes, kg m²; for torque-controlled arms.
    #[serde(default)]
    pub inertia_kg_m2: [f64; 3],
    /// Pose of the tool frame on the flange: origin at the tool's contact point, z out of the tool,
    /// into the surface.
    pub flange_from_tool: PoseConfig,
    /// Shape of the part that touches, as the estimators are told of it.
    #[serde(default)]
    pub tip: TipConfig,
}

impl ToolConfig {
    /// Pose of the tool frame on the flange.
    pub fn flange_from_tool(&self) -> Pose<Flange, Tool> {
        self.flange_from_tool.pose()
    }

    /// Centre of mass, sensor axes, m.
    pub fn com_in_sensor(&self) -> Vector3<f64> {
        Vector3::from(self.com_in_sensor_m)
    }

    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        checker.range("tool.mass_kg", self.mass_kg, 0.0..=20.0, "kg")?;
        checker.ranges(
            "tool.com_in_sensor_m",
            &self.com_in_sensor_m,
            -1.0..=1.0,
            "m",
        )?;
        checker.ranges(
            "tool.inertia_kg_m2",
            &self.inertia_kg_m2,
            0.0..=10.0,
            "kg m²",
        )?;
        self.flange_from_tool
            .check(checker, "tool.flange_from_tool")?;
        self.tip.check(checker)
    }
}
