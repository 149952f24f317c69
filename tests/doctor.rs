//! `tangent doctor` with the simulated robot and sensor, and without them.

#![allow(clippy::unwrap_used)]

mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::Value;

use common::{Process, json, port_offset, root, run, wait_for};

/// Writes the shipped `deploy/cell.toml` at a port offset, with some of its lines replaced, and
/// returns its path.
fn cell(folder: &Path, offset: u16, changes: &[(&str, &str)]) -> PathBuf {
    cell_of("cell.toml", folder, offset, changes)
}

/// Writes the shipped cell file `deploy/{shipped}` at a port offset, with some of its lines
/// replaced, and returns its path.
fn cell_of(shipped: &str, folder: &Path, offset: u16, changes: &[(&str, &str)]) -> PathBuf {
    let mut text = fs::read_to_string(root().join("deploy").join(shipped))
        .unwrap()
        .replace("127.0.0.1:7447", &format!("127.0.0.1:{}", 7447 + offset))
        .replace("port_offset = 0", &format!("port_offset = {offset}"));
    for (from, to) in changes {
        assert!(text.contains(from), "{from} is not in deploy/{shipped}");
        text = text.replacen(from, to, 1);
    }
    let path = folder.join(format!("cell{}.toml", changes.len()));
    fs::write(&path, text).unwrap();
    path
}

/// The findings, after a check that the exit code agrees with the verdict.
fn findings(arguments: &[&str]) -> Value {
    let output = run(&[&["doctor", "--json"], arguments].concat());
    let diagnosis = json(&output);
    let expected = i32::from(diagnosis["verdict"] == "problem");
    assert_eq!(output.status.code(), Some(expected), "{diagnosis:#}");
    diagnosis["findings"].clone()
}

fn finding<'a>(findings: &'a Value, check: &str) -> &'a Value {
    findings
        .as_array()
        .unwrap()
        .iter()
        .find(|f| f["check"] == check)
        .unwrap_or_else(|| panic!("no finding about {check} in {findings:#}"))
}

#[test]
fn the_simulated_cell_passes_and_a_wrong_cell_file_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let offset = port_offset();
    let good = cell(folder.path(), offset, &[]);
    let good = good.to_str().unwrap();
    let _simulated = Process::start("simulator", &["run", "router", "simulator", "--cell", good]);
    wait_for("the simulated cell", Duration::from_secs(30), || {
        let output = run(&["health", "router", "simulator", "--cell", good]);
        output.status.success().then_some(())
    });

    let found = findings(&["--cell", good]);
    for (check, words) in [
        ("robot's software", "3.15.8"),
        ("robot's model", "UR5"),
        ("robot's mode", "RUNNING"),
        ("sensor", "Net F/T"),
        ("sensor's rate", "7000"),
        ("sensor's filter", "off"),
        ("router's port", "held by a running tangent"),
        ("network card", "lo"),
    ] {
        let one = finding(&found, check);
        assert_eq!(one["level"], "ok", "{one:#}");
        assert!(one["found"].as_str().unwrap().contains(words), "{one:#}");
    }

    let changes = [
        ("model = \"ur5\"", "model = \"ur5e\""),
        (
            "rate_hz = 0.0                       # records",
            "rate_hz = 3500.0 # records",
        ),
        ("# loop_cpu = 1", "loop_cpu = 900"),
    ];
    let wrong = cell(folder.path(), offset, &changes);
    let found = findings(&["--cell", wrong.to_str().unwrap()]);
    for (check, level) in [
        ("robot's software", "problem"),
        ("sensor's rate", "warning"),
        ("loop's processor", "problem"),
    ] {
        let one = finding(&found, check);
        assert_eq!(one["level"], level, "{one:#}");
        for key in ["meaning", "advice"] {
            assert!(!one[key].as_str().unwrap().is_empty(), "{one:#}");
        }
    }
}

#[test]
fn devices_that_are_not_there_are_problems_and_may_be_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = cell(folder.path(), port_offset(), &[]);
    let path = path.to_str().unwrap();
    let found = findings(&["--cell", path]);
    for check in ["robot", "sensor"] {
        assert_eq!(finding(&found, check)["level"], "problem");
    }
    let machine = findings(&["--machine", "--cell", path]);
    let about_devices = machine.as_array().unwrap().iter().any(|f| {
        let check = f["check"].as_str().unwrap();
        check.starts_with("robot") || check.starts_with("sensor")
    });
    assert!(!about_devices, "{machine:#}");
    for check in ["scheduling", "kernel preemption", "clock", "disk space"] {
        finding(&machine, check);
    }
}

const NETWORK: &str =
    "[zenoh]\nconnect = [\"tcp/127.0.0.1:7447\"]\nlisten = [\"tcp/127.0.0.1:7447\"]\n\n[tool]";

#[test]
fn a_franka_is_queried_over_its_own_protocol() {
    let folder = tempfile::tempdir().unwrap();
    let offset = port_offset();
    let network = NETWORK.replace("7447", &(7447 + offset).to_string());
    let path = cell_of(
        "cell.franka.toml",
        folder.path(),
        offset,
        &[("[tool]", &network)],
    );
    let path = path.to_str().unwrap();
    let found = findings(&["--cell", path]);
    let robot = finding(&found, "robot");
    assert_eq!(robot["level"], "problem");
    let said = robot["meaning"].as_str().unwrap();
    assert!(said.contains("FCI does not answer"), "{robot:#}");

    let _simulated = Process::start("simulator", &["run", "router", "simulator", "--cell", path]);
    wait_for("the simulated cell", Duration::from_secs(30), || {
        let output = run(&["health", "router", "simulator", "--cell", path]);
        output.status.success().then_some(())
    });
    let found = findings(&["--cell", path]);
    for (check, words) in [
        ("robot's software", "FCI version 5"),
        ("robot's mode", "idle"),
        ("robot's states", "longest pause"),
        ("sensor", "the robot estimates the wrench itself"),
    ] {
        let one = finding(&found, check);
        assert!(one["found"].as_str().unwrap().contains(words), "{one:#}");
    }
    let text = found.to_string();
    assert!(
        !text.contains("Universal Robots") && !text.contains("Net F/T"),
        "{text}"
    );
}

#[test]
fn missing_services_of_a_cell_with_a_torque_arm_and_a_camera_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    for shipped in ["cell.lippiello.toml", "cell.karacan.toml"] {
        let scenario = format!("scenario = \"{}/scenarios/", root().display());
        let changes = [("scenario = \"../scenarios/", scenario.as_str())];
        let path = cell_of(shipped, folder.path(), port_offset(), &changes);
        let found = findings(&["--cell", path.to_str().unwrap()]);
        assert_eq!(finding(&found, "robot")["level"], "problem");
        let camera = finding(&found, "camera");
        assert_eq!(camera["level"], "warning", "{camera:#}");
        let said = camera["found"].as_str().unwrap();
        assert!(said.contains("router does not run"), "{camera:#}");
        assert!(!found.to_string().contains("Universal Robots"));
    }
}
