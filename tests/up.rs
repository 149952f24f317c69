//! `tangent up` on the wire protocols of the real robot and sensor, against `evaluate` of the same
//! scenario.

#![allow(clippy::unwrap_used)]

mod common;

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;

use common::{json, number, port_offset, run, tangent, up, up_system, wait_for};
use tangent_live::{live_beside_others, live_in_half};

const SCENARIO: &str = "pipe_realistic";

/// The whole system wipes the pipe, leaves a recording and a report, and its figures are those of
/// `evaluate`.
#[test]
fn up_wipes_the_pipe_as_evaluate_does() {
    live_beside_others(|| {
        let folder = tempfile::tempdir().unwrap();
        let live = up(SCENARIO, folder.path());
        let evaluation = json(&run(&["evaluate", SCENARIO, "--json"]));

        // Figure, and the largest difference from `evaluate` that is allowed.
        for (path, small) in [
            ("/normal_error_deg/mean", 0.3),
            ("/normal_error_settled_deg/rmse", 0.3),
            ("/alignment_error_deg/mean", 0.3),
            ("/tool_error_deg/mean", 0.3),
            ("/force/mean_n", 0.02),
            ("/force/rmse_n", 0.03),
            ("/force/peak_n", 0.1),
            ("/path/rmse_m", 5e-4),
        ] {
            let (here, there) = (number(&live, path), number(&evaluation, path));
            assert!(
                (here - there).abs() <= (0.2 * there.abs()).max(small),
                "{path}: live {here}, evaluate {there}"
            );
        }
        assert_eq!(number(&live, "/contact/lost_count"), 0.0);
        assert_eq!(live["scenario"], SCENARIO);
        assert_eq!(live["verdict"], "completed");

        let names: Vec<String> = fs::read_dir(folder.path())
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        let recording = names
            .iter()
            .find(|n| n.ends_with(".mcap"))
            .expect("a recording");
        assert!(
            names.iter().any(|n| n.ends_with(".html")),
            "no report in {names:?}"
        );

        // `report` on the recording gives the same figures again.
        let path = folder.path().join(recording);
        let report = run(&["report", path.to_str().unwrap(), "--json", "--no-html"]);
        let again = json(&report);
        assert_eq!(again["force"], live["force"]);
        assert_eq!(again["normal_error_deg"], live["normal_error_deg"]);
        assert!(number(&again, "/loop/packet_to_command_us/p50") > 0.0);
        opens(&path, folder.path());
        says_what_a_cut_recording_lost(&path, folder.path());
    });
}

/// A sensor that dies in the air, with its noise alive, is found by the force that the arm itself
/// states over its own protocol.
#[test]
fn up_finds_a_sensor_that_died_before_the_touch() {
    live_beside_others(|| {
        let folder = tempfile::tempdir().unwrap();
        let offset = port_offset().to_string();
        let output = run(&[
            "up",
            "--set",
            "plant.sensor.fault={ kind = \"deaf\", from_s = 2.0 }",
            "--folder",
            folder.path().to_str().unwrap(),
            "--port-offset",
            &offset,
            "--json",
        ]);
        assert_eq!(output.status.code(), Some(1));
        let live = json(&output);
        let fault = live["fault"].as_str().unwrap();
        assert!(fault.contains("the sensor does not show"), "{fault}");
        // The true force, from the simulator.
        let peak_n = number(&live, "/force/peak_n");
        assert!((25.0..45.0).contains(&peak_n), "{peak_n}");
    });
}

/// Exit code 3 says that something is missing in a recording, alone and in a comparison.
fn says_what_a_cut_recording_lost(whole: &Path, folder: &Path) {
    let cut = folder.join("cut.mcap");
    let bytes = fs::read(whole).unwrap();
    fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    let [whole, cut] = [whole, &cut].map(|path| path.to_str().unwrap());
    for files in [&[cut][..], &[whole, cut], &[cut, whole]] {
        let output = tangent()
            .arg("report")
            .args(files)
            .arg("--no-html")
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(3), "{files:?}: {said}");
        assert!(said.contains("missing"), "{files:?}: {said}");
    }
}

/// `report --open` passes the page to the desktop's program.
fn opens(recording: &Path, folder: &Path) {
    let (bin, opened) = (folder.join("bin"), folder.join("opened"));
    fs::create_dir(&bin).unwrap();
    let program = bin.join("xdg-open");
    let script = format!("#!/bin/sh\necho \"$1\" > {}\n", opened.display());
    fs::write(&program, script).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap());
    let output = tangent()
        .args(["report", recording.to_str().unwrap(), "--open"])
        .env("PATH", path)
        .output()
        .unwrap();
    assert!(output.status.code().is_some_and(|code| code != 1));
    let page = wait_for("the page is opened", Duration::from_secs(20), || {
        fs::read_to_string(&opened)
            .ok()
            .filter(|text| !text.is_empty())
    });
    assert!(page.trim().ends_with(".html"), "{page}");
}

/// The torque-controlled arm with its camera wipes the object, and the figures are those of
/// `evaluate`.
#[test]
fn up_lippiello_wipes_the_object_as_evaluate_does() {
    live_in_half(|| {
        let folder = tempfile::tempdir().unwrap();
        let live = up_system("lippiello", folder.path());
        // Across the normal, touch says nothing of the object's position, and the camera's errors
        // leave some millimetres that differ from run to run.
        let evaluations: Vec<_> = (1..=5)
            .map(|seed| {
                let set = format!("seed={seed}");
                json(&run(&[
                    "evaluate",
                    "lippiello_realistic",
                    "--json",
                    "--set",
                    &set,
                ]))
            })
            .collect();
        for (path, small) in [
            ("/normal_error_deg/mean", 0.3),
            ("/force/mean_n", 0.3),
            ("/object_pose/sliding_force_rmse_n", 0.3),
            ("/object_pose/position_rmse_m", 2e-3),
            ("/object_pose/orientation_rmse_deg", 0.5),
            ("/object_pose/path_on_object_rmse_m", 2e-3),
            ("/path/rmse_m", 3e-4),
        ] {
            let here = number(&live, path);
            let there = evaluations.iter().map(|e| number(e, path));
            let least = there.clone().fold(f64::INFINITY, f64::min);
            let most = there.fold(f64::NEG_INFINITY, f64::max);
            let low = least - (0.3 * least.abs()).max(small);
            let high = most + (0.3 * most.abs()).max(small);
            assert!(
                (low..=high).contains(&here),
                "{path}: live {here}, evaluate {least} to {most}"
            );
        }
        assert_eq!(live["phase"], "done");
        assert!(number(&live, "/loop/packet_to_command_us/p50") > 0.0);
        let page = page(folder.path());
        for title in [
            "Position error in object axes",
            "Orientation error in object axes",
            "Force at the wrist",
            "Moment at the wrist",
        ] {
            assert!(page.contains(title), "the page lacks: {title}");
        }
    });
}

/// The Franka wipes the wave over its own interface, guided by a depth camera and by its estimate
/// of the wrench, as in `evaluate`.
#[test]
fn up_karacan_wipes_the_wave_as_evaluate_does() {
    live_in_half(|| {
        let folder = tempfile::tempdir().unwrap();
        let live = up_system("karacan", folder.path());
        let evaluation = json(&run(&["evaluate", "karacan_depth", "--json"]));
        for (path, small) in [
            ("/force/mean_n", 0.5),
            ("/force/rmse_n", 0.4),
            // The estimate from touch alone is published beside the camera's.
            ("/normal_error_deg/mean", 1.5),
            ("/path/rmse_m", 1e-3),
        ] {
            let (here, there) = (number(&live, path), number(&evaluation, path));
            assert!(
                (here - there).abs() <= (0.3 * there.abs()).max(small),
                "{path}: live {here}, evaluate {there}"
            );
        }
        assert_eq!(live["phase"], "done");
        assert_eq!(live["scenario"], "karacan_depth");
        assert!(live["estimators"]["depth_normal"].is_object());
        for (path, low, high) in [
            ("/tanks/motion_min_j", 1.0, 32.0),
            ("/tanks/motion_max_j", 1.0, 32.0),
            ("/tanks/force_min_j", 1.0, 2.0 + 1e-9),
            ("/tanks/force_max_j", 1.0, 2.0 + 1e-9),
        ] {
            let joules = number(&live, path);
            assert!((low..=high).contains(&joules), "{path}: {joules} J");
        }
        assert!(page(folder.path()).contains("Energy tanks"));
    });
}

/// The report's page.
fn page(folder: &Path) -> String {
    let page = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.extension().is_some_and(|e| e == "html"))
        .unwrap();
    fs::read_to_string(page).unwrap()
}
