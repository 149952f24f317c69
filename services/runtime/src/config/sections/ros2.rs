//! `[ros2]`: what ROS 2 sees of the cell, and what it may send into it.

use serde::Deserialize;

use super::sensor::SensorDriver;
use super::zenoh::is_endpoint;
use crate::config::CellConfig;
use crate::config::check::Checker;
use crate::config::load::ConfigError;

/// Largest domain id for which ROS 2 works on every system.
const DOMAIN_MAX: u32 = 232;
/// Longest name of a topic in ROS 2, from which a key must leave room for the prefix.
const NAME_MAX: usize = 200;

/// A command that ROS 2 may send as a service call.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Ros2Command {
    /// Stops the task and retracts.
    Stop,
    /// Pauses the task: the arm then moves only to keep the force.
    Pause,
    /// Reports the task's state.
    Status,
    /// Continues a paused task; moves the arm.
    Resume,
    /// Starts a task; moves the arm.
    Start,
    /// Selects the estimator in use; turns the tool.
    Select,
    /// Sets the zero of the force.
    Tare,
}

/// `[ros2]`
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ros2Config {
    /// ROS 2 domain, as in `ROS_DOMAIN_ID`.
    pub domain_id: u32,
    /// First part of all names, without slashes; `None`: the cell's name, with `_` for `-`.
    pub prefix: Option<String>,
    /// Routers of the ROS 2 network, tried in turn; `None`: the cell's own router.
    pub connect: Option<Vec<String>>,
    /// Patterns of the cell's keys that are published, each under its own name.
    pub publish: Vec<String>,
    /// Whether `joint_states` is published, made from `arm/state`.
    pub joint_states: bool,
    /// Largest rate of each published topic, Hz; 0: every message.
    pub rate_max_hz: f64,
    /// Commands that are offered as services.
    pub commands: Vec<Ros2Command>,
    /// Topics of ROS 2 that are let in.
    pub inputs: Ros2Inputs,
}

/// `[ros2.inputs]`: absolute names of ROS 2 topics. The cell's key is that of the section which
/// reads the input.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Ros2Inputs {
    /// `geometry_msgs/msg/PoseWithCovarianceStamped`, published in the cell as `base/pose`.
    pub base_pose: Option<String>,
    /// `geometry_msgs/msg/WrenchStamped`, published in the cell as `sensor.topic.key`.
    pub wrench: Option<String>,
    /// `sensor_msgs/msg/Image`, published in the cell as `camera.topic`.
    pub image: Option<String>,
    /// `sensor_msgs/msg/CameraInfo`, published in the cell as `camera.info_topic`.
    pub camera_info: Option<String>,
}

impl Default for Ros2Config {
    fn default() -> Self {
        let publish = [
            "arm/state",
            "wrench/tool",
            "wrench/status",
            "estimate/*/normal",
            "estimate/*/object",
            "control/state",
            "health/*",
            "tf",
            "markers",
        ];
        Self {
            domain_id: 0,
            prefix: None,
            connect: None,
            publish: publish.map(str::to_owned).to_vec(),
            joint_states: true,
            rate_max_hz: 100.0,
            commands: vec![Ros2Command::Stop, Ros2Command::Pause, Ros2Command::Status],
            inputs: Ros2Inputs::default(),
        }
    }
}

/// Whether this is one part of a ROS 2 name: letters, digits and single `_`, no digit first.
fn is_name_part(part: &str) -> bool {
    let first = part.chars().next();
    first.is_some_and(|c| c.is_ascii_alphabetic() || c == '_')
        && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        && !part.contains("__")
}

/// Whether this is an absolute ROS 2 name, such as `/odom/base_pose`.
pub fn is_ros_name(name: &str) -> bool {
    name.len() <= NAME_MAX
        && name
            .strip_prefix('/')
            .is_some_and(|rest| rest.split('/').all(is_name_part))
}

impl Ros2Config {
    /// The first part of all names of a cell, without slashes.
    pub fn prefix_of(&self, cell: &str) -> String {
        if let Some(prefix) = &self.prefix {
            return prefix.clone();
        }
        let mut name = cell.replace('-', "_");
        while name.contains("__") {
            name = name.replace("__", "_");
        }
        if name.starts_with(|c: char| c.is_ascii_digit()) {
            name.insert_str(0, "cell_");
        }
        name
    }

    pub(in crate::config) fn check(
        &self,
        checker: &Checker<'_>,
        cell: &CellConfig,
    ) -> Result<(), ConfigError> {
        checker.require(
            self.domain_id <= DOMAIN_MAX,
            "ros2.domain_id",
            self.domain_id,
            &format!("a number from 0 to {DOMAIN_MAX}"),
        )?;
        if let Some(prefix) = &self.prefix {
            checker.require(
                is_name_part(prefix) && prefix.len() <= 32,
                "ros2.prefix",
                prefix,
                "1 to 32 letters, digits and single `_`, not beginning with a digit",
            )?;
        }
        self.check_network(checker, cell)?;
        let bad = self.publish.iter().find(|pattern| {
            pattern.is_empty()
                || pattern.split('/').any(str::is_empty)
                || pattern.contains(['$', '?', '#', '@'])
        });
        checker.require(
            bad.is_none(),
            "ros2.publish",
            format!("{:?}", self.publish),
            "keys of the cell, without a leading slash, as in \"estimate/*/normal\"",
        )?;
        checker.range("ros2.rate_max_hz", self.rate_max_hz, 0.0..=1000.0, "Hz")?;
        let twice = self.commands.iter().enumerate();
        let twice = twice.filter(|(i, one)| self.commands[..*i].contains(one));
        checker.require(
            twice.count() == 0,
            "ros2.commands",
            format!("{:?}", self.commands),
            "each command once",
        )?;
        self.check_inputs(checker, cell)
    }

    fn check_network(&self, checker: &Checker<'_>, cell: &CellConfig) -> Result<(), ConfigError> {
        let Some(connect) = &self.connect else {
            return Ok(());
        };
        let bad = connect
            .iter()
            .find(|e| !is_endpoint(e) || e.starts_with("tls/") || e.starts_with("quic/"));
        checker.require(
            bad.is_none() && !connect.is_empty(),
            "ros2.connect",
            format!("{connect:?}"),
            "a list of endpoints of the ROS 2 network's router, such as \"tcp/127.0.0.1:7448\"",
        )?;
        // The cell's router would refuse an unencrypted session with an error that names neither.
        let own = connect.iter().find(|e| cell.zenoh.connect.contains(e));
        checker.require(
            own.is_none() || cell.zenoh.tls.is_none(),
            "ros2.connect",
            format!("{connect:?}"),
            "a router other than the cell's, which requires certificates",
        )
    }

    fn check_inputs(&self, checker: &Checker<'_>, cell: &CellConfig) -> Result<(), ConfigError> {
        let inputs = &self.inputs;
        let has_camera = cell.camera.is_some();
        let has_info = cell.camera.as_ref().is_some_and(|c| c.info_topic.is_some());
        let named = [
            ("ros2.inputs.base_pose", &inputs.base_pose, true, ""),
            (
                "ros2.inputs.wrench",
                &inputs.wrench,
                cell.sensor.driver == SensorDriver::Topic,
                "nothing, unless sensor.driver = \"topic\": the cell's sensor service then reads it on sensor.topic.key",
            ),
            (
                "ros2.inputs.image",
                &inputs.image,
                has_camera,
                "nothing, unless there is a [camera]: its service then reads the images on camera.topic",
            ),
            (
                "ros2.inputs.camera_info",
                &inputs.camera_info,
                has_info,
                "nothing, unless camera.info_topic is set: the camera service then reads it there",
            ),
        ];
        for (key, topic, is_read, otherwise) in named {
            let Some(topic) = topic else { continue };
            checker.require(
                is_ros_name(topic),
                key,
                topic,
                "an absolute ROS 2 topic name, such as \"/odom/base_pose\"",
            )?;
            checker.require(is_read, key, topic, otherwise)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::testing::cell;

    #[test]
    fn no_command_that_moves_the_arm_is_offered_unless_it_is_listed() {
        let ros2 = cell("").unwrap().ros2;
        assert_eq!(
            ros2.commands,
            [Ros2Command::Stop, Ros2Command::Pause, Ros2Command::Status]
        );
        assert_eq!(ros2.inputs, Ros2Inputs::default());
        let ros2 = cell("[ros2]\ncommands = [\"start\"]").unwrap().ros2;
        assert_eq!(ros2.commands, [Ros2Command::Start]);
    }

    #[test]
    fn the_prefix_is_a_name_that_ros_accepts() {
        let ros2 = Ros2Config::default();
        for (cell, prefix) in [
            ("cell1", "cell1"),
            ("line-2--left", "line_2_left"),
            ("3", "cell_3"),
        ] {
            assert_eq!(ros2.prefix_of(cell), prefix);
            assert!(is_name_part(&ros2.prefix_of(cell)));
        }
    }

    #[test]
    fn what_cannot_work_is_refused_with_its_key() {
        for (given, key) in [
            ("domain_id = 233", "ros2.domain_id"),
            ("prefix = \"2nd\"", "ros2.prefix"),
            ("prefix = \"a/b\"", "ros2.prefix"),
            ("connect = []", "ros2.connect"),
            ("connect = [\"quic/a:1\"]", "ros2.connect"),
            ("publish = [\"/arm/state\"]", "ros2.publish"),
            ("rate_max_hz = -1.0", "ros2.rate_max_hz"),
            ("commands = [\"stop\", \"stop\"]", "ros2.commands"),
            ("commands = [\"jump\"]", "ros2.commands"),
            ("inputs = { base_pose = \"odom\" }", "ros2.inputs.base_pose"),
            ("inputs = { wrench = \"/ft\" }", "ros2.inputs.wrench"),
            ("inputs = { image = \"/image\" }", "ros2.inputs.image"),
            (
                "inputs = { camera_info = \"/info\" }",
                "ros2.inputs.camera_info",
            ),
            ("inputs = { odometry = \"/odom\" }", "odometry"),
            ("domain = 1", "ros2.domain"),
        ] {
            let error = cell(&format!("[ros2]\n{given}")).unwrap_err();
            assert!(error.contains(key), "{given}: {error}");
        }
    }
}
