//! Reads a recording, complete or truncated.

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use mcap::records::Record as McapRecord;
use mcap::sans_io::{MessageReadEvent, MessageReader};
use mcap::{McapError, Message};

use crate::RecorderError;
use crate::message::RecordedMessage;
use crate::order::Ordered;
use crate::outline::Outline;
use crate::packing::unpack;
use crate::reader::message_reader;
use crate::selection::{Contents, Held, Source, Stored, decode_selected};
use crate::writer::PUBLISHERS;

/// Iterator over the messages of a file, up to the first damage, which is then the last item.
struct Messages<'a> {
    file: &'a File,
    at: u64,
    end: u64,
    reader: MessageReader,
}

impl Messages<'_> {
    fn fill(&mut self, wanted: usize) -> io::Result<()> {
        let left = usize::try_from(self.end - self.at).unwrap_or(usize::MAX);
        let size = wanted.min(left);
        self.file.read_exact_at(self.reader.insert(size), self.at)?;
        self.reader.notify_read(size);
        self.at += size as u64;
        Ok(())
    }
}

impl Iterator for Messages<'_> {
    type Item = Result<Message<'static>, McapError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.reader.next_event()? {
                Ok(MessageReadEvent::ReadRequest(wanted)) => {
                    if let Err(error) = self.fill(wanted) {
                        self.end = self.at;
                        return Some(Err(McapError::Io(error)));
                    }
                }
                Ok(MessageReadEvent::Message(message)) => return Some(Ok(message)),
                // A file that ends between two records is truncated, not damaged; that is already
                // known.
                Err(McapError::UnexpectedEof) => return None,
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// A recording and its contents.
pub struct Recording {
    path: PathBuf,
    file: File,
    outline: Outline,
    attachments: BTreeMap<String, String>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
}

impl Recording {
    /// Reads a file; a truncated one up to its last complete chunk.
    ///
    /// # Errors
    /// The file cannot be read, or is not an MCAP file.
    pub fn open(path: &Path) -> Result<Self, RecorderError> {
        let failed = |source| RecorderError::io(path, source);
        let file = File::open(path).map_err(failed)?;
        let outline = Outline::read(&file).map_err(failed)?;
        if outline.whole_bytes == 0 {
            return Err(RecorderError::mcap(path, McapError::BadMagic));
        }
        let mut attachments = BTreeMap::new();
        let mut metadata = BTreeMap::new();
        let named = outline.named.iter();
        for record in named.map_while(|(opcode, body)| mcap::parse_record(*opcode, body).ok()) {
            match record {
                McapRecord::Attachment { header, data, .. } => {
                    attachments.insert(header.name, String::from_utf8_lossy(&data).into_owned());
                }
                // The messages contain this themselves.
                McapRecord::Metadata(m) if m.name == PUBLISHERS => {}
                McapRecord::Metadata(m) => {
                    metadata.insert(m.name, m.metadata);
                }
                _ => {}
            }
        }
        Ok(Self {
            path: path.to_owned(),
            file,
            outline,
            attachments,
            metadata,
        })
    }

    /// Path that it was read from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the file lacks its end: the recorder was killed, and has not been started since.
    pub fn is_truncated(&self) -> bool {
        !self.outline.is_finished
    }

    /// Attached files, by name.
    pub fn attachments(&self) -> &BTreeMap<String, String> {
        &self.attachments
    }

    /// Metadata tables, by name.
    pub fn metadata(&self) -> &BTreeMap<String, BTreeMap<String, String>> {
        &self.metadata
    }

    /// All messages up to the first damage, in the order of their arrival. A message that was
    /// requested again from its publisher takes the place where it would have arrived. Packed
    /// messages are unpacked.
    pub fn messages(&self) -> impl Iterator<Item = RecordedMessage> + '_ {
        self.try_messages().map_while(Result::ok)
    }

    /// All messages in the order of their arrival, as [`Recording::messages`]; damage, if any, is
    /// the last item.
    pub fn try_messages(
        &self,
    ) -> impl Iterator<Item = Result<RecordedMessage, RecorderError>> + '_ {
        let messages = Messages {
            file: &self.file,
            at: 0,
            end: self.outline.whole_bytes,
            reader: message_reader(),
        };
        Ordered::new(messages.flat_map(|message| match message {
            Ok(message) => unpack(message.into()).into_iter().map(Ok).collect(),
            Err(source) => vec![Err(RecorderError::mcap(&self.path, source))],
        }))
    }

    /// Passes the selected messages to `take`, in the order of their arrival as
    /// [`Recording::messages`], with damage, if any, as the last. Returns the number of all
    /// messages by topic. Damage outside the chunks, at which [`Recording::messages`] ends, costs
    /// no message here.
    ///
    /// `select` is asked once for each channel, and `decode` for each message of a channel for
    /// which it returned something, in several threads. `take` is called in this one.
    pub fn decode_selected<S: Send + Sync, T: Send>(
        &self,
        select: impl Fn(&Contents<'_>) -> Option<S> + Sync,
        decode: impl Fn(&S, &Stored<'_>) -> T + Sync,
        mut take: impl FnMut(Result<T, RecorderError>),
    ) -> Vec<Held> {
        let source = Source {
            path: &self.path,
            file: &self.file,
            pieces: &self.outline.pieces,
        };
        let held = decode_selected(&source, select, decode, &mut take);
        let mut named = self.outline.named.iter();
        let damage = named.find_map(|(opcode, body)| mcap::parse_record(*opcode, body).err());
        if let Some(damage) = damage {
            take(Err(RecorderError::mcap(&self.path, damage)));
        }
        held
    }
}
