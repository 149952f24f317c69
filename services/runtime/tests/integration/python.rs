//! A third-party client on the bus: Python with `eclipse-zenoh` and `rosbags` runs the shipped
//! examples.
//!
//! The packages are those of `tests/interop/requirements.txt`. Without them the test reports this
//! and passes, unless `TANGENT_REQUIRE_INTEROP` is set.
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::common::{PATIENCE, cell, client, until};
use tangent_live::timed;
use tangent_runtime::{Bus, Role};
use tangent_schemas::convert::cut;
use tangent_schemas::standard::{Header, Marker, MarkerArray};
use tangent_schemas::tangent::{ArmState, ControlState, Health, NormalEstimate};
use tangent_schemas::{Message, cdr, topics};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn python() -> PathBuf {
    let own = root().join(".venv/bin/python3");
    match std::env::var_os("TANGENT_PYTHON") {
        Some(path) => path.into(),
        None if own.exists() => own,
        None => "python3".into(),
    }
}

/// Python interpreter with these packages; prints the reason if there is none.
fn python_with(packages: &str) -> Option<PathBuf> {
    let python = python();
    let import = format!("import {packages}");
    let check = Command::new(&python).args(["-c", &import]).output();
    if check.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    let reason = format!("{} cannot `{import}`", python.display());
    assert!(
        std::env::var_os("TANGENT_REQUIRE_INTEROP").is_none(),
        "TANGENT_REQUIRE_INTEROP is set, but {reason}"
    );
    eprintln!("skipped, because {reason} (pip install -r tests/interop/requirements.txt)");
    None
}

#[test]
fn a_python_listener_reads_what_we_publish() {
    timed(|| {
        let Some(python) = python_with("zenoh, rosbags.typesys") else {
            return;
        };
        let config = cell();
        let _router = Bus::open_within(&config, Role::Router, PATIENCE).unwrap();
        let bus = client(&config);
        let states = bus.publisher(&topics::ARM_STATE).unwrap();
        let mut child = Command::new(&python)
            .arg(root().join("examples/python/listen.py"))
            .args(["--router", &config.zenoh.connect[0], "--cell"])
            .args([&config.cell.name, "--key", "arm/*", "--count", "3"])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        until("the listener", || {
            assert!(
                child.try_wait().unwrap().is_none(),
                "the listener ended early"
            );
            states.is_read_remotely()
        });
        let message = ArmState {
            q: [0.5, -1.25, 1e-3].into_iter().collect(),
            not_ready_reason: cut("brakes are on: ä"),
            ready: true,
            missed_cycles: u64::MAX,
            ..ArmState::default()
        };
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        for cycle in 1..=3 {
            let sent = ArmState {
                cycle,
                ..message.clone()
            };
            states.publish(&sent);
            let line = lines.next().expect("a line per message").unwrap();
            let heard: serde_json::Value = serde_json::from_str(&line).unwrap();
            assert_eq!(heard["key"], "arm/state");
            assert_eq!(heard["type"], "tangent_msgs/msg/ArmState");
            assert_eq!(heard["sequence"], states.sequence());
            let id: String = states.id().iter().map(|b| format!("{b:02x}")).collect();
            assert_eq!(heard["publisher"], id);
            assert_eq!(heard["message"], serde_json::to_value(&sent).unwrap());
        }
        assert!(
            child.wait().unwrap().success(),
            "the listener ends by itself"
        );
    });
}

/// The codec of the examples decodes our bytes and encodes identical bytes.
#[test]
fn the_python_codec_gives_back_our_bytes() {
    timed(|| {
        let Some(python) = python_with("zenoh") else {
            return;
        };
        fn line<M: Message>(message: &M) -> String {
            let mut bytes = Vec::new();
            cdr::encode(message, &mut bytes).unwrap();
            let hex: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
            format!("{} {hex}\n", M::NAME)
        }
        let mut normal = NormalEstimate {
            header: Header::new(1_795_260_245_123_456_789, "base"),
            cycle: u64::MAX,
            estimator: cut("ä"),
            reason: cut("not sliding"),
            ..NormalEstimate::default()
        };
        normal.covariance[5] = -1e-9;
        let lines = [
            line(&normal),
            line(&ArmState {
                q: [0.5, -1.25, 1e-3].into_iter().collect(),
                robot_mode: -3,
                ready: true,
                not_ready_reason: cut("brakes are on: ä"),
                ..ArmState::default()
            }),
            line(&ControlState {
                phase_text: cut("slide"),
                estimator_switches: 7,
                ..ControlState::default()
            }),
            line(&Health {
                rate_names: vec!["a".into(), String::new()],
                rates_hz: vec![125.0, 7e3],
                ..Health::default()
            }),
            line(&MarkerArray {
                markers: vec![Marker::default(); 2],
            }),
        ]
        .concat();
        let script = "import sys\nfrom tangent_messages import Messages\nm = Messages()\n\
                  for line in sys.stdin:\n    name, text = line.split()\n    \
                  print(name, m.encode(m.decode(name, bytes.fromhex(text))).hex())\n";
        let mut child = Command::new(&python)
            .args(["-c", script])
            .current_dir(root().join("examples/python"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut input = child.stdin.take().unwrap();
        input.write_all(lines.as_bytes()).unwrap();
        drop(input);
        let output = child.wait_with_output().unwrap();
        assert_eq!(String::from_utf8(output.stdout).unwrap(), lines);
    });
}
