//! `tangent bench` measures everything that it names. The speed of this machine is not asserted.
#![allow(clippy::unwrap_used)]

mod common;

use common::{json, run};

/// Names of the rows, after a check that the figures are consistent.
fn rows(args: &[&str]) -> Vec<String> {
    let output = run(args);
    let table = json(&output);
    assert!(output.status.success());
    assert!(table["machine"]["cores"].as_u64().unwrap() > 0);
    let rows = table["rows"].as_array().unwrap();
    rows.iter()
        .map(|row| {
            let us = |key: &str| row[key].as_f64().unwrap();
            assert!(row["n"].as_u64().unwrap() > 0, "{row}");
            assert!(0.0 < us("p50_us"), "{row}");
            assert!(
                us("p50_us") <= us("p99_us") && us("p99_us") <= us("p999_us"),
                "{row}"
            );
            assert!(us("p999_us") <= us("max_us"), "{row}");
            row["name"].as_str().unwrap().to_owned()
        })
        .collect()
}

#[test]
fn every_step_is_timed() {
    let names = rows(&["bench", "steps", "--json"]);
    for step in [
        "wrench conditioning, one record",
        "control law",
        "control law unified_force_impedance",
        "estimator blend",
        "estimator gaussian_process_paper",
        "depth_normal, whole frame 640 x 480: both",
        "depth_normal, whole frame 848 x 480: both",
    ] {
        assert!(names.iter().any(|n| n == step), "{step}: {names:?}");
    }
}

#[test]
fn the_bus_is_timed_on_every_way_idle_and_loaded() {
    let names = rows(&["bench", "bus", "--seconds", "0.1", "--json"]);
    for way in [
        "one process",
        "two processes, one of them the router",
        "two processes through a router",
    ] {
        for under in ["idle", "every core busy"] {
            for rate in ["125 Hz", "1000 Hz"] {
                let row = format!("{way}, {rate}: there and back, {under}, normal");
                assert!(names.contains(&row), "{row}: {names:?}");
            }
        }
    }
}

#[test]
fn an_invalid_length_is_refused() {
    let output = run(&["bench", "bus", "--seconds", "0"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(common::stderr(&output).contains("0.1 to 3600 seconds"));
}
