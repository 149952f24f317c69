//! The sections of `cell.toml`. Each key is documented here and, for users, in `deploy/cell.toml`
//! and `docs/services/runtime.md`.

mod camera;
mod cell;
mod foxglove;
mod franka;
mod limits;
mod pose;
mod realtime;
mod robot;
mod ros2;
mod sensor;
mod services;
mod tip;
mod tool;
mod ui;
mod zenoh;

pub use camera::{Calibration, CameraConfig, CameraKind, Focal};
pub use cell::CellSection;
pub use foxglove::FoxgloveConfig;
pub use franka::{FRANKA_TORQUE_RATE_SHARE, FrankaConfig};
pub use limits::{JointCountError, LimitsConfig};
pub use pose::PoseConfig;
pub use realtime::RealtimeConfig;
pub use robot::{RobotConfig, RobotDriver, RobotModelError};
pub use ros2::{Ros2Command, Ros2Config, Ros2Inputs, is_ros_name};
pub use sensor::{
    SensorConfig, SensorDriver, SensorMode, TopicSensorConfig, UrReading, UrSensorConfig,
};
pub use services::{
    ControllerConfig, EstimatorsConfig, Law, RecorderConfig, SimulatorConfig, WrenchSource,
};
pub use tip::{TipConfig, TipKind};
pub use tool::ToolConfig;
pub use ui::{OnLostPage, UiConfig};
pub use zenoh::{TlsConfig, ZenohConfig, is_endpoint};

use std::net::IpAddr;

use super::check::Checker;
use super::load::ConfigError;

/// Checks the host of a device. Its ports have keys of their own.
fn check_host(checker: &Checker<'_>, key: &str, host: &str) -> Result<(), ConfigError> {
    let is_name =
        !host.is_empty() && !host.contains([':', '/', '@']) && !host.contains(char::is_whitespace);
    let section = key.split('.').next().unwrap_or_default();
    checker.require(
        is_name || host.parse::<IpAddr>().is_ok(),
        key,
        format!("\"{host}\""),
        &format!(
            "a host name or an IP address, without a scheme and a port: the ports have keys of their own, and \
             {section}.port_offset moves them all"
        ),
    )
}

fn check_port(checker: &Checker<'_>, key: &str, port: u16, offset: u16) -> Result<(), ConfigError> {
    checker.require(
        port > 0 && port.checked_add(offset).is_some(),
        key,
        port,
        "from 1 to 65535, port_offset included",
    )
}
