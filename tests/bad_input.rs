//! Mistakes in what the user gives: each is answered with its name, the value, what is allowed, and exit code 2.

#![allow(clippy::unwrap_used)]

mod common;

use std::fs;
use std::net::TcpListener;
use std::process::Stdio;

use common::{port_offset, root, run, stderr, tangent};

/// Runs and checks that the exit code is 2 and the message has all these words.
fn refused(args: &[&str], words: &[&str]) {
    let output = run(args);
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{args:?}: {said}");
    for word in words {
        assert!(said.contains(word), "{args:?}: no {word:?} in: {said}");
    }
}

/// `tangent ... | head -1`: a reader that has seen enough is no failure.
#[test]
fn a_reader_that_leaves() {
    let mut child = tangent()
        .args(["model", "show", "ur5"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(stderr(&output), "");
    assert_eq!(output.status.code(), Some(0));
}

#[test]
fn scenarios() {
    refused(&["evaluate", "pipes"], &["pipes", "pipe_ideal"]);
    refused(
        &["evaluate", "pipe_ideal", "--estimator", "magic"],
        &["magic", "reactive"],
    );
    refused(
        &["evaluate", "pipe_ideal", "--controller", "magic"],
        &["magic", "paper"],
    );
    refused(
        &["evaluate", "pipe_ideal", "--set", "plant.nothing=1"],
        &["nothing"],
    );
    refused(
        &["evaluate", "pipe_ideal", "--set", "duration_s=-1"],
        &["duration_s", "-1"],
    );
    refused(
        &["evaluate", "pipe_ideal", "--set", "duration_s"],
        &["duration_s"],
    );
    refused(&["evaluate", "pipe_ideal", "--seed", "x"], &["seed", "x"]);
}

#[test]
fn cell_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.toml");
    let good = fs::read_to_string(root().join("deploy/cell.toml")).unwrap();
    let cases = [
        ("[robot]", "[robot]\nspeeed = 1", &["speeed"][..]),
        (
            "rate_hz = 7000.0",
            "rate_hz = 9000.0",
            &["sensor.rate_hz", "9000"],
        ),
        (
            "rtde_port = 30004",
            "rtde_port = \"thirty\"",
            &["rtde_port"],
        ),
        ("mass_kg = 0.3", "mass_kg = -0.3", &["tool.mass_kg", "-0.3"]),
        (
            "register_base = 24",
            "register_base = 47",
            &["register_base", "47"],
        ),
        ("[tool]", "[tol]", &["tol"]),
        ("model = \"ur5\"", "model = \"ur55\"", &["ur55"]),
    ];
    for (from, to, words) in cases {
        let text = good.replacen(from, to, 1);
        assert_ne!(text, good, "{from} is not in deploy/cell.toml");
        fs::write(&path, text).unwrap();
        let file = path.to_str().unwrap();
        refused(
            &["run", "rtde", "--cell", file],
            &[&["cell.toml"], words].concat(),
        );
    }
    refused(
        &["status", "--cell", "/nowhere/cell.toml"],
        &["/nowhere/cell.toml"],
    );
}

#[test]
fn task_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("task.toml");
    let good = fs::read_to_string(root().join("deploy/tasks/raster.toml")).unwrap();
    for (from, to, word) in [
        ("reference_n = ", "reference_n = -", "force.reference_n"),
        ("[path]", "[path]\nspiral = true", "spiral"),
    ] {
        let text = good.replacen(from, to, 1);
        assert_ne!(text, good, "{from} is not in raster.toml");
        fs::write(&path, text).unwrap();
        let file = path.to_str().unwrap();
        refused(&["task", "start", file], &["task.toml", word]);
    }
    refused(&["task", "start", "/nowhere.toml"], &["/nowhere.toml"]);
}

#[test]
fn nobody_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cell.toml");
    let port = 7447 + port_offset();
    let text = fs::read_to_string(root().join("deploy/cell.toml"))
        .unwrap()
        .replace("127.0.0.1:7447", &format!("127.0.0.1:{port}"));
    fs::write(&path, text).unwrap();
    let output = run(&["status", "--cell", path.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr(&output).contains("tangent up"),
        "{}",
        stderr(&output)
    );
}

#[test]
fn a_busy_port_is_named() {
    let offset = port_offset();
    let _busy = TcpListener::bind(("127.0.0.1", 7447 + offset)).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let output = run(&[
        "up",
        "--folder",
        folder.path().to_str().unwrap(),
        "--port-offset",
        &offset.to_string(),
    ]);
    assert!(!output.status.success());
    assert!(
        stderr(&output).contains(&(7447 + offset).to_string()),
        "{}",
        stderr(&output)
    );
}

#[test]
fn recordings() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notes.mcap");
    fs::write(&path, "hello").unwrap();
    for file in [path.to_str().unwrap(), "/nowhere.mcap"] {
        let output = run(&["report", file]);
        assert!(!output.status.success());
        assert!(stderr(&output).contains(file), "{}", stderr(&output));
    }
}
