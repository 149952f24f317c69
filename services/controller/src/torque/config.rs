//! What the torque controller has to know, out of the cell file.

use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;
use tangent_control::{
    ControlError, HybridDynamicsConfig, Limits, TorqueInterface, UnifiedForceImpedanceConfig,
};
use tangent_estimation::ObjectPoseConfig;
use tangent_estimation::object_pose::{OBJECT_ESTIMATORS, ObjectShape};
use tangent_mechanics::{Arm, Flange, ModelData, Payload, Pose, Sensor, Tool};
use tangent_runtime::config::{FRANKA_TORQUE_RATE_SHARE, Law, RobotDriver};
use tangent_runtime::{CellConfig, StateFolder};

use crate::ControllerError;
use crate::config::limits;

/// Everything [`crate::run_torque`] needs, by law.
#[derive(Clone, Debug)]
pub enum TorqueConfig {
    /// On the pose of an object of known shape.
    HybridDynamics(Box<ObjectsConfig>),
    /// On normals, passive by energy tanks.
    UnifiedForceImpedance(Box<UnifiedConfig>),
}

impl TorqueConfig {
    /// From a cell file.
    ///
    /// # Errors
    /// Names the key, the value and what is allowed.
    pub fn from_cell(cell: &CellConfig, model: &ModelData) -> Result<Self, ControllerError> {
        Ok(match cell.controller.law {
            Law::UnifiedForceImpedance => {
                Self::UnifiedForceImpedance(Box::new(UnifiedConfig::from_cell(cell, model)?))
            }
            _ => Self::HybridDynamics(Box::new(ObjectsConfig::from_cell(cell, model)?)),
        })
    }
}

/// For `hybrid_dynamics`.
#[derive(Clone, Debug)]
pub struct ObjectsConfig {
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
    /// Estimators that run in this cell.
    pub estimators: Vec<String>,
    /// Where it keeps over restarts that the tool may touch; none: nowhere.
    pub state: Option<StateFolder>,
}

impl ObjectsConfig {
    fn from_cell(cell: &CellConfig, model: &ModelData) -> Result<Self, ControllerError> {
        let arm = loaded::<6>(model, cell)?;
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
            estimators: cell.estimators.run.clone(),
            state: StateFolder::of_cell(cell),
        })
    }

    /// The law's parameters for a task that may name a preset of its own.
    ///
    /// # Errors
    /// An unknown preset or parameter.
    pub fn law(&self, preset: Option<&str>) -> Result<HybridDynamicsConfig, ControlError> {
        HybridDynamicsConfig::preset_with(preset.unwrap_or(&self.preset), &self.settings)
    }
}

/// For `unified_force_impedance`.
#[derive(Clone, Debug)]
pub struct UnifiedConfig {
    /// The arm with what hangs on its flange.
    pub arm: Arm<7>,
    /// Where the tool is on the flange.
    pub flange_from_tool: Pose<Flange, Tool>,
    /// What the law may never exceed.
    pub limits: Limits,
    /// Preset of the law for tasks that name none.
    pub preset: String,
    /// Parameters that differ from the preset.
    pub settings: toml::Table,
    /// What takes the torques.
    pub interface: TorqueInterface,
    /// Estimators that run in this cell.
    pub estimators: Vec<String>,
    /// Where it keeps over restarts that the tool may touch; none: nowhere.
    pub state: Option<StateFolder>,
}

impl UnifiedConfig {
    fn from_cell(cell: &CellConfig, model: &ModelData) -> Result<Self, ControllerError> {
        let arm = loaded::<7>(model, cell)?;
        let own = &cell.controller;
        UnifiedForceImpedanceConfig::preset_with(&own.preset, &own.settings)?;
        let limits = limits(cell, &arm);
        limits.check()?;
        Ok(Self {
            arm,
            flange_from_tool: cell.tool.flange_from_tool(),
            limits,
            preset: own.preset.clone(),
            settings: own.settings.clone(),
            interface: interface(cell),
            estimators: cell.estimators.run.clone(),
            state: StateFolder::of_cell(cell),
        })
    }

    /// The law's parameters for a task that may name a preset of its own.
    ///
    /// # Errors
    /// An unknown preset or parameter.
    pub fn law(&self, preset: Option<&str>) -> Result<UnifiedForceImpedanceConfig, ControlError> {
        UnifiedForceImpedanceConfig::preset_with(preset.unwrap_or(&self.preset), &self.settings)
    }
}

/// What the arm's bridge lets through of the law's torques, and when it acts.
fn interface(cell: &CellConfig) -> TorqueInterface {
    if cell.robot.driver != RobotDriver::Franka {
        return TorqueInterface::default();
    }
    let franka = cell.robot.franka();
    TorqueInterface {
        delay_periods: franka.delay_periods,
        gravity_by_arm: true,
        effort_share: franka.torque_share,
        rate_share: FRANKA_TORQUE_RATE_SHARE,
    }
}

/// The arm with the tool's mass: its inverse dynamics are those of both.
fn loaded<const N: usize>(model: &ModelData, cell: &CellConfig) -> Result<Arm<N>, ControllerError> {
    if model.dof != N {
        return Err(ControllerError::Joints {
            name: model.name.clone(),
            dof: model.dof,
            wanted: N,
        });
    }
    let arm = Arm::<N>::new(model)?;
    let tool = &cell.tool;
    if tool.mass_kg <= 0.0 {
        return Ok(arm);
    }
    let flange_from_sensor: Pose<Flange, Sensor> = cell.sensor.flange_from_sensor.pose();
    let turn = *flange_from_sensor.rotation().to_rotation_matrix().matrix();
    let inertia = Matrix3::from_diagonal(&Vector3::from(tool.inertia_kg_m2));
    Ok(arm.with_payload(&Payload {
        mass_kg: tool.mass_kg,
        com_in_flange_m: flange_from_sensor.transform_point(&tool.com_in_sensor()),
        inertia_kg_m2: turn * inertia * turn.transpose(),
    }))
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
