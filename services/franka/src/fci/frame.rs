//! Frames of the TCP side: 12 bytes of header (command, id, size with the header), then the
//! payload.

use super::wire::Wire;

/// Bytes before the payload.
pub const HEADER_BYTES: usize = 12;
/// No message that a bridge or a simulator has to take is longer; the model library is never asked
/// for.
const MESSAGE_BYTES_MAX: usize = 64 * 1024;

/// One message, header taken apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// Number of the command.
    pub command: u32,
    /// Chosen by the client, the same in request and reply.
    pub id: u32,
    /// After the header.
    pub payload: &'a [u8],
}

/// A stream that cannot be a stream of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// Shorter than its header, or longer than any message.
    #[error("a message says it has {size} bytes; 12 to 65536 are allowed")]
    Size {
        /// As the header says.
        size: u32,
    },
}

/// Writes a frame around a payload that `body` appends.
pub(super) fn put_frame(command: u32, id: u32, out: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    let start = out.len();
    command.put(out);
    id.put(out);
    0u32.put(out);
    body(out);
    let size = (out.len() - start) as u32;
    out[start + 8..start + HEADER_BYTES].copy_from_slice(&size.to_le_bytes());
}

/// Cuts a byte stream into messages.
#[derive(Debug, Default)]
pub struct Framer {
    buffer: Vec<u8>,
    taken: usize,
}

impl Framer {
    /// With room for a few messages, so that a loop does not allocate later.
    pub fn new() -> Self {
        Self {
            buffer: Vec::with_capacity(4096),
            taken: 0,
        }
    }

    /// Takes in what was received.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.taken);
        self.taken = 0;
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole message.
    ///
    /// # Errors
    /// A size that no message has; nothing after it can be understood.
    pub fn next_message(&mut self) -> Result<Option<Message<'_>>, FrameError> {
        let rest = &self.buffer[self.taken..];
        if rest.len() < HEADER_BYTES {
            return Ok(None);
        }
        let mut header = rest;
        let command = u32::take(&mut header);
        let id = u32::take(&mut header);
        let size = u32::take(&mut header);
        let length = size as usize;
        if !(HEADER_BYTES..=MESSAGE_BYTES_MAX).contains(&length) {
            return Err(FrameError::Size { size });
        }
        if rest.len() < length {
            return Ok(None);
        }
        let start = self.taken;
        self.taken += length;
        Ok(Some(Message {
            command,
            id,
            payload: &self.buffer[start + HEADER_BYTES..start + length],
        }))
    }

    /// Forgets what is half there.
    pub fn clear(&mut self) {
        self.buffer.clear();
        self.taken = 0;
    }
}
