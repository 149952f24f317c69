//! Opens, rotates and closes the files of a recording, and retries while the disk refuses.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::config::RecorderConfig;
use crate::error::RecorderError;
use crate::files::{Files, SystemFiles, free_bytes};
use crate::latched::Latched;
use crate::message::Record;
use crate::utc_name::utc_name;
use crate::writer::RecordingWriter;

/// The file being written, or why there is none.
enum State {
    Closed,
    Open {
        writer: Box<RecordingWriter>,
        opened: Instant,
        flushed: Instant,
    },
    Refused {
        reason: String,
        since: Instant,
    },
}

/// Writes records to rotating files. It never gives up: after an error it tries again.
pub struct Disk {
    config: RecorderConfig,
    system: Arc<dyn Files>,
    state: State,
    /// Number of files of this run.
    files: u32,
    finished: Vec<PathBuf>,
    dropped: u64,
    written: u64,
    /// Messages written to the present file but not synced; lost if the disk fails now.
    unsynced: u64,
    /// Start of the newest sync. A new file is synced as soon as the previous one would have been.
    flushed: Option<Instant>,
    /// Duration of the newest sync.
    sync_took: Duration,
    /// Metadata tables that every file of this run gets at its start.
    tables: BTreeMap<String, BTreeMap<String, String>>,
    /// Newest messages that every later file of this run begins with.
    latched: Latched,
    /// Metadata tables that every file gets at its end.
    last_words: BTreeMap<String, BTreeMap<String, String>>,
}

/// Pause between attempts while the disk refuses.
const RETRY: Duration = Duration::from_secs(2);

impl Disk {
    /// Creates the folder.
    ///
    /// # Errors
    /// The folder does not exist and cannot be created.
    pub fn open(config: RecorderConfig) -> Result<Self, RecorderError> {
        Self::open_on(config, Arc::new(SystemFiles))
    }

    pub(crate) fn open_on(
        config: RecorderConfig,
        system: Arc<dyn Files>,
    ) -> Result<Self, RecorderError> {
        fs::create_dir_all(&config.folder)
            .map_err(|source| RecorderError::io(&config.folder, source))?;
        Ok(Self {
            config,
            system,
            state: State::Closed,
            files: 0,
            finished: Vec::new(),
            dropped: 0,
            written: 0,
            unsynced: 0,
            flushed: None,
            sync_took: Duration::ZERO,
            tables: BTreeMap::new(),
            latched: Latched::default(),
            last_words: BTreeMap::new(),
        })
    }

    /// Writes one record; drops and counts it while the disk refuses.
    pub fn take(&mut self, record: &Record<'_>, now: Instant) {
        self.prepare(record.log_time_ns, now);
        let State::Open { writer, .. } = &mut self.state else {
            self.dropped += 1;
            return;
        };
        match writer.write(record) {
            Ok(()) => {
                self.written += 1;
                self.unsynced += 1;
            }
            Err(error) => {
                self.dropped += 1;
                let path = writer.path().to_owned();
                self.refuse(RecorderError::mcap(&path, error), now);
            }
        }
    }

    /// Keeps a message, already taken, that holds until the next one of its topic and publisher:
    /// later files begin with it.
    pub fn latch(&mut self, record: &Record<'_>) {
        self.latched.take(record);
    }

    /// Syncs and rotates when due. Call it regularly, also without records.
    pub fn tend(&mut self, now: Instant) {
        let State::Open {
            writer,
            opened,
            flushed,
        } = &mut self.state
        else {
            return;
        };
        if now.duration_since(*flushed) < self.config.flush_every {
            return;
        }
        *flushed = now;
        self.flushed = Some(now);
        let old = now.duration_since(*opened) >= self.config.rotate_after;
        if old || writer.bytes() >= self.config.rotate_bytes {
            return self.close(now);
        }
        let path = writer.path().to_owned();
        let begun = Instant::now();
        if let Err(error) = writer.sync() {
            return self.refuse(RecorderError::mcap(&path, error), now);
        }
        self.sync_took = begun.elapsed();
        self.unsynced = 0;
        if let Some(free) = free_bytes(&self.config.folder)
            && free < self.config.free_min_bytes
        {
            self.close(now);
            self.state = State::Refused {
                reason: format!(
                    "{}: only {} MB left, less than the {} MB kept free; free some space or set [recorder] folder to another disk",
                    self.config.folder.display(),
                    free >> 20,
                    self.config.free_min_bytes >> 20
                ),
                since: now,
            };
        }
    }

    /// Stores a table in the present file and in all later ones.
    pub fn metadata(&mut self, name: &str, entries: BTreeMap<String, String>, now: Instant) {
        self.tables.insert(name.to_owned(), entries.clone());
        if let State::Open { writer, .. } = &mut self.state {
            let path = writer.path().to_owned();
            if let Err(error) = writer.metadata(name, entries) {
                self.refuse(RecorderError::mcap(&path, error), now);
            }
        }
    }

    /// Stores a table at the end of the present file and of all later ones. A newer table replaces
    /// an older one of its name.
    pub fn last_words(&mut self, name: &str, entries: BTreeMap<String, String>) {
        self.last_words.insert(name.to_owned(), entries);
    }

    /// Stores a file in the present recording and in all later ones.
    pub fn attach(&mut self, name: &str, text: &str, time_ns: u64, now: Instant) {
        self.config
            .attachments
            .push((name.to_owned(), text.to_owned()));
        if let State::Open { writer, .. } = &mut self.state {
            let path = writer.path().to_owned();
            if let Err(error) = writer.attach(name, text, time_ns) {
                self.refuse(RecorderError::mcap(&path, error), now);
            }
        }
    }

    /// Closes the present file. Returns all files of this run, and the counts of messages written
    /// and dropped.
    pub fn finish(mut self, now: Instant) -> (Vec<PathBuf>, u64, u64) {
        // Files that could not be continued stay truncated: they can be read, and the next start
        // repairs them.
        self.close(now);
        (self.finished, self.written, self.dropped)
    }

    /// Why nothing is written now; `None` if there is no error.
    pub fn refusal(&self) -> Option<&str> {
        match &self.state {
            State::Refused { reason, .. } => Some(reason),
            _ => None,
        }
    }

    /// Number of files closed or given up so far.
    pub fn ended(&self) -> usize {
        self.finished.len()
    }

    /// Duration of the newest sync, during which messages had to wait.
    pub fn sync_took(&self) -> Duration {
        self.sync_took
    }

    /// The file being written.
    pub fn path(&self) -> Option<&Path> {
        match &self.state {
            State::Open { writer, .. } => Some(writer.path()),
            _ => None,
        }
    }

    /// Number of messages written, and of messages dropped because the disk refused.
    pub fn counts(&self) -> (u64, u64) {
        (self.written, self.dropped)
    }

    fn prepare(&mut self, time_ns: u64, now: Instant) {
        match &self.state {
            State::Open { .. } => return,
            State::Refused { since, .. } if now.duration_since(*since) < RETRY => return,
            _ => {}
        }
        if let Some(free) = free_bytes(&self.config.folder)
            && free < self.config.free_min_bytes
            && let State::Refused { since, .. } = &mut self.state
        {
            *since = now;
            return;
        }
        match self.create(time_ns) {
            Ok(writer) => {
                self.state = State::Open {
                    writer: Box::new(writer),
                    opened: now,
                    flushed: self.flushed.unwrap_or(now),
                }
            }
            Err(error) => self.refuse(error, now),
        }
    }

    fn create(&mut self, time_ns: u64) -> Result<RecordingWriter, RecorderError> {
        let path = loop {
            let name = format!(
                "{}-{}-{:03}.mcap",
                self.config.prefix,
                utc_name(time_ns),
                self.files
            );
            self.files += 1;
            let path = self.config.folder.join(name);
            if !path.exists() {
                break path;
            }
        };
        let fail = |source| RecorderError::mcap(&path, source);
        let mut writer = RecordingWriter::create_in(&*self.system, &path, self.config.options())
            .map_err(fail)?;
        writer
            .metadata("tangent", self.config.facts.clone())
            .map_err(fail)?;
        for (name, text) in &self.config.attachments {
            writer.attach(name, text, time_ns).map_err(fail)?;
        }
        for (name, entries) in &self.tables {
            writer.metadata(name, entries.clone()).map_err(fail)?;
        }
        for record in self.latched.records(time_ns) {
            writer.write(&record).map_err(fail)?;
        }
        writer.sync().map_err(fail)?;
        Ok(writer)
    }

    fn close(&mut self, now: Instant) {
        if let State::Open { mut writer, .. } = std::mem::replace(&mut self.state, State::Closed) {
            let path = writer.path().to_owned();
            self.finished.push(path.clone());
            let told = self
                .last_words
                .iter()
                .try_for_each(|(name, entries)| writer.metadata(name, entries.clone()));
            match told.and_then(|()| writer.finish()) {
                Ok(_) => self.unsynced = 0,
                Err(error) => self.refuse(RecorderError::mcap(&path, error), now),
            }
        }
    }

    fn refuse(&mut self, error: RecorderError, now: Instant) {
        // Messages that were only in memory are lost with the file.
        self.written -= self.unsynced;
        self.dropped += self.unsynced;
        self.unsynced = 0;
        let reason = error.to_string();
        if self.refusal() != Some(&reason) {
            tracing::error!("{reason}");
        }
        let refused = State::Refused { reason, since: now };
        if let State::Open { writer, .. } = std::mem::replace(&mut self.state, refused) {
            // The synced part of the file remains; the next start repairs its end.
            self.finished.push(writer.path().to_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(i: u64) -> Record<'static> {
        Record {
            topic: "/test",
            type_name: "std_msgs/msg/Header",
            definition: Some("builtin_interfaces/Time stamp\nstring frame_id\n"),
            publisher: [0; 16],
            sequence: i as u32,
            log_time_ns: i * 1_000_000,
            publish_time_ns: i * 1_000_000,
            bytes: &[0, 1, 0, 0, 1, 2, 3, 4],
        }
    }

    fn config(folder: &Path) -> RecorderConfig {
        RecorderConfig {
            folder: folder.to_owned(),
            free_min_bytes: 0,
            ..RecorderConfig::default()
        }
    }

    #[test]
    fn files_rotate_by_time_and_nothing_is_lost_between_them() {
        let folder = tempfile::tempdir().unwrap();
        let mut disk = Disk::open(RecorderConfig {
            rotate_after: Duration::from_secs(2),
            flush_every: Duration::ZERO,
            attachments: vec![("cell.toml".into(), "[cell]".into())],
            ..config(folder.path())
        })
        .unwrap();
        let start = Instant::now();
        for i in 0..5000 {
            let now = start + Duration::from_millis(i);
            disk.take(&record(i), now);
            disk.tend(now);
        }
        let (files, written, dropped) = disk.finish(start + Duration::from_secs(6));
        assert_eq!((files.len(), written, dropped), (3, 5000, 0));
        let mut sequences = Vec::new();
        for file in &files {
            let recording = crate::Recording::open(file).unwrap();
            assert!(!recording.is_truncated());
            assert_eq!(recording.attachments()["cell.toml"], "[cell]");
            sequences.extend(recording.messages().map(|m| u64::from(m.sequence)));
        }
        assert_eq!(sequences, (0..5000).collect::<Vec<_>>());
    }

    #[test]
    fn a_disk_that_is_nearly_full_is_left_alone_and_what_is_recorded_stays_whole() {
        let folder = tempfile::tempdir().unwrap();
        let mut disk = Disk::open(RecorderConfig {
            flush_every: Duration::from_millis(10),
            free_min_bytes: u64::MAX,
            ..config(folder.path())
        })
        .unwrap();
        let start = Instant::now();
        for i in 0..100 {
            let now = start + Duration::from_millis(i);
            disk.take(&record(i), now);
            disk.tend(now);
        }
        assert!(disk.refusal().unwrap().contains("kept free"));
        let (files, written, dropped) = disk.finish(start);
        assert_eq!(written + dropped, 100);
        assert!(written > 0 && dropped > 0);
        let recording = crate::Recording::open(&files[0]).unwrap();
        assert!(!recording.is_truncated());
        assert_eq!(recording.messages().count() as u64, written);
    }

    #[test]
    fn a_folder_that_vanishes_is_named_and_recording_goes_on_when_it_is_back() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("recordings");
        let mut disk = Disk::open(config(&folder)).unwrap();
        fs::remove_dir(&folder).unwrap();
        let start = Instant::now();
        disk.take(&record(0), start);
        assert!(disk.refusal().unwrap().contains("recordings"));
        fs::create_dir(&folder).unwrap();
        disk.take(&record(1), start + RETRY);
        let (_, written, dropped) = disk.finish(start + RETRY);
        assert_eq!((written, dropped), (1, 1));
    }

    #[test]
    fn a_truncated_file_is_repaired_up_to_its_last_whole_chunk() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("torn.mcap");
        let mut writer = RecordingWriter::create(&path).unwrap();
        writer.attach("task.toml", "name = 'x'", 1).unwrap();
        for i in 0..10 {
            writer.write(&record(i)).unwrap();
        }
        writer.flush().unwrap();
        let whole = fs::read(&path).unwrap();
        for i in 10..20 {
            writer.write(&record(i)).unwrap();
        }
        let finished = writer.finish().unwrap();
        let all = fs::read(&finished).unwrap();
        // Cut in the middle of the data after the flush.
        for cut in [whole.len(), whole.len() + 5, whole.len() + 40] {
            fs::write(&path, &all[..cut]).unwrap();
            let torn = crate::Recording::open(&path).unwrap();
            assert!(torn.is_truncated());
            assert_eq!(torn.messages().count(), 10, "cut at {cut}");
            let repairs = crate::repair::repair_folder(folder.path()).unwrap();
            assert_eq!(repairs.len(), 1);
            assert_eq!(repairs[0].messages, 10);
            let mended = crate::Recording::open(&path).unwrap();
            assert!(!mended.is_truncated());
            assert_eq!(mended.attachments()["task.toml"], "name = 'x'");
            assert!(
                crate::repair::repair_folder(folder.path())
                    .unwrap()
                    .is_empty()
            );
        }
    }

    #[test]
    fn files_other_than_recordings_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notes.mcap");
        for bytes in [&b""[..], b"hello", b"\x89MCAP0\r"] {
            fs::write(&path, bytes).unwrap();
            let error = crate::Recording::open(&path).err().unwrap().to_string();
            assert!(error.contains("notes.mcap"), "{error}");
        }
    }

    proptest::proptest! {
        #[test]
        fn damage_never_panics(at in 0usize..2000, value: u8, cut in 0usize..2000) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("damaged.mcap");
            let mut writer = RecordingWriter::create(&path).unwrap();
            for i in 0..20 {
                writer.write(&record(i)).unwrap();
            }
            writer.finish().unwrap();
            let mut bytes = fs::read(&path).unwrap();
            let at = at % bytes.len();
            bytes[at] = value;
            bytes.truncate(cut.max(1));
            fs::write(&path, &bytes).unwrap();
            if let Ok(recording) = crate::Recording::open(&path) {
                proptest::prop_assert!(recording.messages().count() <= 20);
            }
        }
    }
}
