//! Compares our bytes and definitions with two independent implementations: `rosbags` and
//! `mcap-ros2-support`.
//!
//! They come from `tests/interop/requirements.txt`. If they are missing, the test reports that and
//! passes, unless `TANGENT_REQUIRE_INTEROP` is set.
use crate::common;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use crate::common::sample::sample;
use serde_json::{Value, json};
use tangent_schemas::definition::FILES;
use tangent_schemas::{Message, cdr};

/// One case per length of the sequences: zero, one, and enough to shift every alignment.
fn cases<M: Message>(cases: &mut Vec<Value>) {
    for length in [0, 1, 3] {
        let message: M = sample(length);
        let mut bytes = Vec::new();
        cdr::encode(&message, &mut bytes).unwrap();
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        cases.push(json!({
            "name": M::NAME,
            "definition": M::definition(),
            "value": message,
            "hex": hex,
        }));
    }
}

/// Decodes the bytes that the other implementations wrote.
fn read_back<M: Message>(answers: &mut std::slice::Iter<'_, Value>) {
    for length in [0, 1, 3] {
        let answer = answers.next().expect("an answer to every case");
        for writer in ["rosbags", "mcap"] {
            let hex = answer[writer].as_str().expect("hexadecimal bytes");
            let bytes: Vec<u8> = (0..hex.len() / 2)
                .map(|i| u8::from_str_radix(&hex[2 * i..2 * i + 2], 16).unwrap())
                .collect();
            let theirs: M = cdr::decode(&bytes)
                .unwrap_or_else(|error| panic!("{} written by {writer}: {error}", M::NAME));
            let ours: M = sample(length);
            assert_eq!(
                json!(theirs),
                json!(ours),
                "{} written by {writer}",
                M::NAME
            );
        }
    }
}

fn python() -> PathBuf {
    let own = concat!(env!("CARGO_MANIFEST_DIR"), "/../.venv/bin/python3");
    match std::env::var_os("TANGENT_PYTHON") {
        Some(path) => path.into(),
        None if PathBuf::from(own).exists() => own.into(),
        None => "python3".into(),
    }
}

/// Reason why the test cannot run here, if there is one.
fn missing(python: &PathBuf) -> Option<String> {
    let output = Command::new(python)
        .args(["-c", "import rosbags.typesys, mcap_ros2.decoder"])
        .output();
    match output {
        Ok(output) if output.status.success() => None,
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stderr);
            Some(said.lines().last().unwrap_or_default().to_owned())
        }
        Err(error) => Some(format!("{}: {error}", python.display())),
    }
}

#[test]
fn others_read_what_we_write_and_we_read_what_they_write() {
    let python = python();
    if let Some(reason) = missing(&python) {
        assert!(
            std::env::var_os("TANGENT_REQUIRE_INTEROP").is_none(),
            "TANGENT_REQUIRE_INTEROP is set, but {reason}"
        );
        eprintln!("skipped, because {reason} (pip install -r tests/interop/requirements.txt)");
        return;
    }
    let mut all = Vec::new();
    common::for_every_message!(cases, &mut all);
    let input = json!({ "files": FILES, "cases": all }).to_string();
    let mut child = Command::new(&python)
        .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/independent.py"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let writer = std::thread::spawn(move || stdin.write_all(input.as_bytes()));
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap().unwrap();
    assert!(
        output.status.success(),
        "independent.py found a difference, see above"
    );
    let answers: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(answers.len(), all.len());
    let mut answers = answers.iter();
    common::for_every_message!(read_back, &mut answers);
}
