//! The `[plant.tool]` table: tool, sensor and payload on the flange.

use serde::{Deserialize, Serialize};
use tangent_mechanics::Tip;

use crate::contact::{ComplianceConfig, PadConfig};
use crate::pose_config::PoseConfig;

/// Tool and sensor on the flange.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ToolConfig {
    /// Pose of the sensor on the flange.
    pub flange_from_sensor: PoseConfig,
    /// Pose of the tool on the flange: origin at the middle of the pad, z out of the tool.
    pub flange_from_tool: PoseConfig,
    /// Contact pad, where no `tip` is given.
    pub pad: PadConfig,
    /// True shape of the tip. What the law is told of it is a setting of the law and of the
    /// estimators.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tip: Option<Tip>,
    /// Stiffness of a soft tip, N/m; in series with `contact.stiffness_n_per_m`.
    pub soft_stiffness_n_per_m: f64,
    /// Spring between flange and pad; rigid if absent.
    pub compliance: Option<ComplianceConfig>,
    /// Payload on the sensor, as stated in the cell file.
    pub payload: PayloadConfig,
    /// True payload minus `payload`: mass, kg, and centre of mass, m.
    pub payload_error: PayloadErrorConfig,
}

impl Default for ToolConfig {
    fn default() -> Self {
        Self {
            flange_from_sensor: PoseConfig {
                position_m: [0.0, 0.0, 0.045],
                ..PoseConfig::default()
            },
            flange_from_tool: PoseConfig {
                position_m: [0.0, 0.0, 0.165],
                ..PoseConfig::default()
            },
            pad: PadConfig::default(),
            tip: None,
            soft_stiffness_n_per_m: 1_500.0,
            compliance: None,
            payload: PayloadConfig::default(),
            payload_error: PayloadErrorConfig::default(),
        }
    }
}

/// Payload on the sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PayloadConfig {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, sensor axes, m.
    pub com_in_sensor_m: [f64; 3],
    /// Principal inertia about the centre of mass along sensor axes, kg m².
    pub inertia_kg_m2: [f64; 3],
}

impl Default for PayloadConfig {
    fn default() -> Self {
        Self {
            mass_kg: 0.3,
            com_in_sensor_m: [0.0, 0.0, 0.05],
            inertia_kg_m2: [4e-4, 4e-4, 1e-4],
        }
    }
}

/// Difference between the true payload and the one stated in the cell file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PayloadErrorConfig {
    /// Error of the mass, kg.
    pub mass_kg: f64,
    /// Error of the centre of mass, sensor axes, m.
    pub com_in_sensor_m: [f64; 3],
}
