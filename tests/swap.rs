//! Estimators that are not part of the program, in Python and in Rust, are swapped in while the
//! tool slides.
//!
//! Python needs `eclipse-zenoh` from `tests/interop/requirements.txt`. Without it, that test
//! reports this and passes, unless `TANGENT_REQUIRE_INTEROP` is set.

#![allow(clippy::unwrap_used)]

mod common;

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use common::{json, number, port_offset, root, run, tangent, wait_for, with_slower_sensor};
use serde_json::Value;
use tangent_live::live_beside_others;

const PATIENCE: Duration = Duration::from_secs(60);

/// `tangent up` with a line that is long enough, and the cell file for clients of its router.
struct Up {
    folder: tempfile::TempDir,
    cell: String,
    router: String,
    child: Option<Child>,
}

impl Up {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let offset = port_offset();
        let router = format!("tcp/127.0.0.1:{}", 7447 + offset);
        let text = std::fs::read_to_string(root().join("deploy/cell.toml")).unwrap();
        let cell = folder.path().join("cell.toml");
        std::fs::write(&cell, text.replace("tcp/127.0.0.1:7447", &router)).unwrap();
        let simulated = folder.path().join("up.toml");
        std::fs::write(&simulated, with_slower_sensor(&text)).unwrap();
        let text = std::fs::read_to_string(root().join("deploy/tasks/line.toml")).unwrap();
        let task = folder.path().join("task.toml");
        let text = text.replace("strokes = 6", "strokes = 8");
        let rule = "[switching]\nreturn_after_good_s = 0.5\n\n[force]";
        std::fs::write(&task, text.replace("[force]", rule)).unwrap();
        let child = tangent()
            // Without sensor errors, only the swap changes the force.
            .args(["up", task.to_str().unwrap(), "--scenario", "pipe_ideal"])
            .args(["--cell", simulated.to_str().unwrap()])
            .args(["--json", "--port-offset"])
            .args([&offset.to_string(), "--folder"])
            .arg(folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        Self {
            cell: cell.to_str().unwrap().to_owned(),
            folder,
            router,
            child: Some(child),
        }
    }

    fn ask(&self, args: &[&str]) -> Option<Value> {
        let output = run(&[args, &["--json", "--cell", &self.cell]].concat());
        serde_json::from_slice(&output.stdout).ok()
    }

    fn wait_until_sliding(&mut self) {
        wait_for("sliding", PATIENCE, || {
            let ended = self.child.as_mut().unwrap().try_wait().unwrap();
            assert!(ended.is_none(), "it has ended with {ended:?}");
            let answer = self.ask(&["task", "status"])?;
            (answer["data"]["phase"] == "slide").then_some(())
        });
    }

    /// Waits until the estimator is listed as valid, then requests it.
    fn swap_in(&self, name: &str) {
        let row = wait_for(name, PATIENCE, || {
            let list = self.ask(&["estimator", "list"])?;
            let rows = list["estimators"].as_array()?.clone();
            rows.into_iter().find(|row| {
                let rate_hz = row["rate_hz"].as_f64().unwrap_or(0.0);
                row["name"] == name && row["valid"] == true && rate_hz > 20.0
            })
        });
        assert_eq!(row["instances"].as_array().unwrap().len(), 1, "{row}");
        // On a busy machine the estimate may be too old. The request is then refused and repeated.
        wait_for("the switch", PATIENCE, || {
            let answer = self.ask(&["estimator", "use", name])?;
            (answer["done"] == true).then_some(())
        });
        // On a busy machine the controller may be silent for a second; then there is nothing to
        // compare, and the request is repeated.
        let error_deg = wait_for("a comparison", PATIENCE, || {
            let compared = self.ask(&["estimator", "compare", "--seconds", "1"])?;
            compared
                .pointer(&format!("/estimators/{name}/normal_error_deg/mean"))?
                .as_f64()
        });
        assert!(error_deg < 10.0, "{error_deg}");
    }

    fn report(mut self) -> Value {
        let report = json(&self.child.take().unwrap().wait_with_output().unwrap());
        assert_eq!(report["phase"], "done", "{}", report["fault"]);
        let path = self.folder.path();
        let recording = std::fs::read_dir(path).unwrap().map(|e| e.unwrap().path());
        let recording = recording
            .into_iter()
            .find(|p| p.extension().is_some_and(|e| e == "mcap"));
        // `compare` prints this table from the recording too.
        let recorded = run(&[
            "estimator",
            "compare",
            recording.unwrap().to_str().unwrap(),
            "--json",
        ]);
        assert_eq!(json(&recorded)["estimators"], report["estimators"]);
        report
    }
}

impl Drop for Up {
    fn drop(&mut self) {
        if let Some(child) = &mut self.child {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

struct Own(Child);

impl Drop for Own {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn assert_force_held(report: &Value) {
    let reference = number(report, "/force/reference_n");
    let p95 = number(report, "/force/p95_abs_error_n");
    assert!(p95 < 0.1 * reference, "{p95} N of {reference} N");
    assert_eq!(number(report, "/contact/lost_count"), 0.0);
}

fn switches(report: &Value) -> Vec<(String, String)> {
    let text = |v: &Value| v.as_str().unwrap().to_owned();
    let all = report["estimator_switches"].as_array().unwrap();
    all.iter()
        .map(|s| (text(&s["to"]), text(&s["cause"])))
        .collect()
}

fn python() -> Option<PathBuf> {
    let own = root().join(".venv/bin/python3");
    let python = match std::env::var_os("TANGENT_PYTHON") {
        Some(path) => path.into(),
        None if own.exists() => own,
        None => PathBuf::from("python3"),
    };
    let check = Command::new(&python).args(["-c", "import zenoh"]).output();
    if check.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    let reason = format!("{} has no zenoh", python.display());
    assert!(
        std::env::var_os("TANGENT_REQUIRE_INTEROP").is_none(),
        "TANGENT_REQUIRE_INTEROP is set, but {reason}"
    );
    eprintln!("skipped, because {reason} (pip install -r tests/interop/requirements.txt)");
    None
}

#[test]
fn an_estimator_in_python_is_swapped_in_and_the_wipe_ends_done() {
    live_beside_others(|| {
        let Some(python) = python() else { return };
        let mut up = Up::start();
        up.wait_until_sliding();
        let script = |name: &str| root().join("examples/python").join(name);
        let own = Command::new(&python)
            .arg(script("estimator.py"))
            .args(["--router", &up.router, "--name", "my_python"])
            .spawn();
        let _own = Own(own.unwrap());
        up.swap_in("my_python");
        let client = |args: &[&str]| {
            let output = Command::new(&python)
                .arg(script("client.py"))
                .args(["--router", &up.router])
                .args(args)
                .output()
                .unwrap();
            String::from_utf8(output.stdout).unwrap()
        };
        // Both receive for a fixed time: on a busy machine they are called again until a message
        // arrived in it.
        for (args, word) in [
            (&["status"][..], "controller"),
            (&["plot", "--seconds", "1"][..], " N |"),
        ] {
            wait_for(word, PATIENCE, || client(args).contains(word).then_some(()));
        }
        let report = up.report();
        // On a busy machine it may have been too late later on; then the next one took over, and it
        // returned.
        assert_eq!(
            switches(&report)[0],
            ("my_python".to_owned(), "asked for".to_owned())
        );
        assert_force_held(&report);
    });
}

#[test]
fn an_estimator_in_rust_is_swapped_in_and_when_it_is_killed_the_next_takes_over() {
    live_beside_others(|| {
        let program = Path::new(env!("CARGO_BIN_EXE_tangent")).parent().unwrap();
        let program = program.join("examples/own_estimator");
        if !program.exists() {
            // `cargo test` builds the examples; `cargo test --test swap` does not.
            let mut cargo = Command::new(env!("CARGO"));
            cargo.args(["build", "--release", "--example", "own_estimator"]);
            assert!(cargo.current_dir(root()).status().unwrap().success());
        }
        let mut up = Up::start();
        up.wait_until_sliding();
        let mut own = Own(Command::new(program)
            .args(["my_rust", &up.cell])
            .spawn()
            .unwrap());
        up.swap_in("my_rust");
        own.0.kill().unwrap();
        let report = up.report();
        assert_eq!(report["estimator"], "blend");
        let found = switches(&report);
        assert_eq!(found[0], ("my_rust".to_owned(), "asked for".to_owned()));
        let last = found.last().unwrap();
        assert!(
            last.0 == "blend" && last.1.starts_with("fell back"),
            "{found:?}"
        );
        assert_force_held(&report);
    });
}
