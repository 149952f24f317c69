//! TCP connections of a program: the interface to the network, and what the reading functions
//! parse.

use std::sync::Arc;

use crate::error::ScriptError;
use crate::limits::TEXT_BYTES_MAX;
use crate::value::Value;

/// TCP connections by name. No function waits.
pub trait Sockets {
    /// Begins to connect. A connection of this name is closed.
    fn open(&mut self, name: &str, host: &str, port: u16);
    /// State of a connection.
    fn state(&mut self, name: &str) -> SocketState;
    /// Closes a connection; false if there is none.
    fn close(&mut self, name: &str) -> bool;
    /// Sends bytes; false if the peer does not take them all.
    fn send(&mut self, name: &str, bytes: &[u8]) -> bool;
    /// Bytes that have arrived and were not taken yet; the reader takes them off the front.
    fn received(&mut self, name: &str) -> Option<&mut Vec<u8>>;
}

/// State of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SocketState {
    /// There is none, or its peer has closed it.
    Closed,
    /// On its way.
    Opening,
    /// Bytes can be sent and received.
    Open,
}

/// What a thread waits for.
#[derive(Clone, Debug, PartialEq)]
pub enum Read {
    /// The connection.
    Connection,
    /// `(1.5, 2)` with this many numbers.
    Floats(usize),
    /// Big-endian integers of 4 bytes.
    Integers(usize),
    /// Bytes.
    Bytes(usize),
    /// Text up to a newline.
    Line,
    /// Text between two texts, or whatever has arrived if both are empty.
    Text { prefix: Arc<str>, suffix: Arc<str> },
    /// The integer in a line `NAME VALUE`.
    Variable(Arc<str>),
}

/// A read that has not ended.
#[derive(Clone, Debug, PartialEq)]
pub struct SocketWait {
    name: Arc<str>,
    read: Read,
    left_s: f64,
}

impl SocketWait {
    /// `timeout_s` of 0 or less waits for ever.
    pub fn new(name: Arc<str>, read: Read, timeout_s: f64) -> Self {
        Self {
            name,
            read,
            left_s: if timeout_s > 0.0 {
                timeout_s
            } else {
                f64::INFINITY
            },
        }
    }

    pub fn is_for_connection(&self) -> bool {
        self.read == Read::Connection
    }

    /// The result if it is there.
    pub fn now(&self, sockets: &mut dyn Sockets) -> Result<Option<Value>, ScriptError> {
        if self.is_for_connection() {
            return Ok(match sockets.state(&self.name) {
                SocketState::Open => Some(Value::Bool(true)),
                SocketState::Opening => None,
                SocketState::Closed => Some(Value::Bool(false)),
            });
        }
        match sockets.received(&self.name) {
            Some(bytes) => self.read.take(bytes),
            None => Ok(None),
        }
    }

    /// The result after a further step, which is what a failed read gives if the time is over or
    /// the connection is closed.
    pub fn later(
        &mut self,
        sockets: &mut dyn Sockets,
        step_s: f64,
    ) -> Result<Option<Value>, ScriptError> {
        self.left_s -= step_s;
        if let Some(value) = self.now(sockets)? {
            return Ok(Some(value));
        }
        if self.left_s <= 1e-9 || sockets.state(&self.name) == SocketState::Closed {
            if self.is_for_connection() {
                sockets.close(&self.name);
            }
            return self.read.failed().map(Some);
        }
        Ok(None)
    }
}

impl Read {
    fn take(&self, bytes: &mut Vec<u8>) -> Result<Option<Value>, ScriptError> {
        match self {
            Self::Connection => Ok(None),
            Self::Integers(n) => {
                if bytes.len() < 4 * n {
                    return Ok(None);
                }
                let taken: Vec<u8> = bytes.drain(..4 * n).collect();
                let values = taken.as_chunks::<4>().0.iter();
                counted(*n, values.map(|b| Value::Integer(i32::from_be_bytes(*b))))
            }
            Self::Bytes(n) => {
                if bytes.len() < *n {
                    return Ok(None);
                }
                let taken: Vec<u8> = bytes.drain(..*n).collect();
                counted(*n, taken.iter().map(|b| Value::Integer(i32::from(*b))))
            }
            Self::Floats(n) => {
                let Some(end) = bytes.iter().position(|b| *b == b')') else {
                    return Ok(None);
                };
                let taken: Vec<u8> = bytes.drain(..=end).collect();
                let text = String::from_utf8_lossy(&taken);
                let inner = text.rsplit('(').next().unwrap_or_default();
                let numbers: Vec<f64> = inner
                    .trim_end_matches(')')
                    .split(',')
                    .filter_map(|number| number.trim().parse().ok())
                    .take(*n)
                    .collect();
                let missing = std::iter::repeat_n(f64::NAN, n - numbers.len());
                let count = numbers.len();
                counted(count, numbers.into_iter().chain(missing).map(Value::Float))
            }
            Self::Line => Ok(line(bytes)),
            Self::Text { prefix, suffix } => between(bytes, prefix.as_bytes(), suffix.as_bytes()),
            Self::Variable(name) => {
                // Lines about other variables are answers to questions given up.
                while let Some(Value::Text(line)) = line(bytes) {
                    let value = line
                        .strip_prefix(&**name)
                        .and_then(|rest| rest.trim().parse().ok());
                    if let Some(value) = value {
                        return Ok(Some(Value::Integer(value)));
                    }
                }
                Ok(None)
            }
        }
    }

    /// What a read gives that has not ended in time.
    fn failed(&self) -> Result<Value, ScriptError> {
        let none = |n: usize, value: Value| {
            let values = std::iter::repeat_n(value, n);
            Value::list(std::iter::once(Value::Integer(0)).chain(values).collect())
        };
        match self {
            Self::Connection => Ok(Value::Bool(false)),
            Self::Integers(n) | Self::Bytes(n) => none(*n, Value::Integer(-1)),
            Self::Floats(n) => none(*n, Value::Float(f64::NAN)),
            Self::Line | Self::Text { .. } => Value::text(String::new()),
            Self::Variable(_) => Ok(Value::Integer(0)),
        }
    }
}

fn counted(
    count: usize,
    values: impl Iterator<Item = Value>,
) -> Result<Option<Value>, ScriptError> {
    let count = Value::Integer(i32::try_from(count).unwrap_or(i32::MAX));
    Value::list(std::iter::once(count).chain(values).collect()).map(Some)
}

fn text(bytes: &[u8]) -> Value {
    // Longer texts than a variable holds are cut.
    let mut text = String::from_utf8_lossy(bytes).into_owned();
    while text.len() > TEXT_BYTES_MAX {
        text.pop();
    }
    Value::Text(text.into())
}

/// Takes a line off the front, without its end.
fn line(bytes: &mut Vec<u8>) -> Option<Value> {
    let end = bytes.iter().position(|b| *b == b'\n')?;
    let taken: Vec<u8> = bytes.drain(..=end).collect();
    Some(text(taken.trim_ascii_end()))
}

fn find(bytes: &[u8], pattern: &[u8]) -> Option<usize> {
    bytes.windows(pattern.len()).position(|w| w == pattern)
}

fn between(
    bytes: &mut Vec<u8>,
    prefix: &[u8],
    suffix: &[u8],
) -> Result<Option<Value>, ScriptError> {
    let start = if prefix.is_empty() {
        0
    } else {
        match find(bytes, prefix) {
            Some(at) => at + prefix.len(),
            None => return Ok(None),
        }
    };
    let end = if suffix.is_empty() {
        bytes.len().min(start + TEXT_BYTES_MAX)
    } else {
        match find(&bytes[start..], suffix) {
            Some(at) => start + at,
            None => return Ok(None),
        }
    };
    if suffix.is_empty() && end == start {
        return Ok(None);
    }
    let value = text(&bytes[start..end]);
    bytes.drain(..end + suffix.len());
    Ok(Some(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(read: &Read, bytes: &mut Vec<u8>) -> Option<String> {
        read.take(bytes).unwrap().map(|value| value.to_string())
    }

    #[test]
    fn numbers_come_whole_or_not_at_all() {
        let mut bytes = vec![0, 0, 0, 7, 255, 255, 255];
        assert_eq!(read(&Read::Integers(2), &mut bytes), None);
        bytes.extend([254, 9]);
        let integers = read(&Read::Integers(2), &mut bytes);
        assert_eq!(integers.as_deref(), Some("[2, 7, -2]"));
        let byte = read(&Read::Bytes(1), &mut bytes);
        assert_eq!(byte.as_deref(), Some("[1, 9]"));
        let mut bytes = b"noise (1.5, -2e-1) (3".to_vec();
        let floats = read(&Read::Floats(3), &mut bytes);
        assert_eq!(floats.as_deref(), Some("[2, 1.5, -0.2, NaN]"));
        assert_eq!(read(&Read::Floats(1), &mut bytes), None);
        let failed = Read::Integers(2).failed().unwrap();
        assert_eq!(failed.to_string(), "[0, -1, -1]");
    }

    #[test]
    fn texts_end_where_their_suffix_does() {
        let mut bytes = b"one\r\ntwo>three<four".to_vec();
        assert_eq!(read(&Read::Line, &mut bytes).as_deref(), Some("one"));
        let marked = Read::Text {
            prefix: ">".into(),
            suffix: "<".into(),
        };
        assert_eq!(read(&marked, &mut bytes).as_deref(), Some("three"));
        let all = Read::Text {
            prefix: "".into(),
            suffix: "".into(),
        };
        assert_eq!(read(&all, &mut bytes).as_deref(), Some("four"));
        assert_eq!(read(&all, &mut bytes), None);
        let mut bytes = b"other 1\nspeed -4\n".to_vec();
        let variable = Read::Variable("speed".into());
        assert_eq!(read(&variable, &mut bytes).as_deref(), Some("-4"));
    }
}
