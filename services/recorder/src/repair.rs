//! Mends recordings that a crash left without their end: streamed, one chunk in memory at a time.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use mcap::McapError;
use mcap::records::Record as McapRecord;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader};
use tangent_runtime::Stop;

use crate::RecorderError;
use crate::files::{OPENING, free_bytes, is_being_written, sync_folder_of};
use crate::message::Record;
use crate::publisher::of_channel;
use crate::recording::reader_options;
use crate::writer::{PUBLISHERS, RecordingWriter};

/// Bytes between two looks at the free space, the stop and the disk: what a mend leaves unsynced at
/// most.
const STRIDE: u64 = 4 << 20;

/// A file that is begun has its name long before that.
const OPENING_MAX: std::time::Duration = std::time::Duration::from_secs(60);

/// What a repair did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repair {
    /// The mended file; the torn original stays beside it with `.torn` appended.
    pub path: PathBuf,
    /// Messages saved.
    pub messages: u64,
    /// Bytes at the end that belonged to no whole chunk, or came after damage.
    pub bytes_cut: u64,
}

/// What keeps a repair within bounds.
pub(crate) struct Bounds<'a> {
    /// The disk keeps at least this much free, bytes.
    pub free_min_bytes: u64,
    /// Bytes free in a folder; `None` when unknown.
    pub free: &'a dyn Fn(&Path) -> Option<u64>,
    /// Ends the repair at once; what it has written is removed.
    pub stop: &'a Stop,
    /// Half of the time is left to others.
    pub gently: bool,
}

impl Bounds<'_> {
    /// Room for so many bytes more.
    fn check_room(&self, path: &Path, bytes: u64) -> Result<(), RecorderError> {
        let folder = path.parent().unwrap_or(Path::new("."));
        match (self.free)(folder) {
            Some(free) if free < self.free_min_bytes.saturating_add(bytes) => {
                Err(RecorderError::NoRoom {
                    path: path.to_owned(),
                    free_mb: free >> 20,
                    needed_mb: bytes.div_ceil(1 << 20),
                    kept_mb: self.free_min_bytes >> 20,
                })
            }
            _ => Ok(()),
        }
    }
}

/// True when the file ends as a finished MCAP file does.
///
/// # Errors
/// When the file cannot be read.
pub fn is_finished(path: &Path) -> Result<bool, RecorderError> {
    let fail = |source| RecorderError::io(path, source);
    let mut file = File::open(path).map_err(fail)?;
    let magic = mcap::MAGIC.len() as u64;
    if file.metadata().map_err(fail)?.len() < 2 * magic {
        return Ok(false);
    }
    file.seek(SeekFrom::End(-(magic as i64))).map_err(fail)?;
    let mut end = [0; mcap::MAGIC.len()];
    file.read_exact(&mut end).map_err(fail)?;
    Ok(end == *mcap::MAGIC)
}

/// Unfinished recordings of a folder, oldest first, except those that a recorder is writing.
///
/// # Errors
/// When the folder cannot be listed or a file not be read.
pub(crate) fn torn_files(folder: &Path) -> Result<Vec<PathBuf>, RecorderError> {
    let entries = fs::read_dir(folder).map_err(|source| RecorderError::io(folder, source))?;
    let mut torn = Vec::new();
    for entry in entries.filter_map(Result::ok) {
        let path = entry.path();
        if path.extension().is_some_and(|e| e == "mcap")
            // In this order: nobody goes on with what nobody writes.
            && !is_being_written(&path)
            && !is_finished(&path)?
        {
            torn.push(path);
        }
    }
    torn.sort();
    Ok(torn)
}

/// Clears away what a mend left that was itself killed: a complete copy takes its place, a partial
/// one goes.
///
/// # Errors
/// When the folder cannot be listed or changed.
pub(crate) fn clear_mends(folder: &Path) -> Result<(), RecorderError> {
    let entries = fs::read_dir(folder).map_err(|source| RecorderError::io(folder, source))?;
    for entry in entries.filter_map(Result::ok) {
        let copy = entry.path();
        if was_being_opened(&copy) {
            // Killed before it had its name: nothing is in it.
            let _ = fs::remove_file(&copy);
        }
        if copy.extension().is_none_or(|e| e != "mending") || is_being_written(&copy) {
            continue;
        }
        let place = copy.with_extension("");
        // Without links, the place is empty for a moment.
        let cleared = if !place.exists() && torn_path(&place).exists() && is_finished(&copy)? {
            fs::rename(&copy, &place)
        } else {
            fs::remove_file(&copy)
        };
        cleared.map_err(|source| RecorderError::io(&copy, source))?;
    }
    Ok(())
}

/// Left by a recorder that was killed while it began a file, for so long that it cannot be about to
/// go on.
fn was_being_opened(path: &Path) -> bool {
    let age = || fs::metadata(path).ok()?.modified().ok()?.elapsed().ok();
    path.to_string_lossy().ends_with(OPENING)
        && age().is_some_and(|age| age > OPENING_MAX)
        && !is_being_written(path)
}

/// Mends every unfinished recording in `folder`, except those that another recorder is writing.
///
/// # Errors
/// When the folder cannot be listed or a file not be read or written; files mended before stay
/// mended.
pub fn repair_folder(folder: &Path) -> Result<Vec<Repair>, RecorderError> {
    torn_files(folder)?
        .iter()
        .map(|path| repair(path))
        .collect()
}

/// Rewrites one torn recording with everything in it that is whole, and puts the result in its
/// place.
///
/// # Errors
/// When it cannot be read or the mended copy not be written; the original is untouched then.
pub fn repair(path: &Path) -> Result<Repair, RecorderError> {
    let bounds = Bounds {
        free_min_bytes: 0,
        free: &free_bytes,
        stop: &Stop::new(),
        gently: false,
    };
    repair_within(path, &bounds)
}

/// Mends within bounds.
///
/// # Errors
/// As [`repair`], [`RecorderError::NoRoom`] and [`RecorderError::Stopped`]; the original is
/// untouched then, and nothing else is left.
pub(crate) fn repair_within(path: &Path, bounds: &Bounds<'_>) -> Result<Repair, RecorderError> {
    let fail = |source| RecorderError::io(path, source);
    let mut file = File::open(path).map_err(fail)?;
    let length = file.metadata().map_err(fail)?.len();
    let whole = whole_length(&mut file, length).map_err(fail)?;
    if whole == 0 && !was_never_synced(&mut file).map_err(fail)? {
        return Err(RecorderError::mcap(path, McapError::BadMagic));
    }
    // The copy is hardly ever larger than what it is made of.
    bounds.check_room(path, whole)?;

    let mended_path = mending_path(path);
    if mended_path.exists() {
        if is_being_written(&mended_path) {
            return Err(RecorderError::io(
                &mended_path,
                io::Error::new(
                    io::ErrorKind::AlreadyExists,
                    "another recorder mends it now",
                ),
            ));
        }
        fs::remove_file(&mended_path).map_err(|source| RecorderError::io(&mended_path, source))?;
    }
    let copied = copy(path, whole, &mended_path, bounds).and_then(|copied| {
        put_in_place(path, &mended_path)
            .map_err(|source| RecorderError::io(path, source))
            .map(|()| copied)
    });
    match copied {
        Ok((messages, read)) => Ok(Repair {
            path: path.to_owned(),
            messages,
            bytes_cut: length - read,
        }),
        Err(error) => {
            // The next try makes its own.
            let _ = fs::remove_file(&mended_path);
            Err(error)
        }
    }
}

/// Where a mend is written until it is complete.
pub(crate) fn mending_path(path: &Path) -> PathBuf {
    path.with_extension("mcap.mending")
}

/// Where the original of a mended file is kept.
pub(crate) fn torn_path(path: &Path) -> PathBuf {
    path.with_extension("mcap.torn")
}

/// The original gets a second name before the mended file takes its first: there is no moment
/// without either.
fn put_in_place(path: &Path, mended: &Path) -> io::Result<()> {
    let torn = torn_path(path);
    match fs::remove_file(&torn) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    if fs::hard_link(path, &torn).is_err() {
        // A file system without links.
        fs::rename(path, &torn)?;
    }
    fs::rename(mended, path)?;
    sync_folder_of(path);
    Ok(())
}

/// Length of the longest prefix that ends with a whole record; seeks from record to record and
/// reads none.
fn whole_length(file: &mut File, length: u64) -> io::Result<u64> {
    const HEADER: usize = 9;
    let mut magic = [0; mcap::MAGIC.len()];
    if length < magic.len() as u64 {
        return Ok(0);
    }
    file.read_exact(&mut magic)?;
    if magic != *mcap::MAGIC {
        return Ok(0);
    }
    let mut at = magic.len() as u64;
    while at + HEADER as u64 <= length {
        let mut header = [0; HEADER];
        file.seek(SeekFrom::Start(at))?;
        file.read_exact(&mut header)?;
        let size = u64::from_le_bytes(
            header[1..]
                .try_into()
                .expect("a record's length has eight bytes"),
        );
        match size
            .checked_add(at + HEADER as u64)
            .filter(|&end| end <= length)
        {
            Some(end) => at = end,
            None => break,
        }
    }
    Ok(at)
}

/// True when the power went during the first sync, before the first record was taken: of the header
/// came a part at most, and the rest of the file has its length and reads as zeros.
fn was_never_synced(file: &mut File) -> io::Result<bool> {
    file.rewind()?;
    let mut bytes = BufReader::with_capacity(1 << 16, file).bytes();
    for expected in mcap::MAGIC {
        match bytes.next().transpose()? {
            None => return Ok(true),
            Some(byte) if byte == *expected => {}
            Some(0) => break,
            Some(_) => return Ok(false),
        }
    }
    for byte in bytes {
        if byte? != 0 {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Copies everything up to the first damage. Messages copied, and bytes of the original they were
/// read from.
fn copy(
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
    let mut looked = 0;
    let mut looked_at = std::time::Instant::now();
    // Of the original: read so far, and up to the newest record or chunk that was whole.
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
            // Damage: what comes before it is saved.
            Err(_) => break,
        }
        if bounds.stop.is_stopped() {
            return Err(RecorderError::Stopped {
                path: path.to_owned(),
            });
        }
        if copy.writer.bytes() - looked >= STRIDE {
            copy.writer.sync().map_err(fail)?;
            looked = copy.writer.bytes();
            // What may still come before the next look.
            bounds.check_room(path, 2 * STRIDE)?;
            if bounds.gently {
                bounds.stop.wait(looked_at.elapsed());
                looked_at = std::time::Instant::now();
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

/// Records of the original on their way into the copy.
struct Copy {
    writer: RecordingWriter,
    /// Name, and text of the definition where there is one.
    schemas: HashMap<u16, (String, Option<String>)>,
    /// Topic, schema and publisher.
    channels: HashMap<u16, (String, u16, [u8; 16])>,
    payload: u64,
}

impl Copy {
    /// False when the record cannot belong to a recording: damage that no checksum saw.
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
            // The copy numbers its channels anew.
            McapRecord::Metadata(m) if m.name == PUBLISHERS => {}
            McapRecord::Metadata(m) => self.writer.metadata(&m.name, m.metadata)?,
            _ => {}
        }
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    use crate::Recording;

    /// A torn file of about so many mebibytes that cannot be compressed; its messages.
    fn torn(folder: &Path, mebibytes: usize) -> (PathBuf, u64) {
        let path = folder.join("cell1-20261122T101613Z-000.mcap");
        let mut writer = RecordingWriter::create(&path).unwrap();
        writer.attach("cell.toml", "[cell]", 1).unwrap();
        let mut noise = vec![0; 1 << 16];
        let mut state = 1u64;
        for i in 0..16 * mebibytes as u64 {
            for byte in &mut noise {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                *byte = (state >> 56) as u8;
            }
            writer
                .write(&Record {
                    publisher: [0; 16],
                    topic: "/noise",
                    type_name: "std_msgs/msg/Header",
                    definition: Some("uint8[] data\n"),
                    sequence: i as u32,
                    log_time_ns: i,
                    publish_time_ns: i,
                    bytes: &noise,
                })
                .unwrap();
        }
        writer.flush().unwrap();
        let messages = writer.messages();
        drop(writer);
        let file = File::options().write(true).open(&path).unwrap();
        // Dropping a writer writes an end: cut it off, and some of the last chunk's index.
        let length = file.metadata().unwrap().len();
        file.set_len(length - 600).unwrap();
        (path, messages)
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// Mends with so much free at each look; what came of it, and the number of looks.
    fn mend(
        path: &Path,
        free_min_bytes: u64,
        free: impl Fn(usize, &Stop) -> u64,
    ) -> (Result<Repair, RecorderError>, usize) {
        let stop = Stop::new();
        let looks = Cell::new(0);
        let free = |_: &Path| {
            looks.set(looks.get() + 1);
            Some(free(looks.get(), &stop))
        };
        let bounds = Bounds {
            free_min_bytes,
            free: &free,
            stop: &stop,
            gently: false,
        };
        (repair_within(path, &bounds), looks.get())
    }

    #[test]
    fn a_mend_never_starts_nor_goes_on_below_what_is_kept_free() {
        let folder = tempfile::tempdir().unwrap();
        let (path, messages) = torn(folder.path(), 16);
        let original = fs::read(&path).unwrap();
        let left = [path.file_name().unwrap().to_str().unwrap().to_owned()];
        const KEPT: u64 = 64 << 20;
        // Room for the present, none for the copy.
        let (outcome, looks) = mend(&path, KEPT, |_, _| KEPT + (1 << 20));
        let error = outcome.unwrap_err().to_string();
        assert!(
            error.contains("keep_bytes") && error.contains("[recorder] folder"),
            "{error}"
        );
        assert_eq!(looks, 1, "it has begun");
        // Others fill the disk while it mends.
        let (outcome, looks) = mend(&path, KEPT, |look, _| {
            KEPT + if look < 3 { 32 << 20 } else { STRIDE }
        });
        assert!(matches!(outcome, Err(RecorderError::NoRoom { .. })));
        assert_eq!(looks, 3, "it went on for longer");
        assert_eq!(names(folder.path()), left);
        assert!(fs::read(&path).unwrap() == original);
        let (outcome, looks) = mend(&path, KEPT, |_, _| KEPT + (32 << 20));
        assert_eq!(outcome.unwrap().messages, messages);
        assert!(looks > 3, "{looks} looks at the free space in 16 MiB");
        let mended = Recording::open(&path).unwrap();
        assert!(!mended.is_truncated());
        assert_eq!(mended.messages().count() as u64, messages);
        assert_eq!(mended.attachments()["cell.toml"], "[cell]");
        assert!(fs::read(torn_path(&path)).unwrap() == original);
    }

    #[test]
    fn a_stop_ends_a_mend_at_once_and_leaves_the_original_alone() {
        let folder = tempfile::tempdir().unwrap();
        let (path, _) = torn(folder.path(), 16);
        let (outcome, looks) = mend(&path, 0, |look, stop| {
            if look == 2 {
                stop.trigger();
            }
            u64::MAX
        });
        assert!(matches!(outcome, Err(RecorderError::Stopped { .. })));
        assert_eq!(looks, 2, "it went on after the stop");
        assert_eq!(names(folder.path()).len(), 1);
        assert!(!is_finished(&path).unwrap());
    }

    #[test]
    fn what_a_killed_mend_leaves_is_cleared_away() {
        let folder = tempfile::tempdir().unwrap();
        let (path, messages) = torn(folder.path(), 1);
        fs::write(mending_path(&path), b"partial").unwrap();
        clear_mends(folder.path()).unwrap();
        assert_eq!(names(folder.path()).len(), 1);
        repair(&path).unwrap();
        // As on a file system without links, killed between the two renames.
        fs::rename(&path, mending_path(&path)).unwrap();
        clear_mends(folder.path()).unwrap();
        let mended = Recording::open(&path).unwrap();
        assert_eq!(mended.messages().count() as u64, messages);
        assert!(torn_path(&path).exists());
    }

    #[test]
    fn what_is_no_recording_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notes.mcap");
        let others: [&[u8]; 4] = [
            b"something else altogether",
            b"notes",
            b"\x89MCAP and more",
            b"\0\0\0\0\0\0\0\0\0\0\0\0not zeros all the way",
        ];
        for bytes in others {
            fs::write(&path, bytes).unwrap();
            let error = repair(&path).unwrap_err().to_string();
            assert!(error.contains("notes.mcap"), "{error}");
            assert_eq!(names(folder.path()), ["notes.mcap"]);
        }
    }

    #[test]
    fn a_file_whose_first_sync_a_power_cut_ended_becomes_a_recording_of_nothing() {
        for (magic, zeros) in [(0, 0), (3, 0), (0, 5), (0, 9), (3, 2000), (7, 100_000)] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("cell1-20261122T101613Z-000.mcap");
            let mut bytes = mcap::MAGIC[..magic].to_vec();
            bytes.resize(magic + zeros, 0);
            fs::write(&path, &bytes).unwrap();
            let mended = repair(&path).unwrap();
            assert_eq!(
                (mended.messages, mended.bytes_cut),
                (0, bytes.len() as u64),
                "{magic} bytes and {zeros} zeros"
            );
            let recording = Recording::open(&path).unwrap();
            assert!(!recording.is_truncated());
            assert_eq!(recording.messages().count(), 0);
            assert!(fs::read(torn_path(&path)).unwrap() == bytes);
        }
    }
}
