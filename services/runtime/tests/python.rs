//! A third party on the bus: Python with `eclipse-zenoh` and `rosbags`, running the example that ships.
//!
//! They come from `tests/interop/requirements.txt`. Without them the test says so and passes, unless
//! `TANGENT_REQUIRE_INTEROP` is set.
#![allow(clippy::unwrap_used)]

mod common;

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use common::{PATIENCE, cell, client, until};
use tangent_runtime::{Bus, Role};
use tangent_schemas::convert::cut;
use tangent_schemas::tangent::ArmState;
use tangent_schemas::topics;

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

#[test]
fn a_python_listener_reads_what_we_publish() {
    let python = python();
    let check = Command::new(&python)
        .args(["-c", "import zenoh, rosbags.typesys"])
        .output();
    if !check.is_ok_and(|output| output.status.success()) {
        let reason = format!("{} has no zenoh or no rosbags", python.display());
        assert!(
            std::env::var_os("TANGENT_REQUIRE_INTEROP").is_none(),
            "TANGENT_REQUIRE_INTEROP is set, but {reason}"
        );
        eprintln!("skipped, because {reason} (pip install -r tests/interop/requirements.txt)");
        return;
    }
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
}
