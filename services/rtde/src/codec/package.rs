//! What packages say: [`Request`] from client to controller, [`Reply`] from controller to client.

use super::{ControllerVersion, DataType, HEADER_BYTES, PACKAGE_BYTES_MAX, Protocol, TextMessage};

/// Longest list of names that a controller takes, bytes.
pub const NAMES_BYTES_MAX: usize = 2048;

/// Kinds of package.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PackageKind {
    /// `V`
    RequestProtocolVersion,
    /// `v`
    GetControllerVersion,
    /// `M`
    TextMessage,
    /// `U`
    Data,
    /// `O`
    SetupOutputs,
    /// `I`
    SetupInputs,
    /// `S`
    Start,
    /// `P`
    Pause,
}

impl PackageKind {
    /// Every kind there is.
    pub const ALL: [Self; 8] = [
        Self::RequestProtocolVersion,
        Self::GetControllerVersion,
        Self::TextMessage,
        Self::Data,
        Self::SetupOutputs,
        Self::SetupInputs,
        Self::Start,
        Self::Pause,
    ];

    /// The byte in the header.
    pub fn code(self) -> u8 {
        match self {
            Self::RequestProtocolVersion => b'V',
            Self::GetControllerVersion => b'v',
            Self::TextMessage => b'M',
            Self::Data => b'U',
            Self::SetupOutputs => b'O',
            Self::SetupInputs => b'I',
            Self::Start => b'S',
            Self::Pause => b'P',
        }
    }

    /// By the byte in the header.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|k| k.code() == code)
    }
}

/// A package that makes no sense; the connection can go on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// A kind byte that no package has.
    #[error("package of unknown kind {code} ({:?})", char::from(*code))]
    UnknownKind {
        /// The kind byte.
        code: u8,
    },
    /// Ends too early, or holds more than it should.
    #[error("{kind} with a payload of {bytes} bytes, which it cannot have")]
    Length {
        /// The kind's name.
        kind: &'static str,
        /// Bytes of the payload.
        bytes: usize,
    },
    /// A type name that no field has.
    #[error("the controller names a type {name:?} that RTDE does not have")]
    UnknownType {
        /// As it came, cut to 64 characters.
        name: String,
    },
    /// A list of names longer than [`NAMES_BYTES_MAX`].
    #[error("a list of names of {bytes} bytes; at most {NAMES_BYTES_MAX} are taken")]
    NamesTooLong {
        /// Its length.
        bytes: usize,
    },
}

impl DecodeError {
    pub(super) fn short(kind: &'static str, bytes: usize) -> Self {
        Self::Length { kind, bytes }
    }

    pub(super) fn length(kind: &'static str, bytes: usize) -> Self {
        Self::Length { kind, bytes }
    }
}

/// A package that cannot be written.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a package of {bytes} bytes cannot be sent; the most is {PACKAGE_BYTES_MAX}")]
pub struct EncodeError {
    /// Bytes it would have.
    pub bytes: usize,
}

/// What a controller says about one name of a recipe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// The field exists and has this type.
    Type(DataType),
    /// No such field on this controller.
    NotFound,
    /// Another client owns this input.
    InUse,
}

impl Slot {
    /// As it stands on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::Type(t) => t.name(),
            Self::NotFound => "NOT_FOUND",
            Self::InUse => "IN_USE",
        }
    }

    fn from_name(name: &str) -> Result<Self, DecodeError> {
        match name {
            "NOT_FOUND" => Ok(Self::NotFound),
            "IN_USE" => Ok(Self::InUse),
            _ => {
                DataType::from_name(name)
                    .map(Self::Type)
                    .ok_or_else(|| DecodeError::UnknownType {
                        name: name.chars().take(64).collect(),
                    })
            }
        }
    }
}

/// From client to controller.
#[derive(Clone, Debug, PartialEq)]
pub enum Request<'a> {
    /// Speak this version from now on. Any number may come; [`Protocol::from_number`] says which exist.
    ProtocolVersion(u16),
    /// Which software runs there.
    ControllerVersion,
    /// A line for the controller's log.
    Text(TextMessage),
    /// Replace the output recipe.
    SetupOutputs {
        /// Packages per second asked for; protocol 1 does not carry it.
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
                            .ok_or_else(|| DecodeError::short("SETUP_OUTPUTS", payload.len()))?;
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
                join(names.iter().map(String::as_str), out);
            }
            Self::SetupInputs { names } => join(names.iter().map(String::as_str), out),
            Self::Data(payload) => out.extend_from_slice(payload),
        })
    }

    /// Which kind of package carries it.
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

/// From controller to client.
#[derive(Clone, Debug, PartialEq)]
pub enum Reply<'a> {
    /// Whether the version asked for is spoken from now on.
    ProtocolVersion {
        /// False for a version the controller does not know.
        accepted: bool,
    },
    /// Which software runs here.
    ControllerVersion(ControllerVersion),
    /// A line from the controller.
    Text(TextMessage),
    /// One slot per name, in order.
    SetupOutputs {
        /// `None` in protocol 1.
        recipe_id: Option<u8>,
        /// What became of each name.
        slots: Vec<Slot>,
    },
    /// One slot per name, in order.
    SetupInputs {
        /// 0 when the recipe is refused.
        recipe_id: u8,
        /// What became of each name.
        slots: Vec<Slot>,
    },
    /// Whether outputs flow now.
    Start {
        /// False when there is no valid output recipe.
        accepted: bool,
    },
    /// Whether outputs have ceased.
    Pause {
        /// As the controller says.
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
                            .ok_or_else(|| DecodeError::short("SETUP_OUTPUTS", 0))?;
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
                    .ok_or_else(|| DecodeError::short("SETUP_INPUTS", 0))?;
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

    /// Which kind of package carries it.
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

/// Writes header and payload; on an error `out` is as before.
fn package(
    kind: PackageKind,
    out: &mut Vec<u8>,
    payload: impl FnOnce(&mut Vec<u8>),
) -> Result<(), EncodeError> {
    let start = out.len();
    out.extend_from_slice(&[0, 0, kind.code()]);
    payload(out);
    let bytes = out.len() - start;
    match u16::try_from(bytes) {
        Ok(size) => {
            out[start..start + HEADER_BYTES - 1].copy_from_slice(&size.to_be_bytes());
            Ok(())
        }
        Err(_) => {
            out.truncate(start);
            Err(EncodeError { bytes })
        }
    }
}

fn join<'s>(names: impl Iterator<Item = &'s str>, out: &mut Vec<u8>) {
    for (i, name) in names.enumerate() {
        if i > 0 {
            out.push(b',');
        }
        out.extend_from_slice(name.as_bytes());
    }
}

/// Names between commas. A comma at the very end is no further name: one well-known client always sends it.
fn decode_names(list: &[u8]) -> Result<Vec<String>, DecodeError> {
    if list.len() > NAMES_BYTES_MAX {
        return Err(DecodeError::NamesTooLong { bytes: list.len() });
    }
    let list = list.strip_suffix(b",").unwrap_or(list);
    if list.is_empty() {
        return Ok(Vec::new());
    }
    Ok(list
        .split(|b| *b == b',')
        .map(|name| String::from_utf8_lossy(name).into_owned())
        .collect())
}

fn decode_slots(list: &[u8]) -> Result<Vec<Slot>, DecodeError> {
    let text = String::from_utf8_lossy(list);
    let text = text.strip_suffix(',').unwrap_or(&text);
    if text.is_empty() {
        return Ok(Vec::new());
    }
    text.split(',').map(Slot::from_name).collect()
}

#[cfg(test)]
mod tests {
    use super::super::TextLevel;
    use super::*;
    use proptest::prelude::*;

    fn protocol() -> impl Strategy<Value = Protocol> {
        prop_oneof![Just(Protocol::V1), Just(Protocol::V2)]
    }

    fn names() -> impl Strategy<Value = Vec<String>> {
        prop::collection::vec("[a-z][a-z0-9_]{0,30}", 0..40)
    }

    fn slots() -> impl Strategy<Value = Vec<Slot>> {
        let mut all: Vec<Slot> = DataType::ALL.into_iter().map(Slot::Type).collect();
        all.extend([Slot::NotFound, Slot::InUse]);
        prop::collection::vec(proptest::sample::select(all), 0..60)
    }

    fn text() -> impl Strategy<Value = TextMessage> {
        ("[ -~]{0,255}", "[ -~]{0,255}", any::<u8>()).prop_map(|(message, source, level)| {
            TextMessage {
                message,
                source,
                level: TextLevel::from_number(level),
            }
        })
    }

    proptest! {
        #[test]
        fn requests_there_and_back(
            protocol in protocol(), version in any::<u16>(), names in names(), f in 0.0f64..1000.0,
            text in text(), data in prop::collection::vec(any::<u8>(), 0..100),
        ) {
            let frequency_hz = (protocol == Protocol::V2).then_some(f);
            for request in [
                Request::ProtocolVersion(version),
                Request::ControllerVersion,
                Request::Text(text),
                Request::SetupOutputs { frequency_hz, names: names.clone() },
                Request::SetupInputs { names },
                Request::Start,
                Request::Pause,
                Request::Data(&data),
            ] {
                let mut bytes = Vec::new();
                request.encode(protocol, &mut bytes).unwrap();
                prop_assert_eq!(usize::from(u16::from_be_bytes([bytes[0], bytes[1]])), bytes.len());
                prop_assert_eq!(Request::decode(bytes[2], &bytes[3..], protocol).unwrap(), request);
            }
        }

        #[test]
        fn replies_there_and_back(
            protocol in protocol(), accepted in any::<bool>(), words in any::<[u32; 4]>(), id in any::<u8>(),
            slots in slots(), text in text(), data in prop::collection::vec(any::<u8>(), 0..100),
        ) {
            let recipe_id = (protocol == Protocol::V2).then_some(id);
            let mut text = text;
            if protocol == Protocol::V1 {
                text.source.clear();
            }
            let [major, minor, bugfix, build] = words;
            for reply in [
                Reply::ProtocolVersion { accepted },
                Reply::ControllerVersion(ControllerVersion { major, minor, bugfix, build }),
                Reply::Text(text),
                Reply::SetupOutputs { recipe_id, slots: slots.clone() },
                Reply::SetupInputs { recipe_id: id, slots },
                Reply::Start { accepted },
                Reply::Pause { accepted },
                Reply::Data(&data),
            ] {
                let mut bytes = Vec::new();
                reply.encode(protocol, &mut bytes).unwrap();
                prop_assert_eq!(Reply::decode(bytes[2], &bytes[3..], protocol).unwrap(), reply);
            }
        }

        #[test]
        fn garbage_is_an_error_never_a_panic(
            code in any::<u8>(), payload in prop::collection::vec(any::<u8>(), 0..3000), protocol in protocol(),
        ) {
            for code in PackageKind::ALL.map(PackageKind::code).into_iter().chain([code]) {
                if let Ok(Request::SetupOutputs { names, .. }) = Request::decode(code, &payload, protocol) {
                    prop_assert!(names.len() <= NAMES_BYTES_MAX);
                }
                let _ = Reply::decode(code, &payload, protocol);
            }
        }
    }

    #[test]
    fn a_trailing_comma_is_no_name() {
        let request = Request::decode(b'I', b"timestamp,target_q,", Protocol::V2).unwrap();
        let names = vec!["timestamp".to_owned(), "target_q".to_owned()];
        assert_eq!(request, Request::SetupInputs { names });
        let Request::SetupInputs { names } = Request::decode(b'I', b"a,,b", Protocol::V2).unwrap()
        else {
            panic!()
        };
        assert_eq!(names, ["a", "", "b"]);
    }

    #[test]
    fn bytes_as_they_stand_on_the_wire() {
        let mut bytes = Vec::new();
        Request::ProtocolVersion(2)
            .encode(Protocol::V1, &mut bytes)
            .unwrap();
        assert_eq!(bytes, [0, 5, 86, 0, 2]);
        bytes.clear();
        Reply::SetupInputs {
            recipe_id: 1,
            slots: vec![Slot::Type(DataType::Int32), Slot::InUse],
        }
        .encode(Protocol::V2, &mut bytes)
        .unwrap();
        assert_eq!(&bytes[..4], [0, 16, 73, 1]);
        assert_eq!(&bytes[4..], b"INT32,IN_USE");
    }

    #[test]
    fn a_package_too_long_to_send_leaves_nothing_behind() {
        let mut bytes = vec![7];
        let error = Request::SetupInputs {
            names: vec!["x".repeat(70_000)],
        }
        .encode(Protocol::V2, &mut bytes);
        assert_eq!(error, Err(EncodeError { bytes: 70_003 }));
        assert_eq!(bytes, [7]);
    }

    #[test]
    fn errors_say_what_came() {
        let error = Request::decode(b'x', &[], Protocol::V2).unwrap_err();
        assert_eq!(error.to_string(), "package of unknown kind 120 ('x')");
        let error = Reply::decode(b'v', &[0; 15], Protocol::V2).unwrap_err();
        assert_eq!(
            error.to_string(),
            "GET_URCONTROL_VERSION with a payload of 15 bytes, which it cannot have"
        );
        assert_eq!(
            Reply::decode(b'I', b"\x01DOUBLE,FLOAT", Protocol::V2),
            Err(DecodeError::UnknownType {
                name: "FLOAT".into()
            })
        );
    }
}
