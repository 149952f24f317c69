//! File system operations of a recording: files that grow at their end, and syncs that make them
//! survive a power cut.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A file that is written from its beginning to its end.
pub(crate) trait OpenFile: Send + Sync {
    /// Appends some of the bytes and returns how many. They survive the end of the process, not a
    /// power cut.
    ///
    /// # Errors
    /// The disk refuses.
    fn append(&self, bytes: &[u8]) -> io::Result<usize>;

    /// Returns when everything appended so far survives a power cut.
    ///
    /// # Errors
    /// The disk refuses; the state of the data appended since the last success is then unknown.
    fn sync(&self) -> io::Result<()>;
}

/// Place where recordings are written: the operating system's files, or those of a test.
pub(crate) trait Files: Send + Sync {
    /// Creates a file that must not exist, so that its name survives a power cut.
    ///
    /// # Errors
    /// The file exists or cannot be created.
    fn create(&self, path: &Path) -> io::Result<Arc<dyn OpenFile>>;
}

/// The operating system's files.
pub(crate) struct SystemFiles;

impl OpenFile for File {
    fn append(&self, bytes: &[u8]) -> io::Result<usize> {
        io::Write::write(&mut &*self, bytes)
    }

    fn sync(&self) -> io::Result<()> {
        self.sync_data()
    }
}

impl Files for SystemFiles {
    fn create(&self, path: &Path) -> io::Result<Arc<dyn OpenFile>> {
        let opening = opening_path(path);
        let file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&opening)?;
        // The lock is held while the file is written, so that no recorder repairs or deletes it.
        // The file is locked before it gets its name. On a file system without locks, recordings
        // are made without them.
        let _ = file.try_lock();
        let named = name(&opening, path);
        if named.is_err() {
            let _ = fs::remove_file(&opening);
        }
        named?;
        sync_folder_of(path);
        Ok(Arc::new(file))
    }
}

/// Name of a file until it is locked.
fn opening_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(OPENING);
    name.into()
}

/// End of the name until the file is locked.
pub(crate) const OPENING: &str = ".opening";

/// Gives the file its final name, which must not exist.
fn name(opening: &Path, path: &Path) -> io::Result<()> {
    match fs::hard_link(opening, path) {
        Ok(()) => fs::remove_file(opening),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Err(error),
        // The file system has no hard links.
        Err(_) if !path.exists() => fs::rename(opening, path),
        Err(error) => Err(error),
    }
}

/// Makes files created, renamed or removed beside `path` survive a power cut. Some network file
/// systems cannot sync a folder; there, only the files themselves are synced.
pub(crate) fn sync_folder_of(path: &Path) {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let _ = File::open(folder).and_then(|folder| folder.sync_all());
}

/// Whether a recorder, this one or another, is writing the file.
pub(crate) fn is_being_written(path: &Path) -> bool {
    File::open(path)
        .is_ok_and(|file| matches!(file.try_lock_shared(), Err(fs::TryLockError::WouldBlock)))
}

/// Bytes that unprivileged users may still write in the folder; `None` if the system does not state
/// it.
pub(crate) fn free_bytes(folder: &Path) -> Option<u64> {
    let stat = nix::sys::statvfs::statvfs(folder).ok()?;
    Some(stat.blocks_available() * stat.fragment_size())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recorder_never_repairs_the_file_that_it_begins() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().to_owned();
        let looking = std::thread::spawn(move || {
            let mut found = Vec::new();
            while !place.join("end").exists() {
                found.extend(crate::repair::torn_files(&place).unwrap());
            }
            found
        });
        for i in 0..500 {
            let path = folder.path().join(format!("c-{i}.mcap"));
            let file = SystemFiles.create(&path).unwrap();
            assert!(is_being_written(&path));
            assert!(SystemFiles.create(&path).is_err(), "the name is taken");
            // A reader sees a complete file.
            file.append(mcap::MAGIC).unwrap();
            file.append(mcap::MAGIC).unwrap();
        }
        fs::write(folder.path().join("end"), b"").unwrap();
        let found = looking.join().unwrap();
        assert_eq!(found, Vec::<PathBuf>::new());
        let names = fs::read_dir(folder.path()).unwrap();
        assert_eq!(names.count(), 501, "something is left");
    }
}
