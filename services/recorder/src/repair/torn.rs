//! Detection of truncated files and of remains of interrupted repairs.

use std::fs::{self, File};
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::torn_path;
use crate::RecorderError;
use crate::files::{OPENING, is_being_written};

/// Time after which a file that is being opened must have its name.
const OPENING_MAX: Duration = Duration::from_secs(60);

/// Whether the file ends like a complete MCAP file.
///
/// # Errors
/// The file cannot be read.
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
/// The folder cannot be listed, or a file cannot be read.
pub(crate) fn torn_files(folder: &Path) -> Result<Vec<PathBuf>, RecorderError> {
    let entries = fs::read_dir(folder).map_err(|source| RecorderError::io(folder, source))?;
    let mut torn = Vec::new();
    for entry in entries.filter_map(Result::ok) {
        let path = entry.path();
        if path.extension().is_some_and(|e| e == "mcap")
            // In this order, because a file that no recorder writes does not grow any more.
            && !is_being_written(&path)
            && !is_finished(&path)?
        {
            torn.push(path);
        }
    }
    torn.sort();
    Ok(torn)
}

/// Removes the remains of repairs that were killed. A complete copy takes the place of a missing
/// recording; any other copy is removed.
///
/// # Errors
/// The folder cannot be listed or changed.
pub(crate) fn clear_mends(folder: &Path) -> Result<(), RecorderError> {
    let entries = fs::read_dir(folder).map_err(|source| RecorderError::io(folder, source))?;
    for entry in entries.filter_map(Result::ok) {
        let copy = entry.path();
        if was_being_opened(&copy) {
            // A recorder was killed before it had named the file; the file is empty.
            let _ = fs::remove_file(&copy);
        }
        if copy.extension().is_none_or(|e| e != "mending") || is_being_written(&copy) {
            continue;
        }
        let place = copy.with_extension("");
        // On a file system without links, the recording is missing between two renames.
        let cleared = if !place.exists() && torn_path(&place).exists() && is_finished(&copy)? {
            fs::rename(&copy, &place)
        } else {
            fs::remove_file(&copy)
        };
        cleared.map_err(|source| RecorderError::io(&copy, source))?;
    }
    Ok(())
}

/// Whether the file was left by a recorder that was killed while it opened the file.
fn was_being_opened(path: &Path) -> bool {
    let age = || fs::metadata(path).ok()?.modified().ok()?.elapsed().ok();
    path.to_string_lossy().ends_with(OPENING)
        && age().is_some_and(|age| age > OPENING_MAX)
        && !is_being_written(path)
}

/// Length of the longest prefix that ends with a complete record. Seeks from record to record
/// without reading their content.
pub(super) fn whole_length(file: &mut File, length: u64) -> io::Result<u64> {
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

/// Whether the power failed during the first sync, before any record was written: the file contains
/// at most a part of the header, followed by zeros.
pub(super) fn was_never_synced(file: &mut File) -> io::Result<bool> {
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
