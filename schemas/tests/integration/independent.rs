//! Compares our bytes and definitions with three independent implementations: `rosbags`,
//! `mcap-ros2-support`, and rclpy with the messages that ROS 2's own generators make.
//!
//! The first two come from `tests/interop/requirements.txt`, the third from
//! `tests/interop/ros2/build`. If they are missing, the tests report that and pass, unless
//! `TANGENT_REQUIRE_INTEROP` is set.
use crate::common;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::common::sample::sample;
use serde_json::{Value, json};
use tangent_schemas::definition::FILES;
use tangent_schemas::{Message, cdr};

/// Exit code of a script whose libraries are not installed.
const MISSING: i32 = 77;

fn encoded(message: &impl Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    cdr::encode(message, &mut bytes).unwrap();
    bytes
}

/// One case per length of the sequences: zero, one, and enough to shift every alignment.
fn cases<M: Message>(cases: &mut Vec<Value>) {
    for length in [0, 1, 3] {
        let message: M = sample(length);
        let bytes = encoded(&message);
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        cases.push(json!({
            "name": M::NAME,
            "definition": M::definition(),
            "value": message,
            "hex": hex,
        }));
    }
}

/// Answers of a script, in the order of the cases: bytes by the name of the library that wrote
/// them.
struct Answers<'a> {
    answers: std::slice::Iter<'a, Value>,
    writers: &'a [&'a str],
}

/// Decodes the bytes that the other implementations wrote.
fn read_back<M: Message>(answers: &mut Answers<'_>) {
    for length in [0, 1, 3] {
        let answer = answers.answers.next().expect("an answer to every case");
        for writer in answers.writers {
            let hex = answer[*writer].as_str().expect("hexadecimal bytes");
            let bytes: Vec<u8> = (0..hex.len() / 2)
                .map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).unwrap())
                .collect();
            let ours: M = sample(length);
            let mut bytes = &bytes[..];
            if *writer == "rclpy" {
                // `serialize_message` returns a buffer of the estimated size, which counts the
                // alignment of empty sequences. What is sent over a network has the exact size.
                let exact = encoded(&ours).len();
                assert!((exact..exact + 64).contains(&bytes.len()), "{}", M::NAME);
                bytes = &bytes[..exact];
            }
            let theirs: M = cdr::decode(bytes)
                .unwrap_or_else(|error| panic!("{} written by {writer}: {error}", M::NAME));
            assert_eq!(
                json!(theirs),
                json!(ours),
                "{} written by {writer}",
                M::NAME
            );
        }
    }
}

/// The interpreter that a variable names, else the one at `place` in the repository, else the
/// system's.
fn python(variable: &str, place: &str) -> PathBuf {
    let own = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(place);
    match std::env::var_os(variable) {
        Some(path) => path.into(),
        None if own.exists() => own,
        None => "python3".into(),
    }
}

/// Reports what is missing.
///
/// # Panics
/// `TANGENT_REQUIRE_INTEROP` is set.
fn skip(reason: &str, install: &str) {
    assert!(
        std::env::var_os("TANGENT_REQUIRE_INTEROP").is_none(),
        "TANGENT_REQUIRE_INTEROP is set, but {reason}"
    );
    eprintln!("skipped, because {reason} ({install})");
}

/// Gives every message to a script, and reads what each library named in `writers` wrote.
fn compare(python: &Path, script: &str, writers: &[&str], install: &str) {
    let mut all = Vec::new();
    common::for_every_message!(cases, &mut all);
    let input = json!({ "files": FILES, "cases": all }).to_string();
    let child = Command::new(python)
        .arg(
            Path::new(env!("CARGO_MANIFEST_DIR"))
                .join("tests")
                .join(script),
        )
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn();
    let mut child = match child {
        Ok(child) => child,
        Err(error) => return skip(&format!("{}: {error}", python.display()), install),
    };
    let mut stdin = child.stdin.take().unwrap();
    let writer = std::thread::spawn(move || stdin.write_all(input.as_bytes()));
    let output = child.wait_with_output().unwrap();
    let written = writer.join().unwrap();
    if output.status.code() == Some(MISSING) {
        let reason = String::from_utf8_lossy(&output.stdout);
        return skip(reason.trim(), install);
    }
    written.unwrap();
    assert!(
        output.status.success(),
        "{script} found a difference, see above"
    );
    let answers: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(answers.len(), all.len());
    let mut answers = Answers {
        answers: answers.iter(),
        writers,
    };
    common::for_every_message!(read_back, &mut answers);
}

#[test]
fn others_read_what_we_write_and_we_read_what_they_write() {
    compare(
        &python("TANGENT_PYTHON", ".venv/bin/python3"),
        "independent.py",
        &["rosbags", "mcap"],
        "pip install -r tests/interop/requirements.txt",
    );
}

#[test]
fn ros_reads_what_we_write_and_we_read_what_ros_writes() {
    compare(
        &python("TANGENT_ROS2_PYTHON", ".ros2/python"),
        "with_rclpy.py",
        &["rclpy"],
        "tests/interop/ros2/build",
    );
}
