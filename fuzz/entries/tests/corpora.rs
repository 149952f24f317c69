//! Replays the stored corpora: every input that a fuzzing run has kept, and every input that once
//! failed.

#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::Path;

use tangent_fuzz::{DEPTH_TARGET, TARGETS, Target};

fn targets() -> impl Iterator<Item = Target> {
    TARGETS.into_iter().chain([DEPTH_TARGET])
}

fn corpus() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../corpus")
}

#[test]
fn every_kept_input_is_handled() {
    for target in targets() {
        let folder = corpus().join(target.name);
        let mut files: Vec<_> = fs::read_dir(&folder)
            .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
            .map(|entry| entry.unwrap().path())
            .collect();
        files.sort();
        assert!(!files.is_empty(), "{} is empty", folder.display());
        for file in files {
            // Printed before it runs, so that a panic shows which input caused it.
            println!("{}", file.display());
            (target.run)(&fs::read(&file).unwrap());
        }
    }
}

#[test]
fn every_target_has_a_fuzz_target_and_every_corpus_a_target() {
    let fuzz = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let mut expected: Vec<String> = targets().map(|t| t.name.to_owned()).collect();
    expected.sort();
    let mut sources: Vec<String> = fs::read_dir(fuzz.join("fuzz_targets"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned())
        .collect();
    sources.sort();
    assert_eq!(sources, expected);
    let mut folders: Vec<String> = fs::read_dir(corpus())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_str().unwrap().to_owned())
        .collect();
    folders.sort();
    assert_eq!(folders, expected);
}

/// Every input truncated at every length is handled too.
#[test]
fn every_kept_input_truncated_is_handled() {
    for target in TARGETS.iter().filter(|t| t.name != "recording") {
        for entry in fs::read_dir(corpus().join(target.name)).unwrap() {
            let bytes = fs::read(entry.unwrap().path()).unwrap();
            let step = bytes.len().div_ceil(64).max(1);
            for length in (0..bytes.len()).step_by(step) {
                (target.run)(&bytes[..length]);
            }
        }
    }
}
