use std::cell::Cell;

use super::*;
use crate::Recording;
use crate::message::Record;
use crate::writer::RecordingWriter;

/// A truncated file of about `mebibytes` that cannot be compressed, and its number of messages.
fn torn(folder: &Path, mebibytes: usize) -> (PathBuf, u64) {
    let path = folder.join("cell1-20261122T101613Z-000.mcap");
    let mut writer = RecordingWriter::create(&path).unwrap();
    writer.attach("cell.toml", "[cell]", 1).unwrap();
    let mut noise = vec![0; 1 << 16];
    let mut state = 1u64;
    for i in 0..16 * mebibytes as u64 {
        for byte in &mut noise {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            *byte = (state >> 56) as u8;
        }
        writer
            .write(&Record {
                publisher: [0; 16],
                topic: "/noise",
                type_name: "std_msgs/msg/Header",
                definition: Some("uint8[] data\n"),
                sequence: i as u32,
                log_time_ns: i,
                publish_time_ns: i,
                bytes: &noise,
            })
            .unwrap();
    }
    writer.flush().unwrap();
    let messages = writer.messages();
    drop(writer);
    let file = File::options().write(true).open(&path).unwrap();
    // Dropping a writer writes an end. It is cut off, with a part of the last chunk's index.
    let length = file.metadata().unwrap().len();
    file.set_len(length - 600).unwrap();
    (path, messages)
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// Repairs with the given free space at each check. Returns the result and the number of checks.
fn mend(
    path: &Path,
    free_min_bytes: u64,
    free: impl Fn(usize, &Stop) -> u64,
) -> (Result<Repair, RecorderError>, usize) {
    let stop = Stop::new();
    let looks = Cell::new(0);
    let free = |_: &Path| {
        looks.set(looks.get() + 1);
        Some(free(looks.get(), &stop))
    };
    let bounds = Bounds {
        free_min_bytes,
        free: &free,
        stop: &stop,
        gently: false,
    };
    (repair_within(path, &bounds), looks.get())
}

#[test]
fn a_repair_neither_starts_nor_continues_below_the_free_space_limit() {
    let folder = tempfile::tempdir().unwrap();
    let (path, messages) = torn(folder.path(), 16);
    let original = fs::read(&path).unwrap();
    let left = [path.file_name().unwrap().to_str().unwrap().to_owned()];
    const KEPT: u64 = 64 << 20;
    // Space for the recording in progress, but not for the copy.
    let (outcome, looks) = mend(&path, KEPT, |_, _| KEPT + (1 << 20));
    let error = outcome.unwrap_err().to_string();
    assert!(
        error.contains("keep_bytes") && error.contains("[recorder] folder"),
        "{error}"
    );
    assert_eq!(looks, 1, "it has begun");
    // Other programs fill the disk during the repair.
    let (outcome, looks) = mend(&path, KEPT, |look, _| {
        KEPT + if look < 3 { 32 << 20 } else { STRIDE }
    });
    assert!(matches!(outcome, Err(RecorderError::NoRoom { .. })));
    assert_eq!(looks, 3, "it went on for longer");
    assert_eq!(names(folder.path()), left);
    assert!(fs::read(&path).unwrap() == original);
    let (outcome, looks) = mend(&path, KEPT, |_, _| KEPT + (32 << 20));
    assert_eq!(outcome.unwrap().messages, messages);
    assert!(looks > 3, "{looks} looks at the free space in 16 MiB");
    let mended = Recording::open(&path).unwrap();
    assert!(!mended.is_truncated());
    assert_eq!(mended.messages().count() as u64, messages);
    assert_eq!(mended.attachments()["cell.toml"], "[cell]");
    assert!(fs::read(torn_path(&path)).unwrap() == original);
}

#[test]
fn a_stop_ends_a_repair_at_once_and_leaves_the_original_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let (path, _) = torn(folder.path(), 16);
    let (outcome, looks) = mend(&path, 0, |look, stop| {
        if look == 2 {
            stop.trigger();
        }
        u64::MAX
    });
    assert!(matches!(outcome, Err(RecorderError::Stopped { .. })));
    assert_eq!(looks, 2, "it went on after the stop");
    assert_eq!(names(folder.path()).len(), 1);
    assert!(!is_finished(&path).unwrap());
}

#[test]
fn remains_of_a_killed_repair_are_removed() {
    let folder = tempfile::tempdir().unwrap();
    let (path, messages) = torn(folder.path(), 1);
    fs::write(mending_path(&path), b"partial").unwrap();
    clear_mends(folder.path()).unwrap();
    assert_eq!(names(folder.path()).len(), 1);
    repair(&path).unwrap();
    // As on a file system without links, killed between the two renames.
    fs::rename(&path, mending_path(&path)).unwrap();
    clear_mends(folder.path()).unwrap();
    let mended = Recording::open(&path).unwrap();
    assert_eq!(mended.messages().count() as u64, messages);
    assert!(torn_path(&path).exists());
}

#[test]
fn files_other_than_recordings_are_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notes.mcap");
    let others: [&[u8]; 4] = [
        b"something else altogether",
        b"notes",
        b"\x89MCAP and more",
        b"\0\0\0\0\0\0\0\0\0\0\0\0not zeros all the way",
    ];
    for bytes in others {
        fs::write(&path, bytes).unwrap();
        let error = repair(&path).unwrap_err().to_string();
        assert!(error.contains("notes.mcap"), "{error}");
        assert_eq!(names(folder.path()), ["notes.mcap"]);
    }
}

#[test]
fn a_file_whose_first_sync_a_power_cut_ended_becomes_a_recording_of_nothing() {
    for (magic, zeros) in [(0, 0), (3, 0), (0, 5), (0, 9), (3, 2000), (7, 100_000)] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cell1-20261122T101613Z-000.mcap");
        let mut bytes = mcap::MAGIC[..magic].to_vec();
        bytes.resize(magic + zeros, 0);
        fs::write(&path, &bytes).unwrap();
        let mended = repair(&path).unwrap();
        assert_eq!(
            (mended.messages, mended.bytes_cut),
            (0, bytes.len() as u64),
            "{magic} bytes and {zeros} zeros"
        );
        let recording = Recording::open(&path).unwrap();
        assert!(!recording.is_truncated());
        assert_eq!(recording.messages().count(), 0);
        assert!(fs::read(torn_path(&path)).unwrap() == bytes);
    }
}
