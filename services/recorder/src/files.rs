//! What a recording needs of a file system: files that grow at their end, and a way to make them
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
    /// When the disk refuses.
    fn append(&self, bytes: &[u8]) -> io::Result<usize>;

    /// Returns when everything appended so far survives a power cut.
    ///
    /// # Errors
    /// When the disk refuses; then nothing is known of what was appended since the last success.
    fn sync(&self) -> io::Result<()>;
}

/// Where recordings are written: the system's files, or a test's.
pub(crate) trait Files: Send + Sync {
    /// Creates a file that must not exist, so that its name survives a power cut.
    ///
    /// # Errors
    /// When it exists or cannot be created.
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
        // Held while the file is written, so that no recorder takes it for torn or for old: it gets
        // its name when it is locked already. Where a file system knows no locks, recordings are
        // made all the same.
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

/// What a file is called until it is locked.
fn opening_path(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(OPENING);
    name.into()
}

/// End of such a name.
pub(crate) const OPENING: &str = ".opening";

/// Gives the file its name, which must be free.
fn name(opening: &Path, path: &Path) -> io::Result<()> {
    match fs::hard_link(opening, path) {
        Ok(()) => fs::remove_file(opening),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Err(error),
        // A file system without links.
        Err(_) if !path.exists() => fs::rename(opening, path),
        Err(error) => Err(error),
    }
}

/// Makes what was created, renamed and removed beside `path` survive a power cut. Some network file
/// systems cannot sync a folder; there the files' own syncs have to do.
pub(crate) fn sync_folder_of(path: &Path) {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let _ = File::open(folder).and_then(|folder| folder.sync_all());
}

/// True while a recorder, this one or another, writes the file.
pub(crate) fn is_being_written(path: &Path) -> bool {
    File::open(path)
        .is_ok_and(|file| matches!(file.try_lock_shared(), Err(fs::TryLockError::WouldBlock)))
}

/// Bytes that unprivileged users may still write in the folder; `None` when the system does not
/// say.
pub(crate) fn free_bytes(folder: &Path) -> Option<u64> {
    let stat = nix::sys::statvfs::statvfs(folder).ok()?;
    Some(stat.blocks_available() * stat.fragment_size())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recorder_never_mends_the_file_that_it_begins() {
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
            // Finished, as the one who looks sees it.
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
