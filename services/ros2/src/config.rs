//! Settings of the service, from the cell file.

use tangent_runtime::CellConfig;
use tangent_runtime::config::{Ros2Command, ZenohConfig};

use crate::Ros2Error;

/// What an input of ROS 2 is to the cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKind {
    /// Pose of a moving base.
    BasePose,
    /// Reading of a force/torque sensor.
    Wrench,
    /// Image of the wrist camera.
    Image,
    /// Calibration of the wrist camera.
    CameraInfo,
}

/// A topic of ROS 2 that is let in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Input {
    /// What it is.
    pub kind: InputKind,
    /// Absolute name in ROS 2.
    pub topic: String,
    /// Key in the cell.
    pub key: String,
}

/// Settings of [`crate::run`].
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Domain of ROS 2.
    pub domain: u32,
    /// First part of all names, without slashes.
    pub prefix: String,
    /// Routers of the ROS 2 network.
    pub connect: Vec<String>,
    /// Other settings of the network.
    pub zenoh: ZenohConfig,
    /// Patterns of the keys that are published.
    pub publish: Vec<String>,
    /// Names of the joints, if `joint_states` is published.
    pub joints: Option<Vec<String>>,
    /// Largest rate of each topic, Hz; 0: every message.
    pub rate_max_hz: f64,
    /// Commands that are offered.
    pub commands: Vec<Ros2Command>,
    /// Topics that are let in.
    pub inputs: Vec<Input>,
}

impl Config {
    /// Settings from the cell file; `joints` are the names of the arm's joints.
    ///
    /// # Errors
    /// The cell's network has certificates, and `ros2.connect` is missing.
    pub fn from_cell(cell: &CellConfig, joints: &[String]) -> Result<Self, Ros2Error> {
        let ros2 = &cell.ros2;
        let connect = match &ros2.connect {
            Some(connect) => connect.clone(),
            None if cell.zenoh.tls.is_some() => return Err(Ros2Error::NoNetwork),
            None => cell.zenoh.connect.clone(),
        };
        let named = &ros2.inputs;
        let base = Some("base/pose".to_owned());
        let wrench = cell.sensor.topic.as_ref().map(|topic| topic.key.clone());
        let image = cell.camera.as_ref().map(|camera| camera.topic.clone());
        let info = cell.camera.as_ref().and_then(|c| c.info_topic.clone());
        let inputs = [
            (InputKind::BasePose, &named.base_pose, base),
            (InputKind::Wrench, &named.wrench, wrench),
            (InputKind::Image, &named.image, image),
            (InputKind::CameraInfo, &named.camera_info, info),
        ];
        let inputs = inputs.into_iter().filter_map(|(kind, topic, key)| {
            Some(Input {
                kind,
                topic: topic.clone()?,
                key: key?,
            })
        });
        Ok(Self {
            domain: ros2.domain_id,
            prefix: ros2.prefix_of(&cell.cell.name),
            connect,
            zenoh: cell.zenoh.clone(),
            publish: ros2.publish.clone(),
            joints: ros2.joint_states.then(|| joints.to_vec()),
            rate_max_hz: ros2.rate_max_hz,
            commands: ros2.commands.clone(),
            inputs: inputs.collect(),
        })
    }
}
