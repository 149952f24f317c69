//! Every topic of a cell as a typed value: key, message and delivery. Keys are relative to the
//! cell's namespace.

use std::borrow::Cow;
use std::marker::PhantomData;

use crate::Message;
use crate::standard::{
    CameraInfo, Image, JointState, MarkerArray, PoseStamped, PoseWithCovarianceStamped, StdString,
    TFMessage, WrenchStamped,
};
use crate::tangent::{
    ArmCommand, ArmState, ContactTruth, ControlState, CoverageState, FeatureArray, Health,
    NormalEstimate, ObjectEstimate, OperatorCommand, ShapingState, SurfaceAhead, SurfaceSegment,
    WrenchStatus,
};

/// How a topic is sent to other processes. Within a process, every message is delivered in the
/// sender's thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Delivery {
    /// Inputs of the control loop: highest priority, sent at once, the oldest dropped under
    /// congestion.
    RealTime,
    /// Measurements and states at a steady rate: dropped under congestion, as a newer one follows.
    Stream,
    /// Images and other data too large for one packet: after the measurements, the oldest dropped
    /// under congestion.
    Bulk,
    /// For people and recorders: may wait for everything else.
    Background,
}

/// How many publishers the readers of a topic accept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sources {
    /// Any number.
    Any,
    /// One at a time, as for a safety input. Readers refuse a second one.
    One,
    /// One at a time, chosen by the lease of the reader.
    Leased,
}

/// A key, its message type, and how it is sent. A key with `*` can be read, not published.
#[derive(Debug)]
pub struct Topic<M> {
    key: Cow<'static, str>,
    delivery: Delivery,
    message: PhantomData<fn() -> M>,
}

impl<M: Message> Topic<M> {
    /// A topic with a key known at compile time.
    pub const fn new(key: &'static str, delivery: Delivery) -> Self {
        Self {
            key: Cow::Borrowed(key),
            delivery,
            message: PhantomData,
        }
    }

    /// A topic whose key is composed at run time.
    pub fn named(key: String, delivery: Delivery) -> Self {
        Self {
            key: Cow::Owned(key),
            delivery,
            message: PhantomData,
        }
    }

    /// The key, relative to the cell's namespace.
    pub fn key(&self) -> &str {
        &self.key
    }

    /// How the topic is sent.
    pub fn delivery(&self) -> Delivery {
        self.delivery
    }

    /// How many publishers the readers accept.
    pub fn sources(&self) -> Sources {
        match self.key() {
            "arm/command" => Sources::Leased,
            // The sensor service uses `control/state` to decide whether the tool may touch
            // something.
            "arm/state" | "arm/wrench" | "base/pose" | "control/state" => Sources::One,
            key if key.starts_with("wrench/") => Sources::One,
            _ => Sources::Any,
        }
    }

    /// ROS 2 name of the message, `PACKAGE/msg/NAME`.
    pub fn message_name(&self) -> &'static str {
        M::NAME
    }

    /// Topic with its key as seen from outside any cell: `CELL/KEY`. `*` means every cell.
    pub fn of_cell(&self, cell: &str) -> Self {
        Self::named(format!("{cell}/{}", self.key), self.delivery)
    }
}

impl<M> Clone for Topic<M> {
    fn clone(&self) -> Self {
        Self {
            key: self.key.clone(),
            delivery: self.delivery,
            message: PhantomData,
        }
    }
}

/// State of the arm; once per robot packet, by its bridge.
pub static ARM_STATE: Topic<ArmState> = Topic::new("arm/state", Delivery::RealTime);
/// Command of the controller to the arm, one per `arm/state`.
pub static ARM_COMMAND: Topic<ArmCommand> = Topic::new("arm/command", Delivery::RealTime);
/// Force that the arm itself feels: what the environment does to the flange, at the flange, flange
/// axes, N and Nm. Once per robot packet, just before `arm/state` and with its stamp, by a bridge
/// whose arm states one. With `sensor.driver = "ur"` it is the reading of the arm's own sensor,
/// before any zero; otherwise a second witness of contact, without the weight of the tool, and from
/// a CB3 arm an estimate from the currents of its motors, whose torque is about the tool centre
/// point set on the robot.
pub static ARM_WRENCH: Topic<WrenchStamped> = Topic::new("arm/wrench", Delivery::RealTime);
/// Records of the sensor, sensor axes, SI units; up to 7 kHz, by `netft`.
pub static WRENCH_RAW: Topic<WrenchStamped> = Topic::new("wrench/raw", Delivery::Stream);
/// Conditioned wrench at the tool, tool axes. Use it only if its status is valid.
pub static WRENCH_TOOL: Topic<WrenchStamped> = Topic::new("wrench/tool", Delivery::RealTime);
/// Validity of the wrench with the same stamp; published just before it.
pub static WRENCH_STATUS: Topic<WrenchStatus> = Topic::new("wrench/status", Delivery::RealTime);
/// Pose of the arm's base in the world, by the mobile platform under it. Not published for a fixed
/// base.
pub static BASE_POSE: Topic<PoseWithCovarianceStamped> =
    Topic::new("base/pose", Delivery::RealTime);
/// Images of the wrist camera, for viewers and recordings, at the rate that the camera service is
/// set to.
pub static CAMERA_IMAGE: Topic<Image> = Topic::new("camera/image", Delivery::Bulk);
/// Depth images, 16UC1 in mm or 32FC1 in m, as delivered by the camera's driver.
pub static CAMERA_DEPTH: Topic<Image> = Topic::new("camera/depth", Delivery::Bulk);
/// Stated calibration of the camera.
pub static CAMERA_INFO: Topic<CameraInfo> = Topic::new("camera/info", Delivery::Background);
/// Features found in each image.
pub static CAMERA_FEATURES: Topic<FeatureArray> = Topic::new("camera/features", Delivery::Stream);
/// Images of the simulated camera, in the form that its driver would deliver.
pub static SIMULATED_IMAGE: Topic<Image> = Topic::new("simulator/image", Delivery::Bulk);
/// State of the controller and its reasons; once per cycle.
pub static CONTROL_STATE: Topic<ControlState> = Topic::new("control/state", Delivery::Stream);
/// How the law adapts stiffness and force; once per cycle, by laws that do.
pub static CONTROL_SHAPING: Topic<ShapingState> = Topic::new("control/shaping", Delivery::Stream);
/// What a task with `[coverage]` has covered; after each round.
pub static CONTROL_COVERAGE: Topic<CoverageState> =
    Topic::new("control/coverage", Delivery::Background);
/// True state of the simulated contact. The system under test never reads it.
pub static TRUTH_CONTACT: Topic<ContactTruth> = Topic::new("truth/contact", Delivery::Stream);
/// True pose of the simulated object.
pub static TRUTH_OBJECT: Topic<PoseStamped> = Topic::new("truth/object", Delivery::Stream);
/// Commands of people on the operator's page, each with its outcome, by `ui`.
pub static OPERATOR_COMMAND: Topic<OperatorCommand> =
    Topic::new("operator/command", Delivery::Background);
/// Transforms between frames that move, for viewers.
pub static TF: Topic<TFMessage> = Topic::new("tf", Delivery::Background);
/// Transforms between frames that are fixed to each other, for viewers; see [`is_latched`].
pub static TF_STATIC: Topic<TFMessage> = Topic::new("tf_static", Delivery::Background);
/// Positions and velocities of the joints by name, for viewers.
pub static JOINT_STATES: Topic<JointState> = Topic::new("joint_states", Delivery::Background);
/// URDF of the arm with sensor, tool and camera, for viewers; see [`is_latched`].
pub static ROBOT_DESCRIPTION: Topic<StdString> =
    Topic::new("robot_description", Delivery::Background);
/// What viewers draw: normals with their uncertainty, the force, paths, and the surface touched and
/// covered.
pub static MARKERS: Topic<MarkerArray> = Topic::new("markers", Delivery::Background);
/// Normals of all estimators (read only).
pub static ESTIMATE_NORMALS: Topic<NormalEstimate> =
    Topic::new("estimate/*/normal", Delivery::RealTime);
/// Health of all services (read only).
pub static HEALTHS: Topic<Health> = Topic::new("health/*", Delivery::Background);

/// Normals from one estimator: `estimate/NAME/normal`.
pub fn estimate_normal(estimator: &str) -> Topic<NormalEstimate> {
    Topic::named(format!("estimate/{estimator}/normal"), Delivery::RealTime)
}

/// Poses of an object from one estimator: `estimate/NAME/object`.
pub fn estimate_object(estimator: &str) -> Topic<ObjectEstimate> {
    Topic::named(format!("estimate/{estimator}/object"), Delivery::RealTime)
}

/// Surface segment under the tool from one estimator: `estimate/NAME/segment`, before the normal of
/// the same image.
pub fn estimate_segment(estimator: &str) -> Topic<SurfaceSegment> {
    Topic::named(format!("estimate/{estimator}/segment"), Delivery::RealTime)
}

/// Surface ahead of the tool from one estimator: `estimate/NAME/ahead`, before the normal of the
/// same image.
pub fn estimate_ahead(estimator: &str) -> Topic<SurfaceAhead> {
    Topic::named(format!("estimate/{estimator}/ahead"), Delivery::RealTime)
}

/// Whether the newest message of a key holds until the next one, however old it is: recordings
/// begin with it, and it is sent to every viewer that connects. It is published again every few
/// seconds.
pub fn is_latched(key: &str) -> bool {
    key == TF_STATIC.key() || key == ROBOT_DESCRIPTION.key()
}

/// Health of one service: `health/SERVICE`.
pub fn health(service: &str) -> Topic<Health> {
    Topic::named(format!("health/{service}"), Delivery::Background)
}

/// Keys of queries, each from a [`crate::tangent::Request`] to a [`crate::tangent::Answer`].
pub mod queries {
    use super::Delivery;

    /// How a request is sent: one that brings the arm to rest before all measurements, every other
    /// one with them.
    pub fn delivery(key: &str, action: &str) -> Delivery {
        if key.ends_with("/stop") || matches!(action, "stop" | "pause") {
            Delivery::RealTime
        } else {
            Delivery::Stream
        }
    }

    /// `start` (argument: a task as TOML), `pause`, `resume`, `stop`, `status`.
    pub const CONTROL_TASK: &str = "control/task";
    /// Text of the last task started. It has its own key, as the right to read differs from the
    /// right to start.
    pub const CONTROL_SHOW: &str = "control/show";
    /// Stops the task and retracts; needs no argument.
    pub const CONTROL_STOP: &str = "control/stop";
    /// `select` (argument: an estimator's name).
    pub const CONTROL_SELECT: &str = "control/select";
    /// `tare`: averages the reading of the unloaded sensor and subtracts it.
    pub const NETFT_TARE: &str = "netft/tare";

    /// `ping`: an instance of a service answers with its clock time.
    pub fn ping(service: &str, instance: &str) -> String {
        format!("ping/{service}/{instance}")
    }

    /// One live parameter: `get`, or `set` (argument: a number).
    pub fn parameter(service: &str, name: &str) -> String {
        format!("param/{service}/{name}")
    }

    /// All parameters of one service that can be set.
    pub fn settable(service: &str) -> String {
        format!("param/{service}/*")
    }

    /// List of all parameters of one service, or of all services with `*`. It has its own key, as
    /// the right to read differs from the right to set.
    pub fn parameters(service: &str) -> String {
        format!("parameters/{service}")
    }
}

/// Service part of an estimator's own liveliness token, `alive/estimate/NAME/INSTANCE`: it shows
/// who publishes these normals.
pub fn estimator_service(estimator: &str) -> String {
    format!("estimate/{estimator}")
}

/// Key of a service's liveliness token: `alive/SERVICE/INSTANCE`.
pub fn alive(service: &str, instance: &str) -> String {
    format!("alive/{service}/{instance}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_those_of_the_documentation() {
        assert_eq!(ARM_STATE.key(), "arm/state");
        assert_eq!(estimate_normal("blend").key(), "estimate/blend/normal");
        assert_eq!(health("netft").of_cell("cell1").key(), "cell1/health/netft");
        for topic in [&WRENCH_TOOL, &WRENCH_RAW] {
            assert_eq!(topic.sources(), Sources::One);
        }
        assert_eq!(ARM_STATE.sources(), Sources::One);
        assert_eq!(ARM_WRENCH.sources(), Sources::One);
        assert_eq!(CONTROL_STATE.sources(), Sources::One);
        assert_eq!(ARM_COMMAND.sources(), Sources::Leased);
        assert_eq!(ESTIMATE_NORMALS.sources(), Sources::Any);
        assert!(is_latched("tf_static") && is_latched("robot_description"));
        assert!(!is_latched("tf") && !is_latched("joint_states"));
        assert_eq!(
            WRENCH_TOOL.message_name(),
            "geometry_msgs/msg/WrenchStamped"
        );
    }
}
