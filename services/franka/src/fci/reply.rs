//! Replies of the robot, over TCP.

use super::CodecError;
use super::frame::{Message, put_frame};
use super::request::Command;
use super::wire::{Wire, numbered};

numbered! {
    /// Status of a connect request.
    pub enum ConnectStatus: u8 {
        /// Connected.
        Success = 0,
        /// The robot uses another protocol version.
        IncompatibleVersion = 1,
    }
}

numbered! {
    /// Status of a move request: `MotionStarted` first, then how the motion ended.
    pub enum MoveStatus: u8 {
        /// The motion ended as requested.
        Success = 0,
        /// The motion has started.
        MotionStarted = 1,
        /// Another command ended it.
        Preempted = 2,
        /// Not in this mode.
        NotPossible = 3,
        /// Not from this pose.
        SingularStart = 4,
        /// An argument out of range.
        InvalidArgument = 5,
        /// A reflex ended it.
        ReflexAborted = 6,
        /// A user stop or emergency stop ended it.
        EmergencyAborted = 7,
        /// A bad command ended it.
        InputErrorAborted = 8,
        /// Something else ended it.
        Aborted = 9,
    }
}

numbered! {
    /// Status of a stop request.
    pub enum StopStatus: u8 {
        /// Stopped.
        Success = 0,
        /// Nothing to stop.
        NotPossible = 1,
        /// A user stop or emergency stop came first.
        EmergencyAborted = 2,
        /// A reflex came first.
        ReflexAborted = 3,
        /// Something else came first.
        Aborted = 4,
    }
}

numbered! {
    /// Status of a recovery request.
    pub enum RecoveryStatus: u8 {
        /// Recovered.
        Success = 0,
        /// Not in this mode.
        NotPossible = 1,
        /// An operator has to recover it at the robot.
        ManualRecoveryRequired = 2,
        /// A reflex ended it.
        ReflexAborted = 3,
        /// A user stop or emergency stop ended it.
        EmergencyAborted = 4,
        /// Something else ended it.
        Aborted = 5,
    }
}

numbered! {
    /// Status of a request that sets or gets a value.
    pub enum SetterStatus: u8 {
        /// Done.
        Success = 0,
        /// Not in this mode.
        NotPossible = 1,
        /// Out of range.
        InvalidArgument = 2,
    }
}

/// Payload of a reply.
#[derive(Clone, Debug, PartialEq)]
pub enum ReplyBody {
    /// Reply to a connect request: status, and the robot's protocol version.
    Connect(ConnectStatus, u16),
    /// Reply to a move request.
    Move(MoveStatus),
    /// Reply to a stop request.
    Stop(StopStatus),
    /// Reply to a recovery request.
    Recovery(RecoveryStatus),
    /// Reply to a request that sets a value.
    Setter(SetterStatus),
    /// Reply to a request for a virtual wall: its size (m), its pose in the base (column by column,
    /// m) and whether it is active.
    Wall(SetterStatus, [f64; 3], [f64; 16], bool),
    /// Reply to a request for the model's code: whether it is sent. The data after a success are
    /// not read here.
    Model(bool),
}

/// One reply.
#[derive(Clone, Debug, PartialEq)]
pub struct Reply {
    /// Command of the request.
    pub command: Command,
    /// Id of the request.
    pub id: u32,
    /// Payload.
    pub body: ReplyBody,
}

impl Reply {
    /// Encodes and appends the whole message.
    pub fn encode(&self, out: &mut Vec<u8>) {
        put_frame(self.command.number(), self.id, out, |out| {
            match &self.body {
                ReplyBody::Connect(status, version) => {
                    status.number().put(out);
                    version.put(out);
                }
                ReplyBody::Move(status) => status.number().put(out),
                ReplyBody::Stop(status) => status.number().put(out),
                ReplyBody::Recovery(status) => status.number().put(out),
                ReplyBody::Setter(status) => status.number().put(out),
                ReplyBody::Wall(status, size, pose, active) => {
                    status.number().put(out);
                    size.put(out);
                    pose.put(out);
                    active.put(out);
                }
                ReplyBody::Model(there) => u8::from(!*there).put(out),
            }
        });
    }

    /// Decodes a message. Extra bytes at its end are ignored, as robots add padding.
    ///
    /// # Errors
    /// The command or status is unknown, or the payload is too short.
    pub fn decode(message: &Message<'_>) -> Result<Self, CodecError> {
        let unknown = |what, got| CodecError::Unknown { what, got };
        let command = Command::from_number(message.command)
            .ok_or_else(|| unknown("command", message.command))?;
        let mut rest = message.payload;
        let wanted = match command {
            Command::Connect => 3,
            Command::GetCartesianLimit => 1 + <[f64; 19]>::BYTES + 1,
            _ => 1,
        };
        if rest.len() < wanted {
            return Err(CodecError::Length {
                what: "a reply",
                got: rest.len(),
                wanted,
            });
        }
        let byte = u8::take(&mut rest);
        let status = |what| unknown(what, u32::from(byte));
        let setter = || SetterStatus::from_number(byte).ok_or_else(|| status("status"));
        let body = match command {
            Command::Connect => ReplyBody::Connect(
                ConnectStatus::from_number(byte).ok_or_else(|| status("connect status"))?,
                u16::take(&mut rest),
            ),
            Command::Move => {
                ReplyBody::Move(MoveStatus::from_number(byte).ok_or_else(|| status("move status"))?)
            }
            Command::StopMove => {
                ReplyBody::Stop(StopStatus::from_number(byte).ok_or_else(|| status("stop status"))?)
            }
            Command::AutomaticErrorRecovery => ReplyBody::Recovery(
                RecoveryStatus::from_number(byte).ok_or_else(|| status("recovery status"))?,
            ),
            Command::GetCartesianLimit => ReplyBody::Wall(
                setter()?,
                Wire::take(&mut rest),
                Wire::take(&mut rest),
                Wire::take(&mut rest),
            ),
            Command::LoadModelLibrary => ReplyBody::Model(byte == 0),
            _ => ReplyBody::Setter(setter()?),
        };
        Ok(Self {
            command,
            id: message.id,
            body,
        })
    }
}
