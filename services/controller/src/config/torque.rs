//! Configuration of the torque controller, from the cell file.

use std::fmt::Debug;

use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;
use tangent_control::{
    ControlError, HybridDynamicsConfig, Limits, Presets, TorqueInterface,
    UnifiedForceImpedanceConfig,
};
use tangent_estimation::ObjectPoseConfig;
use tangent_estimation::object_pose::{OBJECT_ESTIMATORS, ObjectShape};
use tangent_mechanics::{Arm, Flange, ModelData, Payload, Pose, Sensor, Tool};
use tangent_runtime::config::{FRANKA_TORQUE_RATE_SHARE, Law, RobotDriver};
use tangent_runtime::{CellConfig, StateFolder};
use tangent_scene::SceneConfig;

use super::limits;
use crate::ControllerError;

/// Configuration for [`crate::run_torque`], by law.
#[derive(Clone, Debug)]
pub enum TorqueConfig {
    /// Control by the pose of an object of known shape.
    HybridDynamics(TorqueCells<HybridDynamicsConfig>),
    /// Control by normals, passive through energy tanks.
    UnifiedForceImpedance(TorqueCells<UnifiedForceImpedanceConfig>),
}

impl TorqueConfig {
    /// Reads the configuration from a cell file.
    ///
    /// # Errors
    /// Names the key, the value and the allowed range.
    pub fn from_cell(cell: &CellConfig, model: &ModelData) -> Result<Self, ControllerError> {
        Ok(match cell.controller.law {
            Law::UnifiedForceImpedance => {
                Self::UnifiedForceImpedance(TorqueCells::from_cell(cell, model)?)
            }
            _ => Self::HybridDynamics(TorqueCells::from_cell(cell, model)?),
        })
    }
}

/// Parameters of a torque law, and what the law needs of the cell beside them.
pub trait CellLaw: Presets + Debug + Sync {
    /// What the law needs of the cell beside its parameters.
    type Setup: Clone + Debug + Send + Sync + 'static;

    /// Reads what the law needs from the cell file.
    ///
    /// # Errors
    /// Names the key.
    fn setup(cell: &CellConfig) -> Result<Self::Setup, ControllerError>;
}

impl CellLaw for HybridDynamicsConfig {
    /// The object's surface, as its estimators know it.
    type Setup = ObjectShape;

    fn setup(cell: &CellConfig) -> Result<Self::Setup, ControllerError> {
        shape(cell)
    }
}

impl CellLaw for UnifiedForceImpedanceConfig {
    /// Torque interface of the arm.
    type Setup = TorqueInterface;

    fn setup(cell: &CellConfig) -> Result<Self::Setup, ControllerError> {
        Ok(interface(cell))
    }
}

/// Configuration of a law, by the number of the arm's joints.
#[derive(Clone, Debug)]
pub enum TorqueCells<C: CellLaw> {
    /// An arm with six joints.
    Six(Box<TorqueCell<C, 6>>),
    /// An arm with seven joints.
    Seven(Box<TorqueCell<C, 7>>),
}

impl<C: CellLaw> TorqueCells<C> {
    fn from_cell(cell: &CellConfig, model: &ModelData) -> Result<Self, ControllerError> {
        Ok(if model.dof == 7 {
            Self::Seven(Box::new(TorqueCell::from_cell(cell, model)?))
        } else {
            Self::Six(Box::new(TorqueCell::from_cell(cell, model)?))
        })
    }
}

/// Configuration of a torque law with the parameters `C`, for an arm of `N` joints.
#[derive(Clone, Debug)]
pub struct TorqueCell<C: CellLaw, const N: usize> {
    /// The arm with its payload.
    pub arm: Arm<N>,
    /// Pose of the tool on the flange.
    pub flange_from_tool: Pose<Flange, Tool>,
    /// Limits of the cell.
    pub limits: Limits,
    /// Preset of the law for tasks that name none.
    pub preset: String,
    /// Parameters that differ from the preset.
    pub settings: toml::Table,
    /// What the law needs of the cell beside its parameters.
    pub setup: C::Setup,
    /// Estimators that run in this cell.
    pub estimators: Vec<String>,
    /// Folder for state that persists across restarts: whether the tool may touch something.
    /// `None`: not stored.
    pub state: Option<StateFolder>,
    /// What viewers show of the cell.
    pub scene: SceneConfig,
}

impl<C: CellLaw, const N: usize> TorqueCell<C, N> {
    fn from_cell(cell: &CellConfig, model: &ModelData) -> Result<Self, ControllerError> {
        let arm = loaded::<N>(model, cell)?;
        let own = &cell.controller;
        C::preset_with(&own.preset, &own.settings)?;
        let limits = limits(cell, &arm);
        limits.check()?;
        Ok(Self {
            arm,
            flange_from_tool: cell.tool.flange_from_tool(),
            limits,
            preset: own.preset.clone(),
            settings: own.settings.clone(),
            setup: C::setup(cell)?,
            estimators: cell.estimators.run.clone(),
            state: StateFolder::of_cell(cell),
            scene: SceneConfig::from_cell(cell, model)?,
        })
    }

    /// The law's parameters for a task that may name a preset of its own.
    ///
    /// # Errors
    /// An unknown preset or parameter.
    pub fn parameters(&self, preset: Option<&str>) -> Result<C, ControlError> {
        C::preset_with(preset.unwrap_or(&self.preset), &self.settings)
    }
}

/// Delay and torque limits of the arm's bridge.
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

/// The arm with the tool's mass: its inverse dynamics include both.
fn loaded<const N: usize>(model: &ModelData, cell: &CellConfig) -> Result<Arm<N>, ControllerError> {
    if model.dof != N {
        return Err(ControllerError::Joints {
            name: model.name.clone(),
            dof: model.dof,
            wanted: "6 or 7",
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

/// Shape of the object from the first estimator that has settings.
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
