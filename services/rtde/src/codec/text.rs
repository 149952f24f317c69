//! Text messages, which either side may send at any time.

use std::fmt;

use super::{DecodeError, Protocol};

/// Severity of a text message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextLevel {
    /// 0
    Exception,
    /// 1
    Error,
    /// 2
    Warning,
    /// 3
    Info,
    /// Any other number, as received.
    Other(u8),
}

impl TextLevel {
    /// The number on the wire.
    pub fn number(self) -> u8 {
        match self {
            Self::Exception => 0,
            Self::Error => 1,
            Self::Warning => 2,
            Self::Info => 3,
            Self::Other(n) => n,
        }
    }

    /// Never fails: an unknown number becomes [`TextLevel::Other`].
    pub fn from_number(number: u8) -> Self {
        match number {
            0 => Self::Exception,
            1 => Self::Error,
            2 => Self::Warning,
            3 => Self::Info,
            n => Self::Other(n),
        }
    }
}

/// A line for the log. A text whose length is in the package has at most 255 bytes; longer texts
/// are cut off.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextMessage {
    /// Text of the message.
    pub message: String,
    /// Sender; empty if the protocol does not contain it.
    pub source: String,
    /// Severity.
    pub level: TextLevel,
}

impl fmt::Display for TextMessage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "robot ({}): {}", self.source, self.message)
    }
}

impl TextMessage {
    /// Layout with lengths: version 2 in both directions, and version 1 from client to controller.
    pub(super) fn encode_full(&self, out: &mut Vec<u8>) {
        for text in [&self.message, &self.source] {
            let text = cut(text);
            out.push(text.len() as u8);
            out.extend_from_slice(text.as_bytes());
        }
        out.push(self.level.number());
    }

    /// Layout of version 1 from controller to client: level, then the message to the end.
    pub(super) fn encode_v1_reply(&self, out: &mut Vec<u8>) {
        out.push(self.level.number());
        out.extend_from_slice(self.message.as_bytes());
    }

    pub(super) fn decode_full(payload: &[u8]) -> Result<Self, DecodeError> {
        let short = || DecodeError::length("TEXT_MESSAGE", payload.len());
        let (message, rest) = counted(payload).ok_or_else(short)?;
        let (source, rest) = counted(rest).ok_or_else(short)?;
        let [level] = rest else {
            return Err(DecodeError::length("TEXT_MESSAGE", payload.len()));
        };
        Ok(Self {
            message: readable(message),
            source: readable(source),
            level: TextLevel::from_number(*level),
        })
    }

    pub(super) fn decode_reply(payload: &[u8], protocol: Protocol) -> Result<Self, DecodeError> {
        match protocol {
            Protocol::V2 => Self::decode_full(payload),
            Protocol::V1 => {
                let (level, message) = payload
                    .split_first()
                    .ok_or_else(|| DecodeError::length("TEXT_MESSAGE", 0))?;
                Ok(Self {
                    message: String::from_utf8_lossy(message).into_owned(),
                    source: String::new(),
                    level: TextLevel::from_number(*level),
                })
            }
        }
    }
}

fn counted(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (n, rest) = bytes.split_first()?;
    rest.split_at_checked(usize::from(*n))
}

/// Converts bytes to text. The replacement character for an invalid byte is longer than the byte,
/// so the text may have to be cut off.
fn readable(bytes: &[u8]) -> String {
    cut(&String::from_utf8_lossy(bytes)).to_owned()
}

/// The first 255 bytes of `text`, whole characters only.
fn cut(text: &str) -> &str {
    let mut end = text.len().min(255);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    &text[..end]
}
