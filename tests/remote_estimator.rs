//! The estimator on another host: the table of `docs/remote-estimators.md`, measured.
//!
//! As root, the "other host" is a network namespace behind a veth pair, otherwise a process behind
//! loopback. If the kernel has netem (`tc qdisc add ... netem`), netem impairs the link. Otherwise
//! a relay on the way to the router delays the bytes as TCP would. Each run prints which of them it
//! used.
//!
//!     cargo test --release --test remote_estimator -- --nocapture

#![allow(clippy::unwrap_used)]

mod common;
mod remote;

use std::cell::RefCell;
use std::time::Duration;

use common::{Process, json, number, port_offset, root, run, wait_for, with_slower_sensor};
use remote::{Host, Wire};
use serde_json::Value;
use tangent_live::live_beside_others;

const PATIENCE: Duration = Duration::from_secs(60);

struct Case {
    name: &'static str,
    wire: Wire,
    /// The law moves old estimates on along the surface.
    predicts: bool,
    /// Whether the remote estimator is used most of the time; `false`: the one beside the robot
    /// takes over; `None`: either.
    used: Option<bool>,
}

const NO_DELAY: Wire = Wire {
    delay_ms: 0.0,
    jitter_ms: 0.0,
    loss: 0.0,
    reorder: 0.0,
};
const DELAY_5_MS: Wire = Wire {
    delay_ms: 5.0,
    ..NO_DELAY
};
const DELAY_20_MS: Wire = Wire {
    delay_ms: 20.0,
    ..NO_DELAY
};

/// A circle on the pipe, faster than usual, so that age has more effect.
const TASK: &str = r#"
    name = "circle"
    estimators = ["blend", "reactive"]
    switching.return_after_good_s = 0.3
    force.reference_n = 3.0
    end.retract_distance_m = 0.01
    [path]
    kind = "circle"
    radius_m = 0.04
    turns = 2
    speed_m_per_s = 0.05
"#;

#[test]
fn a_link_without_delay_is_tolerated() {
    check(&Case {
        name: "0 ms",
        wire: NO_DELAY,
        predicts: true,
        used: Some(true),
    });
}

#[test]
fn a_delay_of_5_ms_is_tolerated() {
    check(&Case {
        name: "5 ms",
        wire: DELAY_5_MS,
        predicts: true,
        used: Some(true),
    });
}

#[test]
fn a_delay_of_20_ms_is_tolerated() {
    check(&Case {
        name: "20 ms",
        wire: DELAY_20_MS,
        predicts: true,
        used: Some(true),
    });
}

#[test]
fn a_delay_of_20_ms_is_tolerated_without_prediction() {
    check(&Case {
        name: "20 ms, not moved on",
        wire: DELAY_20_MS,
        predicts: false,
        used: Some(true),
    });
}

#[test]
fn a_delay_of_50_ms_is_tolerated_by_the_other_estimator() {
    check(&Case {
        name: "50 ms",
        wire: Wire {
            delay_ms: 50.0,
            ..NO_DELAY
        },
        predicts: true,
        used: Some(false),
    });
}

#[test]
fn jitter_is_tolerated() {
    check(&Case {
        name: "5 ms, jitter 4 ms",
        wire: Wire {
            jitter_ms: 4.0,
            ..DELAY_5_MS
        },
        predicts: true,
        used: Some(true),
    });
}

#[test]
fn loss_is_tolerated() {
    check(&Case {
        name: "5 ms, 1 % lost",
        wire: Wire {
            loss: 0.01,
            ..DELAY_5_MS
        },
        predicts: true,
        used: None,
    });
}

#[test]
fn reordering_is_tolerated() {
    check(&Case {
        name: "5 ms, 5 % reordered",
        wire: Wire {
            reorder: 0.05,
            ..DELAY_5_MS
        },
        predicts: true,
        used: None,
    });
}

fn check(case: &Case) {
    // Created once: a repeated run uses the same host.
    let mut host = RefCell::new(Host::new());
    eprintln!(
        "{}: the other host is {}",
        case.name,
        host.get_mut().describe()
    );
    live_beside_others(|| is_tolerated(&mut host.borrow_mut(), case));
}

fn is_tolerated(host: &mut Host, case: &Case) {
    let (report, clock_ms) = wipe(host, case);
    let figure = |path: &str| number(&report, path);
    let age = "/estimators/blend/age_ms";
    let used = share_in_use(&report);
    let fallen = report["estimator_switches"].as_array().unwrap().iter();
    let fallen = fallen.filter(|s| s["from"] == "blend").count();
    // A row of the table: delay in each direction; age of the remote normals, mean / p95; share of
    // the time in use; fallbacks; normal error, RMSE; tool off square, mean; force RMSE.
    eprintln!(
        "| {} | {:.0} / {:.0} ms | {:.0} %; {} times | {:.2} deg | {:.2} deg | {:.3} N |",
        case.name,
        figure(&format!("{age}/mean")),
        figure(&format!("{age}/p95")),
        100.0 * used,
        fallen,
        figure("/normal_error_settled_deg/rmse"),
        figure("/tool_error_deg/mean"),
        figure("/force/rmse_n"),
    );
    assert_eq!(
        report["phase"], "done",
        "{}: {}",
        case.name, report["fault"]
    );
    assert_eq!(figure("/contact/lost_count"), 0.0, "{}", case.name);
    assert!(
        figure("/force/rmse_n") < 0.3,
        "{}: {}",
        case.name,
        report["force"]
    );
    // Both processes are on one machine and read the same clock.
    assert!(
        clock_ms.abs() < 2.0 * case.wire.delay_ms + 20.0,
        "{}: {clock_ms}",
        case.name
    );
    if let Some(wanted) = case.used {
        assert_eq!(used > 0.5, wanted, "{}: {used}", case.name);
    }
}

/// Share of the task in which the remote estimator was in use.
fn share_in_use(report: &Value) -> f64 {
    let (mut since, mut used, mut total) = (Some(0.0), 0.0, number(report, "/duration_s"));
    for switch in report["estimator_switches"].as_array().unwrap() {
        let at = number(switch, "/time_s");
        if let Some(since) = since.take() {
            used += at - since;
        }
        since = (switch["to"] == "blend").then_some(at);
    }
    used += since.map_or(0.0, |since| total - since);
    total = total.max(1e-9);
    used / total
}

/// One run with the remote estimator. Returns its report, and the clock offset of the other host.
fn wipe(host: &mut Host, case: &Case) -> (Value, f64) {
    let folder = tempfile::tempdir().unwrap();
    let offset = port_offset();
    let router = 7447 + offset;
    host.impair(&case.wire, router);
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let text = std::fs::read_to_string(root().join("deploy/cell.toml")).unwrap();
    let most = if case.predicts { 0.1 } else { 0.0 };
    let text = with_slower_sensor(&text)
        .replace("port_offset = 0", &format!("port_offset = {offset}"))
        .replace(
            "# [controller.settings]",
            &format!("[controller.settings.normal]\nprediction_max_rad = {most:?}\n#"),
        )
        .replace(
            "listen = [\"tcp/127.0.0.1:7447\"]",
            &format!("listen = [\"tcp/0.0.0.0:{router}\"]\ninsecure = true"),
        );
    let run_line = r#"run = ["reactive", "quadratic", "gaussian_process", "blend"]"#;
    // Close to the surface: the approach is not measured.
    let scenario = std::fs::read_to_string(root().join("scenarios/pipe_realistic.toml")).unwrap();
    let scenario = scenario.replace("clearance_m = 0.01", "clearance_m = 0.003");
    let scenario = write("scenario.toml", &scenario);
    let commented = "# scenario = \"../scenarios/pipe_ideal.toml\"";
    assert!(text.contains(commented));
    let here = text
        .replace(run_line, r#"run = ["reactive"]"#)
        .replace(commented, &format!("scenario = {scenario:?}\n#"));
    let there = text.replace(run_line, r#"run = ["blend"]"#);
    let local = format!("tcp/127.0.0.1:{router}");
    let here = write("here.toml", &here.replace("tcp/127.0.0.1:7447", &local));
    let there = write(
        "there.toml",
        &there.replace("tcp/127.0.0.1:7447", &host.router(router)),
    );
    let task = write("task.toml", TASK);

    let services = [
        "router",
        "simulator",
        "rtde",
        "controller",
        "netft",
        "estimator",
    ];
    let mut cell = Process::start(
        "cell",
        &[&["run"], &services[..], &["--cell", &here]].concat(),
    );
    let _estimator = host.run(&["run", "estimator", "--cell", &there]);
    let ask = |args: &[&str]| {
        let output = run(&[args, &["--json", "--cell", &here]].concat());
        serde_json::from_slice::<Value>(&output.stdout).ok()
    };
    wait_for("both estimators", PATIENCE, || {
        let list = ask(&["estimator", "list"])?;
        let rows = list["estimators"].as_array()?;
        let here = |name: &str| {
            rows.iter()
                .any(|r| r["name"] == name && r["rate_hz"].is_number())
        };
        (here("blend") && here("reactive")).then_some(())
    });
    let records = folder.path().join("records");
    let mut recorder = Process::start(
        "recorder",
        &[
            "record",
            "--cell",
            &here,
            "--folder",
            records.to_str().unwrap(),
        ],
    );
    let status = wait_for("the recorder", PATIENCE, || {
        let status = ask(&["status"])?;
        let services = status["services"].as_array()?;
        services
            .iter()
            .any(|s| s["name"] == "recorder")
            .then(|| status.clone())
    });
    let services = status["services"].as_array().unwrap();
    let offsets = services.iter().filter(|s| s["name"] == "estimator");
    let offsets: Vec<f64> = offsets
        .filter_map(|s| s["clock_offset_ms"].as_f64())
        .collect();
    assert_eq!(offsets.len(), 2, "{status}");
    let farthest = offsets
        .into_iter()
        .fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    wait_for("the start", PATIENCE, || {
        let answer = ask(&["task", "start", &task])?;
        (answer["done"] == true).then_some(())
    });
    wait_for("the end", Duration::from_secs(120), || {
        let answer = ask(&["task", "status"])?;
        matches!(answer["data"]["phase"].as_str()?, "done" | "fault").then_some(())
    });
    recorder.terminate(Duration::from_secs(20));
    cell.terminate(Duration::from_secs(30));
    let files = std::fs::read_dir(records)
        .unwrap()
        .map(|e| e.unwrap().path());
    let file = files
        .into_iter()
        .find(|p| p.extension().is_some_and(|e| e == "mcap"))
        .unwrap();
    let report = run(&["report", file.to_str().unwrap(), "--json", "--no-html"]);
    (json(&report), farthest)
}
