//! Checks the folder of recordings: whether it is writable, fast enough, and has enough space.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;
use std::time::Instant;

use nix::sys::statvfs::statvfs;
use tangent_runtime::CellConfig;

use crate::finding::Finding;

/// Data rate of the recording of a cell at 125 Hz with a sensor at 7000 records per second, bytes
/// per second.
const RECORDING_BYTES_PER_S: f64 = 1.5e6;
/// Size of the trial file, bytes.
const TRIAL_BYTES: usize = 32 << 20;
const CHUNK_BYTES: usize = 1 << 20;
/// Free space below which the recorder stops by itself, bytes.
const RESERVE_BYTES: u64 = 64 << 20;

/// Checks speed and space of the recorder's folder.
pub fn check(config: &CellConfig) -> Vec<Finding> {
    let folder = &config.recorder.folder;
    // The recorder creates the folder; until then, the nearest existing parent shows which disk it
    // is on.
    let there = folder
        .ancestors()
        .map(|path| {
            if path.as_os_str().is_empty() {
                Path::new(".")
            } else {
                path
            }
        })
        .find(|path| path.is_dir())
        .unwrap_or(Path::new("."));
    let shown = folder.display().to_string();
    vec![speed(&shown, trial(there)), space(&shown, free(there))]
}

fn speed(folder: &str, measured: io::Result<f64>) -> Finding {
    const CHECK: &str = "disk speed";
    match measured {
        Err(error) => Finding::problem(
            CHECK,
            format!("{folder}: {error}"),
            "the recorder cannot write: nothing is recorded",
            "correct [recorder] folder, or the folder's owner and permissions",
        ),
        Ok(rate) => {
            let found = format!("{folder}: {:.0} MB/s to the disk", rate / 1e6);
            let ratio = rate / RECORDING_BYTES_PER_S;
            let meaning = format!(
                "a recording takes about {:.1} MB/s: messages are dropped, and counted, whenever other programs use the disk",
                RECORDING_BYTES_PER_S / 1e6
            );
            let advice = "another disk in [recorder] folder, or `mode = \"buffered\"` and a lower rate_hz in [sensor]";
            if ratio >= 10.0 {
                Finding::ok(CHECK, found)
            } else if ratio >= 2.0 {
                Finding::warning(CHECK, found, meaning, advice)
            } else {
                Finding::problem(CHECK, found, meaning, advice)
            }
        }
    }
}

fn space(folder: &str, free_bytes: io::Result<u64>) -> Finding {
    const CHECK: &str = "disk space";
    let free_bytes = match free_bytes {
        Ok(bytes) => bytes,
        Err(error) => {
            return Finding::warning(
                CHECK,
                format!("{folder}: {error}"),
                "how long the space lasts is not known",
                "correct [recorder] folder",
            );
        }
    };
    let hours = free_bytes.saturating_sub(RESERVE_BYTES) as f64 / RECORDING_BYTES_PER_S / 3600.0;
    let found = format!(
        "{folder}: {:.1} GB free, about {hours:.1} h of recording",
        free_bytes as f64 / 1e9
    );
    let advice = "set [recorder] keep_bytes or keep_days, delete old recordings (and their .torn originals), or choose a \
        larger disk in [recorder] folder";
    if hours >= 8.0 {
        Finding::ok(CHECK, found)
    } else if hours >= 0.5 {
        Finding::warning(CHECK, found, "less than a shift", advice)
    } else {
        Finding::problem(
            CHECK,
            found,
            "the recorder stops by itself when less than 64 MB are free",
            advice,
        )
    }
}

/// Writes a file, waits until it is on the disk, and deletes it. Returns bytes per second.
fn trial(folder: &Path) -> io::Result<f64> {
    let path = folder.join(format!(".tangent-doctor-{}", std::process::id()));
    let measured = write(&path);
    // Deletes the file even if the write failed because the disk is full.
    let removed = fs::remove_file(&path);
    let rate = measured?;
    removed.map(|()| rate)
}

fn write(path: &Path) -> io::Result<f64> {
    let chunk = noise(CHUNK_BYTES);
    let mut file = File::create(path)?;
    let start = Instant::now();
    for _ in 0..TRIAL_BYTES / CHUNK_BYTES {
        file.write_all(&chunk)?;
    }
    file.sync_all()?;
    Ok(TRIAL_BYTES as f64 / start.elapsed().as_secs_f64())
}

/// Returns bytes that no file system can compress.
fn noise(bytes: usize) -> Vec<u8> {
    let mut x = 0x9e37_79b9_7f4a_7c15_u64;
    (0..bytes)
        .map(|_| {
            x ^= x << 13;
            x ^= x >> 7;
            x ^= x << 17;
            (x >> 32) as u8
        })
        .collect()
}

fn free(folder: &Path) -> io::Result<u64> {
    let found = statvfs(folder)?;
    Ok(found.blocks_available() * found.fragment_size())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Level;

    #[test]
    fn a_trial_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        assert!(trial(folder.path()).unwrap() > 0.0);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(free(folder.path()).unwrap() > 0);
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_a_problem() {
        let finding = speed("here", trial(Path::new("/proc/self")));
        assert_eq!(finding.level, Level::Problem, "{finding:?}");
    }

    #[test]
    fn speed_and_space_are_judged_by_what_a_recording_takes() {
        for (rate, level) in [
            (500e6, Level::Ok),
            (5e6, Level::Warning),
            (1e6, Level::Problem),
        ] {
            assert_eq!(speed("x", Ok(rate)).level, level);
        }
        for (bytes, level) in [
            (500_000_000_000, Level::Ok),
            (10_000_000_000, Level::Warning),
            (1_000_000_000, Level::Problem),
            (0, Level::Problem),
        ] {
            assert_eq!(space("x", Ok(bytes)).level, level);
        }
    }
}
