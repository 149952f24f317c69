//! Reads a recording's messages one by one, for files that are too large for memory.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use mcap::McapError;
use mcap::sans_io::{MessageReadEvent, MessageReader};

use crate::RecorderError;
use crate::message::RecordedMessage;
use crate::packing::{Unpacked, unpack};
use crate::reader::message_reader;

/// The messages of a file, read on demand; at most one chunk is in memory. Ends with the file, also
/// a torn one, or with the first damage as its last item. The order is the file's: messages that
/// were requested again follow those received meanwhile, and packed messages follow those received
/// while their batch was filled.
pub struct RecordingStream {
    path: PathBuf,
    file: File,
    reader: MessageReader,
    /// Of a batch.
    unpacked: std::vec::IntoIter<Unpacked>,
    ended: bool,
}

impl RecordingStream {
    /// Opens a file; whether it is a recording shows with the first message.
    ///
    /// # Errors
    /// The file cannot be opened.
    pub fn open(path: &Path) -> Result<Self, RecorderError> {
        Ok(Self {
            path: path.to_owned(),
            file: File::open(path).map_err(|source| RecorderError::io(path, source))?,
            reader: message_reader(),
            unpacked: Vec::new().into_iter(),
            ended: false,
        })
    }

    fn step(&mut self) -> Option<Result<RecordedMessage, RecorderError>> {
        loop {
            if let Some(one) = self.unpacked.next() {
                return Some(Ok(one.message));
            }
            match self.reader.next_event()? {
                Ok(MessageReadEvent::ReadRequest(wanted)) => {
                    match self.file.read(self.reader.insert(wanted)) {
                        Ok(got) => self.reader.notify_read(got),
                        Err(source) => return Some(Err(RecorderError::io(&self.path, source))),
                    }
                }
                Ok(MessageReadEvent::Message(message)) => {
                    self.unpacked = unpack(message.into()).into_iter();
                }
                Err(McapError::UnexpectedEof) => return None,
                Err(source) => return Some(Err(RecorderError::mcap(&self.path, source))),
            }
        }
    }
}

impl Iterator for RecordingStream {
    type Item = Result<RecordedMessage, RecorderError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let item = self.step();
        self.ended = !matches!(item, Some(Ok(_)));
        item
    }
}
