//! A recorder that is killed leaves a file that opens, and the next start repairs it.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use tangent_live::timed;
use tangent_recorder::{RecorderConfig, Recording, repair};
use tangent_runtime::{Bus, Stop};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::topics;

const FOLDER: &str = "TANGENT_TEST_RECORDER_FOLDER";
/// Messages that are surely on the disk when the recorder is killed.
const SAFE: usize = 500;

fn config(folder: &Path) -> RecorderConfig {
    RecorderConfig {
        folder: folder.to_owned(),
        include: vec!["arm/state".to_owned()],
        flush_every: Duration::from_millis(10),
        free_min_bytes: 0,
        ..RecorderConfig::default()
    }
}

fn recordings(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "mcap"))
        .collect();
    files.sort();
    files
}

/// Runs in a process of its own, started by the test below; records without end.
#[test]
#[ignore = "the other half of a_killed_recorder_leaves_a_file_that_opens"]
fn a_recorder_to_be_killed() {
    let Some(folder) = std::env::var_os(FOLDER).map(PathBuf::from) else {
        return;
    };
    let bus = Bus::in_process("cell1");
    let recorder = {
        let (bus, config) = (bus.clone(), config(&folder));
        std::thread::spawn(move || tangent_recorder::run(config, bus, Stop::new()))
    };
    let arm = bus.publisher(&topics::ARM_STATE).unwrap();
    let mut cycle = 0;
    let mut told = false;
    while !recorder.is_finished() {
        if arm.is_read() {
            arm.publish(&ArmState {
                cycle,
                ..ArmState::default()
            });
            cycle += 1;
        }
        if !told && cycle % 1000 == 0 {
            for file in recordings(&folder) {
                if Recording::open(&file).is_ok_and(|r| r.messages().count() >= SAFE) {
                    println!("\nsafe");
                    told = true;
                }
            }
        }
        std::thread::sleep(Duration::from_micros(50));
    }
}

#[test]
fn a_killed_recorder_leaves_a_file_that_opens() {
    timed(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args([
                "--exact",
                "killed::a_recorder_to_be_killed",
                "--ignored",
                "--nocapture",
            ])
            .env(FOLDER, folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let output = BufReader::new(child.stdout.take().unwrap());
        let safe = output.lines().any(|line| line.unwrap().trim() == "safe");
        assert!(safe, "the child ended before it had recorded anything");
        // While the file is written, no other recorder repairs it.
        assert_eq!(repair::repair_folder(folder.path()).unwrap(), []);
        child.kill().unwrap();
        child.wait().unwrap();

        let files = recordings(folder.path());
        assert_eq!(files.len(), 1);
        let torn = Recording::open(&files[0]).unwrap();
        assert!(torn.is_truncated());
        let sequences: Vec<u32> = torn.messages().map(|m| m.sequence).collect();
        assert!(sequences.len() >= SAFE);
        assert!(sequences.windows(2).all(|w| w[1] == w[0] + 1));

        let stop = Stop::new();
        let recorder = {
            let (stop, config) = (stop.clone(), config(folder.path()));
            std::thread::spawn(move || {
                tangent_recorder::run(config, Bus::in_process("cell1"), stop).unwrap()
            })
        };
        while !repair::is_finished(&files[0]).unwrap() {
            assert!(!recorder.is_finished());
            std::thread::yield_now();
        }
        stop.trigger();
        let summary = recorder.join().unwrap();
        assert_eq!(summary.mended.len(), 1);
        let mended = Recording::open(&files[0]).unwrap();
        assert!(!mended.is_truncated());
        let saved: Vec<u32> = mended.messages().map(|m| m.sequence).collect();
        assert_eq!(saved, sequences);
        assert!(files[0].with_extension("mcap.torn").exists());
    });
}
