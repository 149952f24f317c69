//! The robot's state: one UDP datagram per millisecond.

use super::modes::{ControllerMode, MotionMode, RobotMode};
use super::wire::{Wire, exact, wire_struct};
use super::{CodecError, ErrorFlags};

wire_struct! {
    /// One state. Names are the vendor's: `A_T_B` is the pose of B in A, column by column, m; O
    /// base, F flange, NE nominal end effector, EE end effector, K stiffness frame.
    ///
    /// External wrenches and torques carry the vendor's sign: what the robot does to the
    /// environment. Pulled along +z it reports -z ([libfranka issue
    /// 26](https://github.com/frankarobotics/libfranka/issues/26)).
    pub struct RobotState {
        /// Message counter, one per millisecond.
        pub message_id: u64,
        /// Measured.
        pub o_t_ee: [f64; 16],
        /// Desired.
        pub o_t_ee_d: [f64; 16],
        /// As set.
        pub f_t_ee: [f64; 16],
        /// As set.
        pub ee_t_k: [f64; 16],
        /// As set at the robot.
        pub f_t_ne: [f64; 16],
        /// As set.
        pub ne_t_ee: [f64; 16],
        /// End effector as set at the robot, kg.
        pub m_ee: f64,
        /// kg m².
        pub i_ee: [f64; 9],
        /// Flange axes, m.
        pub f_x_cee: [f64; 3],
        /// Load as set, kg.
        pub m_load: f64,
        /// kg m².
        pub i_load: [f64; 9],
        /// Flange axes, m.
        pub f_x_cload: [f64; 3],
        /// Position of joint 3 (rad), sign of joint 4.
        pub elbow: [f64; 2],
        /// Desired.
        pub elbow_d: [f64; 2],
        /// Measured behind the gears, with gravity, Nm.
        pub tau_j: [f64; 7],
        /// Desired, without gravity: of a torque motion what the client sent last, Nm.
        pub tau_j_d: [f64; 7],
        /// Nm/s.
        pub dtau_j: [f64; 7],
        /// Measured, rad.
        pub q: [f64; 7],
        /// Desired, rad.
        pub q_d: [f64; 7],
        /// Measured, rad/s.
        pub dq: [f64; 7],
        /// Desired, rad/s.
        pub dq_d: [f64; 7],
        /// Desired, rad/s².
        pub ddq_d: [f64; 7],
        /// 1 where the lower threshold is passed.
        pub joint_contact: [f64; 7],
        /// 1 where the lower threshold is passed.
        pub cartesian_contact: [f64; 6],
        /// 1 where the upper threshold is passed.
        pub joint_collision: [f64; 7],
        /// 1 where the upper threshold is passed.
        pub cartesian_collision: [f64; 6],
        /// Estimated, Nm.
        pub tau_ext_hat_filtered: [f64; 7],
        /// Estimated, at K, base axes: N, Nm.
        pub o_f_ext_hat_k: [f64; 6],
        /// Estimated, at K, K's axes: N, Nm.
        pub k_f_ext_hat_k: [f64; 6],
        /// Desired, base axes: m/s, rad/s.
        pub o_dp_ee_d: [f64; 6],
        /// Acceleration of gravity, base axes, m/s².
        pub o_ddp_o: [f64; 3],
        /// Commanded.
        pub elbow_c: [f64; 2],
        /// Commanded.
        pub delbow_c: [f64; 2],
        /// Commanded.
        pub ddelbow_c: [f64; 2],
        /// Commanded.
        pub o_t_ee_c: [f64; 16],
        /// Commanded: m/s, rad/s.
        pub o_dp_ee_c: [f64; 6],
        /// Commanded: m/s², rad/s².
        pub o_ddp_ee_c: [f64; 6],
        /// Motors' side, rad.
        pub theta: [f64; 7],
        /// Motors' side, rad/s.
        pub dtheta: [f64; 7],
        /// Number of the motion generator mode, [`RobotState::motion_mode`].
        pub motion_generator_mode: u8,
        /// Number of the controller mode, [`RobotState::controller`].
        pub controller_mode: u8,
        /// Present now.
        pub errors: ErrorFlags,
        /// What caused the last reflex.
        pub reflex_reason: ErrorFlags,
        /// Number of the robot mode, [`RobotState::mode`].
        pub robot_mode: u8,
        /// Share of the last 100 answers that came in time, 0 to 1; 0 without a motion.
        pub control_command_success_rate: f64,
    }
}

/// Length of a state, bytes.
pub const STATE_BYTES: usize = RobotState::BYTES;

impl Default for RobotState {
    /// All zero.
    fn default() -> Self {
        Self::take(&mut &[][..])
    }
}

impl RobotState {
    /// Encodes and appends the datagram.
    pub fn encode(&self, out: &mut Vec<u8>) {
        self.put(out);
    }

    /// Decodes a datagram.
    ///
    /// # Errors
    /// The datagram has another length.
    pub fn decode(datagram: &[u8]) -> Result<Self, CodecError> {
        exact("a state", datagram)
    }

    /// Mode of the robot.
    pub fn mode(&self) -> RobotMode {
        RobotMode::from_number(self.robot_mode).unwrap_or(RobotMode::Other)
    }

    /// Motion generator that runs.
    pub fn motion_mode(&self) -> Option<MotionMode> {
        MotionMode::from_number(self.motion_generator_mode)
    }

    /// Controller that runs.
    pub fn controller(&self) -> ControllerMode {
        ControllerMode::from_number(self.controller_mode).unwrap_or(ControllerMode::Other)
    }

    /// Whether the client's torque motion runs.
    pub fn in_torque_motion(&self) -> bool {
        self.mode() == RobotMode::Move
            && self.motion_mode() == Some(MotionMode::JointVelocity)
            && self.controller() == ControllerMode::External
    }

    /// Whether all values that a loop uses are finite and physically possible; a robot never sends
    /// others.
    pub fn is_usable(&self) -> bool {
        let within = |values: &[f64], most: f64| values.iter().all(|x| x.abs() <= most);
        within(&self.q, JOINT_MAX)
            && within(&self.dq, JOINT_MAX)
            && within(&self.dq_d, JOINT_MAX)
            && within(&self.tau_j_d, EFFORT_MAX)
            && within(&self.k_f_ext_hat_k, EFFORT_MAX)
            && within(&self.f_t_ee, JOINT_MAX)
            && within(&self.ee_t_k, JOINT_MAX)
    }
}

/// Largest joint angle, rad, joint velocity, rad/s, and tool length, m; beyond any arm.
const JOINT_MAX: f64 = 100.0;
/// Largest load of a joint or of the tool, N and Nm; beyond any arm.
const EFFORT_MAX: f64 = 1e6;
