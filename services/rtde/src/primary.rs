//! Messages of the controller on its script port, which report on the bridge's program. State
//! packages are skipped.
//!
//! A package is an `i32` length of the whole package, a `u8` type and a body. Type 20 is a message,
//! whose body begins with `u64` time, `u8` source and `u8` type.

/// Longest accepted package, bytes; robots send about 1.5 kB.
const PACKAGE_MAX: usize = 1 << 16;
const ROBOT_MESSAGE: u8 = 20;

/// A message that is written to the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PrimaryMessage {
    /// A text, for example by `textmsg` of a program.
    Text(String),
    /// An error code of the controller: `C207A0` and its text.
    Error {
        /// Number after the C.
        code: i32,
        /// Number after the A.
        argument: i32,
        /// Text, as sent.
        text: String,
    },
    /// An event of a program, for example `PROGRAM_XXX_STARTED`, with the program's name.
    Key {
        /// Name of the event.
        title: String,
        /// Name of the program.
        text: String,
    },
    /// A program failed.
    RuntimeException {
        /// Line in the text that was sent.
        line: u32,
        /// Column in that line.
        column: u32,
        /// Reason.
        text: String,
    },
    /// A change of safety mode, with its code.
    Safety {
        /// After the C.
        code: i32,
        /// After the A.
        argument: i32,
    },
}

/// Code of the message that the connection is read-only, which an e-Series robot in local control
/// sends.
pub const CODE_READ_ONLY: i32 = 210;

/// The peer is not a primary or secondary interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the script port sent a package of {length} bytes; from 5 to 65536 are possible, so this is not the script port"
)]
pub struct PrimaryError {
    /// Value of the length field.
    pub length: i32,
}

/// Cuts the stream into packages. Its memory is bounded by the longest package.
#[derive(Debug, Default)]
pub struct PrimaryReader {
    bytes: Vec<u8>,
}

impl PrimaryReader {
    /// Appends received bytes and returns the messages that are complete.
    ///
    /// # Errors
    /// A length field is out of range.
    pub fn push(&mut self, bytes: &[u8]) -> Result<Vec<PrimaryMessage>, PrimaryError> {
        let mut messages = Vec::new();
        for chunk in bytes.chunks(PACKAGE_MAX) {
            self.bytes.extend_from_slice(chunk);
            while let Some(head) = self.bytes.first_chunk::<4>() {
                let length = i32::from_be_bytes(*head);
                let Some(n) = usize::try_from(length)
                    .ok()
                    .filter(|n| (5..=PACKAGE_MAX).contains(n))
                else {
                    return Err(PrimaryError { length });
                };
                if self.bytes.len() < n {
                    break;
                }
                if self.bytes[4] == ROBOT_MESSAGE {
                    messages.extend(decode(&self.bytes[5..n]));
                }
                self.bytes.drain(..n);
            }
        }
        Ok(messages)
    }
}

/// Decodes the body of a robot message; `None` if it is of another kind, or too short.
fn decode(body: &[u8]) -> Option<PrimaryMessage> {
    let (head, rest) = body.split_at_checked(10)?;
    let word = |at: usize| {
        let bytes: [u8; 4] = rest.get(at..at + 4)?.try_into().ok()?;
        Some(i32::from_be_bytes(bytes))
    };
    let text = |at: usize| Some(String::from_utf8_lossy(rest.get(at..)?).trim().to_owned());
    Some(match head[9] {
        0 => PrimaryMessage::Text(text(0)?),
        5 => PrimaryMessage::Safety {
            code: word(0)?,
            argument: word(4)?,
        },
        6 => PrimaryMessage::Error {
            code: word(0)?,
            argument: word(4)?,
            text: text(20)?,
        },
        7 => {
            let length = usize::from(*rest.get(8)?);
            let title = rest.get(9..9 + length)?;
            PrimaryMessage::Key {
                title: String::from_utf8_lossy(title).into_owned(),
                text: text(9 + length)?,
            }
        }
        10 => PrimaryMessage::RuntimeException {
            line: word(0)? as u32,
            column: word(4)? as u32,
            text: text(8)?,
        },
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn package(kind: u8, body: &[u8]) -> Vec<u8> {
        let mut bytes = ((body.len() + 5) as i32).to_be_bytes().to_vec();
        bytes.push(kind);
        bytes.extend_from_slice(body);
        bytes
    }

    fn message(kind: u8, body: &[u8]) -> Vec<u8> {
        let mut all = vec![0; 8];
        all.extend([0xfe, kind]);
        all.extend_from_slice(body);
        package(ROBOT_MESSAGE, &all)
    }

    fn key(title: &str, text: &str) -> Vec<u8> {
        let mut body = vec![0; 8];
        body.push(title.len() as u8);
        body.extend_from_slice(title.as_bytes());
        body.extend_from_slice(text.as_bytes());
        message(7, &body)
    }

    #[test]
    fn messages_among_states_however_they_are_cut() {
        let mut stream = package(16, &[0; 700]);
        stream.extend(key("PROGRAM_XXX_STARTED", "tangent_bridge"));
        let mut body = 7i32.to_be_bytes().to_vec();
        body.extend(3i32.to_be_bytes());
        body.extend(b"compile_error_name_not_found:foo:");
        stream.extend(message(10, &body));
        let mut body = 207i32.to_be_bytes().to_vec();
        body.extend(0i32.to_be_bytes());
        body.extend([0; 12]);
        body.extend(b"fieldbus lost");
        stream.extend(message(6, &body));
        stream.extend(message(3, b"version, skipped"));
        let expected = vec![
            PrimaryMessage::Key {
                title: "PROGRAM_XXX_STARTED".into(),
                text: "tangent_bridge".into(),
            },
            PrimaryMessage::RuntimeException {
                line: 7,
                column: 3,
                text: "compile_error_name_not_found:foo:".into(),
            },
            PrimaryMessage::Error {
                code: 207,
                argument: 0,
                text: "fieldbus lost".into(),
            },
        ];
        for size in [1, 7, 100, stream.len()] {
            let mut reader = PrimaryReader::default();
            let got: Vec<_> = stream
                .chunks(size)
                .flat_map(|c| reader.push(c).unwrap())
                .collect();
            assert_eq!(got, expected);
        }
    }

    proptest! {
        #[test]
        fn garbage_is_an_error_or_skipped(chunks in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..2000), 0..10), body in prop::collection::vec(any::<u8>(), 0..60), kind in 0u8..12) {
            let mut reader = PrimaryReader::default();
            reader.push(&message(kind, &body)).unwrap();
            for chunk in &chunks {
                if reader.push(chunk).is_err() {
                    break;
                }
                prop_assert!(reader.bytes.len() <= 2 * PACKAGE_MAX);
            }
        }
    }
}
