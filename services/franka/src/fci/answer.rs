//! The client's answer to one state: a UDP datagram.

use super::CodecError;
use super::wire::{Wire, exact, wire_struct};

wire_struct! {
    /// One answer. In a torque motion only the torques count, and the flag that ends it.
    pub struct RobotCommand {
        /// Of the state that it answers.
        pub message_id: u64,
        /// rad.
        pub q_c: [f64; 7],
        /// rad/s.
        pub dq_c: [f64; 7],
        /// Column by column, m.
        pub o_t_ee_c: [f64; 16],
        /// m/s, rad/s.
        pub o_dp_ee_c: [f64; 6],
        /// Position of joint 3 (rad) and sign of joint 4.
        pub elbow_c: [f64; 2],
        /// The elbow counts.
        pub valid_elbow: bool,
        /// This is the last one.
        pub motion_finished: bool,
        /// Without gravity, Nm.
        pub tau_j_d: [f64; 7],
    }
}

/// Length of an answer.
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

    /// Appends the datagram.
    pub fn encode(&self, out: &mut Vec<u8>) {
        self.put(out);
    }

    /// From a datagram.
    ///
    /// # Errors
    /// Another length.
    pub fn decode(datagram: &[u8]) -> Result<Self, CodecError> {
        exact("an answer", datagram)
    }

    /// Every number is finite.
    pub fn is_finite(&self) -> bool {
        [&self.q_c[..], &self.dq_c, &self.o_t_ee_c, &self.o_dp_ee_c]
            .into_iter()
            .chain([&self.elbow_c[..], &self.tau_j_d])
            .flatten()
            .all(|x| x.is_finite())
    }
}
