//! One MCAP file being written: channels appear with their first message, chunks reach the disk
//! whole.

use std::collections::{BTreeMap, HashMap};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Attachment, Compression, McapError, WriteOptions};

use tangent_schemas::Message;
use tangent_schemas::tangent::WrenchBatch;

use crate::files::{Files, OpenFile, SystemFiles};
use crate::message::Record;
use crate::packing::{self, Packed, Packer, Whole};
use crate::publisher::{self, UNKNOWN_PUBLISHER};

/// Zstd level: higher ones take several times the CPU time, for a hundredth of the size.
const ZSTD_LEVEL: u32 = 3;

/// Name of the tables of channels and publishers: `PUBLISHER TOPIC` by channel number. For readers
/// of the end of a file that has no index.
pub(crate) const PUBLISHERS: &str = "publishers";
/// Largest number of publishers with channels of their own in one file. Messages of further
/// publishers share one channel per topic.
const PUBLISHERS_MAX: usize = 8192;

/// Counts the bytes written, so that rotation by size needs no system call.
struct CountingFile {
    file: Arc<dyn OpenFile>,
    written: Arc<AtomicU64>,
}

impl Write for CountingFile {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let n = self.file.append(buffer)?;
        self.written.fetch_add(n as u64, Ordering::Relaxed);
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

struct Channel {
    type_name: String,
    publisher: [u8; 16],
    id: u16,
}

/// An open recording.
///
/// Chunks are built in memory and written in one go: a recorder that is killed leaves whole chunks
/// and at most one torn record at the end, which [`crate::repair`] cuts off.
pub struct RecordingWriter {
    writer: mcap::Writer<NoSeek<CountingFile>>,
    file: Arc<dyn OpenFile>,
    /// Channels by topic; each type and publisher has its own.
    channels: HashMap<String, Vec<Channel>>,
    /// Number of channels with a publisher.
    publishers: usize,
    /// Publishers of channels that are in no table on the disk yet.
    unsaid: BTreeMap<String, String>,
    path: PathBuf,
    written: Arc<AtomicU64>,
    messages: u64,
    /// `None` if messages are not packed.
    packer: Option<Packer>,
}

/// Options of a recording's file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileOptions {
    /// Whether chunks are compressed with zstd.
    pub compress: bool,
    /// Wrenches on `wrench/raw` are kept in arrays: [`WrenchBatch`] on `/wrench/raw/packed`.
    pub pack: bool,
}

impl RecordingWriter {
    /// Creates `path`, which must not exist: compressed, and every message as it comes.
    ///
    /// # Errors
    /// When the file cannot be created or its header not be written.
    pub fn create(path: &Path) -> Result<Self, McapError> {
        let options = FileOptions {
            compress: true,
            pack: false,
        };
        Self::create_with(path, options)
    }

    /// Creates `path`, which must not exist.
    ///
    /// # Errors
    /// When the file cannot be created or its header not be written.
    pub fn create_with(path: &Path, options: FileOptions) -> Result<Self, McapError> {
        Self::create_in(&SystemFiles, path, options)
    }

    pub(crate) fn create_in(
        files: &dyn Files,
        path: &Path,
        options: FileOptions,
    ) -> Result<Self, McapError> {
        let file = files.create(path)?;
        let written = Arc::new(AtomicU64::new(0));
        let counting = CountingFile {
            file: Arc::clone(&file),
            written: Arc::clone(&written),
        };
        let writer = WriteOptions::new()
            .profile("ros2")
            .library(concat!("tangent ", env!("CARGO_PKG_VERSION")))
            .compression(options.compress.then_some(Compression::Zstd))
            .compression_level(ZSTD_LEVEL)
            .compression_threads(0)
            .chunk_size(Some(1 << 20))
            .disable_seeking(true)
            .create(NoSeek::new(counting))?;
        Ok(Self {
            writer,
            file,
            channels: HashMap::new(),
            publishers: 0,
            unsaid: BTreeMap::new(),
            path: path.to_owned(),
            written,
            messages: 0,
            packer: options.pack.then(Packer::default),
        })
    }

    /// Appends one message. A packed one is written with its batch, at the next
    /// [`flush`](Self::flush) at the latest.
    ///
    /// # Errors
    /// The disk refuses; the file then stays readable up to its last complete chunk.
    pub fn write(&mut self, record: &Record<'_>) -> Result<(), McapError> {
        self.messages += packing::count(record.topic, record.type_name, record.bytes);
        let Some(packer) = &mut self.packer else {
            return self.write_message(record);
        };
        match packer.take(record) {
            Packed::Taken(full) => full.map_or(Ok(()), |whole| self.write_batch(&whole)),
            Packed::Not(before) => {
                if let Some(whole) = before {
                    self.write_batch(&whole)?;
                }
                self.write_message(record)
            }
        }
    }

    fn write_batch(&mut self, whole: &Whole) -> Result<(), McapError> {
        self.write_message(&Record {
            topic: &whole.topic,
            type_name: WrenchBatch::NAME,
            definition: Some(&WrenchBatch::definition()),
            publisher: whole.publisher,
            sequence: whole.sequence,
            log_time_ns: whole.log_time_ns,
            publish_time_ns: whole.publish_time_ns,
            bytes: &whole.bytes,
        })
    }

    /// Writes the incomplete batches.
    fn write_rest(&mut self) -> Result<(), McapError> {
        let rest = self.packer.as_mut().map(Packer::end_all);
        for whole in rest.unwrap_or_default() {
            self.write_batch(&whole)?;
        }
        Ok(())
    }

    fn write_message(&mut self, record: &Record<'_>) -> Result<(), McapError> {
        let channel_id = match self.channel(record, record.publisher) {
            Some(id) => id,
            None if self.publishers < PUBLISHERS_MAX => {
                self.add_channel(record, record.publisher)?
            }
            None => match self.channel(record, UNKNOWN_PUBLISHER) {
                Some(id) => id,
                None => self.add_channel(record, UNKNOWN_PUBLISHER)?,
            },
        };
        let header = MessageHeader {
            channel_id,
            sequence: record.sequence,
            log_time: record.log_time_ns,
            publish_time: record.publish_time_ns,
        };
        self.writer.write_to_known_channel(&header, record.bytes)
    }

    fn channel(&self, record: &Record<'_>, publisher: [u8; 16]) -> Option<u16> {
        let channels = self.channels.get(record.topic)?;
        let found = channels.iter().rev().find(|channel| {
            channel.publisher == publisher && channel.type_name == record.type_name
        });
        found.map(|channel| channel.id)
    }

    fn add_channel(&mut self, record: &Record<'_>, publisher: [u8; 16]) -> Result<u16, McapError> {
        let schema_id = match record.definition {
            Some(text) => self
                .writer
                .add_schema(record.type_name, "ros2msg", text.as_bytes())?,
            None => self.writer.add_schema(record.type_name, "", &[])?,
        };
        let mut metadata = BTreeMap::new();
        if publisher != UNKNOWN_PUBLISHER {
            metadata.insert("publisher".to_owned(), publisher::text(&publisher));
        }
        let id = self
            .writer
            .add_channel(schema_id, record.topic, "cdr", &metadata)?;
        if publisher != UNKNOWN_PUBLISHER {
            self.publishers += 1;
            let said = format!("{} {}", publisher::text(&publisher), record.topic);
            self.unsaid.insert(id.to_string(), said);
        }
        let channels = self.channels.entry(record.topic.to_owned()).or_default();
        channels.push(Channel {
            type_name: record.type_name.to_owned(),
            publisher,
            id,
        });
        Ok(id)
    }

    /// Stores a file (cell, task) inside the recording.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn attach(&mut self, name: &str, text: &str, time_ns: u64) -> Result<(), McapError> {
        self.attach_whole(&Attachment {
            log_time: time_ns,
            create_time: time_ns,
            name: name.to_owned(),
            media_type: "application/toml".to_owned(),
            data: text.as_bytes().into(),
        })
    }

    pub(crate) fn attach_whole(&mut self, attachment: &Attachment<'_>) -> Result<(), McapError> {
        self.writer.attach(attachment)
    }

    /// Stores a table of names and values inside the recording.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn metadata(
        &mut self,
        name: &str,
        entries: BTreeMap<String, String>,
    ) -> Result<(), McapError> {
        self.writer.write_metadata(&Metadata {
            name: name.to_owned(),
            metadata: entries,
        })
    }

    /// Ends the present chunk and passes it to the operating system: the end of the process then
    /// loses only later messages.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn flush(&mut self) -> Result<(), McapError> {
        self.write_rest()?;
        self.say_publishers()?;
        self.writer.flush()
    }

    /// Writes the table of publishers, after the chunk in which their channels begin.
    fn say_publishers(&mut self) -> Result<(), McapError> {
        if self.unsaid.is_empty() {
            return Ok(());
        }
        let unsaid = std::mem::take(&mut self.unsaid);
        self.metadata(PUBLISHERS, unsaid)
    }

    /// Ends the present chunk and waits until it is on the disk: a power cut then loses only later
    /// messages.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn sync(&mut self) -> Result<(), McapError> {
        self.flush()?;
        Ok(self.file.sync()?)
    }

    /// Writes index and footer, and waits until they are on the disk.
    ///
    /// # Errors
    /// When the disk refuses.
    pub fn finish(mut self) -> Result<PathBuf, McapError> {
        self.write_rest()?;
        self.say_publishers()?;
        self.writer.finish()?;
        self.file.sync()?;
        Ok(self.path)
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Number of bytes written so far.
    pub fn bytes(&self) -> u64 {
        self.written.load(Ordering::Relaxed)
    }

    /// Number of messages so far; those in a batch are counted individually.
    pub fn messages(&self) -> u64 {
        self.messages
    }
}
