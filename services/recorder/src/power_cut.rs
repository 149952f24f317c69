//! Tests of power cuts at any moment, on a simulated disk that loses all data that were not synced:
//! at most one second is lost, as long as a sync takes no longer than 0.3 s.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use proptest::prelude::*;

use crate::disk::Disk;
use crate::files::{Files, OpenFile};
use crate::{Record, RecorderConfig, Recording, repair};

/// A disk that loses power at a given simulated time.
struct Simulated {
    now_ms: AtomicU64,
    cut_ms: u64,
    sync_ms: u64,
    files: Mutex<Vec<(PathBuf, Arc<SimulatedFile>)>>,
}

#[derive(Default)]
struct SimulatedFile {
    bytes: Mutex<Vec<u8>>,
    synced: AtomicU64,
}

impl Simulated {
    fn is_off(&self) -> bool {
        self.now_ms.load(Ordering::Relaxed) >= self.cut_ms
    }

    fn check(&self) -> io::Result<()> {
        if self.is_off() {
            return Err(io::Error::other("no power"));
        }
        Ok(())
    }
}

struct Handle(Arc<Simulated>, Arc<SimulatedFile>);

impl OpenFile for Handle {
    fn append(&self, bytes: &[u8]) -> io::Result<usize> {
        self.0.check()?;
        self.1.bytes.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn sync(&self) -> io::Result<()> {
        let length = self.1.bytes.lock().unwrap().len();
        self.0.now_ms.fetch_add(self.0.sync_ms, Ordering::Relaxed);
        self.0.check()?;
        self.1.synced.store(length as u64, Ordering::Relaxed);
        Ok(())
    }
}

struct Power(Arc<Simulated>);

impl Files for Power {
    fn create(&self, path: &Path) -> io::Result<Arc<dyn OpenFile>> {
        self.0.check()?;
        let file = Arc::new(SimulatedFile::default());
        self.0
            .files
            .lock()
            .unwrap()
            .push((path.to_owned(), Arc::clone(&file)));
        Ok(Arc::new(Handle(Arc::clone(&self.0), file)))
    }
}

/// Records one message per millisecond until the power fails. Returns the sequence numbers that are
/// found afterwards.
fn recorded(cut_ms: u64, sync_ms: u64, rotate_ms: u64, survives: f64, zeros: usize) -> Vec<u64> {
    let folder = tempfile::tempdir().unwrap();
    let simulated = Arc::new(Simulated {
        now_ms: AtomicU64::new(0),
        cut_ms,
        sync_ms,
        files: Mutex::default(),
    });
    let config = RecorderConfig {
        folder: folder.path().to_owned(),
        free_min_bytes: 0,
        rotate_after: Duration::from_millis(rotate_ms),
        ..RecorderConfig::default()
    };
    let mut disk = Disk::open_on(config, Arc::new(Power(Arc::clone(&simulated)))).unwrap();
    let start = Instant::now();
    let mut taken = 0;
    while !simulated.is_off() {
        let now_ms = simulated.now_ms.load(Ordering::Relaxed);
        let now = start + Duration::from_millis(now_ms);
        // Messages that arrived while the disk was busy waited in the queue.
        while taken <= now_ms {
            disk.take(
                &Record {
                    topic: "/test",
                    type_name: "std_msgs/msg/Header",
                    definition: Some("builtin_interfaces/Time stamp\nstring frame_id\n"),
                    publisher: [0; 16],
                    sequence: taken as u32,
                    log_time_ns: taken * 1_000_000,
                    publish_time_ns: taken * 1_000_000,
                    bytes: &taken.to_le_bytes(),
                },
                now,
            );
            taken += 1;
        }
        disk.tend(now);
        simulated.now_ms.fetch_add(1, Ordering::Relaxed);
    }
    for (path, file) in simulated.files.lock().unwrap().iter() {
        let bytes = file.bytes.lock().unwrap();
        let synced = file.synced.load(Ordering::Relaxed) as usize;
        let kept = synced + ((bytes.len() - synced) as f64 * survives) as usize;
        let mut left = bytes[..kept].to_vec();
        // The length was written, the bytes were not.
        left.resize((kept + zeros).min(bytes.len()).max(kept), 0);
        std::fs::write(path, left).unwrap();
    }
    repair::repair_folder(folder.path()).unwrap();
    let mut found = Vec::new();
    for (path, _) in simulated.files.lock().unwrap().iter() {
        let recording = Recording::open(path).unwrap();
        assert!(!recording.is_truncated(), "{}", path.display());
        found.extend(recording.messages().map(|m| u64::from(m.sequence)));
    }
    found
}

fn check(cut_ms: u64, sync_ms: u64, rotate_ms: u64, survives: f64, zeros: usize) {
    let found = recorded(cut_ms, sync_ms, rotate_ms, survives, zeros);
    let whole: Vec<u64> = (0..found.len() as u64).collect();
    assert_eq!(found, whole, "something is missing in the middle");
    assert!(
        found.len() as u64 + 1000 >= cut_ms,
        "{} ms of {cut_ms} ms were kept",
        found.len()
    );
}

#[test]
fn a_power_cut_right_at_the_start_leaves_a_file_that_opens() {
    for cut_ms in 0..20 {
        check(cut_ms, 3, 100_000, 0.5, 100);
        check(cut_ms, 3, 100_000, 0.0, 100);
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 200,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]
    #[test]
    fn a_power_cut_costs_at_most_a_second(
        cut_ms in 1u64..6000,
        sync_ms in 0u64..=300,
        rotate_ms in 1000u64..5000,
        survives in 0.0..=1.0,
        zeros in prop_oneof![Just(0), 0usize..2000],
    ) {
        check(cut_ms, sync_ms, rotate_ms, survives, zeros);
    }
}
