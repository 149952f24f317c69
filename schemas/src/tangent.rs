//! The project's own messages, `tangent_msgs/msg/*`. Each has its `.msg` file under `msg/`.

use serde::{Deserialize, Serialize};

use crate::covariance::Covariance;
use crate::standard::{Header, Point, Pose, Twist, Vector3, Wrench};
use crate::{EstimatorArray, JointArray, Name, RoundArray, Text, message};

message! {
    /// State of the arm. Published once per robot packet.
    pub struct ArmState: "tangent_msgs/msg/ArmState" {
        /// Time of measurement on the bridge's host; frame `base`.
        pub header: Header,
        /// Number of robot packets since the bridge started.
        pub cycle: u64,
        /// The robot's own clock, s.
        pub robot_time_s: f64,
        /// Nominal time between packets, s.
        pub period_s: f64,
        /// Measured joint positions, rad.
        pub q: JointArray,
        /// Measured joint velocities, rad/s.
        pub qd: JointArray,
        /// Target joint velocities of the robot's own controller, rad/s.
        pub qd_target: JointArray,
        /// `base_from_tool`, computed from the cell's arm model and TCP.
        pub tool_pose: Pose,
        /// Velocity of the tool's origin, base axes, m/s and rad/s.
        pub tool_twist: Twist,
        /// RTDE `robot_mode`.
        pub robot_mode: i32,
        /// RTDE `safety_mode`.
        pub safety_mode: i32,
        /// RTDE `runtime_state`.
        pub runtime_state: u32,
        /// State of the bridge's program on the robot (output integer register B+0); 255 if it is
        /// absent.
        pub program_state: u8,
        /// Reason why the bridge's program last stopped (output integer register B+4).
        pub stop_cause: u8,
        /// Whether a command of a new activation would move the arm now.
        pub ready: bool,
        /// Reason for not being ready, in words; empty when ready.
        pub not_ready_reason: Text,
        /// Speed scaling in use, 0 to 1: product of limiter and slider.
        pub speed_scaling: f64,
        /// Age of the newest command that the robot has used, s: from sending the sequence to its
        /// use.
        pub command_latency_s: f64,
        /// Cycle of the last accepted command.
        pub command_cycle_accepted: u64,
        /// Number of commands rejected since the start, and the reason for the last rejection.
        pub commands_refused: u64,
        pub refusal_reason: Text,
        /// Activation that is latched out: commands with this activation or an older one do not
        /// move the arm.
        pub activation_latched: u64,
        /// Number of robot packets lost since the start, from the robot's own clock.
        pub packets_lost: u64,
        /// Time from a robot packet's arrival to sending the command, last cycle, s.
        pub packet_to_command_s: f64,
        /// Number of cycles in which a command was due but no new one was available.
        pub missed_cycles: u64,
        /// Source that holds the lease, `SERVICE/INSTANCE`; empty without one, "a source without a
        /// name" for one that states none.
        pub commanded_by: Name,
        /// Identifier of the publisher that holds the lease; all zero without one.
        pub commander_id: [u8; 16],
    }
}

message! {
    /// Command of the controller for one cycle of the arm.
    pub struct ArmCommand: "tangent_msgs/msg/ArmCommand" {
        pub header: Header,
        /// `ArmState.cycle` to which the command responds.
        pub cycle: u64,
        /// Number of a [`crate::CommandKind`]: 0 hold, 1 joint velocity, 2 joint torque, 3 soft
        /// stop.
        pub kind: u8,
        /// Joint velocities (rad/s) or joint torques (Nm), base to flange.
        pub values: JointArray,
        /// Bound on joint acceleration for this cycle, rad/s².
        pub acceleration: f64,
        /// Source of the command, `SERVICE/INSTANCE`.
        pub source: Name,
        /// Number of the task start that the command belongs to. After a fault, the bridge moves
        /// the arm only for a newer activation.
        pub activation: u64,
    }
}

message! {
    /// Validity of a wrench. It has the same stamp as the wrench and is published just before it.
    pub struct WrenchStatus: "tangent_msgs/msg/WrenchStatus" {
        pub header: Header,
        /// Validity code (0 valid, 1 missing, 2 stale, 3 saturated, 4 not finite, 5 sensor error,
        /// 11 frozen, 12 axis stuck, 13 does not answer to motion, 14 implausible, 15 points along
        /// the surface, 16 zero jumped).
        pub validity: u8,
        /// Status word of the sensor, and its bits in words.
        pub status: u32,
        pub status_text: Text,
        pub rdt_sequence: u32,
        pub ft_sequence: u32,
        /// Counts since the service started.
        pub records: u64,
        pub records_lost: u64,
        pub records_out_of_order: u64,
        pub restarts: u64,
        pub reconnects: u64,
        /// Measured rate of the sensor, Hz.
        pub rate_hz: f64,
        /// Age of the tare, s; negative before the first tare.
        pub bias_age_s: f64,
        /// Bias that is subtracted, sensor axes, N and Nm.
        pub bias: Wrench,
        /// Delay of the filter at low frequency, s.
        pub filter_delay_s: f64,
        /// Residual of the clock recovery, s rms.
        pub clock_residual_s: f64,
        /// Records left out since the service started, because they jump as no load can.
        pub records_implausible: u64,
        /// Axes whose reading does not change: bit 0 is Fx, bit 5 is Tz; all axes if the sensor is
        /// frozen.
        pub stuck_axes: u8,
        /// Filtered reading before the zero is subtracted, without the payload: frame of `bias`.
        pub untared: Wrench,
        /// Zero from which the limit on `untared` is measured: the last zero that a motion has
        /// shown to be free of load. Frame of `bias`; meaningless while `reference_age_s` is
        /// negative.
        pub reference: Wrench,
        /// Age of `reference`, s; negative if there is none.
        pub reference_age_s: f64,
        /// Largest share of the sensor's range that `untared` takes in any axis; negative if the
        /// range is unknown.
        pub rated_share: f64,
        /// Error of the zero due to its age and the sensor's stated drift, N; negative before the
        /// first tare.
        pub bias_bound_n: f64,
        /// Whether the zero was taken because an operator stated that the tool hangs free (`tangent
        /// tare --clear`), without a check.
        pub bias_said_clear: bool,
    }
}

message! {
    /// Surface normal from one estimator.
    pub struct NormalEstimate: "tangent_msgs/msg/NormalEstimate" {
        /// Time of the measurement that the estimate is based on; frame `base`.
        pub header: Header,
        /// `ArmState.cycle` that the estimate is based on.
        pub cycle: u64,
        pub estimator: Name,
        /// Contact point, m.
        pub point: Point,
        /// Unit normal, out of the material.
        pub normal: Vector3,
        /// Covariance of `normal`, row-major, base axes, rad².
        pub covariance: [f64; 9],
        /// 0 if valid; otherwise the reason, as a code and in words.
        pub validity: u8,
        pub reason: Text,
        /// Friction coefficient; negative while unknown.
        pub friction: f64,
        /// Shape operator, row-major, base axes, 1/m; all zero while unknown.
        pub curvature: [f64; 9],
        /// Duration of one update, s.
        pub update_s: f64,
    }
}

message! {
    /// One labelled point in an image.
    pub struct Feature: "tangent_msgs/msg/Feature" {
        /// Number of the point on the target.
        pub id: u32,
        /// Column and row, pixels; the middle of the first pixel is (0, 0).
        pub u: f64,
        pub v: f64,
    }
}

message! {
    /// Consecutive wrenches of one publisher, as stored in a recording: one message in place of
    /// hundreds of small ones. It is not published.
    ///
    /// Every array has one element per wrench. A wrench is its integers times the steps, in the
    /// axes of the header's frame.
    pub struct WrenchBatch: "tangent_msgs/msg/WrenchBatch" {
        /// Time and frame of the first wrench.
        pub header: Header,
        /// The publisher's sequence number of the first wrench; the others follow without a gap.
        pub sequence: u32,
        /// Time of receipt of the first wrench, ns since the Unix epoch.
        pub received_ns: u64,
        /// Time since the previous wrench, ns; 0 for the first.
        pub stamp_step_ns: Vec<i32>,
        /// Time since the receipt of the previous wrench, ns; 0 for the first.
        pub received_step_ns: Vec<i32>,
        /// Time from the wrench to its publication, ns.
        pub published_after_ns: Vec<i32>,
        /// Unit of the integer forces, N.
        pub force_step_n: f64,
        /// Unit of the integer torques, Nm.
        pub torque_step_nm: f64,
        /// Force along x, in force steps.
        pub force_x: Vec<i32>,
        /// Force along y, in force steps.
        pub force_y: Vec<i32>,
        /// Force along z, in force steps.
        pub force_z: Vec<i32>,
        /// Torque about x, in torque steps.
        pub torque_x: Vec<i32>,
        /// Torque about y, in torque steps.
        pub torque_y: Vec<i32>,
        /// Torque about z, in torque steps.
        pub torque_z: Vec<i32>,
    }
}

message! {
    /// Points found in one image.
    pub struct FeatureArray: "tangent_msgs/msg/FeatureArray" {
        /// Time of exposure; frame `camera`.
        pub header: Header,
        /// Number of images since the service started, including those without any point.
        pub sequence: u64,
        /// Points found; missing points are left out.
        pub features: Vec<Feature>,
        /// Duration of the detection, s.
        pub detect_s: f64,
    }
}

message! {
    /// Pose of an object of known shape, from one estimator.
    pub struct ObjectEstimate: "tangent_msgs/msg/ObjectEstimate" {
        /// Time of the measurement that the estimate is based on; frame `base`.
        pub header: Header,
        /// `ArmState.cycle` that the estimate is based on.
        pub cycle: u64,
        pub estimator: Name,
        /// `base_from_object`.
        pub pose: Pose,
        /// Velocity of the object's origin, base axes, m/s and rad/s.
        pub twist: Twist,
        /// Covariance of the pose, row-major; x, y, z (m), then small rotations about the base's
        /// axes (rad).
        pub covariance: Covariance,
        /// 0 if valid; otherwise the reason, as a code and in words.
        pub validity: u8,
        pub reason: Text,
        /// Age of the newest camera frame that was used, s; negative without one.
        pub vision_age_s: f64,
        /// Whether the tool touches the object, according to the estimator, and the force along the
        /// normal, N.
        pub in_contact: bool,
        pub force_n: f64,
        /// Duration of one update, s.
        pub update_s: f64,
    }
}

message! {
    /// Principal components of the surface segment under the tool, as seen by a camera. The
    /// orientation of a segment is nearly constant.
    pub struct SurfaceSegment: "tangent_msgs/msg/SurfaceSegment" {
        /// Time of the arm state at exposure; frame `base`.
        pub header: Header,
        /// `ArmState.cycle` at exposure.
        pub cycle: u64,
        pub estimator: Name,
        /// Mean of the segment's points, m.
        pub middle: Point,
        /// Direction of least spread, unit vector, out of the material.
        pub normal: Vector3,
        /// Least eigenvalue of the points' covariance, divided by the sum of all three: 0 for a
        /// flat segment.
        pub surface_variation: f64,
    }
}

message! {
    /// The surface ahead of the tool, as seen by a camera. Each list has one entry per station,
    /// starting at the tool.
    pub struct SurfaceAhead: "tangent_msgs/msg/SurfaceAhead" {
        /// Time of the arm state at exposure; frame `base`.
        pub header: Header,
        /// `ArmState.cycle` at exposure.
        pub cycle: u64,
        pub estimator: Name,
        /// Distance from the tool along the surface, m.
        pub distance: Vec<f64>,
        /// Points on the surface, m.
        pub points: Vec<Point>,
        /// Unit normals, out of the material.
        pub normals: Vec<Vector3>,
        /// Curvature along the direction of travel, 1/m, positive where the surface falls away, and
        /// its standard deviation.
        pub bend: Vec<f64>,
        pub bend_sd: Vec<f64>,
    }
}

message! {
    /// State of the controller and the reasons for it.
    pub struct ControlState: "tangent_msgs/msg/ControlState" {
        pub header: Header,
        pub cycle: u64,
        /// 0 idle, 1 approach, 2 contact, 3 slide, 4 retract, 5 done, 6 fault, 7 hold, 8 seek, 9
        /// tare, 10 clear, 11 travel, 12 lift.
        pub phase: u8,
        pub phase_text: Name,
        pub task: Name,
        pub activation: u64,
        /// Estimator in use, the reason for it, and the number of changes since the task started.
        pub estimator: Name,
        pub estimator_cause: Text,
        pub estimator_switches: u32,
        /// Normal in use, base axes.
        pub normal: Vector3,
        /// Reference and measured value of the pressing force along the normal, N (positive:
        /// pressing). The measured value is NaN while no wrench is usable.
        pub force_reference_n: f64,
        pub force_n: f64,
        /// Wrench in use at the tool, tool axes, N and Nm; NaN while no wrench is usable.
        pub wrench: Wrench,
        /// Path reference and its error in the tangent plane, m.
        pub path_reference: Point,
        pub path_error_m: f64,
        /// Progress along the path, 0 to 1.
        pub path_progress: f64,
        /// Angle between the normal in use and `-z_tool`, rad.
        pub alignment_error_rad: f64,
        /// Ages of the inputs at actuation, s.
        pub wrench_age_s: f64,
        pub estimate_age_s: f64,
        pub arm_state_age_s: f64,
        /// Age of the moving base's pose, s; negative if the base is fixed.
        pub base_age_s: f64,
        /// Energy in the tanks, J; zero if the law has none, never NaN.
        pub motion_tank_j: f64,
        pub force_tank_j: f64,
        pub manipulability: f64,
        /// Number of contact losses since the task started.
        pub contact_lost_count: u32,
        /// Duration of the law's step, s.
        pub step_s: f64,
        /// Last fault, in words; empty without a fault.
        pub fault: Text,
        /// Whether the task is paused: the arm then moves only to keep the force.
        pub paused: bool,
        /// Estimators that the controller reads, and the age of the newest estimate of each at
        /// actuation, s; -1 before the first. An age counts from the arrival of the robot packet
        /// that the estimate is based on, by the controller's monotonic clock.
        pub estimators: EstimatorArray<Name>,
        pub estimate_ages_s: EstimatorArray<f64>,
        /// Validity of the wrench, with the codes of `WrenchStatus.validity`.
        pub wrench_validity: u8,
        /// Whether the tool may touch something: from the approach until a retraction has ended in
        /// free space. Kept across restarts.
        pub contact_possible: bool,
        /// Age of the sensor's zero, s; negative if there is none.
        pub zero_age_s: f64,
        /// Error of the zero due to its age and the sensor's stated drift, N; negative if unknown.
        pub zero_bound_n: f64,
    }
}

message! {
    /// Shaping of stiffness and force by the state of contact and alignment. Published once per
    /// cycle by laws that use shaping.
    pub struct ShapingState: "tangent_msgs/msg/ShapingState" {
        /// Header of the `ControlState` of the same cycle.
        pub header: Header,
        pub cycle: u64,
        /// Contact-alignment monitor, and the margin beyond which the arm yields.
        pub monitor: f64,
        pub monitor_margin: f64,
        /// Share of the stiffness in use, 0 (compliant) to 1.
        pub rho_align: f64,
        /// Share of the force reference in use, 0 to 1.
        pub rho_force: f64,
    }
}

message! {
    /// What a task with `[coverage]` has covered, by the map of dose of its law. Published at the
    /// end of each round that another one follows, and at the end of the task.
    pub struct CoverageState: "tangent_msgs/msg/CoverageState" {
        /// Header of the `ControlState` of the same cycle.
        pub header: Header,
        pub cycle: u64,
        pub task: Name,
        pub activation: u64,
        /// Outcome: 0 open (a further round follows), 1 target met, 2 all rounds used, 3 no stroke
        /// reaches what is missing, 4 the task ended before.
        pub outcome: u8,
        pub outcome_text: Text,
        /// Share of the region within the band at the end of each round, and now, and the share
        /// that the task asks for, 0 to 1.
        pub share_by_round: RoundArray,
        pub share: f64,
        pub share_min: f64,
        /// Area of the region, and of its parts below and above the band, cm^2.
        pub area_cm2: f64,
        pub under_cm2: f64,
        pub over_cm2: f64,
        /// Number of connected areas below the band; area of the largest one, cm^2, and its middle
        /// in the path's plane, m.
        pub holes: u32,
        pub largest_hole_cm2: f64,
        pub largest_hole_m: [f64; 2],
        /// Least and most dose in the region, N*s/cm^2.
        pub dose_n_s_per_cm2: [f64; 2],
    }
}

message! {
    /// State of a service. Published at 1 Hz and on change.
    pub struct Health: "tangent_msgs/msg/Health" {
        pub header: Header,
        pub service: Name,
        pub instance: Name,
        pub host: Name,
        /// State: 0 starting, 1 running, 2 degraded, 3 fault, 4 stopping.
        pub state: u8,
        pub rate_names: Vec<String>,
        pub rates_hz: Vec<f64>,
        pub age_names: Vec<String>,
        pub ages_s: Vec<f64>,
        pub missed_cycles: u64,
        pub lost: u64,
        pub fault: String,
        /// Real-time settings that took effect, in words.
        pub realtime: String,
        /// Further figures by name.
        pub figure_names: Vec<String>,
        pub figures: Vec<f64>,
        /// Notes for an operator although nothing has failed, for instance on an open router.
        pub remarks: Vec<String>,
    }
}

message! {
    /// True state of the contact from the simulator; never read by the system under test.
    pub struct ContactTruth: "tangent_msgs/msg/ContactTruth" {
        pub header: Header,
        /// Closest point of the surface to the tool's origin, base axes, m.
        pub point: Point,
        /// Unit normal at `point`, out of the material.
        pub normal: Vector3,
        pub in_contact: bool,
        /// Depth of the deepest pad point, m.
        pub penetration_m: f64,
        /// Wrench of the surface on the tool, at the tool's origin, base axes, N and Nm.
        pub wrench: Wrench,
        pub tool_pose: Pose,
        pub tool_twist: Twist,
        pub sliding_speed_m_per_s: f64,
        pub friction: f64,
    }
}

message! {
    /// A request to a service, as the payload of a query.
    pub struct Request: "tangent_msgs/msg/Request" {
        /// Requested action, for instance `start`.
        pub action: String,
        /// Argument of the action: a name, a number, or a TOML document.
        pub argument: String,
    }
}

message! {
    /// Answer to a request: success, or the reason for the failure.
    pub struct Answer: "tangent_msgs/msg/Answer" {
        pub done: bool,
        /// Text for an operator.
        pub message: String,
        /// Data for a program: a JSON object, or empty.
        pub data: String,
    }
}

message! {
    /// A command that a person sent from the operator's page, and what became of it. Published once
    /// it is answered.
    pub struct OperatorCommand: "tangent_msgs/msg/OperatorCommand" {
        /// Time at which the page's service received the command.
        pub header: Header,
        /// Name that belongs to the token; `anyone` without a token, `lost page` for the configured
        /// answer to the loss of every page.
        pub who: Name,
        /// `operator` or `engineer`; empty without a token.
        pub role: Name,
        /// Address of the browser; empty without a browser.
        pub address: Name,
        /// Action, for instance `start`.
        pub action: Name,
        /// Name of the task's file or of the estimator; empty for other actions.
        pub argument: Text,
        /// Whether the cell carried it out, and its answer.
        pub done: bool,
        pub message: String,
        /// Time from `header.stamp` to the answer, s.
        pub answered_after_s: f64,
    }
}
