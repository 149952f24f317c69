//! Frames of the TCP side: 12 bytes of header (command, id, size with the header), then the
//! payload.

use super::wire::Wire;

/// Length of the header, bytes.
pub const HEADER_BYTES: usize = 12;
/// Largest accepted length of a message, bytes. Bridge and simulator need no longer ones, as the
/// model library is never requested.
const MESSAGE_BYTES_MAX: usize = 64 * 1024;

/// A message, with its header decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Message<'a> {
    /// Number of the command.
    pub command: u32,
    /// Id chosen by the client; the reply has the id of its request.
    pub id: u32,
    /// Bytes after the header.
    pub payload: &'a [u8],
}

/// The stream is not a stream of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The size is below that of the header, or above that of any message.
    #[error("a message states a length of {size} bytes; 12 to 65536 are allowed")]
    Size {
        /// Size in the header, bytes.
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
    /// Allocates room for a few messages, so that a loop does not allocate later.
    pub fn new() -> Self {
        Self {
            buffer: Vec::with_capacity(4096),
            taken: 0,
        }
    }

    /// Appends received bytes.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.taken);
        self.taken = 0;
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole message.
    ///
    /// # Errors
    /// No message has this size; the rest of the stream cannot be decoded.
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

    /// Discards an incomplete message.
    pub fn clear(&mut self) {
        self.buffer.clear();
        self.taken = 0;
    }
}
