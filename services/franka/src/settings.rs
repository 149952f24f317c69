//! Settings of the service, from the cell file.

use std::time::Duration;

use nalgebra::Vector3;
use tangent_actuation::torque::TorqueLimits;
use tangent_mechanics::{Arm, Flange, Joints, ModelError, Pose, Tool};
use tangent_runtime::StateFolder;
use tangent_runtime::config::{
    CellConfig, FRANKA_TORQUE_RATE_SHARE, FrankaConfig, JointCountError, RealtimeConfig,
    RobotDriver, RobotModelError,
};
use tangent_sensing::TareConfig;

use crate::bridge::BridgeConfig;
use crate::fci::{CollisionBehavior, Load, Request};

/// Silence of the controller after which its activation is latched out, s.
const SILENCE_LATCH_S: f64 = 0.1;
/// Distance from the joint limits at which the arm is held, rad. At the limits the robot stops
/// until it is guided back by hand.
const POSITION_MARGIN_RAD: f64 = 0.03;
/// The robot's limit on the rate of a torque if the model states none, Nm/s.
const TORQUE_RATE_NM_PER_S: f64 = 1000.0;

/// Why a cell file cannot be used by this service.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// The cell is for an arm of another vendor.
    #[error(
        "[robot] driver is \"rtde\", for a Universal Robots arm; this service drives a Franka: set driver = \"franka\""
    )]
    Driver,
    /// The model cannot be read, or has another number of joints.
    #[error("[robot] model: {0}; this service drives \"panda\" (or a model_file of seven joints)")]
    Model(#[from] ModelError),
    /// The file of the model or of its calibration cannot be used.
    #[error(transparent)]
    ModelFile(RobotModelError),
    /// The model does not state the torque limits of the joints.
    #[error("[robot] model = \"{model}\" has no effort_nm, which bounds the torques")]
    NoEffort {
        /// Model as configured.
        model: String,
    },
    /// A list of limits of the wrong length.
    #[error(transparent)]
    JointCount(#[from] JointCountError),
    /// The robot has only one rate.
    #[error("[robot] rate_hz = {rate_hz} is not allowed: 0 or 1000, the rate of FCI")]
    Rate {
        /// Configured rate, Hz.
        rate_hz: f64,
    },
    /// The robot assumes that gravity points towards its base.
    #[error(
        "[robot] gravity_in_base_m_per_s2 = {gravity:?} is not allowed: FCI compensates gravity for an arm that stands on the floor, \
         so it has to be about [0, 0, -9.81]"
    )]
    Gravity {
        /// Gravity as configured, m/s².
        gravity: [f64; 3],
    },
}

impl From<RobotModelError> for SettingsError {
    fn from(error: RobotModelError) -> Self {
        match error {
            RobotModelError::Model(error) => Self::Model(error),
            file => Self::ModelFile(file),
        }
    }
}

/// Settings of [`crate::run`].
#[derive(Clone, Debug)]
pub struct Config {
    /// Host name or address of the robot.
    pub host: String,
    /// Its FCI port.
    pub port: u16,
    /// For each attempt to connect.
    pub connect_timeout: Duration,
    /// The state machine's part.
    pub bridge: BridgeConfig,
    /// The arm's kinematics.
    pub arm: Arm<7>,
    /// The cell's tcp.
    pub flange_from_tool: Pose<Flange, Tool>,
    /// Conditions under which the zero of the wrench estimate may be taken.
    pub tare: TareConfig,
    /// Folder in which the last good zero and the controller's last state are kept across restarts;
    /// `None`: not kept.
    pub state: Option<StateFolder>,
    /// Scheduling of the loop's thread.
    pub realtime: RealtimeConfig,
}

impl Config {
    /// From a cell file.
    ///
    /// # Errors
    /// [`SettingsError`], naming key, value and what is allowed.
    pub fn from_cell(cell: &CellConfig) -> Result<Self, SettingsError> {
        let robot = &cell.robot;
        if robot.driver != RobotDriver::Franka {
            return Err(SettingsError::Driver);
        }
        if robot.rate_hz != 0.0 && robot.rate_hz != 1000.0 {
            return Err(SettingsError::Rate {
                rate_hz: robot.rate_hz,
            });
        }
        let gravity = robot.gravity_in_base();
        if gravity.angle(&-Vector3::z()) > 0.05 {
            return Err(SettingsError::Gravity {
                gravity: robot.gravity_in_base_m_per_s2,
            });
        }
        let model = robot.model_data()?;
        let arm = Arm::<7>::new(&model)?;
        let franka = robot.franka();
        Ok(Self {
            host: robot.address.clone(),
            port: franka.fci_port.saturating_add(robot.port_offset),
            connect_timeout: Duration::from_secs_f64(robot.connect_timeout_s),
            bridge: BridgeConfig {
                settings: settings(cell),
                limits: limits(cell, &arm)?,
            },
            arm,
            flange_from_tool: cell.tool.flange_from_tool(),
            tare: tare(&franka),
            state: StateFolder::of_cell(cell),
            realtime: cell.realtime.clone(),
        })
    }
}

/// Tare settings. The estimate is noisier than a sensor, and its error differs with the pose rather
/// than with time.
fn tare(franka: &FrankaConfig) -> TareConfig {
    TareConfig {
        duration_s: 0.25,
        force_std_max_n: 1.0,
        torque_std_max_nm: 0.2,
        force_change_max_n: 0.5,
        torque_change_max_nm: 0.1,
        jump_max_n: franka.zero_jump_max_n,
        jump_max_nm: franka.zero_jump_max_nm,
        drift_n_per_min: 0.01,
        drift_nm_per_min: 0.001,
        // Beyond it the robot stops by itself.
        rated: Some(franka.collision_force_n_nm),
        zero_max_n: Some(franka.zero_max_n),
        ..TareConfig::default()
    }
}

/// Settings of the robot, in order. The end effector's frame stays as set at the robot; the bridge
/// moves the estimate of the wrench to the cell's tool.
fn settings(cell: &CellConfig) -> Vec<Request> {
    let franka = cell.robot.franka();
    let com = cell
        .sensor
        .flange_from_sensor()
        .transform_point(&cell.tool.com_in_sensor());
    let [ix, iy, iz] = if cell.tool.mass_kg > 0.0 {
        franka.tool_inertia_kg_m2
    } else {
        [0.0; 3]
    };
    vec![
        Request::SetCollisionBehavior(CollisionBehavior {
            lower_torque_acceleration: franka.contact_torque_nm,
            upper_torque_acceleration: franka.collision_torque_nm,
            lower_torque_nominal: franka.contact_torque_nm,
            upper_torque_nominal: franka.collision_torque_nm,
            lower_force_acceleration: franka.contact_force_n_nm,
            upper_force_acceleration: franka.collision_force_n_nm,
            lower_force_nominal: franka.contact_force_n_nm,
            upper_force_nominal: franka.collision_force_n_nm,
        }),
        Request::SetJointImpedance(franka.joint_impedance_nm_per_rad),
        Request::SetLoad(Load {
            mass_kg: cell.tool.mass_kg,
            com_in_flange_m: com.into(),
            inertia_kg_m2: [ix, 0.0, 0.0, 0.0, iy, 0.0, 0.0, 0.0, iz],
        }),
    ]
}

fn limits(cell: &CellConfig, arm: &Arm<7>) -> Result<TorqueLimits<7>, SettingsError> {
    let own = arm.limits();
    let franka = cell.robot.franka();
    let effort = own.effort.ok_or_else(|| SettingsError::NoEffort {
        model: cell.robot.model.clone(),
    })?;
    Ok(TorqueLimits {
        motion: cell.limits.motion(arm)?.inside(POSITION_MARGIN_RAD),
        torque_nm: effort * franka.torque_share,
        torque_rate_nm_per_s: FRANKA_TORQUE_RATE_SHARE
            * own
                .effort_rate
                .unwrap_or_else(|| Joints::repeat(TORQUE_RATE_NM_PER_S)),
        hold_stiffness: Joints::from(franka.hold_stiffness_nm_per_rad),
        hold_damping: Joints::from(franka.hold_damping_nm_s_per_rad),
        patience_cycles: cell.robot.command_patience_cycles,
        silence_latch_s: SILENCE_LATCH_S,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell() -> CellConfig {
        let mut cell = CellConfig::default_cell();
        cell.robot.model = "panda".into();
        cell.robot.driver = RobotDriver::Franka;
        cell
    }

    #[test]
    fn a_franka_cell_becomes_limits_and_settings() {
        let mut cell = cell();
        cell.robot.port_offset = 5;
        cell.sensor.flange_from_sensor.translation_m = [0.0, 0.0, 0.01];
        cell.robot.franka = Some(FrankaConfig {
            torque_share: 0.5,
            ..FrankaConfig::default()
        });
        let config = Config::from_cell(&cell).unwrap();
        assert_eq!(config.port, 1342);
        assert_eq!(config.bridge.limits.torque_nm[0], 43.5);
        assert_eq!(config.bridge.limits.torque_nm[6], 6.0);
        let load = config.bridge.settings.iter().find_map(|r| match r {
            Request::SetLoad(load) => Some(load),
            _ => None,
        });
        let load = load.unwrap();
        assert_eq!(load.mass_kg, 0.3);
        assert!((load.com_in_flange_m[2] - 0.06).abs() < 1e-12);
    }

    #[test]
    fn settings_that_cannot_work_are_reported_by_name() {
        let said = |change: fn(&mut CellConfig)| {
            let mut cell = cell();
            change(&mut cell);
            Config::from_cell(&cell).unwrap_err().to_string()
        };
        for (change, wanted) in [
            (
                (|c| c.robot.driver = RobotDriver::Rtde) as fn(&mut CellConfig),
                "driver = \"franka\"",
            ),
            (|c| c.robot.rate_hz = 500.0, "rate_hz = 500 is not allowed"),
            (|c| c.robot.model = "ur5".into(), "seven joints"),
            (
                |c| c.limits.joint_speed_max_rad_per_s = vec![1.0; 6],
                "has 6 values; 1 or 7",
            ),
            (
                |c| c.robot.gravity_in_base_m_per_s2 = [0.0, 9.81, 0.0],
                "stands on the floor",
            ),
        ] {
            let said = said(change);
            assert!(said.contains(wanted), "{said}");
        }
    }
}
