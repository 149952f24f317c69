//! A large truncated file is repaired while the recorder records, in little memory. The test is
//! alone in its process, because it measures the memory.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use tangent_recorder::{
    FileOptions, Record, RecorderConfig, Recording, RecordingStream, RecordingWriter, repair,
};
use tangent_runtime::{Bus, Stop};

const TORN_MIB: usize = 96;
/// Growth of memory allowed while a file of `TORN_MIB` is repaired; a reader that loads the whole
/// file would need its full size.
const GROWTH_MAX_KIB: u64 = 32 << 10;

fn torn(folder: &Path) -> PathBuf {
    let path = folder.join("cell1-20261122T101613Z-000.mcap");
    let options = FileOptions {
        compress: false,
        pack: false,
    };
    let mut writer = RecordingWriter::create_with(&path, options).unwrap();
    let noise: Vec<u8> = (0u32..1 << 16)
        .map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8)
        .collect();
    for i in 0..16 * TORN_MIB {
        writer
            .write(&Record {
                publisher: [0; 16],
                topic: "/noise",
                type_name: "std_msgs/msg/Header",
                definition: Some("uint8[] data\n"),
                sequence: i as u32,
                log_time_ns: i as u64,
                publish_time_ns: i as u64,
                bytes: &noise,
            })
            .unwrap();
    }
    writer.finish().unwrap();
    let file = fs::File::options().write(true).open(&path).unwrap();
    file.set_len(file.metadata().unwrap().len() - 100_000)
        .unwrap();
    path
}

/// Most memory that this process has had, KiB.
fn peak_kib() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|l| l.starts_with("VmHWM")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
fn recording_starts_while_a_large_truncated_file_is_repaired_in_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = torn(folder.path());
    let bus = Bus::in_process("cell1");
    let stop = Stop::new();
    let before = peak_kib();
    let recorder = {
        let (bus, stop) = (bus.clone(), stop.clone());
        let config = RecorderConfig {
            folder: folder.path().to_owned(),
            free_min_bytes: 0,
            ..RecorderConfig::default()
        };
        std::thread::spawn(move || tangent_recorder::run(config, bus, stop).unwrap())
    };
    while !repair::is_finished(&path).unwrap() {
        assert!(!recorder.is_finished());
        std::thread::yield_now();
    }
    let growth = peak_kib() - before;
    let mended_at = fs::metadata(&path).unwrap().modified().unwrap();
    stop.trigger();
    let summary = recorder.join().unwrap();

    assert!(growth < GROWTH_MAX_KIB, "{growth} KiB");
    assert_eq!(summary.mended.len(), 1);
    let saved = RecordingStream::open(&path).unwrap().count();
    assert_eq!(saved as u64, summary.mended[0].messages);
    assert!(saved > 16 * (TORN_MIB - 2), "{saved}");
    let first = Recording::open(&summary.files[0])
        .unwrap()
        .messages()
        .next()
        .unwrap();
    let mended_ns = mended_at.duration_since(UNIX_EPOCH).unwrap().as_nanos();
    assert!(
        u128::from(first.log_time_ns) < mended_ns,
        "nothing was recorded before the torn file was mended"
    );
    let left = fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(left, 3, "the mended file, its original, the recording");
}
