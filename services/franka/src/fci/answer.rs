//! The client's answer to one state: a UDP datagram.

use super::CodecError;
use super::wire::{Wire, exact, wire_struct};

wire_struct! {
    /// One answer. In a torque motion only the torques and the flag that ends the motion are used.
    pub struct RobotCommand {
        /// Id of the state that it answers.
        pub message_id: u64,
        /// Commanded joint positions, rad.
        pub q_c: [f64; 7],
        /// Commanded joint velocities, rad/s.
        pub dq_c: [f64; 7],
        /// Commanded pose of the end effector, column by column, m.
        pub o_t_ee_c: [f64; 16],
        /// Commanded twist of the end effector, m/s, rad/s.
        pub o_dp_ee_c: [f64; 6],
        /// Position of joint 3 (rad) and sign of joint 4.
        pub elbow_c: [f64; 2],
        /// Whether `elbow_c` is used.
        pub valid_elbow: bool,
        /// Whether this is the last answer of the motion.
        pub motion_finished: bool,
        /// Commanded torques, without gravity, Nm.
        pub tau_j_d: [f64; 7],
    }
}

/// Length of an answer, bytes.
pub const COMMAND_BYTES: usize = RobotCommand::BYTES;

impl RobotCommand {
    /// Torques (Nm, without gravity) in answer to the state `message_id`.
    pub fn torque(message_id: u64, tau_j_d: [f64; 7], motion_finished: bool) -> Self {
        Self {
            message_id,
            q_c: [0.0; 7],
            dq_c: [0.0; 7],
            o_t_ee_c: [0.0; 16],
            o_dp_ee_c: [0.0; 6],
            elbow_c: [0.0; 2],
            valid_elbow: false,
            motion_finished,
            tau_j_d,
        }
    }

    /// Encodes and appends the datagram.
    pub fn encode(&self, out: &mut Vec<u8>) {
        self.put(out);
    }

    /// Decodes a datagram.
    ///
    /// # Errors
    /// The datagram has another length.
    pub fn decode(datagram: &[u8]) -> Result<Self, CodecError> {
        exact("an answer", datagram)
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        [&self.q_c[..], &self.dq_c, &self.o_t_ee_c, &self.o_dp_ee_c]
            .into_iter()
            .chain([&self.elbow_c[..], &self.tau_j_d])
            .flatten()
            .all(|x| x.is_finite())
    }
}
