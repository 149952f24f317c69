//! The bytes of the Franka Control Interface, version 5 (Franka Emika Robot, "Panda"): pure, both
//! sides of it.
//!
//! The bridge speaks the client's side, the simulator the robot's. Commands go over TCP
//! ([`Request`], [`Reply`], in frames of [`Framer`]); the robot's state ([`RobotState`]) and the
//! answer to it ([`RobotCommand`]) are one UDP datagram each, 1000 times a second. All numbers are
//! little-endian and packed. Layouts, numbers and names are those of libfranka 0.9.2
//! (`common/include/research_interface/robot/`), and are tested against an independent client.

mod answer;
mod errors;
mod frame;
mod modes;
mod reply;
mod request;
mod state;
mod wire;

pub use answer::{COMMAND_BYTES, RobotCommand};
pub use errors::{ERROR_COUNT, ERROR_NAMES, ErrorFlags};
pub use frame::{FrameError, Framer, HEADER_BYTES, Message};
pub use modes::{ControllerMode, MotionMode, RobotMode};
pub use reply::{
    ConnectStatus, MoveStatus, RecoveryStatus, Reply, ReplyBody, SetterStatus, StopStatus,
};
pub use request::{
    CollisionBehavior, Command, Deviation, Filters, Load, MoveController, MoveGenerator, Request,
};
pub use state::{RobotState, STATE_BYTES};

/// Protocol version that this module implements.
pub const VERSION: u16 = 5;
/// TCP port of the commands; the robot sends its states over UDP.
pub const PORT: u16 = 1337;
/// Number of joints of every arm with this interface.
pub const JOINTS: usize = 7;
/// Time between two states, s.
pub const PERIOD_S: f64 = 0.001;
/// Number of consecutive lost answers after which the robot stops with
/// `communication_constraints_violation`.
pub const LOST_MAX: u32 = 20;

/// Why bytes cannot be decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// A datagram or payload has the wrong length.
    #[error("{what} of {got} bytes, {wanted} expected")]
    Length {
        /// Structure that was expected.
        what: &'static str,
        /// Length received, bytes.
        got: usize,
        /// Length expected, bytes.
        wanted: usize,
    },
    /// A number is not defined by the protocol.
    #[error("{what} {got} is unknown in FCI version 5")]
    Unknown {
        /// Meaning of the number.
        what: &'static str,
        /// The number received.
        got: u32,
    },
}
