//! The service on a bus without a network; the queries are those that `tangent task` sends.

use std::sync::atomic::Ordering;

use crate::common::{Cell, PATIENCE, TASK, long_task};
use tangent_live::timed;
use tangent_schemas::tangent::{ControlState, CoverageState};
use tangent_schemas::topics::{self, queries};

#[test]
fn a_task_is_started_tared_wiped_and_ended() {
    timed(|| {
        let mut cell = Cell::new();
        assert_eq!(cell.phase(), "idle");
        cell.latched = 41;
        cell.packet(true);
        let answer = cell.ask(queries::CONTROL_TASK, "start", TASK).unwrap();
        assert!(answer.done, "{}", answer.message);
        cell.run_until("slide");
        assert_eq!(cell.tares.load(Ordering::SeqCst), 1);
        let state = cell.control.get().unwrap().message.clone();
        assert_eq!(state.task.as_str(), "short line");
        assert_eq!(state.estimator.as_str(), "blend");
        assert!(state.activation > 41);
        assert!((state.force_n - 3.0).abs() < 0.5);
        cell.run_until("done");
        let status = cell.ask(queries::CONTROL_TASK, "status", "").unwrap();
        assert!(
            status.data.contains("\"phase\":\"done\""),
            "{}",
            status.data
        );
        cell.end();
    });
}

#[test]
fn an_arm_that_another_drives_is_left_alone() {
    timed(|| {
        let mut cell = Cell::new();
        cell.commander = ("controller/lab-2-4711", [9; 16]);
        cell.packet(true);
        let answer = cell.ask(queries::CONTROL_TASK, "start", TASK).unwrap();
        assert!(!answer.done);
        assert!(
            answer
                .message
                .contains("controller/lab-2-4711 on host lab-2 drives the arm"),
            "{}",
            answer.message
        );
        assert_eq!(cell.phase(), "idle");

        // The arm is free, a task runs, and another controller takes the arm: this one ends its
        // task.
        cell.commander = ("", [0; 16]);
        cell.packet(true);
        let answer = cell
            .ask(queries::CONTROL_TASK, "start", &long_task())
            .unwrap();
        assert!(answer.done, "{}", answer.message);
        cell.run_until("slide");
        cell.commander = ("controller/lab-2-4711", [9; 16]);
        cell.run_until("fault");
        let command = cell.packet(true).unwrap();
        assert_eq!(command.kind, 0);
        cell.end();
    });
}

#[test]
fn what_is_missing_is_named_and_nothing_moves() {
    timed(|| {
        let mut cell = Cell::new();
        let start = cell.q;
        for (task, word) in [
            ("name = 1", "invalid type"),
            (&TASK.replace("3.0", "-3.0") as &str, "force.reference_n"),
            (&TASK.replace("blend", "nobody"), "nobody"),
        ] {
            let answer = cell.ask(queries::CONTROL_TASK, "start", task).unwrap();
            assert!(!answer.done, "{task}");
            assert!(answer.message.contains(word), "{word}: {}", answer.message);
        }
        for (key, action) in [
            (queries::CONTROL_TASK, "pause"),
            (queries::CONTROL_TASK, "dance"),
            (queries::CONTROL_SELECT, "select"),
        ] {
            assert!(!cell.ask(key, action, "").unwrap().done, "{action}");
        }
        let answer = cell
            .ask(queries::CONTROL_SELECT, "select", "blend")
            .unwrap();
        assert!(answer.message.contains("no task"), "{}", answer.message);
        assert_eq!(cell.q, start);
        cell.end();
    });
}

#[test]
fn a_task_that_cannot_run_is_refused_with_numbers_and_place_before_anything_moves() {
    timed(|| {
        let mut cell = Cell::new();
        let start = cell.q;
        let cases: [(String, &[&str]); 4] = [
            (
                TASK.replace("3.0", "40.0"),
                &["before anything moves", "40 N", "limits.force_max_n"],
            ),
            (
                TASK.replace("speed_m_per_s = 0.02", "speed_m_per_s = 0.24"),
                &["path.speed_m_per_s", "0.24 m/s", "0.2250 m/s"],
            ),
            (
                TASK.replace("[0.02, 0.0]", "[1.0, 0.0]"),
                &["m along the path", "m of its plane", "m in base axes"],
            ),
            (
                // One estimator that publishes does not hide the unknown ones: all of them are
                // named.
                TASK.replace(
                    "[\"blend\"]",
                    "[\"blend\", \"reactiv\", \"quadratik\", \"magic\"]",
                ),
                &[
                    "\"reactive\"",
                    "reactiv",
                    "\"quadratic\"",
                    "quadratik",
                    "magic",
                ],
            ),
        ];
        for (task, words) in cases {
            let answer = cell.ask(queries::CONTROL_TASK, "start", &task).unwrap();
            assert!(!answer.done, "{task}");
            for word in words {
                assert!(answer.message.contains(word), "{word}: {}", answer.message);
            }
            assert_eq!(cell.phase(), "idle");
        }
        assert_eq!(cell.q, start);
        // A user's own estimator is known because it publishes.
        cell.add("magic");
        let own = TASK.replace("[\"blend\"]", "[\"magic\", \"blend\"]");
        let answer = cell.ask(queries::CONTROL_TASK, "start", &own).unwrap();
        assert!(answer.done, "{}", answer.message);
        cell.end();
    });
}

#[test]
fn the_end_of_the_service_retracts_first() {
    timed(|| {
        let mut cell = Cell::new();
        let answer = cell.ask(queries::CONTROL_TASK, "start", &long_task());
        assert!(answer.unwrap().done);
        cell.run_until("slide");
        let tool = |cell: &Cell| {
            (cell.arm.base_from_flange(&cell.q) * cell.config.flange_from_tool)
                .translation()
                .z
        };
        let pressed = tool(&cell);
        cell.stop.trigger();
        let service = cell.service.take().unwrap();
        while !service.is_finished() {
            cell.packet(true);
            std::thread::yield_now();
        }
        service.join().unwrap().unwrap();
        assert!(tool(&cell) > pressed + 0.04);
    });
}

#[test]
fn parameters_show_the_tasks_values_and_change_them() {
    timed(|| {
        let mut cell = Cell::sliding_for_long();
        let again = cell.ask(queries::CONTROL_TASK, "start", TASK).unwrap();
        assert!(!again.done && again.message.contains("stop the running task"));
        let key = "param/controller/force_reference_n";
        let shown = cell.ask(key, "get", "").unwrap();
        assert!(shown.message.contains("= 3 N"), "{}", shown.message);
        assert!(cell.ask(key, "set", "4.5").unwrap().done);
        assert!(!cell.ask(key, "set", "-1").unwrap().done);
        // Exceeds the force at which the task would end.
        assert!(!cell.ask(key, "set", "90").unwrap().done);
        let mut state = ControlState::default();
        for _ in 0..2000 {
            cell.packet(true);
            state = cell.control.get().unwrap().message.clone();
        }
        assert_eq!(state.force_reference_n, 4.5);
        assert!((state.force_n - 4.5).abs() < 0.3, "{}", state.force_n);
        cell.end();
    });
}

#[test]
fn answering_a_packet_allocates_nothing() {
    timed(|| {
        let mut cell = Cell::sliding_for_long();
        // With a recorder subscribed, every message is also left for the publishing thread.
        let recorder = cell.bus.subscribe_raw("**", 64).unwrap();
        for _ in 0..50 {
            cell.packet(true);
        }
        let before = cell.allocations;
        for _ in 0..1000 {
            cell.packet(true);
        }
        assert_eq!(cell.phase(), "slide");
        assert_eq!(cell.allocations, before);
        assert!(recorder.recv_timeout(PATIENCE).is_some());
        cell.end();
    });
}

/// A region whose first round leaves out strips between its rows.
const COVERED: &str = r#"
    name = "plate"
    estimators = ["blend"]
    force.reference_n = 5.0
    [path]
    kind = "region"
    outline_m = [[0.0, 0.0], [0.05, 0.0], [0.05, 0.05], [0.0, 0.05]]
    spacing_m = 0.04
    margin_m = 0.003
    speed_m_per_s = 0.05
    [coverage]
    radius_m = 0.008
    dose_n_s_per_cm2 = [0.4, 20.0]
"#;

#[test]
fn coverage_is_told_after_each_round_and_at_the_end_of_a_task_that_is_stopped() {
    timed(|| {
        let mut cell = Cell::new();
        let told = cell.bus.subscribe(&topics::CONTROL_COVERAGE, 16).unwrap();
        let next = || -> Option<CoverageState> { told.try_recv().map(|m| m.message.clone()) };
        let answer = cell.ask(queries::CONTROL_TASK, "start", COVERED).unwrap();
        assert!(answer.done, "{}", answer.message);
        cell.run_until("slide");
        let before = cell.allocations;
        cell.run_until("done");
        assert_eq!(cell.allocations, before);
        let all: Vec<CoverageState> = std::iter::from_fn(next).collect();
        let [first, .., last] = &all[..] else {
            panic!("{all:?}");
        };
        assert_eq!((first.outcome, last.outcome), (0, 1), "{all:?}");
        assert_eq!((last.task.as_str(), last.holes), ("plate", 0));
        assert_eq!(last.activation, cell.said().activation);
        assert_eq!(last.share_by_round[..1], first.share_by_round[..]);
        assert!(first.share < 0.99 && last.share >= 0.99, "{last:?}");
        assert!((last.area_cm2 - 25.0).abs() < 1.0, "{last:?}");

        cell.slide(COVERED);
        assert!(cell.ask(queries::CONTROL_TASK, "stop", "").unwrap().done);
        cell.run_until("done");
        let ended = next().unwrap();
        assert_eq!((ended.outcome, next()), (4, None), "{ended:?}");
        assert_eq!(
            ended.outcome_text.as_str(),
            "not complete: the task ended before"
        );
        assert!(ended.activation > last.activation && ended.share < 0.5);
        cell.end();
    });
}

#[test]
fn a_wrench_that_falls_silent_stops_the_arm() {
    timed(|| {
        let mut cell = Cell::sliding_for_long();
        // The wrench has stopped: its age grows with real time.
        for _ in 0..1_000_000 {
            cell.packet(false);
            if matches!(cell.phase().as_str(), "fault" | "done") {
                break;
            }
        }
        let state = cell.control.get().unwrap().message.clone();
        assert_eq!(state.phase_text.as_str(), "fault");
        assert!(state.fault.contains("wrench"), "{}", state.fault);
        cell.end();
    });
}
