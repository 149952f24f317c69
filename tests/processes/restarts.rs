//! The recordings are complete if the recorder, the router or both restart within seconds.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use tangent_recorder::Recording;
use tangent_runtime::clock::now_ns;

use crate::cell::{Cell, Observer, PATIENCE};
use crate::common::wait_for;
use tangent_live::live_beside_others;

const PROCESSES: [&str; 6] = [
    "router",
    "simulator",
    "netft",
    "rtde controller",
    "estimator",
    "recorder",
];

/// Sequences in the files by topic and publisher, sorted, and the losses that the files state.
struct Recorded {
    sequences: BTreeMap<(String, [u8; 16]), Vec<u32>>,
    recovered: u64,
    missing: u64,
}

fn recorded(files: &[PathBuf]) -> Recorded {
    let mut all = Recorded {
        sequences: BTreeMap::new(),
        recovered: 0,
        missing: 0,
    };
    for file in files {
        let recording = Recording::open(file).unwrap();
        if let Some(losses) = recording.metadata().get("losses") {
            all.recovered += losses["recovered"].parse::<u64>().unwrap();
            all.missing += losses["missing"].parse::<u64>().unwrap();
        }
        for message in recording.messages() {
            let publisher = (message.topic, message.publisher);
            let sequences = all.sequences.entry(publisher).or_default();
            sequences.push(message.sequence);
        }
    }
    all.sequences
        .values_mut()
        .for_each(|all| all.sort_unstable());
    all
}

impl Recorded {
    /// Asserts that every message of each topic and publisher is recorded once, from the first to
    /// the last.
    fn assert_whole(&self) {
        let mut wrong = Vec::new();
        let mut messages = 0;
        for ((topic, publisher), sequences) in &self.sequences {
            assert_ne!(*publisher, [0; 16], "{topic}: nobody's");
            messages += sequences.len();
            let span = sequences[sequences.len() - 1] - sequences[0] + 1;
            let mut once = sequences.clone();
            once.dedup();
            let missing = span as usize - once.len();
            let doubled = sequences.len() - once.len();
            if missing + doubled > 0 {
                wrong.push(format!("{topic}: {missing} missing, {doubled} doubled"));
            }
        }
        eprintln!(
            "{messages} messages of {} publishers, {} recovered, {} missing",
            self.sequences.len(),
            self.recovered,
            self.missing
        );
        assert!(wrong.is_empty(), "{wrong:#?}");
        assert_eq!(self.missing, 0, "the recorder counts otherwise");
    }
}

/// Lets the cell run for this time, measured by the simulator's own messages.
fn goes_on(observer: &Observer, seconds: f64) {
    let from = now_ns();
    wait_for("the cell goes on", PATIENCE, || {
        let truths = observer.truths(from);
        let last = truths.last()?;
        (last.at_ns - from > (seconds * 1e9) as i64).then_some(())
    });
}

fn recording(cell: &Cell, files: usize) {
    wait_for("it records", PATIENCE, || {
        (cell.files().len() >= files).then_some(())
    });
}

#[test]
fn a_recorder_that_is_killed_and_back_within_seconds_misses_nothing() {
    live_beside_others(|| {
        let mut cell = Cell::new(|_| {});
        cell.start_all(&PROCESSES);
        let observer = Observer::join(&cell);
        cell.start_task(&cell.long_task());
        observer.sliding(0);
        for (files, seconds) in [(2, 2.0), (3, 8.0)] {
            goes_on(&observer, 3.0);
            cell.process("recorder").kill();
            goes_on(&observer, seconds);
            cell.start("recorder");
            recording(&cell, files);
        }
        goes_on(&observer, 8.0);
        assert_eq!(cell.process("recorder").terminate(PATIENCE), Some(0));
        let recorded = recorded(&cell.files());
        recorded.assert_whole();
        // Ten seconds of some thousand messages each.
        assert!(recorded.recovered > 10_000, "{}", recorded.recovered);
    });
}

#[test]
fn a_router_that_is_killed_and_back_within_seconds_costs_no_record() {
    live_beside_others(|| {
        let mut cell = Cell::new(|_| {});
        cell.start_all(&PROCESSES);
        let observer = Observer::join(&cell);
        cell.start_task(&cell.long_task());
        observer.sliding(0);
        goes_on(&observer, 2.0);
        // The loop correctly ends its task, because it receives no wrench.
        cell.process("router").kill();
        std::thread::sleep(Duration::from_secs(3));
        cell.start("router");
        goes_on(&observer, 8.0);
        assert_eq!(cell.process("recorder").terminate(PATIENCE), Some(0));
        let recorded = recorded(&cell.files());
        recorded.assert_whole();
        assert!(recorded.recovered > 3000, "{}", recorded.recovered);
    });
}

#[test]
fn recorder_and_router_stopped_and_started_cost_no_record() {
    live_beside_others(|| {
        let mut cell = Cell::new(|_| {});
        cell.start_all(&PROCESSES);
        let observer = Observer::join(&cell);
        cell.start_task(&cell.long_task());
        observer.sliding(0);
        goes_on(&observer, 2.0);
        assert_eq!(cell.process("router").terminate(PATIENCE), Some(0));
        assert_eq!(cell.process("recorder").terminate(PATIENCE), Some(0));
        std::thread::sleep(Duration::from_secs(3));
        cell.start("router");
        cell.start("recorder");
        recording(&cell, 2);
        goes_on(&observer, 8.0);
        assert_eq!(cell.process("recorder").terminate(PATIENCE), Some(0));
        let recorded = recorded(&cell.files());
        recorded.assert_whole();
        assert!(recorded.recovered > 3000, "{}", recorded.recovered);
    });
}
