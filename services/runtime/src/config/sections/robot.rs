//! `[robot]`: the arm, its address and the settings of its bridge.

use std::path::PathBuf;

use nalgebra::Vector3;
use serde::Deserialize;
use tangent_mechanics::{CalibrationError, ModelData, ModelError};

use super::franka::FrankaConfig;
use super::{check_host, check_port};
use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// The protocol of the arm, which determines the service that drives it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RobotDriver {
    /// A Universal Robots arm: RTDE, joint velocity, service `rtde`.
    #[default]
    Rtde,
    /// A Franka arm: FCI, joint torque, service `franka`.
    Franka,
}

impl std::fmt::Display for RobotDriver {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Rtde => "rtde",
            Self::Franka => "franka",
        })
    }
}

/// Why the model of the cell's arm cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum RobotModelError {
    /// The file cannot be read.
    #[error("[robot] model_file = {path}: {reason}")]
    File {
        /// Its path.
        path: String,
        /// The system's reason.
        reason: String,
    },
    /// There is no built-in model of this name, or the file is not a valid model.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The factory calibration cannot be read.
    #[error("[robot] calibration_file = {path}: {reason}")]
    CalibrationFile {
        /// Its path.
        path: String,
        /// The system's reason.
        reason: String,
    },
    /// The factory calibration does not fit the model.
    #[error("[robot] calibration_file = {path}: {reason}")]
    Calibration {
        /// Its path.
        path: String,
        /// What is wrong with it.
        reason: CalibrationError,
    },
}

/// `[robot]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotConfig {
    /// Protocol of the arm.
    #[serde(default)]
    pub driver: RobotDriver,
    /// Name of a built-in model, for instance `ur5`.
    pub model: String,
    /// File of a user's own model, used instead of `model`.
    #[serde(default)]
    pub model_file: Option<PathBuf>,
    /// The arm's factory calibration, `calibration.conf` of a Universal Robots controller.
    #[serde(default)]
    pub calibration_file: Option<PathBuf>,
    /// Host name or IP address of the controller.
    pub address: String,
    /// Offset that is added to every port below, so that several simulated robots fit on one host.
    #[serde(default)]
    pub port_offset: u16,
    /// TCP port of RTDE.
    #[serde(default = "ports::rtde")]
    pub rtde_port: u16,
    /// TCP port of the primary interface. The bridge sends its program there, and reads why a
    /// program failed.
    #[serde(default = "ports::script")]
    pub script_port: u16,
    /// TCP port of the dashboard server.
    #[serde(default = "ports::dashboard")]
    pub dashboard_port: u16,
    /// RTDE rate, Hz; 0: the highest that the controller offers (125 on CB3, 500 on e-Series).
    #[serde(default)]
    pub rate_hz: f64,
    /// First RTDE register that the bridge uses.
    #[serde(default = "ports::register_base")]
    pub register_base: u8,
    /// Whether to power on and release the brakes through the dashboard when the bridge starts.
    #[serde(default)]
    pub power_on: bool,
    /// Gravity in base axes, m/s²; it defines how the base is mounted.
    #[serde(default = "standard_gravity")]
    pub gravity_in_base_m_per_s2: [f64; 3],
    /// Cycles without a fresh command before the bridge ramps the joint speed to zero.
    #[serde(default = "command_patience")]
    pub command_patience_cycles: u32,
    /// Least speed scaling (limiter times slider, 0 to 1) at which the arm may move.
    #[serde(default = "speed_scaling_min")]
    pub speed_scaling_min: f64,
    /// Whether to arm the controller's own watchdog, in addition to the one in the bridge's
    /// program. On CB3 its trip is a protective stop.
    #[serde(default = "controller_watchdog")]
    pub controller_watchdog: bool,
    /// Timeout of a connection attempt, s.
    #[serde(default = "connect_timeout")]
    pub connect_timeout_s: f64,
    /// Settings that only a Franka has.
    #[serde(default)]
    pub franka: Option<FrankaConfig>,
}

mod ports {
    pub fn rtde() -> u16 {
        30004
    }
    pub fn script() -> u16 {
        30001
    }
    pub fn dashboard() -> u16 {
        29999
    }
    pub fn register_base() -> u8 {
        24
    }
}

fn standard_gravity() -> [f64; 3] {
    [0.0, 0.0, -9.806_65]
}

fn command_patience() -> u32 {
    2
}

fn speed_scaling_min() -> f64 {
    0.3
}

fn controller_watchdog() -> bool {
    true
}

fn connect_timeout() -> f64 {
    2.0
}

impl RobotConfig {
    /// Settings that only a Franka has; defaults if the cell file has no `[robot.franka]`.
    pub fn franka(&self) -> FrankaConfig {
        self.franka.clone().unwrap_or_default()
    }

    /// Gravity in base axes, m/s².
    pub fn gravity_in_base(&self) -> Vector3<f64> {
        Vector3::from(self.gravity_in_base_m_per_s2)
    }

    /// Model of the arm: read from `model_file` if given, else the built-in one named `model`;
    /// corrected by `calibration_file` if given.
    ///
    /// # Errors
    /// [`RobotModelError`]: there is no such model, or a file cannot be read or is not valid.
    pub fn model_data(&self) -> Result<ModelData, RobotModelError> {
        let Some(path) = &self.model_file else {
            return self.calibrated(ModelData::builtin(&self.model)?);
        };
        let text = std::fs::read_to_string(path).map_err(|error| RobotModelError::File {
            path: path.display().to_string(),
            reason: error.to_string(),
        })?;
        self.calibrated(ModelData::from_toml(&text)?)
    }

    /// `model` with the corrections of `calibration_file`; unchanged if there is none.
    ///
    /// # Errors
    /// [`RobotModelError`]: the file cannot be read, or is not a calibration of this arm.
    pub fn calibrated(&self, model: ModelData) -> Result<ModelData, RobotModelError> {
        let Some(file) = &self.calibration_file else {
            return Ok(model);
        };
        let path = file.display().to_string();
        match std::fs::read_to_string(file) {
            Ok(text) => model
                .calibrated(&text)
                .map_err(|reason| RobotModelError::Calibration { path, reason }),
            Err(error) => Err(RobotModelError::CalibrationFile {
                path,
                reason: error.to_string(),
            }),
        }
    }

    pub(in crate::config) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        checker.require(
            !self.model.is_empty(),
            "robot.model",
            "\"\"",
            "the name of a model, see `tangent model list`",
        )?;
        check_host(checker, "robot.address", &self.address)?;
        checker.require(
            self.franka.is_none() || self.driver == RobotDriver::Franka,
            "robot.driver",
            "rtde",
            "\"franka\" where there is a table [robot.franka]",
        )?;
        if let Some(franka) = &self.franka {
            franka.check(checker, self.port_offset)?;
        }
        for (key, port) in [
            ("robot.rtde_port", self.rtde_port),
            ("robot.script_port", self.script_port),
            ("robot.dashboard_port", self.dashboard_port),
        ] {
            check_port(checker, key, port, self.port_offset)?;
        }
        checker.require(
            self.rate_hz == 0.0 || (1.0..=1000.0).contains(&self.rate_hz),
            "robot.rate_hz",
            self.rate_hz,
            "0 (the controller's own) or from 1 to 1000 Hz",
        )?;
        checker.require(
            (24..=40).contains(&self.register_base),
            "robot.register_base",
            self.register_base,
            "from 24 to 40: 0 to 23 belong to a PLC, and the bridge needs 7 of the 48",
        )?;
        checker.range(
            "robot.command_patience_cycles",
            f64::from(self.command_patience_cycles),
            1.0..=20.0,
            "cycles",
        )?;
        checker.range(
            "robot.speed_scaling_min",
            self.speed_scaling_min,
            0.05..=1.0,
            "",
        )?;
        checker.range(
            "robot.connect_timeout_s",
            self.connect_timeout_s,
            0.1..=60.0,
            "s",
        )?;
        let gravity = self.gravity_in_base().norm();
        checker.require(
            (9.0..=10.5).contains(&gravity),
            "robot.gravity_in_base_m_per_s2",
            format!("{:?}", self.gravity_in_base_m_per_s2),
            "a vector of 9 to 10.5 m/s²; [0, 0, -9.80665] for a base on the floor",
        )
    }
}
