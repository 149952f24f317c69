//! What viewers show of a cell: `/tf`, `/tf_static`, `/joint_states`, `/robot_description` and
//! `/markers`; and where the tool presses ([`Pressed`]), and what dose that gives ([`dose`]).
//!
//! The controller service calls it from its side thread, about 20 times a second. The messages go
//! over the bus like all others, so that recordings and live viewers show the same.

mod config;
pub mod dose;
mod frames;
mod marks;
mod pressed;

use std::time::{Duration, Instant};

use tangent_mechanics::{Base, Pose, Tool, World};
use tangent_runtime::{Bus, BusError, Latest, Publisher};
use tangent_schemas::standard::{
    JointState, MarkerArray, PoseWithCovarianceStamped, StdString, TFMessage,
};
use tangent_schemas::tangent::{ArmState, ControlState, NormalEstimate, Request};
use tangent_schemas::topics::{self, queries};

pub use config::SceneConfig;
use frames::Frames;
use marks::{Marks, Seen};
pub use pressed::{COVER_RADIUS_M, Pressed, cover_radius_m, cross_axes};

/// Interval at which latched messages are published again, for readers that have missed them.
const AGAIN: Duration = Duration::from_secs(2);
/// Longest wait for the text of the task, which this process has itself.
const TASK_PATIENCE: Duration = Duration::from_millis(200);

/// Forms and publishes the messages for viewers.
pub struct Scene {
    bus: Bus,
    arm: Latest<ArmState>,
    control: Latest<ControlState>,
    base: Latest<PoseWithCovarianceStamped>,
    estimates: Vec<(String, Latest<NormalEstimate>)>,
    tf: Publisher<TFMessage>,
    tf_static: Publisher<TFMessage>,
    joints: Publisher<JointState>,
    description: Publisher<StdString>,
    markers: Publisher<MarkerArray>,
    urdf: StdString,
    frames: Frames,
    marks: Marks,
    /// Newest pose of the base; `None` until it is known.
    world_from_base: Option<Pose<World, Base>>,
    latched: Option<Instant>,
}

impl Scene {
    /// Subscribes to the states of the arm and of the controller, and to the estimates.
    ///
    /// # Errors
    /// The bus refused a topic.
    pub fn new(bus: &Bus, config: &SceneConfig) -> Result<Self, BusError> {
        let estimates = config.estimators.iter().map(|name| {
            let newest = bus.latest(&topics::estimate_normal(name))?;
            Ok((name.clone(), newest))
        });
        Ok(Self {
            bus: bus.clone(),
            arm: bus.latest(&topics::ARM_STATE)?,
            control: bus.latest(&topics::CONTROL_STATE)?,
            base: bus.latest(&topics::BASE_POSE)?,
            estimates: estimates.collect::<Result<_, BusError>>()?,
            tf: bus.publisher(&topics::TF)?,
            tf_static: bus.publisher(&topics::TF_STATIC)?,
            joints: bus.publisher(&topics::JOINT_STATES)?,
            description: bus.publisher(&topics::ROBOT_DESCRIPTION)?,
            markers: bus.publisher(&topics::MARKERS)?,
            urdf: StdString {
                data: config.urdf.clone(),
            },
            frames: Frames::new(config),
            marks: Marks::new(config.mounted.tip),
            world_from_base: (!config.base_required).then(Pose::identity),
            latched: None,
        })
    }

    /// Publishes the newest state, if there is a new one, and from time to time what does not
    /// change. Call it about 20 times a second.
    pub fn draw(&mut self, now: Instant) {
        let base_moved = self.take_base();
        let Some(arm) = self.arm.take_new().map(|arm| arm.message.clone()) else {
            return;
        };
        let stamp = arm.header.stamp.to_ns();
        if self.latched.is_none_or(|at| now >= at + AGAIN) {
            self.latched = Some(now);
            self.description.publish(&self.urdf);
            self.tf_static.publish(&self.frames.fixed(stamp));
        }
        self.joints.publish(&self.frames.joints(&arm));
        let Ok(base_from_tool) = Pose::<Base, Tool>::try_from(&arm.tool_pose) else {
            return;
        };
        let control = self.control.get().map(|c| c.message.clone());
        let mut tf = self.frames.links(stamp, &arm.q);
        match (base_moved, self.world_from_base) {
            // A platform states its pose with its own stamp.
            (Some(base_stamp), Some(pose)) => tf.push(frames::base(base_stamp, &pose)),
            (None, Some(pose)) if self.base.get().is_none() => tf.push(frames::base(stamp, &pose)),
            _ => {}
        }
        if let Some(control) = &control {
            tf.extend(frames::contact(stamp, &base_from_tool, &control.normal));
        }
        self.tf.publish(&TFMessage { transforms: tf });
        if let (Some(control), Some(world_from_base)) = (control, self.world_from_base) {
            self.learn_task(&control, &base_from_tool);
            let estimates = self.estimates.iter_mut();
            let estimates = estimates.filter_map(|(name, newest)| {
                Some((name.clone(), newest.take_new()?.message.clone()))
            });
            let markers = self.marks.draw(&Seen {
                now,
                stamp,
                base_from_tool,
                world_from_base,
                control,
                estimates: estimates.collect(),
            });
            self.markers.publish(&MarkerArray { markers });
        }
    }

    /// Takes a new pose of a moving base; returns its stamp.
    fn take_base(&mut self) -> Option<i64> {
        let said = &self.base.take_new()?.message;
        self.world_from_base = Some(Pose::try_from(&said.pose.pose).ok()?);
        Some(said.header.stamp.to_ns())
    }

    /// Reads the path of a task that has just been started.
    fn learn_task(&mut self, control: &ControlState, base_from_tool: &Pose<Base, Tool>) {
        if control.activation == 0 || !self.marks.is_new(control.activation) {
            return;
        }
        let request = Request {
            action: "show".into(),
            argument: String::new(),
        };
        let answer = self.bus.ask(queries::CONTROL_SHOW, &request, TASK_PATIENCE);
        let toml = answer.ok().filter(|answer| answer.done).and_then(|answer| {
            let data: serde_json::Value = serde_json::from_str(&answer.data).ok()?;
            Some(data["task_toml"].as_str()?.to_owned())
        });
        self.marks
            .begin(control.activation, toml.as_deref(), base_from_tool);
    }
}

#[cfg(test)]
mod tests;
