//! Copy of a truncated recording up to the first damage.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::{BufReader, Read};
use std::path::Path;
use std::time::Instant;

use mcap::McapError;
use mcap::records::Record as McapRecord;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader};

use super::{Bounds, STRIDE};
use crate::RecorderError;
use crate::message::Record;
use crate::publisher::of_channel;
use crate::reader::reader_options;
use crate::writer::{PUBLISHERS, RecordingWriter};

/// Copies everything up to the first damage. Returns the number of messages copied, and the number
/// of bytes of the original that they were read from.
pub(super) fn copy(
    path: &Path,
    whole: u64,
    mended_path: &Path,
    bounds: &Bounds<'_>,
) -> Result<(u64, u64), RecorderError> {
    let fail = |source| RecorderError::mcap(mended_path, source);
    let unread = |source| RecorderError::io(path, source);
    let mut copy = Copy {
        writer: RecordingWriter::create(mended_path).map_err(fail)?,
        schemas: HashMap::new(),
        channels: HashMap::new(),
        payload: 0,
    };
    let mut source =
        BufReader::with_capacity(1 << 16, File::open(path).map_err(unread)?).take(whole);
    let mut reader = LinearReader::new_with_options(reader_options());
    let mut checked = 0;
    let mut checked_at = Instant::now();
    // Bytes of the original: read so far, and up to the end of the last complete record or chunk.
    let (mut read, mut good) = (0, 0);
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let got = source.read(reader.insert(wanted)).map_err(unread)?;
                reader.notify_read(got);
                read += got as u64;
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                match mcap::parse_record(opcode, data) {
                    Ok(record) => {
                        if !copy.take(record).map_err(fail)? {
                            break;
                        }
                        good = read;
                    }
                    Err(_) => break,
                }
            }
            // Everything before the damage is saved.
            Err(_) => break,
        }
        if bounds.stop.is_stopped() {
            return Err(RecorderError::Stopped {
                path: path.to_owned(),
            });
        }
        if copy.writer.bytes() - checked >= STRIDE {
            copy.writer.sync().map_err(fail)?;
            checked = copy.writer.bytes();
            // The copy may grow by that much before the next check.
            bounds.check_room(path, 2 * STRIDE)?;
            if bounds.gently {
                bounds.stop.wait(checked_at.elapsed());
                checked_at = Instant::now();
            }
        }
    }
    let messages = copy.writer.messages();
    let entries: BTreeMap<String, String> = [
        ("messages", messages),
        ("payload_bytes", copy.payload),
        (
            "bytes_cut",
            fs::metadata(path).map_err(unread)?.len() - good,
        ),
    ]
    .map(|(name, count)| (name.to_owned(), count.to_string()))
    .into();
    copy.writer.metadata("repaired", entries).map_err(fail)?;
    copy.writer.finish().map_err(fail)?;
    Ok((messages, good))
}

/// State of the copy.
struct Copy {
    writer: RecordingWriter,
    /// Name and definition of each message type, by schema id.
    schemas: HashMap<u16, (String, Option<String>)>,
    /// Topic, schema id and publisher, by channel id.
    channels: HashMap<u16, (String, u16, [u8; 16])>,
    payload: u64,
}

impl Copy {
    /// Copies one record. Returns false if it cannot belong to a recording: damage that no checksum
    /// has detected.
    fn take(&mut self, record: McapRecord<'_>) -> Result<bool, McapError> {
        match record {
            McapRecord::Schema { header, data } => {
                let text = (header.encoding == "ros2msg")
                    .then(|| String::from_utf8(data.into_owned()).ok())
                    .flatten();
                self.schemas.insert(header.id, (header.name, text));
            }
            McapRecord::Channel(channel) => {
                let publisher = of_channel(&channel.metadata);
                self.channels
                    .insert(channel.id, (channel.topic, channel.schema_id, publisher));
            }
            McapRecord::Message { header, data } => {
                let Some((topic, schema, publisher)) = self.channels.get(&header.channel_id) else {
                    return Ok(false);
                };
                let schema = self.schemas.get(schema);
                self.payload += data.len() as u64;
                self.writer.write(&Record {
                    topic,
                    type_name: schema.map_or("", |(name, _)| name),
                    definition: schema.and_then(|(_, text)| text.as_deref()),
                    publisher: *publisher,
                    sequence: header.sequence,
                    log_time_ns: header.log_time,
                    publish_time_ns: header.publish_time,
                    bytes: &data,
                })?;
            }
            McapRecord::Attachment { header, data, .. } => {
                self.writer.attach_whole(&mcap::Attachment {
                    log_time: header.log_time,
                    create_time: header.create_time,
                    name: header.name,
                    media_type: header.media_type,
                    data,
                })?;
            }
            // The copy has its own channel ids.
            McapRecord::Metadata(m) if m.name == PUBLISHERS => {}
            McapRecord::Metadata(m) => self.writer.metadata(&m.name, m.metadata)?,
            _ => {}
        }
        Ok(true)
    }
}
