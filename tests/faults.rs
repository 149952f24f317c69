//! Every failure of the table, provoked at the wire on a cell of processes: noticed, answered, and without a hard push.
//!
//! How soon is a benchmark (`tangent faults`, docs/faults.md); here a machine that does other things too is given time.

#![allow(clippy::unwrap_used)]

mod common;

use common::{json, number, port_offset, run, stderr};

/// Beyond every bound, ms.
const ALLOWED_MS: &str = "1500";

#[test]
fn every_fault_is_answered() {
    let offset = port_offset().to_string();
    let output = run(&[
        "faults",
        "--json",
        "--allow-ms",
        ALLOWED_MS,
        "--port-offset",
        &offset,
    ]);
    // 3: some take root, and are skipped without.
    assert!(
        matches!(output.status.code(), Some(0 | 3)),
        "{}\n{}",
        String::from_utf8_lossy(&output.stdout),
        stderr(&output)
    );
    let said = json(&output);
    let rows = said["rows"].as_array().unwrap();
    assert!(rows.len() >= 46, "{}", rows.len());
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
        // Where the fault ended a task, the next one begins in a known state: it presses as it says, and leaves the surface.
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
}
