//! Requests of a client to the controller.

use super::package::{DecodeError, EncodeError, NAMES_BYTES_MAX, PackageKind, join, package};
use super::{Protocol, TextMessage};

/// A package from client to controller.
#[derive(Clone, Debug, PartialEq)]
pub enum Request<'a> {
    /// Use this protocol version from now on. Any number may arrive; [`Protocol::from_number`]
    /// accepts the existing ones.
    ProtocolVersion(u16),
    /// Request the version of the controller's software.
    ControllerVersion,
    /// A line for the controller's log.
    Text(TextMessage),
    /// Replace the output recipe.
    SetupOutputs {
        /// Requested rate, Hz; protocol 1 does not contain it.
        frequency_hz: Option<f64>,
        /// Fields.
        names: Vec<String>,
    },
    /// Add an input recipe.
    SetupInputs {
        /// Fields.
        names: Vec<String>,
    },
    /// Send outputs.
    Start,
    /// Stop sending outputs.
    Pause,
    /// Input data: recipe id, then fields; see [`super::Recipe::decode`].
    Data(&'a [u8]),
}

impl<'a> Request<'a> {
    /// Reads a package that a client sent.
    pub fn decode(code: u8, payload: &'a [u8], protocol: Protocol) -> Result<Self, DecodeError> {
        let kind = PackageKind::from_code(code).ok_or(DecodeError::UnknownKind { code })?;
        Ok(match kind {
            PackageKind::RequestProtocolVersion => match payload {
                [a, b] => Self::ProtocolVersion(u16::from_be_bytes([*a, *b])),
                _ => {
                    return Err(DecodeError::length(
                        "REQUEST_PROTOCOL_VERSION",
                        payload.len(),
                    ));
                }
            },
            PackageKind::GetControllerVersion => Self::ControllerVersion,
            PackageKind::TextMessage => Self::Text(TextMessage::decode_full(payload)?),
            PackageKind::SetupOutputs => {
                let (frequency_hz, list) = match protocol {
                    Protocol::V1 => (None, payload),
                    Protocol::V2 => {
                        let (head, list) = payload
                            .split_first_chunk::<8>()
                            .ok_or_else(|| DecodeError::length("SETUP_OUTPUTS", payload.len()))?;
                        (Some(f64::from_be_bytes(*head)), list)
                    }
                };
                Self::SetupOutputs {
                    frequency_hz,
                    names: decode_names(list)?,
                }
            }
            PackageKind::SetupInputs => Self::SetupInputs {
                names: decode_names(payload)?,
            },
            PackageKind::Start => Self::Start,
            PackageKind::Pause => Self::Pause,
            PackageKind::Data => Self::Data(payload),
        })
    }

    /// Appends the whole package.
    pub fn encode(&self, protocol: Protocol, out: &mut Vec<u8>) -> Result<(), EncodeError> {
        package(self.kind(), out, |out| match self {
            Self::ProtocolVersion(v) => out.extend_from_slice(&v.to_be_bytes()),
            Self::ControllerVersion | Self::Start | Self::Pause => {}
            Self::Text(text) => text.encode_full(out),
            Self::SetupOutputs {
                frequency_hz,
                names,
            } => {
                if protocol == Protocol::V2 {
                    out.extend_from_slice(&frequency_hz.unwrap_or(0.0).to_be_bytes());
                }
                encode_names(names, out);
            }
            Self::SetupInputs { names } => encode_names(names, out),
            Self::Data(payload) => out.extend_from_slice(payload),
        })
    }

    /// Kind of the package.
    pub fn kind(&self) -> PackageKind {
        match self {
            Self::ProtocolVersion(_) => PackageKind::RequestProtocolVersion,
            Self::ControllerVersion => PackageKind::GetControllerVersion,
            Self::Text(_) => PackageKind::TextMessage,
            Self::SetupOutputs { .. } => PackageKind::SetupOutputs,
            Self::SetupInputs { .. } => PackageKind::SetupInputs,
            Self::Start => PackageKind::Start,
            Self::Pause => PackageKind::Pause,
            Self::Data(_) => PackageKind::Data,
        }
    }
}

/// Joins names with commas. An empty name at the end is followed by an extra comma, which adds no
/// name.
fn encode_names(names: &[String], out: &mut Vec<u8>) {
    join(names.iter().map(String::as_str), out);
    if names.last().is_some_and(String::is_empty) {
        out.push(b',');
    }
}

/// Splits names at commas. A comma at the very end adds no name: one well-known client always sends
/// it.
fn decode_names(list: &[u8]) -> Result<Vec<String>, DecodeError> {
    if list.len() > NAMES_BYTES_MAX {
        return Err(DecodeError::NamesTooLong { bytes: list.len() });
    }
    // The replacement character for an invalid byte is longer than the byte.
    let text = String::from_utf8_lossy(list);
    if text.len() > NAMES_BYTES_MAX {
        return Err(DecodeError::NamesTooLong { bytes: text.len() });
    }
    let names = text.strip_suffix(',').unwrap_or(&text);
    if names.is_empty() {
        return Ok(Vec::new());
    }
    Ok(names.split(',').map(str::to_owned).collect())
}
