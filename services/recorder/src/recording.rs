//! Reads a recording, complete or truncated.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use mcap::read::{LinearReader, Options};
use mcap::records::Record as McapRecord;
use mcap::sans_io::{LinearReaderOptions, MessageReadEvent, MessageReader};
use mcap::{McapError, Message};
use tangent_schemas::Message as _;
use tangent_schemas::standard::WrenchStamped;

use crate::RecorderError;
use crate::message::RecordedMessage;
use crate::order::Ordered;
use crate::packing::{packed_topic, size, unpack};
use crate::writer::PUBLISHERS;

/// The bytes of a file, and up to where its records are complete.
pub(crate) struct WholeFile {
    bytes: Vec<u8>,
    whole: usize,
}

impl WholeFile {
    pub(crate) fn read(path: &Path) -> Result<Self, RecorderError> {
        let bytes = fs::read(path).map_err(|source| RecorderError::io(path, source))?;
        let whole = whole_length(&bytes);
        Ok(Self { bytes, whole })
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Number of bytes up to the end of the last complete record.
    pub(crate) fn whole_bytes(&self) -> u64 {
        self.whole as u64
    }

    /// All messages up to the first damage, which is then the last item.
    pub(crate) fn messages(&self) -> Messages<'_> {
        Messages {
            left: &self.bytes[..self.whole],
            reader: message_reader(),
        }
    }
}

/// Largest record, bytes. A longer one is damage: without a limit, a single flipped bit could
/// request all memory.
const RECORD_BYTES_MAX: usize = 256 << 20;

/// Options for a file that may lack its end.
pub(crate) fn reader_options() -> LinearReaderOptions {
    LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(RECORD_BYTES_MAX)
}

pub(crate) fn message_reader() -> MessageReader {
    MessageReader::new_with_options(reader_options())
}

/// Iterator over the messages in a file's bytes.
pub(crate) struct Messages<'a> {
    left: &'a [u8],
    reader: MessageReader,
}

impl Iterator for Messages<'_> {
    type Item = Result<Message<'static>, McapError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            match self.reader.next_event()? {
                Ok(MessageReadEvent::ReadRequest(wanted)) => {
                    let (now, later) = self.left.split_at(wanted.min(self.left.len()));
                    self.reader.insert(now.len()).copy_from_slice(now);
                    self.reader.notify_read(now.len());
                    self.left = later;
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

/// Length of the longest prefix that ends with a complete record.
fn whole_length(bytes: &[u8]) -> usize {
    const RECORD_HEADER: usize = 9;
    let magic = mcap::MAGIC.len();
    if !bytes.starts_with(mcap::MAGIC) {
        return 0;
    }
    let mut at = magic;
    while let Some(header) = bytes.get(at..at + RECORD_HEADER) {
        let length = u64::from_le_bytes(
            header[1..]
                .try_into()
                .expect("a record's length has eight bytes"),
        );
        let Some(end) = usize::try_from(length)
            .ok()
            .and_then(|n| (at + RECORD_HEADER).checked_add(n))
            .filter(|&end| end <= bytes.len())
        else {
            break;
        };
        at = end;
    }
    if bytes[at..] == *mcap::MAGIC {
        bytes.len()
    } else {
        at
    }
}

/// What a message of a file holds: one message of the bus, or a batch of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Contents<'a> {
    /// Topic of the messages, with its leading slash.
    pub topic: &'a str,
    /// Their ROS 2 message type.
    pub type_name: &'a str,
    /// Their number.
    pub count: u64,
}

impl<'a> Contents<'a> {
    fn of(message: &'a Message<'_>) -> Self {
        let schema = message.channel.schema.as_ref();
        let type_name = schema.map_or("", |schema| schema.name.as_str());
        let topic = message.channel.topic.as_str();
        match packed_topic(topic).zip(size(topic, type_name, &message.data)) {
            Some((topic, count)) => Self {
                topic,
                type_name: WrenchStamped::NAME,
                count,
            },
            None => Self {
                topic,
                type_name,
                count: 1,
            },
        }
    }
}

/// A recording and its contents.
pub struct Recording {
    path: PathBuf,
    whole: WholeFile,
    attachments: BTreeMap<String, String>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    truncated: bool,
}

impl Recording {
    /// Reads a file; a truncated one up to its last complete chunk.
    ///
    /// # Errors
    /// The file cannot be read, or is not an MCAP file.
    pub fn open(path: &Path) -> Result<Self, RecorderError> {
        let whole = WholeFile::read(path)?;
        if whole.whole_bytes() == 0 {
            return Err(RecorderError::mcap(path, McapError::BadMagic));
        }
        let truncated =
            !whole.bytes().ends_with(mcap::MAGIC) || whole.bytes().len() < 2 * mcap::MAGIC.len();
        let mut attachments = BTreeMap::new();
        let mut metadata = BTreeMap::new();
        let readable = &whole.bytes()[..whole.whole_bytes() as usize];
        let records = LinearReader::new_with_options(readable, Options::IgnoreEndMagic.into())
            .map_err(|source| RecorderError::mcap(path, source))?;
        for record in records.map_while(Result::ok) {
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
            whole,
            attachments,
            metadata,
            truncated,
        })
    }

    /// Path that it was read from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the file lacks its end: the recorder was killed, and has not been started since.
    pub fn is_truncated(&self) -> bool {
        self.truncated
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
        self.try_messages_where(|_| true)
    }

    /// As [`Recording::try_messages`], only those for which `wanted` is true. It is asked in the
    /// order of the file, once for all messages of a batch. What is not wanted costs little.
    pub fn try_messages_where<'a>(
        &'a self,
        mut wanted: impl FnMut(&Contents<'_>) -> bool + 'a,
    ) -> impl Iterator<Item = Result<RecordedMessage, RecorderError>> + 'a {
        Ordered::new(
            self.whole
                .messages()
                .flat_map(move |message| match message {
                    Ok(message) if !wanted(&Contents::of(&message)) => Vec::new(),
                    Ok(message) => unpack(message.into()).into_iter().map(Ok).collect(),
                    Err(source) => vec![Err(RecorderError::mcap(&self.path, source))],
                }),
        )
    }
}
