//! Failures of the table, provoked at the wire on a cell of processes: noticed, answered, and
//! without a hard push.
//!
//! Bounds are held in simulated time (services/simulator/tests/failure_table). How soon a machine
//! is, measures `tangent faults` (docs/faults.md); here one that does other things too is given
//! time.

#![allow(clippy::unwrap_used)]

mod common;

use common::{json, number, port_offset, run, stderr};
use tangent_live::live;

/// Beyond every bound, ms.
const ALLOWED_MS: &str = "1500";

/// One of each kind that no other test provokes on processes: in the robot, in the sensor's
/// datagrams, in messages, on the disk, in clocks, on the surface.
const HERE: [&str; 9] = [
    "protective_stop",
    "sensor_frozen",
    "sensor_datagrams_corrupted",
    "wrench_not_finite",
    "disk_full",
    "command_not_finite",
    "second_controller",
    "clock_set_forward",
    "contact_lost",
];

#[test]
fn a_fault_of_each_kind_is_answered() {
    live(|| {
        let rows = answered(&HERE);
        assert_eq!(rows, HERE.len());
    });
}

/// All of them, ten minutes.
#[test]
#[ignore = "a benchmark's length: `tangent faults` does the same"]
fn every_fault_is_answered() {
    live(|| {
        let rows = answered(&[]);
        assert!(rows >= 46, "{rows}");
    });
}

/// Provokes these, or all; how many there were.
fn answered(faults: &[&str]) -> usize {
    let offset = port_offset().to_string();
    let mut args = vec!["faults"];
    args.extend(faults);
    args.extend(["--json", "--allow-ms", ALLOWED_MS, "--port-offset", &offset]);
    let output = run(&args);
    // 3: some take root, and are skipped without.
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
        // Where the fault ended a task, the next one begins in a known state: it presses as it
        // says, and leaves the surface.
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
