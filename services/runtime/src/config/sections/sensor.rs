//! `[sensor]`: the force/torque sensor and its sensor box.

use serde::Deserialize;
use tangent_mechanics::{Flange, Pose, Sensor};

use super::{PoseConfig, RobotConfig, RobotDriver, check_host, check_port};
use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// Origin of the wrench.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorDriver {
    /// A sensor behind an ATI Net F/T box.
    #[default]
    Netft,
    /// The force/torque sensor in the flange of a Universal Robots e-Series arm, over RTDE.
    Ur,
    /// Any program that publishes `geometry_msgs/WrenchStamped` on the bus.
    Topic,
}

/// Value of an e-Series' own sensor that the bridge reads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
pub enum UrReading {
    /// Reading of the sensor at the flange, flange axes, with the weight of the payload. Software
    /// 5.9 or later.
    #[default]
    #[serde(rename = "ft_raw_wrench")]
    FtRawWrench,
    /// Force at the flange, base axes. The robot has subtracted the weight of the payload that is
    /// set on the pendant, and zeroes it when a program starts.
    #[serde(rename = "actual_TCP_force")]
    ActualTcpForce,
}

impl UrReading {
    /// Name of the RTDE output, and value of the key in the cell file.
    pub fn field(self) -> &'static str {
        match self {
            Self::FtRawWrench => "ft_raw_wrench",
            Self::ActualTcpForce => "actual_TCP_force",
        }
    }
}

/// `[sensor.ur]`: the sensor of an e-Series arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UrSensorConfig {
    /// Value that is read.
    pub reading: UrReading,
}

/// `[sensor.topic]`: a wrench that another program publishes on the bus. It is what the environment
/// does to the sensor, N and Nm, at the origin and in the axes of the sensor.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TopicSensorConfig {
    /// Key of the topic, relative to the cell.
    pub key: String,
    /// `frame_id` that every message must have; messages in another frame are refused. Empty: any.
    #[serde(default)]
    pub frame: String,
    /// Whether the program publishes what the sensor does to the environment: the sign is reversed.
    #[serde(default)]
    pub inverted: bool,
}

/// Transmission mode of the sensor box.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorMode {
    /// One record per datagram: smallest delay.
    #[default]
    Realtime,
    /// Several records per datagram: smallest load.
    Buffered,
}

/// `[sensor]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorConfig {
    /// Origin of the wrench.
    #[serde(default)]
    pub driver: SensorDriver,
    /// Settings of `driver = "ur"`.
    #[serde(default)]
    pub ur: Option<UrSensorConfig>,
    /// Settings of `driver = "topic"`.
    #[serde(default)]
    pub topic: Option<TopicSensorConfig>,
    /// Host name or IP address of the Net F/T box. Other drivers do not use it.
    #[serde(default)]
    pub address: String,
    /// Offset that is added to both ports below.
    #[serde(default)]
    pub port_offset: u16,
    /// UDP port of RDT.
    #[serde(default = "rdt_port")]
    pub rdt_port: u16,
    /// Port of the box's web server, which provides units and scales.
    #[serde(default = "http_port")]
    pub http_port: u16,
    /// Number of records per second, 1 to 7000. A Net F/T box is set to it while the service runs;
    /// 0: the box keeps its own setting. See [`SensorConfig::rate_stated_hz`].
    #[serde(default)]
    pub rate_hz: f64,
    /// Transmission mode.
    #[serde(default)]
    pub mode: SensorMode,
    /// Number of records per datagram in buffered mode, 1 to 40.
    #[serde(default = "buffer_records")]
    pub buffer_records: u8,
    /// Rate of `wrench/raw`, Hz; 0: every record. Each message costs every process on its way a few
    /// microseconds. Conditioning uses every record in any case.
    #[serde(default)]
    pub raw_rate_hz: f64,
    /// Rate of `wrench/tool`, Hz; 0: 1000, so that it is never older than about 1 ms when read.
    #[serde(default)]
    pub tool_rate_hz: f64,
    /// Cut-off of the low-pass filter, Hz.
    #[serde(default = "filter_cutoff")]
    pub filter_cutoff_hz: f64,
    /// Time without records after which this is reported and the stream is requested again, s.
    #[serde(default = "sensor_patience")]
    pub patience_s: f64,
    /// Pose of the sensor on the flange.
    #[serde(default)]
    pub flange_from_sensor: PoseConfig,
    /// Forces beyond which the sensor counts as saturated, N; x, y, z.
    #[serde(default = "force_range")]
    pub force_range_n: [f64; 3],
    /// Torques beyond which the sensor counts as saturated, Nm; x, y, z.
    #[serde(default = "torque_range")]
    pub torque_range_nm: [f64; 3],
    /// Largest difference between the zero of a tare and the last good one, N in any axis, besides
    /// the drift in between. A tare beyond it is refused.
    #[serde(default = "zero_jump")]
    pub zero_jump_max_n: f64,
    /// Largest difference between the zero of a tare and the last good one, Nm in any axis, besides
    /// the drift in between. A tare beyond it is refused.
    #[serde(default = "zero_jump_nm")]
    pub zero_jump_max_nm: f64,
    /// Drift of the zero, N per minute. It bounds the error of a zero by its age.
    #[serde(default = "zero_drift")]
    pub zero_drift_n_per_min: f64,
    /// Drift of the zero, Nm per minute. It bounds the error of a zero by its age.
    #[serde(default = "zero_drift_nm")]
    pub zero_drift_nm_per_min: f64,
    /// Largest share of the sensor's range that a zero may take in any axis, 0 to 1.
    #[serde(default = "zero_share")]
    pub zero_share_max: f64,
}

fn zero_jump() -> f64 {
    0.3
}

fn zero_jump_nm() -> f64 {
    0.05
}

fn zero_drift() -> f64 {
    0.05
}

fn zero_drift_nm() -> f64 {
    0.005
}

fn zero_share() -> f64 {
    0.5
}

fn rdt_port() -> u16 {
    49152
}

fn http_port() -> u16 {
    80
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

/// Most records per second that a Net F/T box sends.
const BOX_RATE_MAX_HZ: f64 = 7000.0;

impl SensorConfig {
    /// Records per second that the cell file asks for; `None` if the box keeps its own setting.
    pub fn rate_stated_hz(&self) -> Option<f64> {
        (self.rate_hz > 0.0).then_some(self.rate_hz)
    }

    /// Most records per second that may arrive: the stated rate, or what a box sends at most.
    pub fn rate_max_hz(&self) -> f64 {
        self.rate_stated_hz().unwrap_or(BOX_RATE_MAX_HZ)
    }

    /// Pose of the sensor on the flange.
    pub fn flange_from_sensor(&self) -> Pose<Flange, Sensor> {
        self.flange_from_sensor.pose()
    }

    /// Value of an e-Series' own sensor that is read; `None` with another driver.
    pub fn ur_reading(&self) -> Option<UrReading> {
        (self.driver == SensorDriver::Ur).then(|| self.ur.unwrap_or_default().reading)
    }

    pub(in crate::config) fn check(
        &self,
        checker: &Checker<'_>,
        robot: &RobotConfig,
    ) -> Result<(), ConfigError> {
        self.check_driver(checker, robot)?;
        check_port(checker, "sensor.rdt_port", self.rdt_port, self.port_offset)?;
        check_port(
            checker,
            "sensor.http_port",
            self.http_port,
            self.port_offset,
        )?;
        checker.require(
            self.rate_hz == 0.0 || (1.0..=BOX_RATE_MAX_HZ).contains(&self.rate_hz),
            "sensor.rate_hz",
            self.rate_hz,
            "0 (the rate that the box is set to) or from 1 to 7000 Hz",
        )?;
        checker.range(
            "sensor.buffer_records",
            f64::from(self.buffer_records),
            1.0..=40.0,
            "records",
        )?;
        checker.require(
            self.raw_rate_hz == 0.0 || (1.0..=7000.0).contains(&self.raw_rate_hz),
            "sensor.raw_rate_hz",
            self.raw_rate_hz,
            "0 (every record) or from 1 to 7000 Hz",
        )?;
        checker.require(
            self.tool_rate_hz == 0.0 || (1.0..=7000.0).contains(&self.tool_rate_hz),
            "sensor.tool_rate_hz",
            self.tool_rate_hz,
            "0 (1000 Hz) or from 1 to 7000 Hz",
        )?;
        // A filter above half the rate has no effect, and below 1 Hz the control loop cannot be
        // stable.
        checker.range(
            "sensor.filter_cutoff_hz",
            self.filter_cutoff_hz,
            1.0..=(0.45 * self.rate_max_hz()).max(1.0),
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
        for (key, value) in [
            ("sensor.zero_jump_max_n", self.zero_jump_max_n),
            ("sensor.zero_drift_n_per_min", self.zero_drift_n_per_min),
            ("sensor.zero_jump_max_nm", self.zero_jump_max_nm),
            ("sensor.zero_drift_nm_per_min", self.zero_drift_nm_per_min),
        ] {
            checker.range(key, value, 1e-4..=100.0, "")?;
        }
        checker.range("sensor.zero_share_max", self.zero_share_max, 0.01..=1.0, "")?;
        self.flange_from_sensor
            .check(checker, "sensor.flange_from_sensor")
    }

    /// The keys that depend on the driver.
    fn check_driver(&self, checker: &Checker<'_>, robot: &RobotConfig) -> Result<(), ConfigError> {
        checker.require(
            self.driver != SensorDriver::Netft || !self.address.is_empty(),
            "sensor.address",
            "\"\"",
            "a host name or an IP address of the Net F/T box; without a box, set sensor.driver to \"ur\" (sensor of an e-Series \
             arm) or \"topic\" (a WrenchStamped on the bus)",
        )?;
        if self.driver == SensorDriver::Netft {
            check_host(checker, "sensor.address", &self.address)?;
        }
        let driver = match self.driver {
            SensorDriver::Netft => "netft",
            SensorDriver::Ur => "ur",
            SensorDriver::Topic => "topic",
        };
        for (there, wanted, table) in [
            (
                self.ur.is_some(),
                SensorDriver::Ur,
                "\"ur\" where there is a table [sensor.ur]",
            ),
            (
                self.topic.is_some(),
                SensorDriver::Topic,
                "\"topic\" where there is a table [sensor.topic]",
            ),
        ] {
            let fits = !there || self.driver == wanted;
            checker.require(fits, "sensor.driver", format!("\"{driver}\""), table)?;
        }
        if self.driver == SensorDriver::Netft {
            return Ok(());
        }
        // The defaults are those of an ATI Gamma, with which another sensor would saturate
        // unnoticed.
        for (key, value) in [
            ("sensor.force_range_n", self.force_range_n),
            ("sensor.torque_range_nm", self.torque_range_nm),
        ] {
            checker.require(
                checker.states(key),
                key,
                format!("{value:?}"),
                "the range of this sensor, from its data sheet: a sensor other than a Net F/T has no default. For a UR5e: \
                 force_range_n = [50.0, 50.0, 50.0], torque_range_nm = [10.0, 10.0, 10.0]",
            )?;
        }
        match self.driver {
            SensorDriver::Ur => self.check_ur(checker, robot),
            _ => self.check_topic(checker),
        }
    }

    fn check_ur(&self, checker: &Checker<'_>, robot: &RobotConfig) -> Result<(), ConfigError> {
        checker.require(
            robot.driver == RobotDriver::Rtde,
            "sensor.driver",
            "\"ur\"",
            "\"netft\" or \"topic\" where robot.driver is not \"rtde\": a Franka publishes its own wrench",
        )?;
        let rate_hz = if robot.rate_hz > 0.0 {
            robot.rate_hz
        } else {
            UR_RATE_HZ
        };
        checker.require(
            self.rate_hz == rate_hz,
            "sensor.rate_hz",
            self.rate_hz,
            &format!("{rate_hz:.1}, the rate of the robot's packets (robot.rate_hz; 500 of an e-Series without it)"),
        )?;
        checker.require(
            self.flange_from_sensor == PoseConfig::default(),
            "sensor.flange_from_sensor",
            "a pose",
            "none with sensor.driver = \"ur\": this sensor measures at the flange. Remove the table",
        )
    }

    fn check_topic(&self, checker: &Checker<'_>) -> Result<(), ConfigError> {
        let allowed = "a topic's name without a leading / and without *, $, ?, #, and none that this service publishes \
                       (wrench/raw, wrench/tool, wrench/status) or its bridge (arm/): [sensor.topic] key = \"my_sensor/wrench\"";
        let key = self.topic.as_ref().map_or("", |topic| topic.key.as_str());
        let named = !key.is_empty()
            && !key.starts_with('/')
            && !key.ends_with('/')
            && !key.contains("//")
            && !key.contains(['*', '$', '?', '#'])
            && !key.starts_with("wrench/")
            && !key.starts_with("arm/");
        checker.require(named, "sensor.topic.key", format!("\"{key}\""), allowed)?;
        checker.require(
            self.rate_hz > 0.0,
            "sensor.rate_hz",
            self.rate_hz,
            "the rate at which the wrench arrives, from 1 to 7000 Hz: only a Net F/T box has a setting of its own",
        )?;
        let frame = self.topic.as_ref().map_or("", |topic| topic.frame.as_str());
        checker.require(
            frame.len() <= FRAME_BYTES_MAX,
            "sensor.topic.frame",
            format!("\"{frame}\""),
            "a frame_id of at most 32 bytes, or empty for any",
        )
    }
}

/// Longest `frame_id` of a message.
const FRAME_BYTES_MAX: usize = 32;
/// Rate of an e-Series' packets if the cell file states none, Hz.
const UR_RATE_HZ: f64 = 500.0;
