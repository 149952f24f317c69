//! Publishes for 3-D viewers: frames on `tf` (the moving base's frame in the world too), arrows and
//! the path on `markers`, a few times a second from a side thread.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use tangent_control::Phase;
use tangent_mechanics::{Base, Pose, Tool, World};
use tangent_runtime::{Bus, BusError, Latest, Publisher};
use tangent_schemas::standard::{
    ColorRGBA, Header, Marker, MarkerArray, Point, PoseWithCovarianceStamped, TFMessage, Transform,
    TransformStamped,
};
use tangent_schemas::tangent::{ArmState, ControlState};
use tangent_schemas::{convert::cut, topics};

/// Number of path points kept for drawing.
const TRACE: usize = 2000;
/// Minimum distance between two stored points, m.
const TRACE_STEP_M: f64 = 0.001;
/// Length of an arrow per newton, m.
const METRES_PER_N: f64 = 0.02;
/// Length of the normal's arrow, m.
const NORMAL_M: f64 = 0.08;

/// Publisher of frames and markers.
pub struct Viewer {
    arm: Latest<ArmState>,
    control: Latest<ControlState>,
    base: Latest<PoseWithCovarianceStamped>,
    tf: Publisher<TFMessage>,
    markers: Publisher<MarkerArray>,
    trace: VecDeque<Point>,
    activation: u64,
}

impl Viewer {
    /// Subscribes to the state of the arm and of the controller.
    pub fn new(bus: &Bus) -> Result<Self, BusError> {
        Ok(Self {
            arm: bus.latest(&topics::ARM_STATE)?,
            control: bus.latest(&topics::CONTROL_STATE)?,
            base: bus.latest(&topics::BASE_POSE)?,
            tf: bus.publisher(&topics::TF)?,
            markers: bus.publisher(&topics::MARKERS)?,
            trace: VecDeque::new(),
            activation: 0,
        })
    }

    /// Publishes the newest state, if there is a new one.
    pub fn draw(&mut self) {
        let Some(arm) = self.arm.take_new().map(|a| a.message.clone()) else {
            return;
        };
        let Ok(base_from_tool) = Pose::<Base, Tool>::try_from(&arm.tool_pose) else {
            return;
        };
        let stamp = arm.header.stamp.to_ns();
        let control = self.control.get().map(|c| c.message.clone());
        let mut transforms = vec![transform(stamp, "base", "tool", (&base_from_tool).into())];
        transforms.extend(self.base_in_world());
        if let Some(control) = &control {
            let normal = Vector3::from(&control.normal);
            if let Some(contact) = contact_frame(&base_from_tool, &normal) {
                transforms.push(transform(stamp, "base", "contact", contact));
            }
            let markers = self.draw_control(stamp, &base_from_tool, control);
            self.markers.publish(&MarkerArray { markers });
        }
        self.tf.publish(&TFMessage { transforms });
    }

    /// Pose from the platform with its own stamp; `None` if there is no new one.
    fn base_in_world(&mut self) -> Option<TransformStamped> {
        let said = &self.base.take_new()?.message;
        let world_from_base = Pose::<World, Base>::try_from(&said.pose.pose).ok()?;
        let stamp = said.header.stamp.to_ns();
        Some(transform(stamp, "world", "base", (&world_from_base).into()))
    }

    fn draw_control(
        &mut self,
        stamp: i64,
        base_from_tool: &Pose<Base, Tool>,
        control: &ControlState,
    ) -> Vec<Marker> {
        let at = base_from_tool.translation();
        if control.activation != self.activation {
            self.activation = control.activation;
            self.trace.clear();
        }
        if control.phase == Phase::Slide as u8 {
            let far = self
                .trace
                .back()
                .is_none_or(|last| (Vector3::from(last) - at).norm() >= TRACE_STEP_M);
            if far {
                if self.trace.len() == TRACE {
                    self.trace.pop_front();
                }
                self.trace.push_back((&at).into());
            }
        }
        let normal = Vector3::from(&control.normal);
        let force = base_from_tool.rotate(&Vector3::from(&control.wrench.force));
        let mut markers = vec![
            arrow(stamp, "normal", at, normal * NORMAL_M, [0.1, 0.4, 1.0]),
            arrow(stamp, "force", at, force * METRES_PER_N, [1.0, 0.3, 0.1]),
        ];
        if self.trace.len() >= 2 {
            let mut path = marker(stamp, "path", 4, [0.2, 0.8, 0.3]);
            path.scale.x = 0.003;
            path.points = self.trace.iter().cloned().collect();
            markers.push(path);
        }
        markers
    }
}

fn transform(stamp: i64, parent: &str, child: &str, transform: Transform) -> TransformStamped {
    TransformStamped {
        header: Header::new(stamp, parent),
        child_frame_id: cut(child),
        transform,
    }
}

/// Frame with its origin at the tool, z along the normal, and x as near as possible to the tool's
/// x.
fn contact_frame(base_from_tool: &Pose<Base, Tool>, normal: &Vector3<f64>) -> Option<Transform> {
    let x = base_from_tool.rotate(&Vector3::x());
    let x = (x - normal * x.dot(normal)).try_normalize(1e-6)?;
    let z = normal.try_normalize(1e-6)?;
    let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
    let pose = Pose::<Base, Tool>::new(
        base_from_tool.translation(),
        UnitQuaternion::from_rotation_matrix(&axes),
    );
    Some((&pose).into())
}

fn marker(stamp: i64, name: &str, kind: i32, [r, g, b]: [f32; 3]) -> Marker {
    let mut marker = Marker {
        header: Header::new(stamp, "base"),
        ns: cut(name),
        r#type: kind,
        color: ColorRGBA { r, g, b, a: 1.0 },
        ..Marker::default()
    };
    marker.pose.orientation.w = 1.0;
    marker
}

fn arrow(
    stamp: i64,
    name: &str,
    from: Vector3<f64>,
    along: Vector3<f64>,
    color: [f32; 3],
) -> Marker {
    let mut arrow = marker(stamp, name, 0, color);
    arrow.scale.x = 0.004;
    arrow.scale.y = 0.009;
    arrow.points = vec![(&from).into(), (&(from + along)).into()];
    arrow
}
