//! Deletes the oldest recordings of a folder, according to limits of total size and age.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use crate::files::{is_being_written, sync_folder_of};
use crate::repair::mending_path;
use crate::{RecorderConfig, RecorderError};

/// Limits of a folder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Budget {
    /// Total size of all recordings and torn copies, bytes; `None`: unlimited.
    pub bytes: Option<u64>,
    /// Time since a file was last written; `None`: unlimited.
    pub age: Option<Duration>,
}

impl Budget {
    pub(crate) fn of(config: &RecorderConfig) -> Self {
        Self {
            bytes: config.keep_bytes,
            age: config.keep_for,
        }
    }
}

/// One file of the folder that a recorder wrote.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Kept {
    path: PathBuf,
    bytes: u64,
    /// Part of the name that orders files: UTC, the number in its run, and a torn original before
    /// its repaired copy.
    order: String,
    modified: SystemTime,
    /// Whether it is being written or repaired.
    busy: bool,
}

/// Deletes files beyond the limits, and returns them. Only files named like recordings are deleted:
/// `NAME-YYYYMMDDThhmmssZ-NNN.mcap` and `.mcap.torn`. A file that is being written or repaired is
/// never deleted.
///
/// # Errors
/// The folder cannot be listed. A file that cannot be deleted is logged, and tried again later.
pub(crate) fn apply(
    folder: &Path,
    budget: Budget,
    now: SystemTime,
) -> Result<Vec<PathBuf>, RecorderError> {
    if budget.bytes.is_none() && budget.age.is_none() {
        return Ok(Vec::new());
    }
    let files = list(folder)?;
    let mut deleted = Vec::new();
    for file in surplus(&files, budget, now) {
        match fs::remove_file(&file.path) {
            Ok(()) => {
                tracing::info!(
                    "{} deleted: it exceeds [recorder] keep_bytes or keep_days",
                    file.path.display()
                );
                deleted.push(file.path.clone());
            }
            Err(error) => tracing::warn!(
                "{} cannot be deleted ({error}): the folder holds more than [recorder] keep_bytes or keep_days allows; \
                 let this user delete files in it",
                file.path.display()
            ),
        }
    }
    if let Some(one) = deleted.first() {
        sync_folder_of(one);
    }
    Ok(deleted)
}

fn list(folder: &Path) -> Result<Vec<Kept>, RecorderError> {
    let entries = fs::read_dir(folder).map_err(|source| RecorderError::io(folder, source))?;
    let mut files: Vec<Kept> = entries
        .filter_map(|entry| {
            let path = entry.ok()?.path();
            let order = order_of(path.file_name()?.to_str()?)?;
            let about = fs::symlink_metadata(&path)
                .ok()
                .filter(fs::Metadata::is_file)?;
            let busy = is_being_written(&path) || is_being_written(&mending_path(&path));
            Some(Kept {
                bytes: about.len(),
                modified: about.modified().unwrap_or(SystemTime::UNIX_EPOCH),
                order,
                path,
                busy,
            })
        })
        .collect();
    files.sort_by(|a, b| a.order.cmp(&b.order));
    Ok(files)
}

const TORN: char = 'a';
const WHOLE: char = 'b';

/// What orders a recording among others by its name; `None` for every other name.
pub(crate) fn order_of(name: &str) -> Option<String> {
    let (stem, kind) = match name.strip_suffix(".mcap.torn") {
        Some(stem) => (stem, TORN),
        None => (name.strip_suffix(".mcap")?, WHOLE),
    };
    let (rest, number) = stem.rsplit_once('-')?;
    let (_, utc) = rest.rsplit_once('-')?;
    let digits = |text: &str| text.bytes().all(|b| b.is_ascii_digit());
    let (date, time) = utc.strip_suffix('Z')?.split_once('T')?;
    let named = number.len() >= 3
        && digits(number)
        && date.len() == 8
        && digits(date)
        && time.len() == 6
        && digits(time);
    named.then(|| format!("{utc}-{number:0>10}{kind}"))
}

/// Files beyond the limits, oldest first.
fn surplus(files: &[Kept], budget: Budget, now: SystemTime) -> Vec<&Kept> {
    let mut held: u64 = files.iter().map(|file| file.bytes).sum();
    files
        .iter()
        .filter(|file| {
            let old = budget.age.is_some_and(|age| {
                // A file from the future is not old: the clock was set back.
                now.duration_since(file.modified)
                    .is_ok_and(|since| since > age)
            });
            let much = budget.bytes.is_some_and(|bytes| held > bytes);
            let goes = !file.busy && (old || much);
            if goes {
                held -= file.bytes;
            }
            goes
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RecordingWriter;

    const DAY: Duration = Duration::from_secs(86_400);

    fn budget(bytes: Option<u64>, age: Option<Duration>) -> Budget {
        Budget { bytes, age }
    }

    fn put(folder: &Path, name: &str, bytes: usize, age: Duration) -> PathBuf {
        let path = folder.join(name);
        fs::write(&path, vec![0; bytes]).unwrap();
        let file = fs::File::options().write(true).open(&path).unwrap();
        file.set_modified(SystemTime::now() - age).unwrap();
        path
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn only_names_of_recordings_are_ordered_by_time_across_cells() {
        for other in [
            "notes.mcap",
            "cell1-20261122T101613Z-000.html",
            "cell1-20261122T101613Z-000.mcap.mending",
            "best-of-20261122.mcap",
            "cell1-20261122T101613Z-abc.mcap",
        ] {
            assert_eq!(order_of(other), None, "{other}");
        }
        let order = |name: &str| order_of(name).unwrap();
        assert!(order("z-cell-20261122T101613Z-000.mcap") < order("a-20261122T101614Z-000.mcap"));
        assert!(order("a-20261122T101613Z-999.mcap") < order("a-20261122T101613Z-1000.mcap"));
        assert!(order("a-20261122T101613Z-000.mcap.torn") < order("a-20261122T101613Z-000.mcap"));
    }

    #[test]
    fn the_oldest_go_until_the_bytes_fit_and_torn_copies_count() {
        let folder = tempfile::tempdir().unwrap();
        let old = Duration::from_secs(60);
        put(folder.path(), "notes.mcap", 5000, 400 * DAY);
        put(folder.path(), "b-20261101T000000Z-000.mcap", 1000, old);
        put(folder.path(), "b-20261102T000000Z-000.mcap.torn", 1000, old);
        put(folder.path(), "b-20261102T000000Z-000.mcap", 900, old);
        put(folder.path(), "a-20261103T000000Z-000.mcap", 1000, old);
        let keep =
            |bytes| apply(folder.path(), budget(Some(bytes), None), SystemTime::now()).unwrap();
        assert_eq!(keep(3900), Vec::<PathBuf>::new());
        // Without the torn copy counted, 2900 bytes would fit.
        assert_eq!(keep(2899).len(), 2);
        assert_eq!(
            names(folder.path()),
            [
                "a-20261103T000000Z-000.mcap",
                "b-20261102T000000Z-000.mcap",
                "notes.mcap"
            ]
        );
        keep(0);
        assert_eq!(names(folder.path()), ["notes.mcap"]);
    }

    #[test]
    fn what_is_too_old_goes_and_a_clock_that_was_set_back_costs_nothing() {
        let folder = tempfile::tempdir().unwrap();
        put(folder.path(), "a-20261101T000000Z-000.mcap", 10, 8 * DAY);
        put(folder.path(), "a-20261102T000000Z-000.mcap", 10, 6 * DAY);
        let week = budget(None, Some(7 * DAY));
        let past = SystemTime::now() - 365 * DAY;
        assert!(apply(folder.path(), week, past).unwrap().is_empty());
        apply(folder.path(), week, SystemTime::now()).unwrap();
        assert_eq!(names(folder.path()), ["a-20261102T000000Z-000.mcap"]);
        apply(folder.path(), budget(None, None), SystemTime::now()).unwrap();
        assert_eq!(names(folder.path()).len(), 1);
    }

    #[test]
    fn a_file_that_is_being_written_is_never_deleted() {
        let folder = tempfile::tempdir().unwrap();
        let running = folder.path().join("a-20261101T000000Z-000.mcap");
        let writer = RecordingWriter::create(&running).unwrap();
        put(folder.path(), "a-20261102T000000Z-000.mcap", 10, 2 * DAY);
        let nothing = budget(Some(0), Some(Duration::ZERO));
        apply(folder.path(), nothing, SystemTime::now()).unwrap();
        assert_eq!(names(folder.path()), ["a-20261101T000000Z-000.mcap"]);
        writer.finish().unwrap();
        apply(folder.path(), nothing, SystemTime::now() + DAY).unwrap();
        assert!(names(folder.path()).is_empty());
    }
}
