//! A recorder that was absent for a moment records the messages that it missed: real sessions on
//! loopback.
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_live::timed;
use tangent_recorder::{RecorderConfig, Recording, Summary};
use tangent_runtime::{Bus, CellConfig, Publisher, Role, Stop};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::topics;

const PATIENCE: Duration = Duration::from_secs(20);

fn cell() -> CellConfig {
    let port = tangent_live::ports::free();
    let mut config = CellConfig::default_cell();
    config.cell.name = format!("test{port}");
    config.zenoh.connect = vec![format!("tcp/127.0.0.1:{port}")];
    config.zenoh.listen = config.zenoh.connect.clone();
    config
}

struct Recorder {
    stop: Stop,
    thread: JoinHandle<Summary>,
}

impl Recorder {
    fn start(cell: &CellConfig, folder: &Path, queue: usize) -> Self {
        let config = RecorderConfig {
            folder: folder.to_owned(),
            prefix: cell.cell.name.clone(),
            include: vec!["arm/state".to_owned()],
            free_min_bytes: 0,
            queue,
            ..RecorderConfig::default()
        };
        let bus = Bus::open_within(cell, Role::Client, PATIENCE).unwrap();
        let stop = Stop::new();
        let stopped = stop.clone();
        let thread =
            std::thread::spawn(move || tangent_recorder::run(config, bus, stopped).unwrap());
        Self { stop, thread }
    }

    fn end(self) -> Summary {
        self.stop.trigger();
        self.thread.join().unwrap()
    }
}

/// Publishes once per millisecond for this time.
fn publish(states: &Publisher<ArmState>, time: Duration) {
    let start = Instant::now();
    while start.elapsed() < time {
        states.publish(&ArmState::default());
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut files: Vec<PathBuf> = entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "mcap"))
        .collect();
    files.sort();
    files
}

fn sequences(folder: &Path) -> Vec<u32> {
    let mut all = Vec::new();
    for file in files(folder) {
        let recording = Recording::open(&file).unwrap();
        let messages = recording.messages();
        let in_file: Vec<u32> = messages
            .inspect(|message| assert_eq!(message.topic, "/arm/state"))
            .map(|message| message.sequence)
            .collect();
        assert!(in_file.is_sorted(), "each stands where it would have come");
        all.extend(in_file);
    }
    all.sort_unstable();
    all
}

fn assert_whole(sequences: &[u32], last: u64) {
    let missing: Vec<_> = sequences.windows(2).filter(|w| w[1] != w[0] + 1).collect();
    assert!(missing.is_empty(), "{missing:?}");
    assert_eq!(u64::from(*sequences.last().unwrap()), last);
}

#[test]
fn what_was_published_while_no_recorder_ran_is_recorded_once() {
    timed(|| {
        let cell = cell();
        let folder = tempfile::tempdir().unwrap();
        let _router = Bus::open_within(&cell, Role::Router, PATIENCE).unwrap();
        let robot = Bus::open_within(&cell, Role::Client, PATIENCE).unwrap();
        let states = robot.publisher(&topics::ARM_STATE).unwrap();
        let first = Recorder::start(&cell, folder.path(), 1 << 16);
        while !states.is_read_remotely() {
            publish(&states, Duration::from_millis(10));
        }
        publish(&states, Duration::from_secs(1));
        assert_eq!(first.end().missing, 0);
        // As if it had been killed: the file ends in the middle.
        let file = files(folder.path())[0].clone();
        let bytes = std::fs::read(&file).unwrap();
        std::fs::write(&file, &bytes[..bytes.len() / 2]).unwrap();
        let unrecorded = states.sequence();
        publish(&states, Duration::from_secs(2));
        let unrecorded = states.sequence() - unrecorded;
        let second = Recorder::start(&cell, folder.path(), 1 << 16);
        publish(&states, Duration::from_secs(3));
        let last = states.sequence();
        let summary = second.end();
        // A busy machine publishes fewer of them, and the truncated file lost some more.
        assert!(summary.recovered > unrecorded, "{unrecorded}: {summary:?}");
        assert_eq!((summary.missing, summary.lost()), (0, 0));
        assert_whole(&sequences(folder.path()), last);

        // With nothing new, nothing is recorded again.
        let third = Recorder::start(&cell, folder.path(), 1 << 16);
        publish(&states, Duration::from_secs(1));
        let last = states.sequence();
        assert_eq!(third.end().missing, 0);
        assert_whole(&sequences(folder.path()), last);
    });
}

#[test]
fn messages_dropped_from_a_full_queue_are_requested_again() {
    timed(|| {
        let cell = cell();
        let folder = tempfile::tempdir().unwrap();
        let _router = Bus::open_within(&cell, Role::Router, PATIENCE).unwrap();
        let robot = Bus::open_within(&cell, Role::Client, PATIENCE).unwrap();
        let states = robot.publisher(&topics::ARM_STATE).unwrap();
        let recorder = Recorder::start(&cell, folder.path(), 4);
        while !states.is_read_remotely() {
            publish(&states, Duration::from_millis(10));
        }
        for _ in 0..5 {
            for _ in 0..200 {
                states.publish(&ArmState::default());
            }
            publish(&states, Duration::from_millis(50));
        }
        publish(&states, Duration::from_secs(2));
        let last = states.sequence();
        let summary = recorder.end();
        assert!(summary.queue_dropped > 0, "{summary:?}");
        assert_eq!((summary.missing, summary.lost()), (0, 0), "{summary:?}");
        assert_whole(&sequences(folder.path()), last);
    });
}
