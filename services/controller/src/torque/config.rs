//! What the torque controller has to know, out of the cell file.

use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;
use tangent_control::{HybridDynamicsConfig, Limits};
use tangent_estimation::ObjectPoseConfig;
use tangent_estimation::object_pose::{OBJECT_ESTIMATORS, ObjectShape};
use tangent_mechanics::{Arm, Flange, ModelData, Payload, Pose, Sensor, Tool};
use tangent_runtime::CellConfig;

use crate::ControllerError;
use crate::config::limits;

/// Everything [`crate::run_torque`] needs.
#[derive(Clone, Debug)]
pub struct TorqueConfig {
    /// The arm with what hangs on its flange.
    pub arm: Arm<6>,
    /// Where the tool is on the flange.
    pub flange_from_tool: Pose<Flange, Tool>,
    /// What the law may never exceed.
    pub limits: Limits,
    /// Preset of the law for tasks that name none.
    pub preset: String,
    /// Parameters that differ from the preset.
    pub settings: toml::Table,
    /// The object's surface, as its estimators know it.
    pub shape: ObjectShape,
}

impl TorqueConfig {
    /// From a cell file.
    ///
    /// # Errors
    /// Names the key, the value and what is allowed.
    pub fn from_cell(cell: &CellConfig, model: &ModelData) -> Result<Self, ControllerError> {
        if model.dof != 6 {
            return Err(ControllerError::Joints {
                name: model.name.clone(),
                dof: model.dof,
            });
        }
        let arm = loaded(Arm::new(model)?, cell);
        HybridDynamicsConfig::preset_with(&cell.controller.preset, &cell.controller.settings)?;
        let limits = limits(cell, &arm);
        limits.check()?;
        Ok(Self {
            arm,
            flange_from_tool: cell.tool.flange_from_tool(),
            limits,
            preset: cell.controller.preset.clone(),
            settings: cell.controller.settings.clone(),
            shape: shape(cell)?,
        })
    }

    /// The law's parameters for a task that may name a preset of its own.
    ///
    /// # Errors
    /// An unknown preset or parameter.
    pub fn law(
        &self,
        preset: Option<&str>,
    ) -> Result<HybridDynamicsConfig, tangent_control::ControlError> {
        HybridDynamicsConfig::preset_with(preset.unwrap_or(&self.preset), &self.settings)
    }
}

/// The arm with the tool's mass: its inverse dynamics are those of both.
fn loaded(arm: Arm<6>, cell: &CellConfig) -> Arm<6> {
    let tool = &cell.tool;
    if tool.mass_kg <= 0.0 {
        return arm;
    }
    let flange_from_sensor: Pose<Flange, Sensor> = cell.sensor.flange_from_sensor.pose();
    let turn = *flange_from_sensor.rotation().to_rotation_matrix().matrix();
    let inertia = Matrix3::from_diagonal(&Vector3::from(tool.inertia_kg_m2));
    arm.with_payload(&Payload {
        mass_kg: tool.mass_kg,
        com_in_flange_m: flange_from_sensor.transform_point(&tool.com_in_sensor()),
        inertia_kg_m2: turn * inertia * turn.transpose(),
    })
}

/// What the estimators are told of the object: the first of them that has settings.
fn shape(cell: &CellConfig) -> Result<ObjectShape, ControllerError> {
    let settings = OBJECT_ESTIMATORS
        .iter()
        .find_map(|name| cell.estimators.settings.get(*name));
    let Some(table) = settings else {
        return Ok(ObjectPoseConfig::default().target.surface);
    };
    let config = ObjectPoseConfig::deserialize(toml::Value::Table(table.clone()))
        .map_err(|e| ControllerError::Object(e.message().to_owned()))?;
    Ok(config.target.surface)
}
