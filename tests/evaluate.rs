//! `tangent evaluate` and `reproduce` as a user calls them: same numbers every time, and the figures that are promised.

#![allow(clippy::unwrap_used)]

mod common;

use common::{json, run};
use serde_json::Value;

#[test]
fn the_same_input_gives_the_same_digest() {
    let once = || {
        json(&run(&[
            "evaluate",
            "pipe_realistic",
            "--seed",
            "7",
            "--json",
        ]))
    };
    let (a, b) = (once(), once());
    assert_eq!(a["state_digest"], b["state_digest"]);
    assert_eq!(a["force"], b["force"]);
    let other = json(&run(&[
        "evaluate",
        "pipe_realistic",
        "--seed",
        "8",
        "--json",
    ]));
    assert_ne!(a["state_digest"], other["state_digest"]);
}

#[test]
fn every_key_of_the_contract_is_there() {
    let value = json(&run(&["evaluate", "pipe_ideal", "--json"]));
    for key in [
        "scenario",
        "controller",
        "estimator",
        "seed",
        "duration_s",
        "steps",
        "wall_s",
        "real_time_factor",
        "normal_error_deg",
        "normal_error_settled_deg",
        "alignment_error_deg",
        "tool_error_deg",
        "normal_nees_per_dof",
        "force",
        "path",
        "contact",
        "joints",
        "object_pose",
        "tanks",
        "loop",
        "state_digest",
    ] {
        assert!(value.get(key).is_some(), "{key} is missing");
    }
    for key in ["mean", "median", "std", "rmse", "p95", "max", "n"] {
        assert!(
            value["normal_error_deg"][key].is_number(),
            "normal_error_deg.{key}"
        );
    }
}

/// Two seeds of every row: the promised figures hold.
#[test]
fn the_papers_tables_are_beaten() {
    let output = run(&["reproduce", "tugal", "--seeds", "2", "--json"]);
    let value = json(&output);
    let rows = value["rows"].as_array().unwrap();
    assert!(rows.len() >= 20, "{} rows", rows.len());
    let missed: Vec<&Value> = rows.iter().filter(|row| row["met"] == false).collect();
    assert!(missed.is_empty(), "{missed:#?}");
    assert_eq!(output.status.code(), Some(0));
}

#[test]
fn models_agree_with_the_reference_values() {
    let file = common::root().join("core/mechanics/tests/golden/golden.json");
    let output = run(&["model", "check", file.to_str().unwrap(), "--json"]);
    assert_eq!(output.status.code(), Some(0));
    let value = json(&output);
    let rows = value["models"].as_array().unwrap();
    assert_eq!(rows.len(), 45);
    for row in rows {
        let difference = row["max_relative_difference"].as_f64().unwrap();
        let bound = if row["quantity"] == "fd_qdd" {
            1e-9
        } else {
            1e-10
        };
        assert!(difference <= bound, "{row}");
    }
}
