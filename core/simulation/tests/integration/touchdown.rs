//! One touchdown on 10 kN/m, cycle by cycle, as a table small enough to read in review, and figures
//! of touchdowns from soft to stiff surfaces.
//!
//! The table changes with every change of the force law, and should: read the difference, then
//! accept it with `INSTA_UPDATE=always cargo test --release -p tangent-simulation --test
//! touchdown`.

// A whole file of tests: what fails here is the test.
use std::fmt::Write;

use tangent_simulation::{
    AdmittanceScenario, evaluate_admittance, evaluate_admittance_with, no_files,
};

#[test]
fn on_a_stiff_surface() {
    let text = include_str!("../../../../scenarios/touchdown_10kN_per_m.toml");
    let scenario = AdmittanceScenario::parse("touchdown", text, &[], &no_files).unwrap();
    let mut lines: Vec<(bool, String)> = Vec::new();
    evaluate_admittance_with(&scenario, |cycle| {
        let truth = cycle.truth;
        let normal = truth.normal;
        lines.push((
            truth.in_contact,
            format!(
                "{:>7.3} {:<8} {:>8.3} {:>8.3} {:>8.3} {:>9.3} {:>9.3}",
                cycle.arm.time_s,
                cycle.output.phase.name(),
                truth.wrench.force.dot(&normal),
                cycle.output.force_n.unwrap_or(f64::NAN),
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
        // -0.000 and 0.000 mean the same to a reader.
        writeln!(table, "{}", lines[row].1.replace("-0.000", " 0.000")).unwrap();
    }
    insta::assert_snapshot!(table);
}

/// The law does not know the stiffness. Includes a real sensor, an arm's encoders and a tool that
/// touches down with a tilt.
#[test]
fn gentle_from_2_to_50_kn_per_m() {
    let text = include_str!("../../../../scenarios/touchdown_10kN_per_m.toml");
    let real: Vec<String> = [
        "plant.sensor.noise_n_per_sqrt_hz=0.002",
        "plant.sensor.noise_nm_per_sqrt_hz=6e-5",
        "plant.sensor.resolution_n=[0.025, 0.025, 0.05]",
        "plant.sensor.bias_n=2.0",
        "plant.sensor.bias_nm=0.1",
        "plant.sensor.drift_n=0.3",
        "plant.sensor.drift_nm=0.01",
        "plant.sensor.walk_n_per_sqrt_s=0.005",
        "plant.arm.encoder_resolution_rad=1e-5",
        "plant.arm.velocity_resolution_rad_per_s=1e-4",
        "plant.tool.payload_error.mass_kg=0.02",
        "plant.start.tilt_rad=0.05",
    ]
    .map(str::to_owned)
    .to_vec();
    for stiffness in [1e3, 2e3, 5e3, 1e4, 2.5e4, 5e4] {
        let key = format!("plant.contact.stiffness_n_per_m={stiffness:.1}");
        let mut cells = vec![vec![key.clone()]];
        for seed in 1..=5 {
            // The touchdown may happen at any time within a cycle.
            let clearance = format!("plant.start.clearance_m={}", 0.004 + 3e-6 * seed as f64);
            let mut cell = real.clone();
            cell.extend([key.clone(), format!("seed={seed}"), clearance.clone()]);
            cells.extend([cell, vec![key.clone(), clearance]]);
        }
        for cell in cells {
            let scenario = AdmittanceScenario::parse("touchdown", text, &cell, &no_files).unwrap();
            let result = evaluate_admittance(&scenario).unwrap();
            let force = result.figures.force;
            assert_eq!(result.phase, "done", "{cell:?}");
            assert!(result.figures.contact.lost_count <= 1, "{cell:?}");
            assert!(
                force.overshoot_percent.unwrap() <= 30.0,
                "{cell:?}: {force:?}"
            );
            assert!(force.settling_s.unwrap() < 3.0, "{cell:?}: {force:?}");
        }
    }
}

#[test]
fn a_touchdown_that_never_settles_is_not_called_gentle() {
    let text = include_str!("../../../../scenarios/touchdown_10kN_per_m.toml");
    let paper = ["controller=paper".to_owned()];
    let scenario = AdmittanceScenario::parse("touchdown", text, &paper, &no_files).unwrap();
    let figures = evaluate_admittance(&scenario).unwrap().figures;
    assert!(
        figures.force.overshoot_percent.unwrap() > 100.0,
        "{:?}",
        figures.force
    );
    assert_eq!(figures.force.settling_s, None);
}

/// A swab that lands 16 degrees off, touches with its rim and gives: time from the touch until the
/// force has built up to 1.5 N, from which the tool explores, s.
fn soft_touch_s(stated: &str, seed: u32) -> f64 {
    let text = include_str!("../../../../scenarios/touchdown_10kN_per_m.toml");
    let set = [
        "plant.tool.tip={ shape = \"soft\", radius_m = 0.012 }".to_owned(),
        "plant.tool.soft_stiffness_n_per_m=1000.0".to_owned(),
        format!("estimation.contact.tip={stated}"),
        "plant.start.tilt_rad=0.28".to_owned(),
        "plant.sensor.noise_n_per_sqrt_hz=0.002".to_owned(),
        "plant.sensor.noise_nm_per_sqrt_hz=6e-5".to_owned(),
        format!("seed={seed}"),
    ];
    let scenario = AdmittanceScenario::parse("soft", text, &set, &no_files).unwrap();
    let (mut touched_s, mut pressed_s) = (None, None);
    evaluate_admittance_with(&scenario, |cycle| {
        let time_s = cycle.arm.time_s;
        if cycle.truth.in_contact {
            touched_s.get_or_insert(time_s);
        }
        if cycle.output.force_n.is_some_and(|force_n| force_n > 1.5) {
            pressed_s.get_or_insert(time_s);
        }
    })
    .unwrap();
    pressed_s.unwrap() - touched_s.unwrap()
}

/// Before, the law took every contact for one of 50 kN/m at first, and a swab was pressed as
/// slowly.
#[test]
fn a_tip_stated_as_soft_is_pressed_sooner() {
    for seed in 1..=3 {
        let soft = soft_touch_s("{ shape = \"soft\", radius_m = 0.012 }", seed);
        let unknown = soft_touch_s("{ shape = \"unknown\" }", seed);
        assert!(soft < 0.6 * unknown, "{soft} s and {unknown} s");
    }
}
