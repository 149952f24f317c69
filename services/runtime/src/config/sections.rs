//! The sections of `cell.toml`. What a key means stands here and, for users, in `deploy/cell.toml` and
//! `docs/services/runtime.md`.

use std::collections::BTreeMap;
use std::path::PathBuf;

use nalgebra::{UnitQuaternion, Vector3};
use serde::Deserialize;
use tangent_mechanics::{Flange, Pose, Sensor, Tool};
use tangent_schemas::JointArray;

use super::check::Checker;
use super::load::ConfigError;

/// `[cell]`
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellSection {
    /// Namespace of all keys on the network.
    pub name: String,
}

impl CellSection {
    pub(super) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        let good = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        let fits = (1..=32).contains(&self.name.len()) && self.name.chars().all(good);
        checker.require(
            fits,
            "cell.name",
            &self.name,
            "1 to 32 letters, digits, `_` or `-`",
        )
    }
}

/// A pose as a position and a rotation vector (axis times angle), as a UR pendant shows a tcp.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseConfig {
    /// m
    #[serde(default)]
    pub translation_m: [f64; 3],
    /// rad
    #[serde(default)]
    pub rotation_vector_rad: [f64; 3],
}

impl PoseConfig {
    /// As a pose between frames.
    pub fn pose<A, B>(&self) -> Pose<A, B> {
        Pose::new(
            Vector3::from(self.translation_m),
            UnitQuaternion::from_scaled_axis(Vector3::from(self.rotation_vector_rad)),
        )
    }

    fn check(&self, checker: &Checker<'_>, key: &str) -> Result<(), ConfigError> {
        let translation = format!("{key}.translation_m");
        checker.ranges(&translation, &self.translation_m, -5.0..=5.0, "m")?;
        let rotation = format!("{key}.rotation_vector_rad");
        let turn = std::f64::consts::TAU;
        checker.ranges(&rotation, &self.rotation_vector_rad, -turn..=turn, "rad")
    }
}

/// `[robot]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotConfig {
    /// Name of a built-in model, for instance `ur5`.
    pub model: String,
    /// A model of one's own instead.
    #[serde(default)]
    pub model_file: Option<PathBuf>,
    /// Host name or IP address of the controller.
    pub address: String,
    /// Added to every port below, so that several simulated robots fit on one host.
    #[serde(default)]
    pub port_offset: u16,
    /// RTDE.
    #[serde(default = "ports::rtde")]
    pub rtde_port: u16,
    /// Where the program is sent: the primary interface, which also says why a program failed.
    #[serde(default = "ports::script")]
    pub script_port: u16,
    /// Dashboard server.
    #[serde(default = "ports::dashboard")]
    pub dashboard_port: u16,
    /// Packets per second; 0: the most that the controller offers (125 on CB3, 500 on e-Series).
    #[serde(default)]
    pub rate_hz: f64,
    /// First RTDE register in use.
    #[serde(default = "ports::register_base")]
    pub register_base: u8,
    /// Power on and release the brakes through the dashboard when the bridge starts.
    #[serde(default)]
    pub power_on: bool,
    /// Gravity in base axes, m/s²: tells how the base is mounted.
    #[serde(default = "standard_gravity")]
    pub gravity_in_base_m_per_s2: [f64; 3],
    /// Cycles without a fresh command before the bridge ramps the joint speed to zero.
    #[serde(default = "command_patience")]
    pub command_patience_cycles: u32,
    /// Least speed scaling (limiter times slider, 0 to 1) at which the arm may move.
    #[serde(default = "speed_scaling_min")]
    pub speed_scaling_min: f64,
    /// Arm the controller's own watchdog behind the bridge's program. On CB3 a trip is a protective stop.
    #[serde(default = "controller_watchdog")]
    pub controller_watchdog: bool,
    /// Connection attempts wait this long, s.
    #[serde(default = "connect_timeout")]
    pub connect_timeout_s: f64,
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
    pub fn rdt() -> u16 {
        49152
    }
    pub fn http() -> u16 {
        80
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
    /// Gravity in base axes, m/s².
    pub fn gravity_in_base(&self) -> Vector3<f64> {
        Vector3::from(self.gravity_in_base_m_per_s2)
    }

    pub(super) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        checker.require(
            !self.model.is_empty(),
            "robot.model",
            "\"\"",
            "the name of a model, see `tangent model list`",
        )?;
        checker.require(
            !self.address.is_empty(),
            "robot.address",
            "\"\"",
            "a host name or an IP address",
        )?;
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

fn check_port(checker: &Checker<'_>, key: &str, port: u16, offset: u16) -> Result<(), ConfigError> {
    checker.require(
        port > 0 && port.checked_add(offset).is_some(),
        key,
        port,
        "from 1 to 65535, port_offset included",
    )
}

/// How the sensor box sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorMode {
    /// One record per datagram: least delay.
    #[default]
    Realtime,
    /// Several records per datagram: least load.
    Buffered,
}

/// `[sensor]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorConfig {
    /// Host name or IP address of the Net F/T box.
    pub address: String,
    /// Added to both ports below.
    #[serde(default)]
    pub port_offset: u16,
    /// RDT, UDP.
    #[serde(default = "ports::rdt")]
    pub rdt_port: u16,
    /// Its web server, for units and scales.
    #[serde(default = "ports::http")]
    pub http_port: u16,
    /// Records per second, 1 to 7000.
    #[serde(default = "sensor_rate")]
    pub rate_hz: f64,
    /// How it sends.
    #[serde(default)]
    pub mode: SensorMode,
    /// Records per datagram when buffered, 1 to 40.
    #[serde(default = "buffer_records")]
    pub buffer_records: u8,
    /// `wrench/tool` is published this often, Hz; 0: 1000, so that no reader finds it older than about 1 ms.
    #[serde(default)]
    pub tool_rate_hz: f64,
    /// Cut-off of the low-pass filter, Hz.
    #[serde(default = "filter_cutoff")]
    pub filter_cutoff_hz: f64,
    /// Silence for this long is reported, and the stream asked for again, s.
    #[serde(default = "sensor_patience")]
    pub patience_s: f64,
    /// Where the sensor sits on the flange.
    #[serde(default)]
    pub flange_from_sensor: PoseConfig,
    /// Forces beyond are taken for saturation, N; x, y, z.
    #[serde(default = "force_range")]
    pub force_range_n: [f64; 3],
    /// Torques beyond are taken for saturation, Nm; x, y, z.
    #[serde(default = "torque_range")]
    pub torque_range_nm: [f64; 3],
}

fn sensor_rate() -> f64 {
    7000.0
}

fn buffer_records() -> u8 {
    7
}

fn filter_cutoff() -> f64 {
    50.0
}

fn sensor_patience() -> f64 {
    0.05
}

fn force_range() -> [f64; 3] {
    [130.0, 130.0, 400.0]
}

fn torque_range() -> [f64; 3] {
    [10.0; 3]
}

impl SensorConfig {
    /// Where the sensor sits on the flange.
    pub fn flange_from_sensor(&self) -> Pose<Flange, Sensor> {
        self.flange_from_sensor.pose()
    }

    pub(super) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        checker.require(
            !self.address.is_empty(),
            "sensor.address",
            "\"\"",
            "a host name or an IP address",
        )?;
        check_port(checker, "sensor.rdt_port", self.rdt_port, self.port_offset)?;
        check_port(
            checker,
            "sensor.http_port",
            self.http_port,
            self.port_offset,
        )?;
        checker.range("sensor.rate_hz", self.rate_hz, 1.0..=7000.0, "Hz")?;
        checker.range(
            "sensor.buffer_records",
            f64::from(self.buffer_records),
            1.0..=40.0,
            "records",
        )?;
        checker.require(
            self.tool_rate_hz == 0.0 || (1.0..=7000.0).contains(&self.tool_rate_hz),
            "sensor.tool_rate_hz",
            self.tool_rate_hz,
            "0 (1000 Hz) or from 1 to 7000 Hz",
        )?;
        // A filter above half the rate does nothing and below 1 Hz the loop cannot be stable.
        checker.range(
            "sensor.filter_cutoff_hz",
            self.filter_cutoff_hz,
            1.0..=self.rate_hz.mul_add(0.45, 0.0).max(1.0),
            "Hz (at most 0.45 of sensor.rate_hz)",
        )?;
        checker.range("sensor.patience_s", self.patience_s, 0.005..=5.0, "s")?;
        checker.ranges("sensor.force_range_n", &self.force_range_n, 0.1..=1e5, "N")?;
        checker.ranges(
            "sensor.torque_range_nm",
            &self.torque_range_nm,
            0.01..=1e4,
            "Nm",
        )?;
        self.flange_from_sensor
            .check(checker, "sensor.flange_from_sensor")
    }
}

/// `[tool]`: everything that the sensor carries.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolConfig {
    /// Mass behind the sensor, kg.
    pub mass_kg: f64,
    /// Its centre, sensor axes, m.
    pub com_in_sensor_m: [f64; 3],
    /// Origin at the tool's contact point, z out of the tool, into the surface.
    pub flange_from_tool: PoseConfig,
}

impl ToolConfig {
    /// The tool frame on the flange.
    pub fn flange_from_tool(&self) -> Pose<Flange, Tool> {
        self.flange_from_tool.pose()
    }

    /// Centre of mass, sensor axes, m.
    pub fn com_in_sensor(&self) -> Vector3<f64> {
        Vector3::from(self.com_in_sensor_m)
    }

    pub(super) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        checker.range("tool.mass_kg", self.mass_kg, 0.0..=20.0, "kg")?;
        checker.ranges(
            "tool.com_in_sensor_m",
            &self.com_in_sensor_m,
            -1.0..=1.0,
            "m",
        )?;
        self.flange_from_tool
            .check(checker, "tool.flange_from_tool")
    }
}

/// `[limits]`: the last guard, in `rtde`; the controller keeps inside them too.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LimitsConfig {
    /// rad/s; one number for all joints, or one per joint.
    pub joint_speed_max_rad_per_s: Vec<f64>,
    /// rad/s²; one number for all joints, or one per joint.
    pub joint_acceleration_max_rad_per_s2: Vec<f64>,
    /// Speed of the tool's origin, m/s.
    pub tool_speed_max_m_per_s: f64,
    /// Turn rate of the tool, rad/s.
    pub tool_turn_rate_max_rad_per_s: f64,
    /// The controller stops and retracts beyond this force, N.
    pub force_max_n: f64,
    /// The same for torque at the tool, Nm.
    pub torque_max_nm: f64,
    /// The tool's origin stays inside this box: lower corner, base axes, m.
    pub workspace_min_m: [f64; 3],
    /// Upper corner, base axes, m.
    pub workspace_max_m: [f64; 3],
}

impl Default for LimitsConfig {
    fn default() -> Self {
        Self {
            joint_speed_max_rad_per_s: vec![1.0],
            joint_acceleration_max_rad_per_s2: vec![4.0],
            tool_speed_max_m_per_s: 0.25,
            tool_turn_rate_max_rad_per_s: 1.0,
            force_max_n: 40.0,
            torque_max_nm: 5.0,
            workspace_min_m: [-1.2, -1.2, -0.5],
            workspace_max_m: [1.2, 1.2, 1.5],
        }
    }
}

impl LimitsConfig {
    /// rad/s for an arm of `joints` joints; `None` when the list has another length.
    pub fn joint_speed_max(&self, joints: usize) -> Option<JointArray> {
        per_joint(&self.joint_speed_max_rad_per_s, joints)
    }

    /// rad/s² for an arm of `joints` joints; `None` when the list has another length.
    pub fn joint_acceleration_max(&self, joints: usize) -> Option<JointArray> {
        per_joint(&self.joint_acceleration_max_rad_per_s2, joints)
    }

    pub(super) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        for (key, list, most) in [
            (
                "limits.joint_speed_max_rad_per_s",
                &self.joint_speed_max_rad_per_s,
                10.0,
            ),
            (
                "limits.joint_acceleration_max_rad_per_s2",
                &self.joint_acceleration_max_rad_per_s2,
                100.0,
            ),
        ] {
            checker.require(
                matches!(list.len(), 1..=7),
                key,
                format!("{list:?}"),
                "a list of one number for all joints, or one per joint",
            )?;
            checker.ranges(key, list, 0.001..=most, "")?;
        }
        let ranges = [
            ("tool_speed_max_m_per_s", self.tool_speed_max_m_per_s, 3.0),
            (
                "tool_turn_rate_max_rad_per_s",
                self.tool_turn_rate_max_rad_per_s,
                10.0,
            ),
            ("force_max_n", self.force_max_n, 1000.0),
            ("torque_max_nm", self.torque_max_nm, 200.0),
        ];
        for (key, value, most) in ranges {
            checker.range(&format!("limits.{key}"), value, 0.001..=most, "")?;
        }
        let ordered = (0..3).all(|i| self.workspace_min_m[i] < self.workspace_max_m[i]);
        checker.require(
            ordered,
            "limits.workspace_min_m",
            format!("{:?}", self.workspace_min_m),
            "every coordinate below that of limits.workspace_max_m",
        )?;
        checker.ranges(
            "limits.workspace_min_m",
            &self.workspace_min_m,
            -10.0..=10.0,
            "m",
        )?;
        checker.ranges(
            "limits.workspace_max_m",
            &self.workspace_max_m,
            -10.0..=10.0,
            "m",
        )
    }
}

fn per_joint(list: &[f64], joints: usize) -> Option<JointArray> {
    match list {
        [all] => Some(std::iter::repeat_n(*all, joints.min(7)).collect()),
        each if each.len() == joints => Some(each.iter().copied().collect()),
        _ => None,
    }
}

/// `[zenoh]`
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ZenohConfig {
    /// Routers to dial, tried in turn.
    pub connect: Vec<String>,
    /// Where `up` and `run router` listen.
    pub listen: Vec<String>,
    /// A neighbour that is silent this long is gone, ms.
    pub lease_ms: u32,
    /// Keep-alives per lease.
    pub keep_alive: u8,
    /// A Zenoh file (JSON5) to start from, for TLS and access control.
    pub file: Option<PathBuf>,
}

impl Default for ZenohConfig {
    fn default() -> Self {
        Self {
            connect: vec!["tcp/127.0.0.1:7447".into()],
            listen: vec!["tcp/127.0.0.1:7447".into()],
            lease_ms: 1000,
            keep_alive: 4,
            file: None,
        }
    }
}

impl ZenohConfig {
    pub(super) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        for (key, endpoints) in [
            ("zenoh.connect", &self.connect),
            ("zenoh.listen", &self.listen),
        ] {
            let bad = endpoints.iter().find(|endpoint| !is_endpoint(endpoint));
            checker.require(
                bad.is_none() && !endpoints.is_empty(),
                key,
                format!("{endpoints:?}"),
                "a list of endpoints such as \"tcp/127.0.0.1:7447\"",
            )?;
        }
        checker.range(
            "zenoh.lease_ms",
            f64::from(self.lease_ms),
            400.0..=60_000.0,
            "ms (shorter leases expire falsely under load)",
        )?;
        checker.range(
            "zenoh.keep_alive",
            f64::from(self.keep_alive),
            2.0..=10.0,
            "",
        )
    }
}

/// `PROTOCOL/ADDRESS:PORT`, options behind it allowed.
fn is_endpoint(endpoint: &str) -> bool {
    let Some((protocol, address)) = endpoint.split_once('/') else {
        return false;
    };
    let address = address.split(['?', '#']).next().unwrap_or_default();
    let port = address
        .rsplit_once(':')
        .map(|(_, port)| port.parse::<u16>());
    match protocol {
        "tcp" | "tls" => matches!(port, Some(Ok(_))),
        _ => false,
    }
}

/// `[estimators]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EstimatorsConfig {
    /// Those that this cell's estimator service runs, each on its own topic.
    pub run: Vec<String>,
    /// The one that the controller starts with.
    pub active: String,
    /// Settings per estimator, as that estimator documents them.
    pub settings: BTreeMap<String, toml::Table>,
}

impl Default for EstimatorsConfig {
    fn default() -> Self {
        Self {
            run: vec!["blend".into()],
            active: "blend".into(),
            settings: BTreeMap::new(),
        }
    }
}

impl EstimatorsConfig {
    pub(super) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        let good = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
        for name in self.run.iter().chain([&self.active]) {
            checker.require(
                (1..=64).contains(&name.len()) && name.chars().all(good),
                "estimators.run",
                name,
                "names of lower-case letters, digits and `_`",
            )?;
        }
        Ok(())
    }
}

/// `[controller]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ControllerConfig {
    /// Set of gains: `default` or `paper`.
    pub preset: String,
    /// Gains that differ from the preset, as the controller documents them.
    pub settings: toml::Table,
}

impl Default for ControllerConfig {
    fn default() -> Self {
        Self {
            preset: "default".into(),
            settings: toml::Table::new(),
        }
    }
}

/// `[recorder]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecorderConfig {
    /// Folder of the recordings, made when missing; from the working directory.
    pub folder: PathBuf,
    /// Key patterns to record.
    pub include: Vec<String>,
    /// A new file after so many megabytes.
    pub rotate_mb: f64,
    /// A new file after so many seconds.
    pub rotate_s: f64,
    /// Chunks are compressed with LZ4.
    pub compress: bool,
    /// Messages that wait for the disk before the oldest is dropped and counted.
    pub queue_messages: usize,
}

impl Default for RecorderConfig {
    fn default() -> Self {
        Self {
            folder: "recordings".into(),
            include: vec!["**".into()],
            rotate_mb: 1024.0,
            rotate_s: 3600.0,
            compress: true,
            queue_messages: 65_536,
        }
    }
}

impl RecorderConfig {
    pub(super) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        checker.range("recorder.rotate_mb", self.rotate_mb, 0.1..=1e6, "MB")?;
        checker.range("recorder.rotate_s", self.rotate_s, 1.0..=1e6, "s")?;
        checker.range(
            "recorder.queue_messages",
            self.queue_messages as f64,
            100.0..=1e7,
            "messages",
        )
    }
}

/// `[simulator]`
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimulatorConfig {
    /// Scenario file: surface, contact, sensor noise. Without one: the built-in pipe.
    pub scenario: Option<PathBuf>,
    /// Seed of all randomness; without one the scenario's.
    pub seed: Option<u64>,
}

/// `[realtime]`
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RealtimeConfig {
    /// Ask for SCHED_FIFO and locked memory.
    pub enabled: bool,
    /// SCHED_FIFO priority of the control loop's thread, 1 to 99.
    pub loop_priority: u8,
    /// The same for the sensor's thread.
    pub sensor_priority: u8,
    /// The same for the estimator's thread.
    pub estimator_priority: u8,
    /// The same for the simulated robot and sensor box: no load on this machine would delay the real ones.
    pub simulator_priority: u8,
    /// CPU that the control loop keeps to.
    pub loop_cpu: Option<usize>,
}

impl Default for RealtimeConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            loop_priority: 80,
            sensor_priority: 70,
            estimator_priority: 60,
            simulator_priority: 85,
            loop_cpu: None,
        }
    }
}

impl RealtimeConfig {
    pub(super) fn check(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        for (key, priority) in [
            ("realtime.loop_priority", self.loop_priority),
            ("realtime.sensor_priority", self.sensor_priority),
            ("realtime.estimator_priority", self.estimator_priority),
            ("realtime.simulator_priority", self.simulator_priority),
        ] {
            checker.range(key, f64::from(priority), 1.0..=99.0, "")?;
        }
        Ok(())
    }
}
