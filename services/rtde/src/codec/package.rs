//! Common to all packages in both directions: kind, frame, lists of names, and errors.

use super::{DataType, HEADER_BYTES, PACKAGE_BYTES_MAX};

/// Longest list of names that a controller accepts, bytes.
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
    /// All kinds.
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

    /// Kind byte in the header.
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

    /// Kind from the kind byte in the header.
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|k| k.code() == code)
    }
}

/// Error of a package that cannot be decoded; the connection can continue.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecodeError {
    /// The kind byte is unknown.
    #[error("package of unknown kind {code} ({:?})", char::from(*code))]
    UnknownKind {
        /// The kind byte.
        code: u8,
    },
    /// The package is too short or too long for its contents.
    #[error("{kind} with a payload of {bytes} bytes, which is not a possible length")]
    Length {
        /// Name of the kind.
        kind: &'static str,
        /// Bytes of the payload.
        bytes: usize,
    },
    /// The type name is unknown.
    #[error("the controller names a type \"{name}\", which RTDE does not have")]
    UnknownType {
        /// Name as received, cut to 64 characters.
        name: String,
    },
    /// A list of names longer than [`NAMES_BYTES_MAX`].
    #[error("a list of names of {bytes} bytes; at most {NAMES_BYTES_MAX} are accepted")]
    NamesTooLong {
        /// Length of the list, bytes.
        bytes: usize,
    },
}

impl DecodeError {
    pub(super) fn length(kind: &'static str, bytes: usize) -> Self {
        Self::Length { kind, bytes }
    }
}

/// Error of a package that cannot be encoded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a package of {bytes} bytes cannot be sent; the most is {PACKAGE_BYTES_MAX}")]
pub struct EncodeError {
    /// Length that the package would have, bytes.
    pub bytes: usize,
}

/// A controller's reply for one name of a recipe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slot {
    /// The field exists, with this type.
    Type(DataType),
    /// The controller has no such field.
    NotFound,
    /// Another client owns this input.
    InUse,
}

impl Slot {
    /// Text in the package.
    pub fn name(self) -> &'static str {
        match self {
            Self::Type(t) => t.name(),
            Self::NotFound => "NOT_FOUND",
            Self::InUse => "IN_USE",
        }
    }

    pub(super) fn from_name(name: &str) -> Result<Self, DecodeError> {
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

/// Writes header and payload; after an error `out` is unchanged.
pub(super) fn package(
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

pub(super) fn join<'s>(names: impl Iterator<Item = &'s str>, out: &mut Vec<u8>) {
    for (i, name) in names.enumerate() {
        if i > 0 {
            out.push(b',');
        }
        out.extend_from_slice(name.as_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::{ControllerVersion, Protocol, Reply, Request, TextLevel, TextMessage};
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
        // An empty name at the end was lost when it was written again.
        for list in [&b"a,,"[..], b",,", b"a,,,"] {
            let read = Request::decode(b'I', list, Protocol::V2).unwrap();
            let mut bytes = Vec::new();
            read.encode(Protocol::V2, &mut bytes).unwrap();
            assert_eq!(&bytes[3..], list);
        }
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
            "GET_URCONTROL_VERSION with a payload of 15 bytes, which is not a possible length"
        );
        assert_eq!(
            Reply::decode(b'I', b"\x01DOUBLE,FLOAT", Protocol::V2),
            Err(DecodeError::UnknownType {
                name: "FLOAT".into()
            })
        );
    }
}
