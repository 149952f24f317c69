//! End of the cell's former recording: the messages of each publisher in it, so that a restarted
//! recorder can request those that came after.
//!
//! Reads the end of the newest files, complete or torn, before they are repaired. It reads the
//! chunks of the last seconds; of everything earlier it reads only the positions of the records.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use mcap::records::Record as McapRecord;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader};

use crate::packing;
use crate::publisher;
use crate::reader::reader_options;
use crate::repair::is_finished;
use crate::retention::order_of;
use crate::writer::PUBLISHERS;

/// Time span before the end that is read: slightly more than publishers keep.
const TAIL: Duration = Duration::from_secs(15);
/// Largest number of files read: rotation within the time span is hardly more frequent.
const FILES_MAX: usize = 4;
/// Largest chunk, bytes; a longer one is damage.
const CHUNK_BYTES_MAX: u64 = 256 << 20;

/// The end of the former recordings.
#[derive(Debug, Default)]
pub(crate) struct Former {
    /// Time of receipt of the newest message, ns since the Unix epoch.
    pub newest_ns: u64,
    /// Messages by key and publisher.
    pub heard: BTreeMap<(Arc<str>, [u8; 16]), Heard>,
}

/// Messages of one publisher.
#[derive(Debug, Default)]
pub(crate) struct Heard {
    /// Lower 32 bits of their sequence numbers, in the file's order.
    pub sequences: Vec<u32>,
    /// Whether the last of them is in a torn file, whose missing messages have not been counted.
    pub torn: bool,
}

impl Former {
    /// Reads the files in `folder` whose names begin with the cell's name. Empty if the newest
    /// message is older than what publishers keep. A file that cannot be read is left out: its
    /// messages are requested again.
    pub(crate) fn read(folder: &Path, prefix: &str, now_ns: u64) -> Self {
        let oldest_ns = now_ns.saturating_sub(TAIL.as_nanos() as u64);
        let mut ends = Vec::new();
        for path in newest_files(folder, prefix) {
            match End::read(&path, oldest_ns) {
                Ok(end) => {
                    let before = end.begins_before;
                    ends.push(end);
                    if before {
                        break;
                    }
                }
                Err(error) => tracing::warn!(
                    "{}: its end cannot be read ({error}); some messages may be recorded twice",
                    path.display()
                ),
            }
        }
        let mut former = Self::default();
        for end in ends.into_iter().rev() {
            former.newest_ns = former.newest_ns.max(end.newest_ns);
            for (key, publisher, sequence) in end.messages {
                let heard = former.heard.entry((key, publisher)).or_default();
                heard.sequences.push(sequence);
                heard.torn = end.torn;
            }
        }
        former
    }
}

/// The newest files, newest first.
fn newest_files(folder: &Path, prefix: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let mut files: Vec<(String, PathBuf)> = entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            let name = path.file_name()?.to_str()?;
            let rest = name.strip_prefix(prefix)?;
            // Only `-UTC-NNN.mcap` may follow: the name of another cell may begin in the same way.
            let own = rest.starts_with('-') && rest.split('-').count() == 3;
            let order = order_of(name).filter(|_| own && rest.ends_with(".mcap"))?;
            Some((order, path))
        })
        .collect();
    files.sort_by(|a, b| b.cmp(a));
    files.truncate(FILES_MAX);
    files.into_iter().map(|(_, path)| path).collect()
}

/// The end of one file.
struct End {
    newest_ns: u64,
    torn: bool,
    /// Whether the file also has older messages.
    begins_before: bool,
    messages: Vec<(Arc<str>, [u8; 16], u32)>,
}

impl End {
    fn read(path: &Path, oldest_ns: u64) -> io::Result<Self> {
        let mut file = File::open(path)?;
        let records = Records::find(&mut file, oldest_ns)?;
        let mut end = Self {
            newest_ns: 0,
            torn: !is_finished(path).map_err(io::Error::other)?,
            begins_before: records.begins_before,
            messages: Vec::new(),
        };
        let mut publishers = records.publishers;
        for (at, length) in records.chunks {
            let mut bytes = mcap::MAGIC.to_vec();
            file.seek(SeekFrom::Start(at))?;
            Read::by_ref(&mut file)
                .take(length)
                .read_to_end(&mut bytes)?;
            end.take(&bytes, &mut publishers);
        }
        Ok(end)
    }

    /// Takes the messages of one chunk, up to the first damage.
    fn take(&mut self, bytes: &[u8], publishers: &mut Publishers) {
        let mut left = bytes;
        let mut reader = LinearReader::new_with_options(reader_options());
        while let Some(Ok(event)) = reader.next_event() {
            match event {
                LinearReadEvent::ReadRequest(wanted) => {
                    let (now, later) = left.split_at(wanted.min(left.len()));
                    reader.insert(now.len()).copy_from_slice(now);
                    reader.notify_read(now.len());
                    left = later;
                }
                LinearReadEvent::Record { opcode, data } => {
                    match mcap::parse_record(opcode, data) {
                        Ok(McapRecord::Channel(channel)) => {
                            publishers.add(channel.id, &channel.topic, &channel.metadata);
                        }
                        Ok(McapRecord::Message { header, data }) => {
                            self.newest_ns = self.newest_ns.max(header.log_time);
                            if let Some((key, publisher)) = publishers.0.get(&header.channel_id) {
                                let (key, count) = match packing::batch(key, &data) {
                                    Some(batch) => {
                                        let key = packing::packed_topic(key).unwrap_or(key);
                                        (key.into(), batch.force_x.len())
                                    }
                                    None => (Arc::clone(key), 1),
                                };
                                for i in 0..count as u32 {
                                    let sequence = header.sequence.wrapping_add(i);
                                    self.messages.push((Arc::clone(&key), *publisher, sequence));
                                }
                            }
                        }
                        _ => {}
                    }
                }
            }
        }
    }
}

/// Key and publisher by channel.
#[derive(Default)]
struct Publishers(HashMap<u16, (Arc<str>, [u8; 16])>);

impl Publishers {
    fn add(&mut self, id: u16, topic: &str, metadata: &BTreeMap<String, String>) {
        if let Some(publisher) = metadata.get("publisher").and_then(|p| publisher::parse(p)) {
            let key = topic.trim_start_matches('/');
            self.0.insert(id, (key.into(), publisher));
        }
    }

    /// Takes the table that the writer puts after the chunk in which channels begin.
    fn add_table(&mut self, table: &BTreeMap<String, String>) {
        for (id, text) in table {
            if let Ok(id) = id.parse()
                && let Some((publisher, topic)) = text.split_once(' ')
                && let Some(publisher) = publisher::parse(publisher)
            {
                self.0
                    .insert(id, (topic.trim_start_matches('/').into(), publisher));
            }
        }
    }
}

/// Positions of a file's records.
#[derive(Default)]
struct Records {
    publishers: Publishers,
    /// Start and length of the chunks that are not too old.
    chunks: Vec<(u64, u64)>,
    begins_before: bool,
}

impl Records {
    /// Goes through the records, and reads only those that name publishers.
    fn find(file: &mut File, oldest_ns: u64) -> io::Result<Self> {
        const HEADER: u64 = 9;
        let length = file.metadata()?.len();
        let mut found = Self::default();
        let mut reader = io::BufReader::with_capacity(1 << 12, file);
        let mut at = mcap::MAGIC.len() as u64;
        reader.seek(SeekFrom::Start(at))?;
        while at + HEADER <= length {
            let [opcode] = read(&mut reader)?;
            let size = u64::from_le_bytes(read(&mut reader)?);
            let Some(next) = size.checked_add(at + HEADER).filter(|&end| end <= length) else {
                break;
            };
            let mut done = 0;
            match opcode {
                mcap::records::op::CHUNK if (16..CHUNK_BYTES_MAX).contains(&size) => {
                    let _begin: [u8; 8] = read(&mut reader)?;
                    let end_ns = u64::from_le_bytes(read(&mut reader)?);
                    done = 16;
                    if end_ns >= oldest_ns {
                        found.chunks.push((at, HEADER + size));
                    } else {
                        found.begins_before = true;
                    }
                }
                mcap::records::op::METADATA if size < 1 << 20 => {
                    let mut bytes = vec![0; size as usize];
                    reader.read_exact(&mut bytes)?;
                    done = size;
                    if let Ok(McapRecord::Metadata(table)) = mcap::parse_record(opcode, &bytes)
                        && table.name == PUBLISHERS
                    {
                        found.publishers.add_table(&table.metadata);
                    }
                }
                _ => {}
            }
            let rest = i64::try_from(size - done).map_err(io::Error::other)?;
            reader.seek_relative(rest)?;
            at = next;
        }
        Ok(found)
    }
}

fn read<const N: usize>(reader: &mut impl Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    reader.read_exact(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Record;
    use crate::writer::{FileOptions, RecordingWriter};
    use tangent_schemas::standard::WrenchStamped;
    use tangent_schemas::{Message, cdr};

    const S: u64 = 1_000_000_000;

    /// A file of two publishers of one topic and one of another, one message of each per 0.1 s from
    /// `from_s` on.
    fn write(folder: &Path, name: &str, from_s: u64, to_s: u64, finish: bool) -> PathBuf {
        let path = folder.join(name);
        let mut writer = RecordingWriter::create(&path).unwrap();
        for tick in from_s * 10..to_s * 10 {
            for (topic, publisher) in [("/a/b", 1), ("/a/b", 2), ("/c", 3), ("/foreign", 0)] {
                let record = Record {
                    topic,
                    type_name: "x/msg/Y",
                    definition: None,
                    publisher: [publisher; 16],
                    sequence: tick as u32,
                    log_time_ns: tick * S / 10,
                    publish_time_ns: tick,
                    bytes: &[0, 1, 0, 0],
                };
                writer.write(&record).unwrap();
            }
            if tick % 4 == 3 {
                writer.flush().unwrap();
            }
        }
        writer.finish().unwrap();
        if !finish {
            let bytes = fs::read(&path).unwrap();
            fs::write(&path, &bytes[..bytes.len() - 20]).unwrap();
        }
        path
    }

    fn heard(former: &Former, key: &str, publisher: u8) -> Vec<u32> {
        let id = (Arc::from(key), [publisher; 16]);
        former.heard[&id].sequences.clone()
    }

    #[test]
    fn the_end_of_the_newest_files_is_found_whole_or_torn() {
        for finish in [true, false] {
            let folder = tempfile::tempdir().unwrap();
            write(folder.path(), "c-20261122T101613Z-000.mcap", 0, 90, finish);
            write(
                folder.path(),
                "c-20261122T101613Z-001.mcap",
                90,
                100,
                finish,
            );
            // A recording of another cell, and a file that is not a recording.
            write(folder.path(), "c-2-20261122T101613Z-009.mcap", 0, 100, true);
            fs::write(folder.path().join("c-20261122T101613Z-002.mcap"), b"").unwrap();
            let former = Former::read(folder.path(), "c", 101 * S);
            assert_eq!(former.newest_ns, 100 * S - S / 10);
            for (key, publisher) in [("a/b", 1), ("a/b", 2), ("c", 3)] {
                let sequences = heard(&former, key, publisher);
                assert!(
                    sequences[0] <= 860 && sequences[0] > 850,
                    "{}",
                    sequences[0]
                );
                assert!(sequences.windows(2).all(|pair| pair[1] == pair[0] + 1));
                assert_eq!(sequences.last(), Some(&999));
            }
            assert_eq!(former.heard.len(), 3);
            assert!(former.heard.values().all(|heard| heard.torn != finish));
        }
    }

    #[test]
    fn wrenches_in_a_batch_count_one_by_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c-20261122T101613Z-000.mcap");
        let options = FileOptions {
            compress: true,
            pack: true,
        };
        let mut writer = RecordingWriter::create_with(&path, options).unwrap();
        let mut bytes = Vec::new();
        cdr::encode(&WrenchStamped::default(), &mut bytes).unwrap();
        for sequence in 0..100 {
            let record = Record {
                topic: "/wrench/raw",
                type_name: WrenchStamped::NAME,
                definition: None,
                publisher: [1; 16],
                sequence,
                log_time_ns: S,
                publish_time_ns: u64::from(sequence),
                bytes: &bytes,
            };
            writer.write(&record).unwrap();
        }
        writer.flush().unwrap();
        let former = Former::read(folder.path(), "c", 2 * S);
        assert_eq!(
            heard(&former, "wrench/raw", 1),
            (0..100).collect::<Vec<_>>()
        );
        assert_eq!((former.heard.len(), former.newest_ns), (1, S));
    }

    #[test]
    fn the_thousandth_file_of_a_run_is_newer_than_the_one_before() {
        let folder = tempfile::tempdir().unwrap();
        let names = [998, 999, 1000, 1001].map(|n| format!("c-20261122T101613Z-{n:03}.mcap"));
        for (tenth, name) in names.iter().enumerate() {
            write(
                folder.path(),
                name,
                tenth as u64 * 10,
                tenth as u64 * 10 + 10,
                true,
            );
        }
        let files = newest_files(folder.path(), "c");
        let expected: Vec<_> = names.iter().rev().map(|n| folder.path().join(n)).collect();
        assert_eq!(files, expected);
    }

    #[test]
    fn what_is_long_ago_is_no_former_recording() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), "c-20261122T101613Z-000.mcap", 0, 10, true);
        let former = Former::read(folder.path(), "c", 26 * S);
        assert_eq!((former.newest_ns, former.heard.len()), (0, 0));
    }

    #[test]
    fn a_file_that_is_cut_or_damaged_anywhere_is_read_as_far_as_it_goes() {
        let folder = tempfile::tempdir().unwrap();
        let path = write(folder.path(), "c-20261122T101613Z-000.mcap", 0, 3, true);
        let whole = fs::read(&path).unwrap();
        for cut in 0..whole.len() {
            fs::write(&path, &whole[..cut]).unwrap();
            Former::read(folder.path(), "c", 3 * S);
        }
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 0x80;
            fs::write(&path, &damaged).unwrap();
            Former::read(folder.path(), "c", 3 * S);
        }
    }
}
