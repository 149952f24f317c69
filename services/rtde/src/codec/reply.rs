//! Replies of the controller, and the data that it sends.

use super::package::{DecodeError, EncodeError, PackageKind, Slot, join, package};
use super::{ControllerVersion, Protocol, TextMessage};

/// A package from controller to client.
#[derive(Clone, Debug, PartialEq)]
pub enum Reply<'a> {
    /// Whether the requested protocol version is used from now on.
    ProtocolVersion {
        /// False if the controller does not support the version.
        accepted: bool,
    },
    /// Version of the controller's software.
    ControllerVersion(ControllerVersion),
    /// A line from the controller.
    Text(TextMessage),
    /// One slot per name, in order.
    SetupOutputs {
        /// `None` in protocol 1.
        recipe_id: Option<u8>,
        /// Result for each name.
        slots: Vec<Slot>,
    },
    /// One slot per name, in order.
    SetupInputs {
        /// Id of the recipe; 0 if it is refused.
        recipe_id: u8,
        /// Result for each name.
        slots: Vec<Slot>,
    },
    /// Whether the outputs are now being sent.
    Start {
        /// False when there is no valid output recipe.
        accepted: bool,
    },
    /// Whether the outputs have stopped.
    Pause {
        /// As reported by the controller.
        accepted: bool,
    },
    /// Output data: recipe id (protocol 2 only), then fields.
    Data(&'a [u8]),
}

impl<'a> Reply<'a> {
    /// Reads a package that a controller sent.
    pub fn decode(code: u8, payload: &'a [u8], protocol: Protocol) -> Result<Self, DecodeError> {
        let kind = PackageKind::from_code(code).ok_or(DecodeError::UnknownKind { code })?;
        let flag = |name| match payload {
            [x] => Ok(*x != 0),
            _ => Err(DecodeError::length(name, payload.len())),
        };
        Ok(match kind {
            PackageKind::RequestProtocolVersion => Self::ProtocolVersion {
                accepted: flag("REQUEST_PROTOCOL_VERSION")?,
            },
            PackageKind::GetControllerVersion => {
                let words: [u8; 16] = payload
                    .try_into()
                    .map_err(|_| DecodeError::length("GET_URCONTROL_VERSION", payload.len()))?;
                let word = |i: usize| {
                    u32::from_be_bytes([words[i], words[i + 1], words[i + 2], words[i + 3]])
                };
                Self::ControllerVersion(ControllerVersion {
                    major: word(0),
                    minor: word(4),
                    bugfix: word(8),
                    build: word(12),
                })
            }
            PackageKind::TextMessage => Self::Text(TextMessage::decode_reply(payload, protocol)?),
            PackageKind::SetupOutputs => {
                let (recipe_id, list) = match protocol {
                    Protocol::V1 => (None, payload),
                    Protocol::V2 => {
                        let (id, list) = payload
                            .split_first()
                            .ok_or_else(|| DecodeError::length("SETUP_OUTPUTS", 0))?;
                        (Some(*id), list)
                    }
                };
                Self::SetupOutputs {
                    recipe_id,
                    slots: decode_slots(list)?,
                }
            }
            PackageKind::SetupInputs => {
                let (id, list) = payload
                    .split_first()
                    .ok_or_else(|| DecodeError::length("SETUP_INPUTS", 0))?;
                Self::SetupInputs {
                    recipe_id: *id,
                    slots: decode_slots(list)?,
                }
            }
            PackageKind::Start => Self::Start {
                accepted: flag("START")?,
            },
            PackageKind::Pause => Self::Pause {
                accepted: flag("PAUSE")?,
            },
            PackageKind::Data => Self::Data(payload),
        })
    }

    /// Appends the whole package.
    pub fn encode(&self, protocol: Protocol, out: &mut Vec<u8>) -> Result<(), EncodeError> {
        package(self.kind(), out, |out| match self {
            Self::ProtocolVersion { accepted }
            | Self::Start { accepted }
            | Self::Pause { accepted } => out.push(u8::from(*accepted)),
            Self::ControllerVersion(v) => {
                for word in [v.major, v.minor, v.bugfix, v.build] {
                    out.extend_from_slice(&word.to_be_bytes());
                }
            }
            Self::Text(text) => match protocol {
                Protocol::V1 => text.encode_v1_reply(out),
                Protocol::V2 => text.encode_full(out),
            },
            Self::SetupOutputs { recipe_id, slots } => {
                if protocol == Protocol::V2 {
                    out.push(recipe_id.unwrap_or(0));
                }
                join(slots.iter().map(|s| s.name()), out);
            }
            Self::SetupInputs { recipe_id, slots } => {
                out.push(*recipe_id);
                join(slots.iter().map(|s| s.name()), out);
            }
            Self::Data(payload) => out.extend_from_slice(payload),
        })
    }

    /// Kind of the package.
    pub fn kind(&self) -> PackageKind {
        match self {
            Self::ProtocolVersion { .. } => PackageKind::RequestProtocolVersion,
            Self::ControllerVersion(_) => PackageKind::GetControllerVersion,
            Self::Text(_) => PackageKind::TextMessage,
            Self::SetupOutputs { .. } => PackageKind::SetupOutputs,
            Self::SetupInputs { .. } => PackageKind::SetupInputs,
            Self::Start { .. } => PackageKind::Start,
            Self::Pause { .. } => PackageKind::Pause,
            Self::Data(_) => PackageKind::Data,
        }
    }
}

fn decode_slots(list: &[u8]) -> Result<Vec<Slot>, DecodeError> {
    let text = String::from_utf8_lossy(list);
    let text = text.strip_suffix(',').unwrap_or(&text);
    if text.is_empty() {
        return Ok(Vec::new());
    }
    text.split(',').map(Slot::from_name).collect()
}
