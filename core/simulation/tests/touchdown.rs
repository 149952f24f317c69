//! One touchdown on 10 kN/m, cycle by cycle, as a table small enough to read in review.
//!
//! It changes with every change of the force law, and should: read the difference, then accept it with
//! `INSTA_UPDATE=always cargo test --release -p tangent-simulation --test touchdown`.

// A whole file of tests: what fails here is the test.
#![allow(clippy::unwrap_used)]

use std::fmt::Write;

use tangent_simulation::{Scenario, evaluate_with};

#[test]
fn on_a_stiff_surface() {
    let text = include_str!("../../../scenarios/touchdown_10kN_per_m.toml");
    let scenario = Scenario::parse("touchdown", text, &[], &|_| Err(String::new())).unwrap();
    let mut lines: Vec<(bool, String)> = Vec::new();
    evaluate_with(&scenario, |cycle| {
        let truth = cycle.truth;
        let normal = truth.normal;
        lines.push((
            truth.in_contact,
            format!(
                "{:>7.3} {:<8} {:>8.3} {:>8.3} {:>8.3} {:>9.3} {:>9.3}",
                cycle.arm.time_s,
                cycle.output.phase.name(),
                truth.wrench.force.dot(&normal),
                cycle.output.force_n,
                cycle.output.force_reference_n,
                cycle.output.twist_commanded.linear.dot(&normal) * 1e3,
                truth.twist.linear.dot(&normal) * 1e3,
            ),
        ));
    })
    .unwrap();
    let first = lines.iter().position(|(touching, _)| *touching).unwrap();
    let mut table = String::from(
        "   time phase        force measured   wanted   v asked    v true\n      s                   N        N        N      mm/s      mm/s\n",
    );
    // Every cycle of the impact, then every fifth until the force has settled.
    let rows = (first - 3..first + 25).chain((first + 25..first + 125).step_by(5));
    for row in rows {
        // -0.000 and 0.000 are the same to a reader.
        writeln!(table, "{}", lines[row].1.replace("-0.000", " 0.000")).unwrap();
    }
    insta::assert_snapshot!(table);
}
