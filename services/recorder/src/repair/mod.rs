//! Repair of recordings that a crash left without their end. One chunk at a time is in memory.
//!
//! The keeper calls it while the recorder runs. A copy of everything before the
//! first damage takes the place of the truncated file, which is kept beside it.

mod bounds;
mod copy;
mod torn;

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use mcap::McapError;
use tangent_runtime::Stop;

pub(crate) use self::bounds::Bounds;
use self::copy::copy;
pub use self::torn::is_finished;
pub(crate) use self::torn::{clear_mends, torn_files};
use self::torn::{was_never_synced, whole_length};
use crate::RecorderError;
use crate::files::{free_bytes, is_being_written, sync_folder_of};

/// Number of bytes between two checks of the free space, the stop and the disk. No more than that
/// is unsynced at any time.
const STRIDE: u64 = 4 << 20;

/// Result of a repair.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repair {
    /// The repaired file. The truncated original is kept beside it, with `.torn` appended.
    pub path: PathBuf,
    /// Number of messages saved.
    pub messages: u64,
    /// Number of bytes at the end that belonged to no complete chunk or followed damage.
    pub bytes_cut: u64,
}

/// Repairs every unfinished recording in `folder`, except those that another recorder is writing.
///
/// # Errors
/// The folder cannot be listed, or a file cannot be read or written. Files repaired before stay
/// repaired.
pub fn repair_folder(folder: &Path) -> Result<Vec<Repair>, RecorderError> {
    torn_files(folder)?
        .iter()
        .map(|path| repair(path))
        .collect()
}

/// Replaces one truncated recording by a copy of everything in it that is complete.
///
/// # Errors
/// The file cannot be read, or the copy cannot be written. The original is then unchanged.
pub fn repair(path: &Path) -> Result<Repair, RecorderError> {
    let bounds = Bounds {
        free_min_bytes: 0,
        free: &free_bytes,
        stop: &Stop::new(),
        gently: false,
    };
    repair_within(path, &bounds)
}

/// Repairs one truncated recording within bounds.
///
/// # Errors
/// Those of [`repair`], [`RecorderError::NoRoom`] and [`RecorderError::Stopped`]. The original is
/// then unchanged, and no partial copy is left.
pub(crate) fn repair_within(path: &Path, bounds: &Bounds<'_>) -> Result<Repair, RecorderError> {
    let fail = |source| RecorderError::io(path, source);
    let mut file = File::open(path).map_err(fail)?;
    let length = file.metadata().map_err(fail)?.len();
    let whole = whole_length(&mut file, length).map_err(fail)?;
    if whole == 0 && !was_never_synced(&mut file).map_err(fail)? {
        return Err(RecorderError::mcap(path, McapError::BadMagic));
    }
    // The copy is rarely larger than the original.
    bounds.check_room(path, whole)?;

    let mended_path = mending_path(path);
    if mended_path.exists() {
        if is_being_written(&mended_path) {
            return Err(RecorderError::io(
                &mended_path,
                io::Error::new(
                    io::ErrorKind::AlreadyExists,
                    "another recorder is repairing it",
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
            // The next repair starts with a new copy.
            let _ = fs::remove_file(&mended_path);
            Err(error)
        }
    }
}

/// Path of the copy until it is complete.
pub(crate) fn mending_path(path: &Path) -> PathBuf {
    path.with_extension("mcap.mending")
}

/// Path under which the original of a repaired file is kept.
pub(crate) fn torn_path(path: &Path) -> PathBuf {
    path.with_extension("mcap.torn")
}

/// Gives the original a second name before the copy takes its first, so that one of both exists at
/// any time.
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

#[cfg(test)]
mod tests;
