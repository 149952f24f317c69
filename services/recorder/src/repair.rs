//! Mends recordings that a crash left without their end.

use std::fs::{self, File, TryLockError};
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use mcap::read::Options;
use mcap::records::Record as McapRecord;

use crate::RecorderError;
use crate::recording::WholeFile;
use crate::writer::{Record, RecordingWriter};

/// What a repair did.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repair {
    /// The mended file; the torn original stays beside it with `.torn` appended.
    pub path: PathBuf,
    /// Messages saved.
    pub messages: u64,
    /// Bytes at the end that belonged to no whole chunk.
    pub bytes_cut: u64,
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

/// True while another recorder writes the file.
fn is_being_written(path: &Path) -> bool {
    File::open(path)
        .is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
}

/// Mends every unfinished recording in `folder`, except those that another recorder is writing.
///
/// # Errors
/// When the folder cannot be listed or a file not be read or written; files mended before stay mended.
pub fn repair_folder(folder: &Path) -> Result<Vec<Repair>, RecorderError> {
    let mut repairs = Vec::new();
    let entries = fs::read_dir(folder).map_err(|source| RecorderError::io(folder, source))?;
    let mut paths: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|e| e == "mcap"))
        .collect();
    paths.sort();
    for path in paths {
        if !is_finished(&path)? && !is_being_written(&path) {
            repairs.push(repair(&path)?);
        }
    }
    Ok(repairs)
}

/// Rewrites one torn recording with everything in it that is whole, and puts the result in its place.
///
/// # Errors
/// When it cannot be read or the mended copy not be written; the original is untouched then.
pub fn repair(path: &Path) -> Result<Repair, RecorderError> {
    let whole = WholeFile::read(path)?;
    let bytes = whole.bytes();
    let mended_path = path.with_extension("mcap.mending");
    if mended_path.exists() {
        fs::remove_file(&mended_path).map_err(|source| RecorderError::io(&mended_path, source))?;
    }
    let fail = |source| RecorderError::mcap(&mended_path, source);
    let mut mended = RecordingWriter::create(&mended_path).map_err(fail)?;

    // Attachments and metadata stand between the chunks.
    if let Ok(records) =
        mcap::read::LinearReader::new_with_options(bytes, Options::IgnoreEndMagic.into())
    {
        for record in records.map_while(Result::ok) {
            match record {
                McapRecord::Attachment { header, data, .. } => {
                    let text = String::from_utf8_lossy(&data);
                    mended
                        .attach(&header.name, &text, header.log_time)
                        .map_err(fail)?;
                }
                McapRecord::Metadata(m) => mended.metadata(&m.name, m.metadata).map_err(fail)?,
                _ => {}
            }
        }
    }
    let mut payload = 0;
    for message in whole.messages().map_while(Result::ok) {
        payload += message.data.len() as u64;
        let schema = message.channel.schema.as_ref();
        let definition = schema
            .filter(|s| s.encoding == "ros2msg")
            .and_then(|s| std::str::from_utf8(&s.data).ok().map(str::to_owned));
        mended
            .write(&Record {
                topic: &message.channel.topic,
                type_name: schema.map_or("", |s| s.name.as_str()),
                definition: definition.as_deref(),
                sequence: message.sequence,
                log_time_ns: message.log_time,
                publish_time_ns: message.publish_time,
                bytes: &message.data,
            })
            .map_err(fail)?;
    }
    let messages = mended.messages();
    let mut entries = std::collections::BTreeMap::new();
    entries.insert("messages".to_owned(), messages.to_string());
    entries.insert("payload_bytes".to_owned(), payload.to_string());
    mended.metadata("repaired", entries).map_err(fail)?;
    mended.finish().map_err(fail)?;

    let torn = path.with_extension("mcap.torn");
    fs::rename(path, &torn).map_err(|source| RecorderError::io(path, source))?;
    fs::rename(&mended_path, path).map_err(|source| RecorderError::io(path, source))?;
    Ok(Repair {
        path: path.to_owned(),
        messages,
        bytes_cut: bytes.len() as u64 - whole.whole_bytes(),
    })
}
