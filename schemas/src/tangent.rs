//! The project's own messages, `tangent_msgs/msg/*`. Each has its `.msg` file under `msg/`.

use serde::{Deserialize, Serialize};

use crate::standard::{Header, Point, Pose, Twist, Vector3, Wrench};
use crate::{Covariance, EstimatorArray, JointArray, Name, Text, message};

message! {
    /// What the arm does now. Published once per robot packet.
    pub struct ArmState: "tangent_msgs/msg/ArmState" {
        /// Time of measurement on the bridge's host; frame `base`.
        pub header: Header,
        /// Counts robot packets since the bridge started.
        pub cycle: u64,
        /// The robot's own clock, s.
        pub robot_time_s: f64,
        /// Nominal time between packets, s.
        pub period_s: f64,
        /// Measured joint positions, rad.
        pub q: JointArray,
        /// Measured joint velocities, rad/s.
        pub qd: JointArray,
        /// Joint velocities the robot's own controller aims for, rad/s.
        pub qd_target: JointArray,
        /// `base_from_tool` by the cell's arm model and tcp.
        pub tool_pose: Pose,
        /// Velocity of the tool's origin, base axes.
        pub tool_twist: Twist,
        /// RTDE `robot_mode`.
        pub robot_mode: i32,
        /// RTDE `safety_mode`.
        pub safety_mode: i32,
        /// RTDE `runtime_state`.
        pub runtime_state: u32,
        /// State of our program on the robot (register out int B+0); 255 when it is not there.
        pub program_state: u8,
        /// Why our program stopped last (register out int B+4).
        pub stop_cause: u8,
        /// True when a command of a fresh activation would move the arm now.
        pub ready: bool,
        /// Why not ready, in words; empty when ready.
        pub not_ready_reason: Text,
        /// Speed scaling in force, 0 to 1: limiter times slider.
        pub speed_scaling: f64,
        /// Age of the newest command that the robot has used, s: sequence sent to sequence used.
        pub command_latency_s: f64,
        /// Cycle of the last command that was accepted.
        pub command_cycle_accepted: u64,
        /// Commands refused since start, and why the last one was.
        pub commands_refused: u64,
        pub refusal_reason: Text,
        /// Activation that is latched out: commands with this activation or an older one do not
        /// move the arm.
        pub activation_latched: u64,
        /// Robot packets lost since start, from the robot's own clock.
        pub packets_lost: u64,
        /// Time from a robot packet's arrival to the command bytes' departure, last cycle, s.
        pub packet_to_command_s: f64,
        /// Cycles in which no fresh command was at hand while one was due.
        pub missed_cycles: u64,
        /// Source that holds the lease, `SERVICE/INSTANCE`; empty without one.
        pub commanded_by: Name,
        /// Mark of its publisher; all zero without one.
        pub commander_id: [u8; 16],
    }
}

message! {
    /// What the controller wants of the arm for one cycle.
    pub struct ArmCommand: "tangent_msgs/msg/ArmCommand" {
        pub header: Header,
        /// `ArmState.cycle` that this answers.
        pub cycle: u64,
        /// Number of a [`crate::CommandKind`]: 0 hold, 1 joint velocity, 2 joint torque, 3 soft
        /// stop.
        pub kind: u8,
        /// rad/s or Nm, base to flange.
        pub values: JointArray,
        /// Bound on joint acceleration for this cycle, rad/s².
        pub acceleration: f64,
        /// Who commands: `SERVICE/INSTANCE`.
        pub source: Name,
        /// Counts task starts. After a fault the bridge moves again only for a newer activation.
        pub activation: u64,
    }
}

message! {
    /// How far a wrench can be trusted; same stamp as the wrench it belongs to, and published just
    /// before it.
    pub struct WrenchStatus: "tangent_msgs/msg/WrenchStatus" {
        pub header: Header,
        /// Validity code (0 valid, 1 missing, 2 stale, 3 saturated, 4 not finite, 5 sensor error,
        /// 11 frozen, 12 axis stuck, 13 does not answer to motion, 14 implausible).
        pub validity: u8,
        /// The sensor's status word, and its bits in words.
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
        /// Sensor's rate as measured, Hz.
        pub rate_hz: f64,
        /// Age of the tare, s; negative when none was made.
        pub bias_age_s: f64,
        /// Bias subtracted, sensor axes.
        pub bias: Wrench,
        /// Delay of the filter at low frequency, s.
        pub filter_delay_s: f64,
        /// Residual of the clock recovery, s rms.
        pub clock_residual_s: f64,
        /// Records left out since the service started, because no load can cause their jump.
        pub records_implausible: u64,
        /// Axes that stand still: bit 0 Fx to bit 5 Tz; all of them when the sensor is frozen.
        pub stuck_axes: u8,
        /// Filtered reading before the zero is taken off, without the payload: frame of `bias`.
        pub untared: Wrench,
        /// The zero that the limit on `untared` counts from, the last that a motion has shown to be
        /// free of load: frame of `bias`; meaningless while `reference_age_s` is negative.
        pub reference: Wrench,
        /// Age of `reference`, s; negative when there is none.
        pub reference_age_s: f64,
        /// Largest share of the sensor's range that `untared` takes in any axis; negative where the
        /// range is not known.
        pub rated_share: f64,
        /// Error of the zero that its age and the sensor's stated drift imply, N; negative when
        /// none was made.
        pub bias_bound_n: f64,
        /// The zero was taken on a person's word that the tool hangs free (`tangent tare --clear`),
        /// and not judged.
        pub bias_said_clear: bool,
    }
}

message! {
    /// Where the surface faces, by one estimator.
    pub struct NormalEstimate: "tangent_msgs/msg/NormalEstimate" {
        /// Time of the measurement it rests on; frame `base`.
        pub header: Header,
        /// `ArmState.cycle` that it rests on.
        pub cycle: u64,
        pub estimator: Name,
        /// Contact point, m.
        pub point: Point,
        /// Unit, out of the material.
        pub normal: Vector3,
        /// Of `normal`, row-major, base axes, rad².
        pub covariance: [f64; 9],
        /// 0 valid; else why not, in code and in words.
        pub validity: u8,
        pub reason: Text,
        /// Friction coefficient; negative while unknown.
        pub friction: f64,
        /// Shape operator, row-major, base axes, 1/m; all zero while unknown.
        pub curvature: [f64; 9],
        /// Time one update took, s.
        pub update_s: f64,
    }
}

message! {
    /// One labelled point in an image.
    pub struct Feature: "tangent_msgs/msg/Feature" {
        /// Which point of the target.
        pub id: u32,
        /// Column and row, pixels; the middle of the first pixel is (0, 0).
        pub u: f64,
        pub v: f64,
    }
}

message! {
    /// Wrenches of one publisher in a row, as a recording keeps them: hundreds of small messages in
    /// one. Not on the bus.
    ///
    /// Every array has one element for each wrench; a wrench is its numbers times the steps, in the
    /// axes of the header's frame.
    pub struct WrenchBatch: "tangent_msgs/msg/WrenchBatch" {
        /// Time and frame of the first wrench.
        pub header: Header,
        /// The publisher's number of the first wrench; the others follow without a gap.
        pub sequence: u32,
        /// When the first wrench was received, ns since the Unix epoch.
        pub received_ns: u64,
        /// From the time of the wrench before, ns; 0 for the first.
        pub stamp_step_ns: Vec<i32>,
        /// From the receipt of the wrench before, ns; 0 for the first.
        pub received_step_ns: Vec<i32>,
        /// From the time of the wrench to its publication, ns.
        pub published_after_ns: Vec<i32>,
        /// N
        pub force_step_n: f64,
        /// Nm
        pub torque_step_nm: f64,
        /// In force steps.
        pub force_x: Vec<i32>,
        /// In force steps.
        pub force_y: Vec<i32>,
        /// In force steps.
        pub force_z: Vec<i32>,
        /// In torque steps.
        pub torque_x: Vec<i32>,
        /// In torque steps.
        pub torque_y: Vec<i32>,
        /// In torque steps.
        pub torque_z: Vec<i32>,
    }
}

message! {
    /// What was found in one image.
    pub struct FeatureArray: "tangent_msgs/msg/FeatureArray" {
        /// Time of exposure; frame `camera`.
        pub header: Header,
        /// Counts the images since the service started, those in which nothing was found too.
        pub sequence: u64,
        /// Points that were found; those that were not are left out.
        pub features: Vec<Feature>,
        /// Time that finding them took, s.
        pub detect_s: f64,
    }
}

message! {
    /// Where an object of known shape is, by one estimator.
    pub struct ObjectEstimate: "tangent_msgs/msg/ObjectEstimate" {
        /// Time of the measurement it rests on; frame `base`.
        pub header: Header,
        /// `ArmState.cycle` that it rests on.
        pub cycle: u64,
        pub estimator: Name,
        /// `base_from_object`.
        pub pose: Pose,
        /// Of its origin, base axes.
        pub twist: Twist,
        /// Row-major; x, y, z (m), then small turns about the base's axes (rad).
        pub covariance: Covariance,
        /// 0 valid; else why not, in code and in words.
        pub validity: u8,
        pub reason: Text,
        /// Of the newest camera frame that was used, s; negative without one.
        pub vision_age_s: f64,
        /// The estimator holds that the tool touches the object, and how hard along its normal, N.
        pub in_contact: bool,
        pub force_n: f64,
        /// Time one update took, s.
        pub update_s: f64,
    }
}

message! {
    /// The piece of surface of one orientation that the tool is on, as a camera saw it: its
    /// principal components.
    pub struct SurfaceSegment: "tangent_msgs/msg/SurfaceSegment" {
        /// Time of the arm state at exposure; frame `base`.
        pub header: Header,
        /// `ArmState.cycle` at exposure.
        pub cycle: u64,
        pub estimator: Name,
        /// Mean of its points, m.
        pub middle: Point,
        /// Direction of least spread, unit, out of the material.
        pub normal: Vector3,
        /// Share of the spread that lies along the normal: 0 where it is flat.
        pub surface_variation: f64,
    }
}

message! {
    /// Where the surface goes ahead of the tool, as a camera saw it. One entry per station in each
    /// list, from the tool on.
    pub struct SurfaceAhead: "tangent_msgs/msg/SurfaceAhead" {
        /// Time of the arm state at exposure; frame `base`.
        pub header: Header,
        /// `ArmState.cycle` at exposure.
        pub cycle: u64,
        pub estimator: Name,
        /// Along the surface from the tool, m.
        pub distance: Vec<f64>,
        /// On the surface, m.
        pub points: Vec<Point>,
        /// Unit, out of the material.
        pub normals: Vec<Vector3>,
        /// Bend along the way, 1/m, positive where the surface falls away, and its standard
        /// deviation.
        pub bend: Vec<f64>,
        pub bend_sd: Vec<f64>,
    }
}

message! {
    /// What the controller does and why.
    pub struct ControlState: "tangent_msgs/msg/ControlState" {
        pub header: Header,
        pub cycle: u64,
        /// 0 idle, 1 approach, 2 contact, 3 slide, 4 retract, 5 done, 6 fault, 7 hold, 8 seek, 9
        /// tare, 10 clear.
        pub phase: u8,
        pub phase_text: Name,
        pub task: Name,
        pub activation: u64,
        /// Estimator in use, why this one, and changes of it since the task started.
        pub estimator: Name,
        pub estimator_cause: Text,
        pub estimator_switches: u32,
        /// Normal in use, base axes.
        pub normal: Vector3,
        /// Pressing force asked for and measured along the normal, N (positive: pressing). What is
        /// measured is NaN while no wrench can be used.
        pub force_reference_n: f64,
        pub force_n: f64,
        /// Wrench in use at the tool, tool axes; NaN while no wrench can be used.
        pub wrench: Wrench,
        /// Path reference and its error in the tangent plane, m.
        pub path_reference: Point,
        pub path_error_m: f64,
        /// 0 to 1.
        pub path_progress: f64,
        /// Angle between the normal in use and `-z_tool`, rad.
        pub alignment_error_rad: f64,
        /// Ages at actuation, s.
        pub wrench_age_s: f64,
        pub estimate_age_s: f64,
        pub arm_state_age_s: f64,
        /// Of the moving base's pose; negative where the base stands for good.
        pub base_age_s: f64,
        /// Energy in the tanks, J; NaN-free: zero where the law has none.
        pub motion_tank_j: f64,
        pub force_tank_j: f64,
        pub manipulability: f64,
        /// Contact losses since the task started.
        pub contact_lost_count: u32,
        /// Time the law's step took, s.
        pub step_s: f64,
        /// Last fault, in words; empty when none.
        pub fault: Text,
        /// The task is paused: nothing moves but what keeps the force.
        pub paused: bool,
        /// Estimators that the controller reads, and the age of the newest of each at actuation, s;
        /// -1 before its first. An age counts from the arrival of the robot's packet that the
        /// estimate rests on, by the controller's monotonic clock.
        pub estimators: EstimatorArray<Name>,
        pub estimate_ages_s: EstimatorArray<f64>,
        /// Whether the wrench can be used: the codes of `WrenchStatus.validity`.
        pub wrench_validity: u8,
        /// The tool may touch something: from the approach on, until a retraction has ended in free
        /// space. Kept over restarts.
        pub contact_possible: bool,
        /// Age of the sensor's zero, s; negative when there is none.
        pub zero_age_s: f64,
        /// Error of the zero that its age and the sensor's stated drift imply, N; negative when
        /// that is not known.
        pub zero_bound_n: f64,
    }
}

message! {
    /// How a law shapes what it does by how contact and alignment fare. Once per cycle, by laws
    /// that shape.
    pub struct ShapingState: "tangent_msgs/msg/ShapingState" {
        /// As in the `ControlState` of the same cycle.
        pub header: Header,
        pub cycle: u64,
        /// Contact-alignment monitor, and the margin beyond which the arm gives way.
        pub monitor: f64,
        pub monitor_margin: f64,
        /// Share of the stiffness in force, 0 (limp) to 1.
        pub rho_align: f64,
        /// Share of the force reference in force, 0 to 1.
        pub rho_force: f64,
    }
}

message! {
    /// How a service fares. 1 Hz and on change.
    pub struct Health: "tangent_msgs/msg/Health" {
        pub header: Header,
        pub service: Name,
        pub instance: Name,
        pub host: Name,
        /// 0 starting, 1 running, 2 degraded, 3 fault, 4 stopping.
        pub state: u8,
        pub rate_names: Vec<String>,
        pub rates_hz: Vec<f64>,
        pub age_names: Vec<String>,
        pub ages_s: Vec<f64>,
        pub missed_cycles: u64,
        pub lost: u64,
        pub fault: String,
        /// What the real-time set-up got, in words.
        pub realtime: String,
        /// Further figures by name.
        pub figure_names: Vec<String>,
        pub figures: Vec<f64>,
        /// What a person should know though nothing has failed, for instance an open router.
        pub remarks: Vec<String>,
    }
}

message! {
    /// Simulator's truth about the contact; never read by the system under test.
    pub struct ContactTruth: "tangent_msgs/msg/ContactTruth" {
        pub header: Header,
        /// Closest point of the surface to the tool's origin, base axes, m.
        pub point: Point,
        /// Unit normal there, out of the material.
        pub normal: Vector3,
        pub in_contact: bool,
        /// Depth of the deepest pad point, m.
        pub penetration_m: f64,
        /// What the surface does to the tool at the tool's origin, base axes.
        pub wrench: Wrench,
        pub tool_pose: Pose,
        pub tool_twist: Twist,
        pub sliding_speed_m_per_s: f64,
        pub friction: f64,
    }
}

message! {
    /// A request to a service, the payload of a query.
    pub struct Request: "tangent_msgs/msg/Request" {
        /// What to do, for instance `start`.
        pub action: String,
        /// Its argument: a name, a number, or a TOML document.
        pub argument: String,
    }
}

message! {
    /// The answer to a request: done, or why not.
    pub struct Answer: "tangent_msgs/msg/Answer" {
        pub done: bool,
        /// For a person.
        pub message: String,
        /// For a program: a JSON object, or empty.
        pub data: String,
    }
}
