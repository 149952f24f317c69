//! Requests while the loop stands, the sensor refuses, or a fault has left the tool on the surface.

// A whole file of tests: what fails here is the test.
use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::common::{Cell, PATIENCE, TASK, long_task};
use nalgebra::Vector3;
use tangent_live::timed;
use tangent_runtime::StateFolder;
use tangent_schemas::tangent::{Answer, Request};
use tangent_schemas::topics::queries;

/// Sends a request while no packet arrives.
fn ask_standing(cell: &Cell, action: &str, argument: &str) -> Answer {
    let request = Request {
        action: action.into(),
        argument: argument.into(),
    };
    cell.bus
        .ask(queries::CONTROL_TASK, &request, PATIENCE)
        .unwrap()
}

/// Starts the task, with packets that do not wait for its tare.
fn start(cell: &mut Cell) {
    let bus = cell.bus.clone();
    let asking = std::thread::spawn(move || {
        let request = Request {
            action: "start".into(),
            argument: TASK.into(),
        };
        bus.ask(queries::CONTROL_TASK, &request, PATIENCE)
    });
    // No further packet is needed once the loop has the request.
    while !asking.is_finished() && cell.phase() != "tare" {
        cell.packet(true);
        std::thread::yield_now();
    }
    assert!(asking.join().unwrap().unwrap().done);
}

fn height(cell: &Cell) -> f64 {
    let tool = cell.arm.base_from_flange(&cell.q) * cell.config.flange_from_tool;
    tool.translation().z
}

/// Regression: the caller gave up after 0.5 s, the request stayed, and the arm moved when packets
/// arrived again.
#[test]
fn a_start_that_the_loop_did_not_take_in_time_never_runs() {
    timed(|| {
        let mut cell = Cell::new();
        let start = cell.q;
        cell.packet(true);
        let answer = ask_standing(&cell, "start", TASK);
        assert!(!answer.done, "{}", answer.message);
        assert!(
            answer.message.contains("nothing was done"),
            "{}",
            answer.message
        );
        for _ in 0..300 {
            cell.packet(true);
            assert_eq!(cell.phase(), "idle");
        }
        assert_eq!(cell.q, start);
        cell.end();
    });
}

#[test]
fn a_stop_and_a_pause_that_the_loop_did_not_take_in_time_have_no_effect() {
    timed(|| {
        let mut cell = Cell::sliding_for_long();
        for action in ["pause", "stop"] {
            let answer = ask_standing(&cell, action, "");
            assert!(!answer.done, "{action}: {}", answer.message);
            for _ in 0..50 {
                cell.packet(true);
                assert_eq!(cell.phase(), "slide", "{action}");
            }
        }
        cell.end();
    });
}

#[test]
fn a_refused_tare_is_asked_for_again_and_says_why_meanwhile() {
    timed(|| {
        let mut cell = Cell::new();
        // Until the service has received the message.
        cell.refusals.store(u64::MAX / 2, Ordering::SeqCst);
        start(&mut cell);
        cell.packet(true);
        assert_eq!(cell.phase(), "tare");
        loop {
            cell.packet(true);
            let said = ask_standing(&cell, "status", "").message;
            if said.contains("somebody leans on the tool") {
                break;
            }
            std::thread::park_timeout(Duration::from_millis(5));
        }
        cell.refusals.store(0, Ordering::SeqCst);
        // The packets of this bench arrive faster than in reality: they wait for the sensor.
        cell.run_until("slide");
        assert!(cell.tares.load(Ordering::SeqCst) >= 2);
        cell.end();
    });
}

#[test]
fn a_task_without_a_tare_says_why_it_was_refused() {
    timed(|| {
        let mut cell = Cell::new();
        cell.refusals.store(u64::MAX / 2, Ordering::SeqCst);
        start(&mut cell);
        // The second tare request shows that two were refused.
        while cell.tares.load(Ordering::SeqCst) < 2 {
            std::thread::yield_now();
        }
        let start = cell.q;
        while cell.phase() != "fault" {
            cell.packet(true);
        }
        let fault = cell.said().fault;
        assert!(fault.contains("somebody leans on the tool"), "{fault}");
        assert!(fault.starts_with("no tare in time"), "{fault}");
        assert_eq!(cell.q, start);
        cell.refusals.store(0, Ordering::SeqCst);
        cell.end();
    });
}

#[test]
fn a_stop_takes_the_tool_off_after_a_fault_or_says_why_it_cannot() {
    timed(|| {
        let mut cell = Cell::new();
        let stop = |cell: &mut Cell| cell.ask(queries::CONTROL_STOP, "stop", "").unwrap();
        let answer = stop(&mut cell);
        assert!(
            answer.done && answer.message.contains("nothing to do"),
            "{}",
            answer.message
        );
        cell.slide(&long_task());
        cell.ready = false;
        cell.run_until("fault");
        let fault = "arm does not take commands: protective stop";
        assert_eq!(cell.said().fault.as_str(), fault);
        let pressing = height(&cell);
        let answer = stop(&mut cell);
        assert!(!answer.done, "{}", answer.message);
        assert!(
            answer.message.contains("protective stop"),
            "{}",
            answer.message
        );
        assert_eq!(height(&cell), pressing);
        // Unlocked; activations that the bridge had latched out stay latched.
        cell.latched = cell.said().activation;
        cell.ready = true;
        cell.packet(true);
        assert_eq!(cell.said().fault.as_str(), fault);
        let answer = stop(&mut cell);
        assert!(answer.done, "{}", answer.message);
        assert_eq!(answer.message, "retracting");
        cell.run_until("fault");
        assert!(cell.said().activation > cell.latched);
        assert!(
            height(&cell) > pressing + 5e-3,
            "{} m",
            height(&cell) - pressing
        );
        let answer = stop(&mut cell);
        assert!(
            answer.done && answer.message.contains("nothing to do"),
            "{}",
            answer.message
        );
        cell.end();
    });
}

/// State of a controller that was killed while the tool pressed at its present position.
fn killed_while_pressing(folder: &tempfile::TempDir, at: Vector3<f64>) -> Option<StateFolder> {
    let state = StateFolder::new(folder.path());
    let kept = serde_json::json!({
        "contact_possible": true, "since_ns": 0, "way_out": [[0.0, 0.0, 1.0], [at.x, at.y, at.z]],
    });
    state.write("controller", &kept).unwrap();
    Some(state)
}

#[test]
fn a_stop_after_a_restart_takes_the_tool_off_or_says_why_it_cannot() {
    timed(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut cell = Cell::with_state(|at| killed_while_pressing(&folder, at));
        let stop = |cell: &mut Cell| cell.ask(queries::CONTROL_STOP, "stop", "").unwrap();
        let pressing = height(&cell);
        cell.ready = false;
        cell.packet(true);
        let answer = stop(&mut cell);
        assert!(!answer.done, "{}", answer.message);
        assert!(
            answer.message.contains("protective stop"),
            "{}",
            answer.message
        );
        assert_eq!(height(&cell), pressing);
        cell.ready = true;
        cell.packet(true);
        let answer = stop(&mut cell);
        assert!(answer.done, "{}", answer.message);
        assert!(answer.message.contains("moving off"), "{}", answer.message);
        cell.run_until("done");
        let gone_m = height(&cell) - pressing;
        assert!((0.005..0.02).contains(&gone_m), "{gone_m} m");
        let answer = stop(&mut cell);
        assert!(
            answer.message.contains("nothing to do"),
            "{}",
            answer.message
        );
        cell.end();
    });
}

#[test]
fn a_refused_start_with_clear_keeps_the_contact_possible() {
    timed(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut cell = Cell::with_state(|at| killed_while_pressing(&folder, at));
        let start =
            |cell: &mut Cell, action| cell.ask(queries::CONTROL_TASK, action, TASK).unwrap();
        cell.ready = false;
        cell.packet(true);
        let answer = start(&mut cell, "start_clear");
        assert!(!answer.done, "{}", answer.message);
        cell.ready = true;
        cell.packet(true);
        assert!(cell.said().contact_possible);
        let kept = std::fs::read_to_string(folder.path().join("controller.json")).unwrap();
        assert!(
            kept.contains("\"contact_possible\": true")
                || kept.contains("\"contact_possible\":true"),
            "{kept}"
        );
        let answer = start(&mut cell, "start");
        assert!(answer.done, "{}", answer.message);
        while !cell.phases.iter().any(|phase| phase == "clear") {
            assert!(cell.phase() != "done", "{:?}", cell.phases);
            cell.packet(true);
        }
        cell.end();
    });
}

#[test]
fn old_numbers_are_not_shown_as_new_ones() {
    timed(|| {
        let mut cell = Cell::sliding_for_long();
        let fresh = cell.ask(queries::CONTROL_TASK, "status", "").unwrap();
        assert!(fresh.message.contains("of 3.00 N"), "{}", fresh.message);
        let old = loop {
            let status = ask_standing(&cell, "status", "");
            if status.message.starts_with("no control/state for") {
                break status;
            }
            std::thread::park_timeout(Duration::from_millis(10));
        };
        let data: serde_json::Value = serde_json::from_str(&old.data).unwrap();
        assert!(
            data["phase"].is_null() && data["force_n"].is_null(),
            "{data}"
        );
        assert_eq!(data["phase_before"], "slide");
        assert!(!old.message.contains(" N,"), "{}", old.message);
        cell.end();
    });
}
