//! Provokes failures of the table on a cell of real processes: each must be detected and handled,
//! without excessive force.
//!
//! The bounds are tested in simulated time (services/simulator/tests/failure_table). `tangent
//! faults` measures how fast a machine is (docs/faults.md); here, the bounds allow for a machine
//! with other load.

#![allow(clippy::unwrap_used)]

mod common;

use common::{json, number, port_offset, run, stderr};
use tangent_live::{live, live_beside_others};

/// Time allowed beyond every bound, ms.
const ALLOWED_MS: &str = "1500";

// One fault of each kind that no other test provokes on processes: in the robot, in the sensor's
// datagrams, in messages, on the disk, in clocks, on the surface.

#[test]
fn faults_of_the_robot_and_of_commands_are_answered() {
    each_is_answered(&["protective_stop", "command_not_finite", "second_controller"]);
}

#[test]
fn faults_of_the_sensor_are_answered() {
    each_is_answered(&[
        "sensor_frozen",
        "sensor_datagrams_corrupted",
        "wrench_not_finite",
    ]);
}

#[test]
fn faults_of_the_disk_of_clocks_and_of_the_surface_are_answered() {
    each_is_answered(&["disk_full", "clock_set_forward", "contact_lost"]);
}

fn each_is_answered(faults: &[&str]) {
    live_beside_others(|| {
        let rows = answered(faults);
        assert_eq!(rows, faults.len());
    });
}

/// All faults, which takes ten minutes.
#[test]
#[ignore = "a benchmark's length: `tangent faults` does the same"]
fn every_fault_is_answered() {
    live(|| {
        let rows = answered(&[]);
        assert!(rows >= 46, "{rows}");
    });
}

/// Provokes these faults, or all; returns their number.
fn answered(faults: &[&str]) -> usize {
    let offset = port_offset().to_string();
    let mut args = vec!["faults"];
    args.extend(faults);
    args.extend(["--json", "--allow-ms", ALLOWED_MS, "--port-offset", &offset]);
    let output = run(&args);
    // Exit code 3: some faults require root, and are skipped without it.
    assert!(
        matches!(output.status.code(), Some(0 | 3)),
        "{}\n{}",
        String::from_utf8_lossy(&output.stdout),
        stderr(&output)
    );
    let said = json(&output);
    let rows = said["rows"].as_array().unwrap();
    let force_max_n = number(&said, "/force_max_n");
    for row in rows {
        if row["skipped"] == true {
            println!("{}: {}", row["fault"], row["remark"]);
            continue;
        }
        println!(
            "{}: noticed {} ms, safe {} ms, {:.1} N",
            row["fault"],
            row["noticed_ms"],
            row["safe_ms"],
            number(row, "/peak_force_n")
        );
        assert_eq!(row["met"], true, "{row}");
        assert_eq!(row["messages_lost_outside"], 0, "{row}");
        // If the fault ended a task, the next one begins in a known state: its force is shown
        // correctly, and it leaves the surface.
        let again = &row["again_retracted"];
        if again.is_null() {
            assert!(row["outcome"] != "ends", "{row}");
            continue;
        }
        assert_eq!(again, true, "{row}");
        assert!(number(row, "/again_peak_force_n") <= force_max_n, "{row}");
        let shown_minus_true_n = number(row, "/again_shown_minus_true_n");
        assert!(shown_minus_true_n.abs() <= 0.5, "{row}");
    }
    rows.len()
}
