//! Configuration of the service, from the cell file.

pub mod torque;

use tangent_control::{ControllerConfig, Limits, Presets};
use tangent_mechanics::{Arm, Flange, ModelData, Pose, Tool};
use tangent_runtime::{CellConfig, StateFolder};
use tangent_scene::SceneConfig;
use tangent_sensing::BaseConfig;

use crate::ControllerError;

/// Share of the bridge's own limits that the law uses, so that the bridge's guard never has to
/// intervene.
const SHARE: f64 = 0.9;

/// Configuration for `run`.
#[derive(Clone, Debug)]
pub struct Config {
    /// The arm's kinematics.
    pub arm: Arm<6>,
    /// Pose of the tool on the flange.
    pub flange_from_tool: Pose<Flange, Tool>,
    /// Limits of the cell.
    pub limits: Limits,
    /// Parameters of the law for tasks that name no preset.
    pub control: ControllerConfig,
    /// Estimators that run in this cell: subscribed to from the start, so that a switch finds fresh
    /// estimates.
    pub estimators: Vec<String>,
    /// Whether the force that the arm itself feels is independent of the sensor in use.
    pub compares_arm_force: bool,
    /// Checks on the pose of a moving base.
    pub base: BaseConfig,
    /// Folder for state that persists across restarts: whether the tool may touch something.
    /// `None`: not stored.
    pub state: Option<StateFolder>,
    /// What viewers show of the cell.
    pub scene: SceneConfig,
}

impl Config {
    /// Reads the configuration from a cell file.
    ///
    /// # Errors
    /// Names the key, the value and the allowed range.
    pub fn from_cell(cell: &CellConfig, model: ModelData) -> Result<Self, ControllerError> {
        if model.dof != 6 {
            return Err(ControllerError::Joints {
                name: model.name.clone(),
                dof: model.dof,
                wanted: "6",
            });
        }
        let arm = Arm::new(&model)?;
        let control =
            ControllerConfig::preset_with(&cell.controller.preset, &cell.controller.settings)?;
        let limits = limits(cell, &arm);
        limits.check()?;
        let mut estimators = vec![cell.estimators.active.clone()];
        for name in &cell.estimators.run {
            if !estimators.contains(name) {
                estimators.push(name.clone());
            }
        }
        Ok(Self {
            arm,
            flange_from_tool: cell.tool.flange_from_tool(),
            limits,
            control,
            estimators,
            compares_arm_force: cell.sensor.ur_reading().is_none(),
            base: cell.base,
            state: StateFolder::of_cell(cell),
            scene: SceneConfig::from_cell(cell, &model)?,
        })
    }
}

pub(crate) fn limits<const N: usize>(cell: &CellConfig, arm: &Arm<N>) -> Limits {
    let own = &cell.limits;
    // One share for all joints: the smallest that any joint requires.
    let joint_speed_share = own.joint_speed_max(N).map_or(SHARE, |speeds| {
        speeds
            .iter()
            .zip(arm.limits().velocity.iter())
            .map(|(limit, velocity)| SHARE * (limit / velocity).min(1.0))
            .fold(1.0, f64::min)
    });
    let default = Limits::default();
    let acceleration = own
        .joint_acceleration_max(N)
        .map_or(default.joint_acceleration_max_rad_per_s2, |list| {
            list.iter().copied().fold(f64::INFINITY, f64::min)
        });
    Limits {
        speed_max_m_per_s: SHARE * own.tool_speed_max_m_per_s,
        turn_rate_max_rad_per_s: SHARE * own.tool_turn_rate_max_rad_per_s,
        joint_speed_share,
        joint_acceleration_max_rad_per_s2: SHARE * acceleration,
        force_max_n: own.force_max_n,
        torque_max_nm: own.torque_max_nm,
        untared_force_max_n: own.untared_force_max_n,
        unread_force_max_n: own.unread_force_max_n,
        untared_share_max: own.untared_share_max,
        workspace_min_m: own.workspace_min_m,
        workspace_max_m: own.workspace_max_m,
        blind_distance_max_m: own.blind_distance_max_m,
        ..default
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ur5() -> ModelData {
        ModelData::builtin("ur5").unwrap()
    }

    #[test]
    fn the_law_stays_inside_the_bridges_limits() {
        let cell = CellConfig::default_cell();
        let config = Config::from_cell(&cell, ur5()).unwrap();
        assert!(config.limits.speed_max_m_per_s < cell.limits.tool_speed_max_m_per_s);
        let limit = cell.limits.joint_speed_max(6).unwrap();
        for (velocity, limit) in config.arm.limits().velocity.iter().zip(limit) {
            assert!(velocity * config.limits.joint_speed_share < limit);
        }
        assert_eq!(config.estimators[0], cell.estimators.active);
    }

    /// A fault's text refers the operator to this key.
    #[test]
    fn the_distance_without_contact_is_the_cells() {
        let mut cell = CellConfig::default_cell();
        assert_eq!(
            cell.limits.blind_distance_max_m,
            Limits::default().blind_distance_max_m
        );
        cell.limits.blind_distance_max_m = 0.012;
        let config = Config::from_cell(&cell, ur5()).unwrap();
        assert_eq!(config.limits.blind_distance_max_m, 0.012);
    }

    #[test]
    fn wrong_gains_and_arms_are_named() {
        let mut cell = CellConfig::default_cell();
        cell.controller.settings = toml::from_str("alignment.gain = 1.0").unwrap();
        let error = Config::from_cell(&cell, ur5()).unwrap_err().to_string();
        assert!(error.contains("gain"), "{error}");
        cell.controller.settings = toml::Table::new();
        cell.controller.preset = "magic".into();
        let error = Config::from_cell(&cell, ur5()).unwrap_err().to_string();
        assert!(error.contains("magic"), "{error}");
        let panda = ModelData::builtin("panda").unwrap();
        let error = Config::from_cell(&CellConfig::default_cell(), panda)
            .unwrap_err()
            .to_string();
        assert!(error.contains("7 joints"), "{error}");
    }
}
