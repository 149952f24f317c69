//! The recorder in a process of its own: killed, hanging, and with small files.

use tangent_recorder::Recording;
use tangent_runtime::clock::now_ns;

use crate::cell::{Cell, Observer, PATIENCE, set};
use crate::common::{json, run, wait_for};
use tangent_live::live_beside_others;

const PROCESSES: [&str; 2] = [
    "router simulator netft rtde controller estimator",
    "recorder",
];

/// Killed in the middle of a task: no other service is affected, the file opens as it is, and the
/// next start repairs it.
#[test]
fn a_killed_recorder_leaves_a_file_that_opens_and_is_repaired() {
    live_beside_others(|| {
        let mut cell = Cell::new(|_| {});
        cell.start_all(&PROCESSES);
        let observer = Observer::join(&cell);
        observer.slide(&cell, &cell.long_task());
        wait_for("the file has the slide", PATIENCE, || {
            let recording = Recording::open(cell.files().first()?).ok()?;
            let slides = recording.messages().filter(|m| m.topic == "/truth/contact");
            (slides.count() > 400).then_some(())
        });
        let killed = now_ns();
        cell.process("recorder").kill();
        let torn = cell.files()[0].clone();
        let recording = Recording::open(&torn).unwrap();
        assert!(recording.is_truncated());
        let saved = recording.messages().count();
        let report = run(&["report", torn.to_str().unwrap(), "--json", "--no-html"]);
        assert_eq!(
            report.status.code(),
            Some(3),
            "done, but something is missing"
        );
        assert_eq!(json(&report)["recording"]["truncated"], true);

        cell.start("recorder");
        wait_for("a second file", PATIENCE, || {
            (cell.files().len() == 2).then_some(())
        });
        let mended = wait_for("the first is mended", PATIENCE, || {
            let recording = Recording::open(&torn).ok()?;
            (!recording.is_truncated()).then_some(recording)
        });
        assert_eq!(mended.messages().count(), saved);
        assert!(mended.metadata().contains_key("repaired"));
        assert!(mended.attachments().contains_key("cell.toml"));
        assert!(torn.with_extension("mcap.torn").exists());

        // A recorder that hangs delays no other service either.
        cell.process("recorder").signal("STOP");
        let hung = now_ns();
        wait_for("two seconds go by", PATIENCE, || {
            (observer.truths(hung).len() > 250).then_some(())
        });
        cell.process("recorder").signal("CONT");
        let since = observer.controls(killed);
        assert!(since.len() > 100);
        for seen in since {
            // On a raster, the tool rests at the corners.
            assert!(matches!(seen.message.phase_text.as_str(), "slide" | "hold"));
        }
        assert!(observer.peak_force_n(killed) < 10.0);
        cell.assert_running(&PROCESSES);
        assert_eq!(cell.process("recorder").terminate(PATIENCE), Some(0));
    });
}

/// Files of a few seconds or a few hundred kilobytes: each is complete, and no message is lost
/// between them.
#[test]
fn recordings_rotate_by_time_and_by_size() {
    live_beside_others(|| {
        for (key, value, files) in [("rotate_s", 2.0, 3), ("rotate_mb", 0.4, 3)] {
            let mut cell = Cell::new(|cell| {
                set(cell, &format!("recorder.{key}"), value);
            });
            // In one process, because a loaded machine may lose messages between processes, which
            // this test does not count.
            cell.start_all(&["router simulator netft rtde controller estimator recorder"]);
            wait_for("files are written", PATIENCE, || {
                (cell.files().len() > files).then_some(())
            });
            let name = "router simulator netft rtde controller estimator recorder";
            assert_eq!(cell.process(name).terminate(PATIENCE), Some(0));
            let mut last = 0;
            for file in cell.files() {
                let recording = Recording::open(&file).unwrap();
                assert!(!recording.is_truncated(), "{}", file.display());
                assert!(recording.attachments().contains_key("cell.toml"));
                for message in recording.messages().filter(|m| m.topic == "/arm/state") {
                    assert!(
                        last == 0 || message.sequence == last + 1,
                        "{key}: after {last}"
                    );
                    last = message.sequence;
                }
            }
            assert!(last > 300, "{key}: only {last} states");
        }
    });
}
