//! Tests with a closed-loop run written as a live system would record it: the report's figures must
//! equal those of `evaluate`.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use tangent_schemas::standard::Header;
use tangent_schemas::tangent::CoverageState;
use tangent_simulation::suite::{SurfaceKind, draw};
use tangent_simulation::{AdmittanceScenario, Evaluation, evaluate_admittance_with};

use crate::files::{Part, compare, read, write_for};
use tape::{START_NS, Tape};

mod tape;

fn scenario() -> AdmittanceScenario {
    let text = include_str!("../../../scenarios/pipe_ideal.toml");
    AdmittanceScenario::parse("pipe_ideal", text, &[], &tangent_simulation::no_files).unwrap()
}

/// Records a run into files with this many cycles each.
fn record(folder: &Path, cycles_per_file: u64) -> (Evaluation, Vec<PathBuf>) {
    let scenario = scenario();
    let mut files = Vec::new();
    let mut tape: Option<Tape> = None;
    let mut number = 0;
    let evaluation = evaluate_admittance_with(&scenario, |cycle| {
        if number % cycles_per_file == 0 {
            if let Some(tape) = tape.take() {
                tape.writer.finish().unwrap();
            }
            let path = folder.join(format!("run-{:03}.mcap", files.len()));
            tape = Some(Tape::create(&path));
            files.push(path);
        }
        // The bridge ran before the task.
        number += 1;
        tape.as_mut().unwrap().cycle(1000 + number, 0.008, cycle);
    })
    .unwrap();
    tape.unwrap().writer.finish().unwrap();
    (evaluation, files)
}

/// Fails if two JSON values differ by more than a relative error of 1e-6.
fn assert_close(path: &str, a: &Value, b: &Value) {
    match (a, b) {
        (Value::Number(x), Value::Number(y)) => {
            let (x, y) = (x.as_f64().unwrap(), y.as_f64().unwrap());
            assert!(
                (x - y).abs() <= 1e-6 * x.abs().max(1e-3),
                "{path}: {x} and {y}"
            );
        }
        (Value::Object(x), Value::Object(y)) => {
            assert_eq!(
                x.keys().collect::<Vec<_>>(),
                y.keys().collect::<Vec<_>>(),
                "{path}"
            );
            for (key, value) in x {
                assert_close(&format!("{path}.{key}"), value, &y[key]);
            }
        }
        (Value::Array(x), Value::Array(y)) => {
            assert_eq!(x.len(), y.len(), "{path}");
            for (x, y) in x.iter().zip(y) {
                assert_close(path, x, y);
            }
        }
        _ => assert_eq!(a, b, "{path}"),
    }
}

#[test]
fn the_figures_are_those_of_evaluate_also_over_rotated_files() {
    for cycles_per_file in [u64::MAX, 1111] {
        let folder = tempfile::tempdir().unwrap();
        let (evaluation, files) = record(folder.path(), cycles_per_file);
        assert!(files.len() == 1 || files.len() > 2);
        let (report, html) = write_for(&files).unwrap();
        let (ours, theirs) = (
            serde_json::to_value(&report).unwrap(),
            serde_json::to_value(&evaluation).unwrap(),
        );
        for (key, value) in theirs.as_object().unwrap() {
            match key.as_str() {
                "loop" | "state_digest" | "wall_s" | "real_time_factor" => {}
                // A run ends 0.2 s after its task, up to the rounding of one cycle's stamp.
                "steps" | "duration_s" => {
                    let (x, y) = (value.as_f64().unwrap(), ours[key].as_f64().unwrap());
                    assert!(
                        (x - y).abs() <= 1.001 * x / evaluation.steps as f64,
                        "{key}"
                    );
                }
                _ => assert_close(key, value, &ours[key]),
            }
            assert!(ours.get(key).is_some(), "{key} is missing in the report");
        }
        assert_eq!(ours["scenario"], "pipe_ideal");
        assert_eq!(ours["loop"]["missed_cycles"], 0);
        let max = ours["loop"]["packet_to_command_us"]["max"]
            .as_f64()
            .unwrap();
        assert!((max - 100.0 - 1e-3 * (1000 + evaluation.steps) as f64).abs() < 1e-6);
        assert!(!report.is_lossy());

        let page = std::fs::read_to_string(&html).unwrap();
        assert!(page.matches("<svg").count() >= 6);
        for words in [
            "Pressing force",
            "Path on the surface",
            "wipe &lt;a&gt; pipe",
            "This recording is complete",
        ] {
            assert!(page.contains(words), "{words}");
        }
        // The page loads nothing from outside.
        for outside in ["src=", "href=", "@import", "url("] {
            assert!(!page.contains(outside), "{outside}");
        }
        if let (1, Some(keep)) = (files.len(), std::env::var_os("TANGENT_KEEP_REPORT")) {
            std::fs::copy(&html, keep).unwrap();
        }
    }
}

#[test]
fn a_cut_recording_gives_what_is_whole_and_says_that_something_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let (evaluation, files) = record(folder.path(), u64::MAX);
    let bytes = std::fs::read(&files[0]).unwrap();
    std::fs::write(&files[0], &bytes[..bytes.len() / 2]).unwrap();
    let found = read(&files, Part::default(), true).unwrap();
    assert!(found.report.is_lossy());
    assert_eq!(found.truncated, files);
    assert!(found.report.recording.truncated);
    assert!(found.report.steps > 100 && found.report.steps < evaluation.steps);
    assert!(found.page.unwrap().contains("has no end"));
}

/// Records the whole run of a scenario, and returns the activation of its task.
fn record_all(tape: &mut Tape, scenario: &AdmittanceScenario) -> u64 {
    let (mut number, mut activation) = (0, 0);
    evaluate_admittance_with(scenario, |cycle| {
        number += 1;
        activation = cycle.output.activation;
        tape.cycle(1000 + number, 0.008, cycle);
    })
    .unwrap();
    activation
}

/// Two tasks in one recording, the second with 5 N and after a restart of the bridge, which counts
/// its cycles anew.
fn record_two(path: &Path) {
    let text = include_str!("../../../scenarios/pipe_ideal.toml");
    let mut tape = Tape::create(path);
    for (second, force, peak) in [(0, "3.0", "8.0"), (1, "5.0", "4.0")] {
        tape.tasks_before = second;
        tape.start_ns = START_NS + 60_000_000_000 * second.cast_signed();
        let scenario = AdmittanceScenario::parse(
            "pipe_ideal",
            text,
            &[format!("task.force.reference_n={force}")],
            &tangent_simulation::no_files,
        )
        .unwrap();
        let activation = record_all(&mut tape, &scenario) + second;
        let task = format!(
            "name = \"wipe\"\ntolerances.force_rmse_n = 0.3\ntolerances.force_peak_n = {peak}"
        );
        // Both cover a region in two rounds; only the second one gets enough.
        let (share, outcome) = [(0.86, 2), (0.9961, 1)][second as usize];
        for (at_s, outcome, shares) in [(1, 0, vec![0.76]), (2, outcome, vec![0.76, share])] {
            let stamp_ns = tape.start_ns + 1_000_000_000 * at_s;
            let state = CoverageState {
                header: Header::new(stamp_ns, "base"),
                activation,
                outcome,
                share: *shares.last().unwrap(),
                share_by_round: shares.into_iter().collect(),
                share_min: 0.99,
                area_cm2: 71.04,
                ..CoverageState::default()
            };
            tape.put("/control/coverage", stamp_ns, &state);
        }
        let name = format!("task-{activation}.toml");
        tape.writer.attach(&name, &task, 1).unwrap();
    }
    tape.writer.finish().unwrap();
}

#[test]
fn each_task_of_a_recording_is_judged_by_its_own_tolerances() {
    let folder = tempfile::tempdir().unwrap();
    let path = [folder.path().join("two.mcap")];
    record_two(&path[0]);
    let part = |task| Part { cell: None, task };
    let last = read(&path, part(None), false).unwrap().report;
    assert_eq!((last.task, last.tasks.len()), (Some(2), 2));
    assert!((last.figures.force.mean_n.unwrap() - 5.0).abs() < 0.3);
    // Its peak is above 4 N.
    assert_eq!(last.accepted, Some(false));
    let second = read(&path, part(Some(2)), false).unwrap().report;
    let figures = |report: &crate::Report| serde_json::to_value(report.figures).unwrap();
    assert_eq!(figures(&second), figures(&last));

    let first = read(&path, part(Some(1)), true).unwrap();
    assert_eq!(first.report.task, Some(1));
    assert!((first.report.figures.force.mean_n.unwrap() - 3.0).abs() < 0.3);
    assert_eq!(
        first.report.accepted,
        Some(true),
        "{:?}",
        first.report.tolerances
    );
    let page = first.page.unwrap();
    for words in [
        "content=\"wipe a pipe: completed: the whole path was followed; ACCEPTED\"",
        "task 1 of 2",
        "2026-",
        "RMS error of the force",
        "Coverage by the controller: 86.0 % of 71.0 cm² within the band after 2 rounds (target 99 %): given up",
    ] {
        assert!(page.contains(words), "{words}");
    }

    let covered =
        |report: &crate::Report| serde_json::to_value(report).unwrap()["coverage"].clone();
    assert_eq!(covered(&first.report)["outcome"], "rounds_max");
    assert_eq!(covered(&second)["outcome"], "met");
    assert_eq!(covered(&second)["share_by_round"], json!([0.76, 0.9961]));
    let words = crate::words(&last);
    assert!(
        words.contains("\ncoverage         99.6 % of 71.0 cm² within"),
        "{words}"
    );

    let error = read(&path, part(Some(3)), false).err().unwrap().to_string();
    for words in ["--task 3", "1 (wipe a pipe, completed)", "2 (wipe a pipe"] {
        assert!(error.contains(words), "{error}");
    }

    let (difference, page) = compare((&path, part(Some(1))), (&path, part(Some(2))), true).unwrap();
    let mean = difference
        .figures
        .iter()
        .find(|f| f.name == "force, mean")
        .unwrap();
    assert!((mean.b.unwrap() - mean.a.unwrap() - 2.0).abs() < 0.3);
    let [setting] = &difference.settings[..] else {
        panic!("{:?}", difference.settings);
    };
    assert_eq!(setting.key, "tolerances.force_peak_n");
    for words in ["force, mean", "coverage, within the band, %"] {
        assert!(difference.words().contains(words), "{words}");
    }
    let page = page.unwrap();
    assert!(page.matches("<svg").count() >= 3 && page.contains("tolerances.force_peak_n"));
}

#[test]
fn a_part_of_the_path_that_was_passed_over_is_told_and_not_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let path = [folder.path().join("ledge.mcap")];
    let mut tape = Tape::create(&path[0]);
    // A flat pad cannot climb this ledge.
    let ledge = "plant.surface={shape=\"step\", height_m=0.006, edge_radius_m=0.0005, position_m=[0.43, 0.0, 0.1]}";
    let line = "kind=\"line\", to_m=[0.1, 0.0], speed_m_per_s=0.02";
    let scenario = AdmittanceScenario::parse(
        "plane",
        include_str!("../../../scenarios/plane.toml"),
        &[ledge.to_owned(), format!("task.path={{{line}}}")],
        &tangent_simulation::no_files,
    )
    .unwrap();
    let activation = record_all(&mut tape, &scenario);
    let task = format!("name = \"ledge\"\ntolerances.force_peak_n = 50.0\npath = {{{line}}}");
    let name = format!("task-{activation}.toml");
    tape.writer.attach(&name, &task, 1).unwrap();
    tape.writer.finish().unwrap();

    let report = read(&path, Part::default(), false).unwrap().report;
    let ours = serde_json::to_value(&report).unwrap();
    assert_eq!(ours["verdict"], "completed");
    assert_eq!(ours["passed_over"]["times"], 1);
    let share = ours["passed_over"]["path_share"].as_f64().unwrap();
    assert!((0.2..0.5).contains(&share), "{share}");
    assert_eq!(ours["accepted"], false);
    let words = crate::words(&report);
    let told = "completed, but the tool passed over something in the way once, ";
    assert!(words.contains(told), "{words}");
}

/// A tool that slid off again and again touched around the place, and then followed the whole path.
#[test]
fn touches_around_a_place_pass_over_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = [folder.path().join("slips.mcap")];
    let mut tape = Tape::create(&path[0]);
    let scenario = draw(SurfaceKind::Ellipsoid, 70, 12).scenario;
    let activation = record_all(&mut tape, &scenario);
    let task = "name = \"slips\"\npath = { kind=\"line\", to_m=[0.1, 0.0], speed_m_per_s=0.02 }";
    let name = format!("task-{activation}.toml");
    tape.writer.attach(&name, task, 1).unwrap();
    tape.writer.finish().unwrap();

    let report = read(&path, Part::default(), false).unwrap().report;
    assert_eq!(
        serde_json::to_value(&report).unwrap()["passed_over"],
        Value::Null
    );
    let words = crate::words(&report);
    assert!(
        words.contains("completed: the whole path was followed"),
        "{words}"
    );
}

fn with_causes(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes
        .map(ToString::to_string)
        .collect::<Vec<_>>()
        .join(": ")
}

#[test]
fn what_is_no_recording_of_a_cell_is_refused_with_a_way_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.mcap");
    let mut tape = Tape::create(&path);
    tape.put("/scan", 1, &Header::new(1, "laser"));
    tape.writer.finish().unwrap();
    let error = read(std::slice::from_ref(&path), Part::default(), false)
        .err()
        .unwrap();
    let error = with_causes(&error);
    for words in ["other.mcap", "/scan", "tangent record"] {
        assert!(error.contains(words), "{error}");
    }
    std::fs::write(&path, "no recording").unwrap();
    let error = with_causes(&read(&[path], Part::default(), false).err().unwrap());
    assert!(
        error.contains("other.mcap") && error.contains("not an MCAP file"),
        "{error}"
    );
}
