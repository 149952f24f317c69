//! Settings of the service, from the cell file.

use std::time::Duration;

use tangent_actuation::velocity::VelocityLimits;
use tangent_mechanics::{Arm, Flange, ModelError, Pose, Tool};
use tangent_runtime::config::{
    CellConfig, JointCountError, RealtimeConfig, RobotModelError, UrReading,
};

use crate::bridge::BridgeConfig;
use crate::codec::Series;
use crate::dashboard::{ur_number, ur_size};
use crate::link::OwnWrench;
use crate::program::{ProgramConfig, ProgramError, RegisterMap};

/// Time from sending a velocity until the arm follows it, s, as used by the gate.
const RESPONSE_CB3_S: f64 = 0.040;
const RESPONSE_E_SERIES_S: f64 = 0.016;
/// Silence of the controller after which its activation is latched out, s.
const SILENCE_LATCH_S: f64 = 0.1;
/// Deceleration of the robot program's own stops, rad/s².
const STOP_DECELERATION: f64 = 4.0;

/// Why a cell file cannot be used by this service.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// The arm is not a Universal Robots arm.
    #[error(
        "[robot] model = \"{model}\" is not a Universal Robots arm: rtde drives ur3 to ur30 of `tangent model list` (or a \
         model_file of six joints)"
    )]
    NotUr {
        /// The cell file's model.
        model: String,
    },
    /// The model cannot be read.
    #[error(transparent)]
    Model(#[from] RobotModelError),
    /// The model is not of an arm with six joints.
    #[error(transparent)]
    Arm(#[from] ModelError),
    /// A list of limits of the wrong length.
    #[error(transparent)]
    JointCount(#[from] JointCountError),
    /// The rate is too low for the program on the robot.
    #[error(
        "[robot] rate_hz = {rate_hz} is not allowed: 0 (the controller's own) or at least 125, since the robot's program \
         treats a longer pause as a lost connection"
    )]
    Rate {
        /// Configured rate, Hz.
        rate_hz: f64,
    },
    /// The arm has no force/torque sensor of its own.
    #[error(
        "[sensor] driver = \"ur\" is not allowed with [robot] model = \"{model}\": only e-Series arms (ur3e to ur16e, ur15 to ur30) \
         have a force/torque sensor. Correct the model, or set driver to \"netft\" or \"topic\""
    )]
    NoSensor {
        /// The cell file's model.
        model: String,
    },
    /// The robot's program cannot be rendered with these numbers.
    #[error(transparent)]
    Program(#[from] ProgramError),
}

/// Settings of [`crate::run`].
#[derive(Clone, Debug)]
pub struct Config {
    /// Host name or address of the controller.
    pub host: String,
    /// RTDE port.
    pub rtde_port: u16,
    /// Script port.
    pub script_port: u16,
    /// Dashboard port.
    pub dashboard_port: u16,
    /// Timeout of each attempt to connect.
    pub connect_timeout: Duration,
    /// Power on and release the brakes when the bridge starts.
    pub power_on: bool,
    /// Arm the controller's own watchdog behind the program.
    pub watchdog: bool,
    /// Settings of the state machine; its seed is drawn at the start.
    pub bridge: BridgeConfig,
    /// The arm's kinematics.
    pub arm: Arm<6>,
    /// The cell's tcp.
    pub flange_from_tool: Pose<Flange, Tool>,
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
        let series = series_of(&robot.model);
        if robot.model_file.is_none() && ur_size(&robot.model).is_none() {
            return Err(SettingsError::NotUr {
                model: robot.model.clone(),
            });
        }
        let model = robot.model_data()?;
        if robot.rate_hz != 0.0 && robot.rate_hz < Series::Cb3.rate_hz() {
            return Err(SettingsError::Rate {
                rate_hz: robot.rate_hz,
            });
        }
        let sensor = cell.sensor.ur_reading();
        if sensor.is_some() && series == Some(Series::Cb3) {
            return Err(SettingsError::NoSensor {
                model: robot.model.clone(),
            });
        }
        let arm = Arm::<6>::new(&model)?;
        let limits = guard_limits(cell, &arm, series)?;
        let config = Self {
            host: robot.address.clone(),
            rtde_port: robot.rtde_port.saturating_add(robot.port_offset),
            script_port: robot.script_port.saturating_add(robot.port_offset),
            dashboard_port: robot.dashboard_port.saturating_add(robot.port_offset),
            connect_timeout: Duration::from_secs_f64(robot.connect_timeout_s),
            power_on: robot.power_on,
            watchdog: robot.controller_watchdog,
            bridge: BridgeConfig {
                registers: RegisterMap::new(robot.register_base)?,
                model: robot.model.clone(),
                series,
                rate_hz: (robot.rate_hz > 0.0).then_some(robot.rate_hz),
                wrench: Some(OwnWrench {
                    reading: sensor.unwrap_or(UrReading::ActualTcpForce),
                    needed: sensor.is_some(),
                }),
                limits,
                speed_scaling_min: robot.speed_scaling_min,
                seed: 1,
            },
            arm,
            flange_from_tool: cell.tool.flange_from_tool(),
            realtime: cell.realtime.clone(),
        };
        // Values that the program cannot be compiled with are reported before the robot is
        // contacted.
        config.program(1, Series::Cb3).render()?;
        Ok(config)
    }

    /// The program for one session.
    pub fn program(&self, session: i32, series: Series) -> ProgramConfig {
        let limits = &self.bridge.limits;
        ProgramConfig {
            registers: self.bridge.registers,
            session,
            series,
            speed_max_rad_per_s: limits.motion.speed_rad_per_s.max(),
            acceleration_max_rad_per_s2: limits.acceleration_rad_per_s2.max(),
            stop_deceleration_rad_per_s2: STOP_DECELERATION,
            watchdog: self.watchdog,
        }
    }
}

/// CB3 or e-Series, from the model's name; `None` if the name does not determine it.
pub fn series_of(model: &str) -> Option<Series> {
    let number = ur_number(model)?;
    let e_series = model.trim().to_ascii_lowercase().ends_with('e') || number >= 15;
    match (e_series, number) {
        (true, _) => Some(Series::ESeries),
        (false, 3 | 5 | 10) => Some(Series::Cb3),
        _ => None,
    }
}

fn guard_limits(
    cell: &CellConfig,
    arm: &Arm<6>,
    series: Option<Series>,
) -> Result<VelocityLimits<6>, JointCountError> {
    Ok(VelocityLimits {
        motion: cell.limits.motion(arm)?,
        acceleration_rad_per_s2: cell.limits.joint_acceleration()?,
        response_s: match series {
            Some(Series::ESeries) => RESPONSE_E_SERIES_S,
            _ => RESPONSE_CB3_S,
        },
        patience_cycles: cell.robot.command_patience_cycles,
        silence_latch_s: SILENCE_LATCH_S,
    })
}

#[cfg(test)]
mod tests {
    use tangent_mechanics::ModelData;
    use tangent_runtime::config::SensorDriver;

    use super::*;

    #[test]
    fn the_cell_that_ships_works() {
        let config = Config::from_cell(&CellConfig::default_cell()).unwrap();
        assert_eq!(config.bridge.series, Some(Series::Cb3));
        let program = config.program(77, Series::Cb3);
        assert_eq!(
            program.speed_max_rad_per_s,
            config.bridge.limits.motion.speed_rad_per_s.max()
        );
        assert!(program.render().unwrap().contains("== 77"));
    }

    #[test]
    fn settings_that_cannot_work_are_reported_by_name() {
        let mut cell = CellConfig::default_cell();
        cell.robot.model = "panda".into();
        let text = Config::from_cell(&cell).unwrap_err().to_string();
        assert!(
            text.starts_with("[robot] model = \"panda\" is not a Universal Robots arm"),
            "{text}"
        );

        let mut cell = CellConfig::default_cell();
        cell.limits.joint_speed_max_rad_per_s = vec![1.0; 5];
        let text = Config::from_cell(&cell).unwrap_err().to_string();
        assert!(text.contains("has 5 values"), "{text}");

        let mut cell = CellConfig::default_cell();
        cell.sensor.driver = SensorDriver::Ur;
        let text = Config::from_cell(&cell).unwrap_err().to_string();
        assert!(
            text.starts_with(
                "[sensor] driver = \"ur\" is not allowed with [robot] model = \"ur5\""
            ),
            "{text}"
        );

        let mut cell = CellConfig::default_cell();
        cell.robot.rate_hz = 50.0;
        assert!(matches!(
            Config::from_cell(&cell),
            Err(SettingsError::Rate { .. })
        ));
    }

    #[test]
    fn a_model_says_its_series() {
        for (model, series) in [
            ("ur3", Some(Series::Cb3)),
            ("ur5", Some(Series::Cb3)),
            ("ur10", Some(Series::Cb3)),
            ("ur3e", Some(Series::ESeries)),
            ("ur5e", Some(Series::ESeries)),
            ("ur10e", Some(Series::ESeries)),
            ("ur16e", Some(Series::ESeries)),
            ("ur7e", Some(Series::ESeries)),
            ("ur12e", Some(Series::ESeries)),
            ("ur15", Some(Series::ESeries)),
            ("ur18", Some(Series::ESeries)),
            ("ur20", Some(Series::ESeries)),
            ("ur30", Some(Series::ESeries)),
            ("ur7", None),
            ("my_arm", None),
        ] {
            assert_eq!(series_of(model), series, "{model}");
        }
    }

    #[test]
    fn every_built_in_ur_arm_is_driven_and_says_its_series() {
        let mut driven = 0;
        for name in ModelData::builtin_names().filter(|name| name.starts_with("ur")) {
            let mut cell = CellConfig::default_cell();
            cell.robot.model = name.into();
            let config = Config::from_cell(&cell).unwrap();
            assert_eq!(config.bridge.series, series_of(name), "{name}");
            assert!(config.bridge.series.is_some(), "{name}");
            driven += 1;
        }
        assert_eq!(driven, 13);
    }
}
