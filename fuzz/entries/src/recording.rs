//! Recordings of other programs: complete, truncated or damaged MCAP files.

use std::fs;

use tangent_recorder::{Recording, repair};

/// Writes the bytes to a file, reads it as a recording, and repairs it. A repaired file can be read
/// completely.
pub fn recording(data: &[u8]) {
    let folder = tempfile::tempdir().expect("a folder for temporary files is there");
    let path = folder.path().join("cell.mcap");
    fs::write(&path, data).expect("a temporary file can be written");
    if let Ok(recording) = Recording::open(&path) {
        for message in recording.try_messages() {
            if message.is_err() {
                break;
            }
        }
    }
    if repair::repair(&path).is_ok() {
        let mended = Recording::open(&path).expect("a mended recording can be read");
        assert!(mended.try_messages().all(|message| message.is_ok()));
        assert!(!mended.is_truncated());
    }
}
